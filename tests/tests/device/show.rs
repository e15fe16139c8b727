//! `show` and the display against the reference. Cases cover every kind of image, gains, marks, letters, and both
//! orders of colors.

use half::f16;
use sgs_engine::ImageFormat;
use sgs_passes::pipeline::{Display, DisplayRoom, Font, Shown};
use sgs_passes::reference::show::{self as reference, Text};
use sgs_passes::splat::{Letters, MARK_HOLLOW, MARK_RINGED, Mark, ShownKind};
use sgs_tests::Gpu;
use sgs_tests::scenes::Rng;

const SIZE: [u32; 2] = [61, 37];
const LETTERS: Letters = Letters { cell: [5, 7], first: 65, count: 3 };
const ROOM: DisplayRoom = DisplayRoom { columns: 7, rows: 3, marks: 4 };

struct Case {
    image: Vec<[f16; 4]>,
    font: Vec<u8>,
    marks: Vec<Mark>,
    text: Vec<u8>,
}

fn case() -> Case {
    let mut r = Rng::new(5);
    let mut half = |low: f64, high: f64| f16::from_f64(r.between(low, high));
    let mut image: Vec<[f16; 4]> =
        (0..SIZE[0] * SIZE[1]).map(|_| [half(-0.2, 1.3), half(0.0, 1.0), half(0.0, 0.02), f16::ONE]).collect();
    image[3] = [f16::NAN, f16::INFINITY, f16::from_f32(0.5), f16::ONE];
    let font = (0..LETTERS.bytes() as usize).map(|i| (i * 37 % 256) as u8).collect();
    let mark = |at, radius, style| Mark { at, radius, style, color: [0.9, 0.4, 0.1] };
    let marks = vec![
        mark([20.25, 18.5], 6.0, 0),
        mark([40.0, 20.0], 7.5, MARK_RINGED),
        mark([60.0, 36.0], 5.0, MARK_HOLLOW),
        mark([-90.0, 2.0], 5.0, MARK_HOLLOW | MARK_RINGED),
    ];
    // Letters outside the font, before its first or after its last, leave the image unchanged.
    let text = b"ABC\0D@A\0\0\0\0AB\0CCCCCCC".to_vec();
    Case { image, font, marks, text }
}

/// Returns the texels that a display draws.
fn made(gpu: &Gpu, case: &Case, format: ImageFormat, kind: ShownKind, gain: f32, size: u32) -> Vec<[u8; 4]> {
    let font = Font::new(gpu.device(), LETTERS, &case.font).unwrap();
    let mut display = Display::new(gpu.device(), &font, SIZE, format, ROOM).unwrap();
    gpu.device().upload_image(display.image(), bytemuck::cast_slice(&case.image)).unwrap();
    let visible = Shown { kind, gain, marks: &case.marks, text: &case.text, letter_size: size };
    for _ in 0..3 {
        display.submit(&visible).unwrap();
    }
    display.finish().unwrap();
    bytemuck::pod_collect_to_vec(&gpu.device().download_image(display.window()).unwrap())
}

/// Returns a description of the first wrong texel.
fn wrong(case: &Case, texels: &[[u8; 4]], kind: ShownKind, gain: f32, size: u32, blue_first: bool) -> Option<String> {
    let image: Vec<[f64; 3]> =
        case.image.iter().map(|t| [0, 1, 2].map(|c| if t[c].is_finite() { t[c].to_f64() } else { 0.0 })).collect();
    let text = Text { cells: &case.text, columns: 7, size: size as usize, letters: LETTERS, font: &case.font };
    let expected = reference::show(&image, SIZE[0] as usize, kind, f64::from(gain), &case.marks, Some(text));
    assert_eq!(expected.len(), texels.len());
    texels.iter().zip(expected).enumerate().find_map(|(i, (texel, expected))| {
        let order = if blue_first { [2, 1, 0] } else { [0, 1, 2] };
        let near = |c: usize| (f64::from(texel[order[c]]) - 255.0 * expected[c]).abs() < 0.75;
        ((0..3).any(|c| !near(c)) || texel[3] != 255)
            .then(|| format!("pixel {i}: {texel:?}, not {expected:?}, as {kind:?}"))
    })
}

#[test]
fn every_display_mode_matches_reference() {
    let (gpu, case) = (Gpu::new(), case());
    let kinds = [ShownKind::Encoded, ShownKind::Linear, ShownKind::Values, ShownKind::Directions];
    for (k, kind) in kinds.into_iter().enumerate() {
        for (format, gain, size) in
            [(ImageFormat::Bgra8Unorm, 1.0, 1), (ImageFormat::Rgba8Srgb, 2.5, 2), (ImageFormat::Rgba8Unorm, 0.3, 1)]
        {
            let texels = made(&gpu, &case, format, kind, gain, size);
            let blue_first = format == ImageFormat::Bgra8Unorm;
            assert_eq!(wrong(&case, &texels, kind, gain, size, blue_first), None);
            assert!(wrong(&case, &texels, kind, gain, size, !blue_first).is_some());
            assert!(wrong(&case, &texels, kinds[(k + 1) % 4], gain, size, blue_first).is_some(), "{kind:?}");
            let mut damaged = texels.clone();
            damaged[1000][1] ^= 4;
            assert!(wrong(&case, &damaged, kind, gain, size, blue_first).is_some());
        }
    }
}

#[test]
fn marks_and_letters_beyond_capacity_are_dropped() {
    let (gpu, mut case) = (Gpu::new(), case());
    case.marks.push(Mark { at: [5.0, 30.0], radius: 4.0, style: 0, color: [1.0; 3] });
    case.text.truncate(20);
    let texels = made(&gpu, &case, ImageFormat::Rgba8Unorm, ShownKind::Encoded, 1.0, 1);
    case.marks.pop();
    case.text.clear();
    assert_eq!(wrong(&case, &texels, ShownKind::Encoded, 1.0, 1, false), None);
    let refused = |format| {
        let font = Font::new(gpu.device(), LETTERS, &case.font).unwrap();
        Display::new(gpu.device(), &font, SIZE, format, ROOM).err().unwrap().to_string()
    };
    assert!(refused(ImageFormat::Rgba16Float).contains("rgba16float"));
    assert!(refused(ImageFormat::R32Uint).contains("r32uint"));
}

#[test]
fn smaller_images_are_interpolated() {
    let gpu = Gpu::new();
    let font = Font::new(gpu.device(), LETTERS, &case().font).unwrap();
    let (window, image) = ([60, 36], [20, 12]);
    let mut display = Display::scaled(gpu.device(), &font, [window, image], ImageFormat::Rgba8Unorm, ROOM).unwrap();
    assert_eq!((display.image().size(), display.window().size()), (image, window));
    // Bilinear interpolation reproduces ramps between the centers of the outer pixels.
    let ramp = |x: f32, y: f32| [x / 20.0, y / 12.0, 0.5];
    let texels: Vec<[f16; 4]> = (0..12)
        .flat_map(|y| (0..20).map(move |x| (x, y)))
        .map(|(x, y)| {
            let [r, g, b] = ramp(x as f32 + 0.5, y as f32 + 0.5).map(f16::from_f32);
            [r, g, b, f16::ONE]
        })
        .collect();
    gpu.device().upload_image(display.image(), bytemuck::cast_slice(&texels)).unwrap();
    display.submit(&Shown { kind: ShownKind::Encoded, gain: 1.0, marks: &[], text: &[], letter_size: 1 }).unwrap();
    display.finish().unwrap();
    let found: Vec<[u8; 4]> = bytemuck::pod_collect_to_vec(&gpu.device().download_image(display.window()).unwrap());
    for (i, texel) in found.iter().enumerate() {
        let [x, y] = [(i % 60) as f32, (i / 60) as f32].map(|v| (v + 0.5) / 3.0);
        let expected = ramp(x.clamp(0.5, 19.5), y.clamp(0.5, 11.5));
        assert!(
            (0..3).all(|c| (f32::from(texel[c]) - 255.0 * expected[c]).abs() < 1.0),
            "{i}: {texel:?}, not {expected:?}"
        );
    }
}
