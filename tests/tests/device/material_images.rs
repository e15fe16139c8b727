//! Material images and composed images on the device against their references. Gradients are also tested against finite
//! differences of the references.

use sgs_engine::graph::Graph;
use sgs_passes::loss::{
    Compose, MaterialImages, Materials, compose, compose_bwd, material_images, material_images_bwd,
};
use sgs_passes::reference::rng::Pcg;
use sgs_passes::reference::{compose as composed, material_images as pictured};
use sgs_shaders::structs::Step;
use sgs_tests::{Gpu, Tolerance, assert_close, worst};

/// Number of pixels of the buffers beyond those of the view.
const SPARE: usize = 37;
const TOLERANCE: Tolerance = Tolerance::new(2e-6, 2e-5);
const SIZES: [[usize; 2]; 5] = [[1, 1], [17, 3], [1, 40], [16, 16], [97, 61]];

fn bytes<T: bytemuck::NoUninit>(data: &[T]) -> Vec<u8> {
    bytemuck::cast_slice(data).to_vec()
}

/// Rounds to single precision, so that the reference gets the device's inputs.
fn narrow(x: f64) -> f64 {
    f64::from(x as f32)
}

/// Converts to 32 bits and appends `SPARE` pixels of NaN.
fn single(data: &[f64], channels: usize) -> Vec<f32> {
    data.iter().map(|&x| x as f32).chain(std::iter::repeat_n(f32::NAN, SPARE * channels)).collect()
}

/// Returns the first `count` values; fails if any later value was written.
fn front(data: &[f32], count: usize) -> Vec<f32> {
    assert!(data[count..].iter().all(|x| x.to_bits() == u32::MAX), "something behind the view was written");
    data[..count].to_vec()
}

/// View with holes, clamped materials and light, and non-finite values.
struct Case {
    size: [usize; 2],
    coverage: Vec<f64>,
    materials: Vec<[f64; 4]>,
    direct: Vec<[f64; 3]>,
    ambient: Vec<[f64; 3]>,
    background: [f64; 3],
    gradients: [Vec<f64>; 3],
}

impl Case {
    fn new(size: [usize; 2], seed: u32) -> Case {
        let mut rng = Pcg::new(seed);
        let pixels = size[0] * size[1];
        let coverage = (0..pixels).map(|p| narrow([0.0, 5e-4, 2e-3, 1.0, rng.uniform()][p % 5])).collect();
        let mut channel = |low: f64, high: f64| match rng.next_u32() % 16 {
            0 => narrow(rng.range(0.0, 0.006)),
            1 => 0.0,
            2 => narrow(-rng.uniform()),
            3 => narrow(1.0 + rng.uniform()),
            4 => f64::NAN,
            5 => f64::INFINITY,
            _ => narrow(rng.range(low, high)),
        };
        let materials = (0..pixels).map(|_| [(); 4].map(|()| channel(0.0, 1.0))).collect();
        let direct = (0..pixels).map(|_| [(); 3].map(|()| channel(0.0, 0.7))).collect();
        let ambient = (0..pixels).map(|_| [(); 3].map(|()| channel(0.0, 0.5))).collect();
        let gradients = [(); 3].map(|()| (0..3 * pixels).map(|_| narrow(rng.normal())).collect());
        Case { size, coverage, materials, direct, ambient, background: [0.25, 0.02, 1.5], gradients }
    }

    fn pixels(&self) -> usize {
        self.size[0] * self.size[1]
    }

    fn largest(&self) -> [u32; 2] {
        [self.size[0] as u32, self.size[1] as u32 + 2]
    }

    fn step(&self) -> Step {
        let mut step = Step { background: self.background.map(|x| x as f32), ..Default::default() };
        step.camera.size = self.size.map(|s| s as u32);
        step
    }

    /// Returns the sum of the requested ones of `direct` and `ambient`, in 32 bits.
    fn radiance(&self, direct: bool, ambient: bool) -> Vec<[f64; 3]> {
        let of = |p: usize, c: usize| {
            let d = if direct { self.direct[p][c] as f32 } else { 0.0 };
            let a = if ambient { self.ambient[p][c] as f32 } else { 0.0 };
            f64::from(d + a)
        };
        (0..self.pixels()).map(|p| [0, 1, 2].map(|c| of(p, c))).collect()
    }
}

/// Returns the material images and the gradient with respect to materials. The gradient buffer holds 0.5 before the
/// pass, which adds to it.
fn run_images(gpu: &Gpu, case: &Case, roughness: bool) -> [Vec<f32>; 3] {
    let room = case.pixels() + SPARE;
    let mut g = Graph::new("material_images");
    let step = g.uniform("step", size_of::<Step>() as u64);
    let materials = g.input("materials", 16 * room as u64);
    let coverage = g.input("coverage", 4 * room as u64);
    let by_albedo = g.input("by_albedo", 12 * room as u64);
    let by_roughness = g.input("by_roughness", 12 * room as u64);
    let (albedo, gray) = (g.external("albedo", 12 * room as u64), g.external("gray", 12 * room as u64));
    let gradient = g.external("gradient", 16 * room as u64);
    let a = Materials { step, materials, coverage, largest: case.largest() };
    let into = MaterialImages { albedo, roughness: roughness.then_some(gray) };
    material_images(&mut g, gpu.tuning(), &a, &into).unwrap();
    let by = MaterialImages { albedo: by_albedo, roughness: roughness.then_some(by_roughness) };
    material_images_bwd(&mut g, gpu.tuning(), &a, &by, gradient).unwrap();
    let inputs = [
        (step, bytes(&[case.step()])),
        (materials, bytes(&single(case.materials.as_flattened(), 4))),
        (coverage, bytes(&single(&case.coverage, 1))),
        (by_albedo, bytes(&single(&case.gradients[0], 3))),
        (by_roughness, bytes(&single(&case.gradients[1], 3))),
        (gradient, bytes(&vec![0.5_f32; 4 * case.pixels()])),
    ];
    let out = gpu.run(g, &inputs);
    let n = case.pixels();
    let gray = front(&out.get(gray), if roughness { 3 * n } else { 0 });
    [front(&out.get(albedo), 3 * n), gray, front(&out.get(gradient), 4 * n)]
}

#[test]
fn material_images_match_reference() {
    let gpu = Gpu::new();
    for (i, size) in SIZES.into_iter().enumerate() {
        let case = Case::new(size, i as u32);
        let (albedo, gray) = pictured::material_images(&case.materials, &case.coverage);
        for roughness in [true, false] {
            let found = run_images(&gpu, &case, roughness);
            assert_close("albedo", &albedo, &found[0], TOLERANCE);
            let by_gray = if roughness { case.gradients[1].clone() } else { vec![0.0; 3 * case.pixels()] };
            if roughness {
                assert_close("roughness", &gray, &found[1], TOLERANCE);
            }
            let expected = pictured::material_images_bwd(&case.materials, &case.coverage, &case.gradients[0], &by_gray);
            let expected: Vec<f64> = expected.as_flattened().iter().map(|x| x + 0.5).collect();
            assert_close("gradient", &expected, &found[2], TOLERANCE);
        }
    }
}

struct Composed {
    image: Vec<f32>,
    gradient: Vec<f32>,
    saturated: f32,
}

fn run_compose(gpu: &Gpu, case: &Case, direct: bool, ambient: bool) -> Composed {
    let room = case.pixels() + SPARE;
    let mut g = Graph::new("compose");
    let step = g.uniform("step", size_of::<Step>() as u64);
    let [d, a, by] = ["direct", "ambient", "by_image"].map(|name| g.input(name, 12 * room as u64));
    let coverage = g.input("coverage", 4 * room as u64);
    let [image, gradient] = ["image", "gradient"].map(|name| g.external(name, 12 * room as u64));
    let args =
        Compose { step, direct: direct.then_some(d), ambient: ambient.then_some(a), coverage, largest: case.largest() };
    let saturated = compose(&mut g, gpu.tuning(), &args, image).unwrap();
    let sums = g.external("sums", 4 * u64::from(saturated.count));
    g.copy("out.sums", saturated.sums, sums).unwrap();
    compose_bwd(&mut g, gpu.tuning(), &args, by, gradient).unwrap();
    let inputs = [
        (step, bytes(&[case.step()])),
        (d, bytes(&single(case.direct.as_flattened(), 3))),
        (a, bytes(&single(case.ambient.as_flattened(), 3))),
        (by, bytes(&single(&case.gradients[2], 3))),
        (coverage, bytes(&single(&case.coverage, 1))),
    ];
    let out = gpu.run(g, &inputs);
    let n = 3 * case.pixels();
    Composed {
        image: front(&out.get(image), n),
        gradient: front(&out.get(gradient), n),
        saturated: out.get::<f32>(sums).iter().sum(),
    }
}

#[test]
fn composed_images_match_reference() {
    let gpu = Gpu::new();
    for (i, size) in SIZES.into_iter().enumerate() {
        let case = Case::new(size, 10 + i as u32);
        for (direct, ambient) in [(true, true), (true, false), (false, true), (false, false)] {
            let radiance = case.radiance(direct, ambient);
            let (image, saturated) = composed::compose(&radiance, &case.coverage, case.background);
            let found = run_compose(&gpu, &case, direct, ambient);
            assert_close("image", &image, &found.image, TOLERANCE);
            let gradient = composed::compose_bwd(&radiance, &case.coverage, case.background, &case.gradients[2]);
            assert_close("gradient", &gradient, &found.gradient, TOLERANCE);
            assert!((found.saturated - saturated as f32).abs() < 0.5, "{} {saturated}", found.saturated);
        }
    }
}

/// Tests gradients of a weighted sum of all images against finite differences. The differences are those of the
/// references, with respect to materials and light.
#[test]
fn gradients_are_finite_differences_of_the_reference() {
    let gpu = Gpu::new();
    let mut case = Case::new([23, 9], 77);
    let mut rng = Pcg::new(3);
    for p in 0..case.pixels() {
        // Values stay away from clamps and kinks.
        case.materials[p] = [(); 4].map(|()| narrow(rng.range(0.01, 0.98)));
        case.direct[p] = [(); 3].map(|()| narrow(rng.range(0.01, 0.5)));
        case.ambient[p] = [(); 3].map(|()| narrow(rng.range(0.01, 0.4)));
    }
    case.background = [0.25, 0.5, 0.875];
    let found = run_images(&gpu, &case, true);
    let light = run_compose(&gpu, &case, true, true);
    let sum = |values: &[f64], weights: &[f64]| values.iter().zip(weights).map(|(v, w)| v * w).sum::<f64>();
    for p in 0..case.pixels() {
        for c in 0..4 {
            let loss = |x: f64| {
                let mut materials = case.materials.clone();
                materials[p][c] += x;
                let (albedo, gray) = pictured::material_images(&materials, &case.coverage);
                sum(&albedo, &case.gradients[0]) + sum(&gray, &case.gradients[1])
            };
            let fd = (loss(1e-6) - loss(-1e-6)) / 2e-6;
            assert_close("materials", &[fd], &[found[2][4 * p + c] - 0.5], Tolerance::new(1e-5, 1e-4));
        }
        for c in 0..3 {
            let loss = |x: f64| {
                let mut radiance = case.radiance(true, true);
                radiance[p][c] += x;
                sum(&composed::compose(&radiance, &case.coverage, case.background).0, &case.gradients[2])
            };
            let fd = (loss(1e-6) - loss(-1e-6)) / 2e-6;
            assert_close("light", &[fd], &[light.gradient[3 * p + c]], Tolerance::new(1e-5, 1e-4));
        }
    }
}

/// Tests that the comparison detects planted errors. Errors are: a coverage off by 0.1 %, another encoding.
#[test]
fn checks_can_fail() {
    let case = Case::new([17, 3], 1);
    let radiance = case.radiance(true, true);
    let of = |coverage: &[f64]| composed::compose_bwd(&radiance, coverage, case.background, &case.gradients[2]);
    let differs = |a: &[f64], b: &[f64]| {
        let b: Vec<f32> = b.iter().map(|&x| x as f32).collect();
        worst(a, &b, TOLERANCE).is_some_and(|w| w.3 > 1.0)
    };
    let exact = of(&case.coverage);
    assert!(!differs(&exact, &exact));
    assert!(differs(&exact, &of(&case.coverage.iter().map(|c| c * 1.001).collect::<Vec<_>>())));
    let (image, _) = composed::compose(&radiance, &case.coverage, case.background);
    assert!(differs(&image, &image.iter().map(|x| x.powf(1.0001)).collect::<Vec<_>>()));
}
