//! Property tests of pixels under an environment map against the reference.
//!
//! All numbers are drawn log-uniformly. Filtered levels, light and material gradients are compared. Failures are
//! shrunk. Every run draws the same cases; `SGS_TEST_CASES` sets their number.
//!
//! Bounds of single precision are measured by the sensitivity of the reference to its inputs, as in
//! `shading_properties`.

use proptest::prelude::*;
use sgs_passes::reference::environment as reference;
use sgs_passes::reference::environment::{Cube, Pixel};
use sgs_passes::reference::rng::Pcg;
use sgs_passes::shade::environment::Environment;
use sgs_tests::drawn::{Compared, runner, signed, spread};
use sgs_tests::environment::{BEFORE, CAMERA, Case, made, narrow, run, unit};
use sgs_tests::{Gpu, Tolerance, assert_close};

/// Perturbation of directions, a few units in the last place.
const MOVE: f64 = 1e-6;

/// Texels along a side of a cube face.
const SIZE: u32 = 16;

#[derive(Clone, Debug)]
struct Drawn {
    pixel: Pixel,
    gradient: [f64; 3],
}

prop_compose! {
    fn drawn()(
        way in [signed(-4.0, 0.0), signed(-4.0, 0.0), signed(-4.0, 0.0)],
        away in spread(-3.0, 3.0),
        normal in [signed(-4.0, 0.0), signed(-4.0, 0.0), signed(-4.0, 0.0)],
        coverage in prop_oneof![4 => spread(-2.9, 0.0), 1 => spread(-6.0, -3.1)],
        albedo in [spread(-6.0, 0.0), spread(-6.0, 0.0), spread(-6.0, 0.0)],
        roughness in spread(-2.5, -1e-4),
        metallic in spread(-6.0, 0.0),
        gradient in [signed(-6.0, 6.0), signed(-6.0, 6.0), signed(-6.0, 6.0)],
    ) -> Drawn {
        let way = unit(way);
        let point = std::array::from_fn(|k| f64::from(CAMERA[k]) + away * way[k]);
        let pixel = narrow(Pixel { point, normal: unit(normal), coverage, albedo, roughness, metallic });
        Drawn { pixel, gradient: gradient.map(|g| f64::from(g as f32)) }
    }
}

prop_compose! {
    /// Draws the base brightness, the brightness of spots, their share, and a seed.
    fn sky()(bright in spread(-8.0, 4.0), spot in spread(-4.0, 6.0), share in spread(-3.0, 0.0), seed in 0..1000_u32)
        -> (f64, f64, f64, u32)
    {
        (bright, spot, share, seed)
    }
}

fn texels(e: &Environment, (bright, spot, share, seed): (f64, f64, f64, u32)) -> Vec<f32> {
    let mut rng = Pcg::new(seed);
    let texel = |_| {
        let bright = bright * rng.range(0.5, 1.5) * if rng.uniform() < share { spot } else { 1.0 };
        bright as f32
    };
    (0..e.floats()).map(texel).collect()
}

/// Computes the reference's light and material gradients of one pixel.
///
/// The first 3 numbers are the light, the other 5 the gradients by albedo, roughness and metallic.
fn truth(e: &Environment, levels: &[Cube], drawn: &Drawn, camera: [f64; 3]) -> [f64; 8] {
    let shade = |p: &Pixel| reference::shade(levels, e.split_sum(), camera, p);
    let p = drawn.pixel;
    let light = shade(&p);
    let mut all = [0.0; 8];
    all[..3].copy_from_slice(&light);
    let x = [p.albedo[0], p.albedo[1], p.albedo[2], p.roughness, p.metallic];
    for k in 0..5 {
        // Light is linear in albedo and in metallic, so a large step is exact.
        let step = if k == 3 { 1e-6 * x[k] } else { 1e-3 };
        let at = |value: f64| -> f64 {
            let mut x = x;
            x[k] = value;
            let moved = Pixel { albedo: [x[0], x[1], x[2]], roughness: x[3], metallic: x[4], ..p };
            let light = shade(&moved);
            (0..3).map(|c| drawn.gradient[c] * light[c]).sum()
        };
        let (up, down) = (x[k] + step, x[k] - step);
        all[3 + k] = (at(up) - at(down)) / (up - down);
    }
    all
}

/// Compares all pixels with the reference.
///
/// Scales the `planted`-th of a pixel's eight numbers by 1.01, if set.
fn check(
    gpu: &Gpu,
    e: &Environment,
    sky: (f64, f64, f64, u32),
    all: &[Drawn],
    planted: Option<usize>,
    compared: &Compared,
) -> Result<(), TestCaseError> {
    let texels = texels(e, sky);
    let pixels: Vec<Pixel> = all.iter().map(|d| d.pixel).collect();
    let gradient: Vec<f32> = all.iter().flat_map(|d| d.gradient).map(|g| g as f32).collect();
    let case =
        Case { e, texels: &texels, pixels: &pixels, gradient: &gradient, smooth: false, metallic: true, merge: false };
    let found = run(gpu, &gpu.tuning(), &case);
    let cube = Cube::from_floats(e.size() as usize, &texels);
    let levels: Vec<Cube> = e.levels().iter().map(|l| reference::prefilter(&cube, l)).collect();
    let expected: Vec<f64> = levels.iter().flat_map(Cube::flat).collect();
    assert_close("radiance", &expected, &found.radiance, Tolerance::new(1e-30, 1e-4));
    prop_assert!(found.texels.iter().all(|x| x.is_finite()));
    let camera = CAMERA.map(f64::from);
    for (i, drawn) in all.iter().enumerate() {
        let p = &drawn.pixel;
        let expected = truth(e, &levels, drawn, camera);
        let mut slack = expected.map(|x| 3e-4 * x.abs());
        let away = (0..3).map(|k| (camera[k] - p.point[k]).powi(2)).sum::<f64>().sqrt();
        for axis in 0..3 {
            let moved = [MOVE, -MOVE].map(|by| {
                let mut other = drawn.clone();
                other.pixel.normal[axis] += by;
                let mut from = camera;
                from[axis] += by * away;
                [truth(e, &levels, &other, camera), truth(e, &levels, drawn, from)]
            });
            for (k, slack) in slack.iter_mut().enumerate() {
                let most = |way: usize| moved.iter().map(|m| (m[way][k] - expected[k]).abs()).fold(0.0, f64::max);
                *slack += most(0) + most(1);
            }
        }
        // Colors may cancel, and so may the terms of each color.
        let white = Pixel { albedo: [1.0; 3], metallic: 0.5, ..*p };
        let white = reference::shade(&levels, e.split_sum(), camera, &white).iter().fold(0.0_f64, |m, x| m.max(*x));
        let brightest = texels.iter().fold(0.0_f64, |m, t| m.max(f64::from(*t)));
        let light: f64 = (0..3).map(|c| drawn.gradient[c].abs() * expected[c].abs()).sum();
        let total_gradient: f64 = drawn.gradient.iter().map(|g| g.abs()).sum();
        for (k, slack) in slack.iter().enumerate() {
            let (is, size) = match k {
                0..3 => (f64::from(found.ambient[3 * i + k]), 1e-9 * brightest),
                3..7 => (
                    f64::from(found.materials[4 * i + k - 3] - BEFORE),
                    3e-6 * light + 3e-6 * total_gradient * white + 1e-9 * total_gradient * brightest,
                ),
                _ => (
                    f64::from(found.metallic[i] - BEFORE),
                    3e-6 * light + 3e-6 * total_gradient * white + 1e-9 * total_gradient * brightest,
                ),
            };
            let is = if planted == Some(k) { 1.01 * is } else { is };
            // Material gradients are added to previous contents, whose rounding counts.
            let before = if k < 3 { 0.0 } else { 1e-7 };
            let t = slack + size + before + 1e-30;
            compared.see(expected[k], t);
            prop_assert!((is - expected[k]).abs() <= t, "{}, {} is {} and not {}, to {}", i, k, is, expected[k], t);
        }
    }
    Ok(())
}

#[test]
fn environment_light_matches_reference() {
    let (gpu, e) = (Gpu::new(), made(SIZE));
    let cases = (sky(), prop::collection::vec(drawn(), 1..20));
    let compared = Compared::default();
    runner(24).run(&cases, |(sky, all)| check(&gpu, &e, sky, &all, None, &compared)).unwrap_or_else(|e| panic!("{e}"));
    compared.check(1000, 0.7);
}

/// Checks that the comparison detects an error of 1 % in any number.
#[test]
fn environment_checks_can_fail() {
    let (gpu, e) = (Gpu::new(), made(SIZE));
    let mut rng = Pcg::new(4);
    let pixel = sgs_tests::environment::pixel(&mut rng, 0.4, 0.6);
    let all = [Drawn { pixel, gradient: [10.0, -7.0, 3.0] }];
    let sky = (1.0, 20.0, 0.1, 3);
    let compared = Compared::default();
    assert!(check(&gpu, &e, sky, &all, None, &compared).is_ok());
    for k in 0..8 {
        assert!(check(&gpu, &e, sky, &all, Some(k), &compared).is_err(), "number {k}");
    }
}
