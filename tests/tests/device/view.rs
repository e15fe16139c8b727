//! Views into images: texels against the renderer, late growth of capacity, and refusals.

use sgs_engine::ImageFormat;
use sgs_engine::graph::ImageState;
use sgs_passes::pipeline::{Frame, Renderer, View, ViewError, ViewOptions, ViewReport};
use sgs_passes::scene::{Gaussians, Model};
use sgs_passes::splat::{Channels, Encoding, Layer, Presented, TexelFormat};
use sgs_tests::{Gpu, scenes};

const SIZE: [u32; 2] = [75, 41];

fn options(layer: Layer, format: TexelFormat) -> ViewOptions {
    ViewOptions {
        size: SIZE,
        presented: Presented { layer, format, encoding: Encoding::Display, depth_scale: 0.25 },
        entry: ImageState::Undefined,
        exit: ImageState::General,
        frames_in_flight: 2,
        entry_capacity: 0,
    }
}

fn upload(gpu: &Gpu, count: usize, normals: bool) -> Gaussians {
    let data = scenes::ordinary(count, 3, normals, 11);
    let model = Model { sh_degree: 3, normals, ..Default::default() };
    let gaussians = Gaussians::new(gpu.device(), model, count as u32, false).unwrap();
    gaussians.upload(gpu.device(), &scenes::data(&data)).unwrap();
    gaussians
}

fn frame() -> Frame {
    Frame { camera: scenes::gpu_camera(&scenes::camera(SIZE)), sh_degree: 9, background: [0.1, 0.2, 0.7] }
}

#[test]
fn view_matches_renderer_output() {
    let gpu = Gpu::new();
    let gaussians = upload(&gpu, 300, true);
    let f = frame();
    let all = Channels { colors: true, normals: true, depth: true };
    let mut renderer = Renderer::new(gpu.device(), gpu.tuning(), &gaussians, SIZE, all).unwrap();
    let rendered = renderer.render(&gaussians, &f.camera, 3, f.background).unwrap();
    for layer in [Layer::Color, Layer::Depth, Layer::Normal, Layer::Alpha] {
        let image = gpu.device().image("target", SIZE, ImageFormat::Rgba32Float).unwrap();
        let mut view =
            View::new(gpu.device(), gpu.tuning(), &gaussians, options(layer, TexelFormat::Rgba32Float)).unwrap();
        for _ in 0..3 {
            view.submit(&gaussians, &image, &f).unwrap();
        }
        view.finish().unwrap();
        assert_eq!(view.report().unwrap().frames, 3);
        assert_eq!(view.report().unwrap().incomplete, 0);
        let texels: Vec<f32> =
            gpu.device().download_image(&image).unwrap().chunks(4).map(bytemuck::pod_read_unaligned).collect();
        for (i, texel) in texels.chunks(4).enumerate() {
            let p = &rendered.image[8 * i..8 * i + 8];
            let alpha = 1.0 - rendered.transmittance[i];
            let expected = match layer {
                Layer::Color => [p[0], p[1], p[2]],
                Layer::Depth => [p[6] * 0.25; 3],
                Layer::Normal => [p[3], p[4], p[5]],
                Layer::Alpha => [alpha; 3],
            };
            assert_eq!(texel, [expected[0], expected[1], expected[2], alpha], "{layer:?}, pixel {i}");
        }
    }
}

#[test]
fn entry_capacity_grows_for_the_next_frame() {
    let gpu = Gpu::new();
    let gaussians = upload(&gpu, 400, false);
    let f = frame();
    let image = gpu.device().image("target", SIZE, ImageFormat::Rgba8Unorm).unwrap();
    let mut small = ViewOptions { entry_capacity: 16, ..options(Layer::Color, TexelFormat::Rgba8Unorm) };
    let mut view = View::new(gpu.device(), gpu.tuning(), &gaussians, small).unwrap();
    assert_eq!(view.entry_capacity(), 16);
    view.submit(&gaussians, &image, &f).unwrap();
    view.finish().unwrap();
    let report = view.report().unwrap();
    assert!(report.incomplete == 1 && report.wanted > 16, "{report:?}");
    let background: Vec<u8> = f.background.iter().map(|v| (v * 255.0 + 0.5) as u8).chain([0]).collect();
    assert!(gpu.device().download_image(&image).unwrap().chunks(4).all(|t| t == background));
    view.submit(&gaussians, &image, &f).unwrap();
    view.finish().unwrap();
    assert!(view.entry_capacity() >= report.wanted);
    assert_eq!(view.report().unwrap(), ViewReport { frames: 2, incomplete: 1, wanted: report.wanted });
    let grown = gpu.device().download_image(&image).unwrap();
    small.entry_capacity = 0;
    let mut roomy = View::new(gpu.device(), gpu.tuning(), &gaussians, small).unwrap();
    roomy.submit(&gaussians, &image, &f).unwrap();
    roomy.finish().unwrap();
    assert_eq!(gpu.device().download_image(&image).unwrap(), grown);
    assert!(grown.chunks(4).any(|t| t != background));
}

#[test]
fn invalid_view_inputs_are_refused() {
    let gpu = Gpu::new();
    let gaussians = upload(&gpu, 10, false);
    let make = |o| View::new(gpu.device(), gpu.tuning(), &gaussians, o).err();
    assert!(matches!(make(options(Layer::Normal, TexelFormat::Rgba32Float)), Some(ViewError::NoNormals)));
    let error = make(options(Layer::Depth, TexelFormat::Bgra8Srgb)).unwrap();
    assert!(error.to_string().contains("Depth cannot be shown in bgra8srgb"), "{error}");
    assert!(make(ViewOptions { size: [0, 4], ..options(Layer::Color, TexelFormat::Rgba8Srgb) }).is_some());
    assert!(matches!(TexelFormat::try_from(ImageFormat::R32Uint), Err(ViewError::Format(_))));
    let mut view =
        View::new(gpu.device(), gpu.tuning(), &gaussians, options(Layer::Color, TexelFormat::Rgba8Srgb)).unwrap();
    let image = |size, format| gpu.device().image("target", size, format).unwrap();
    let other = view.submit(&gaussians, &image([8, 8], ImageFormat::Rgba8Srgb), &frame()).unwrap_err();
    assert!(matches!(other, ViewError::Size { what: "image", .. }), "{other}");
    let other = view.submit(&gaussians, &image(SIZE, ImageFormat::Rgba8Unorm), &frame()).unwrap_err();
    assert!(matches!(other, ViewError::Format(ImageFormat::Rgba8Unorm)), "{other}");
    let mut wrong = frame();
    wrong.camera.size = [4, 4];
    let other = view.submit(&gaussians, &image(SIZE, ImageFormat::Rgba8Srgb), &wrong).unwrap_err();
    assert!(matches!(other, ViewError::Size { what: "camera", .. }), "{other}");
}
