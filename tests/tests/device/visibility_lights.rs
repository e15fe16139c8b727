//! Lights with visibility from the field. Radiance is unoccluded radiance times visibility, and the field's gradients
//! match the reference.

use sgs_engine::MatrixShape;
use sgs_engine::graph::{Buffer, Graph};
use sgs_passes::reference::visibility as reference;
use sgs_passes::shade::lights::{
    LightModel, LightParameterGradients, LightParameters, Lights, Shape, lights, lights_normals_bwd, lights_prepare,
    lights_prepare_bwd,
};
use sgs_passes::shade::visibility::{
    BackwardOptions, Gradients, VisibilityField, lights_bwd_field, lights_field, lights_normals_bwd_field,
    lights_split_field, lights_train_field, packed_tables, visibility_lights_bwd,
};
use sgs_passes::shade::{PixelMaterials, Pixels, Surfaces};
use sgs_passes::splat::Screen;
use sgs_passes::{Accuracy, Matrices, Tuning};
use sgs_shaders::structs::Step;
use sgs_tests::field::{Case, Found, SMALL, tiles, whole};
use sgs_tests::{Gpu, Tolerance, assert_close};

const SIZE: [u32; 2] = [13, 7];
const PIXELS: usize = 91;
const LIGHTS: usize = 3;

fn bytes<T: bytemuck::NoUninit>(data: &[T]) -> Vec<u8> {
    bytemuck::cast_slice(data).to_vec()
}

fn model() -> LightModel {
    LightModel { lights: LIGHTS as u32, lobes: 2, ..Default::default() }
}

/// Case of a field, with surfaces.
struct Scene {
    case: Case,
    normals: Vec<[f32; 3]>,
    materials: Vec<[f32; 4]>,
    metallic: Vec<f32>,
    gradient: Vec<[f32; 3]>,
}

impl Scene {
    fn new() -> Scene {
        let case = Case::random(SMALL, PIXELS, LIGHTS, 30);
        let wave = |i: usize, k: usize| (1.7 * i as f32 + 2.3 * k as f32).sin();
        let unit = |v: [f32; 3]| {
            let length = v.iter().map(|x| x * x).sum::<f32>().sqrt();
            v.map(|x| x / length)
        };
        Scene {
            case,
            normals: (0..PIXELS).map(|i| unit([0, 1, 2].map(|k| wave(i, k)))).collect(),
            materials: (0..PIXELS).map(|i| [3, 4, 5, 6].map(|k| 0.55 + 0.4 * wave(i, k))).collect(),
            metallic: (0..PIXELS).map(|i| 0.5 + 0.5 * wave(i, 7)).collect(),
            gradient: (0..PIXELS).map(|i| [8, 9, 10].map(|k| wave(i, k))).collect(),
        }
    }

    /// Declares the lights with these gains; returns them with their inputs.
    fn declare(&self, gpu: &Gpu, g: &mut Graph, metallic: bool, gains: &[f32]) -> (Lights, Vec<(Buffer, Vec<u8>)>) {
        let (lights, _, inputs) = self.declare_with(gpu, g, metallic, gains);
        (lights, inputs)
    }

    /// Declares the lights like [`Self::declare`]; also returns their raw parameters.
    fn declare_with(
        &self,
        gpu: &Gpu,
        g: &mut Graph,
        metallic: bool,
        gains: &[f32],
    ) -> (Lights, LightParameters, Vec<(Buffer, Vec<u8>)>) {
        let mut inputs = Vec::new();
        let mut provided = |g: &mut Graph, name: &str, data: Vec<u8>| {
            let buffer = g.input(name, data.len() as u64);
            inputs.push((buffer, data));
            buffer
        };
        let mut lobes = model().start_lobes();
        lobes.iter_mut().enumerate().for_each(|(i, x)| *x += 0.3 * (i as f32).cos());
        let parameters = LightParameters {
            positions: provided(g, "positions", bytes(&self.case.lights)),
            lobes: provided(g, "lobes", bytes(&lobes)),
            gains: provided(g, "gains", bytes(gains)),
        };
        let surfaces = Surfaces {
            points: provided(g, "points", bytes(&self.case.points)),
            normals: provided(g, "normals", bytes(&self.normals)),
            coverage: provided(g, "coverage", bytes(&self.case.coverage)),
        };
        let materials = PixelMaterials {
            materials: provided(g, "materials", bytes(&self.materials)),
            metallic: metallic.then(|| provided(g, "metallic", bytes(&self.metallic))),
        };
        let step = g.uniform("step", size_of::<Step>() as u64);
        let mut values = Step::default();
        values.camera.size = SIZE;
        values.camera.position = [0.3, 0.1, 1.2];
        inputs.push((step, bytes(&[values])));
        let tuning = gpu.tuning();
        let prepared = lights_prepare(g, tuning, "lights_prepare", step, model(), &parameters, None).unwrap();
        let screen = Screen { step, largest: SIZE, tile: tuning.tile };
        let pixels = Pixels { screen, surfaces, materials };
        (Lights { pixels, prepared, normalizer: 0.25, shape: Shape::for_device(tuning) }, parameters, inputs)
    }

    fn field(&self, g: &mut Graph, inputs: &mut Vec<(Buffer, Vec<u8>)>) -> sgs_passes::shade::visibility::Field {
        let handles = VisibilityField::handles(g, self.case.config, false, self.case.table_bits);
        let f = handles.field;
        inputs.push((f.levels, bytes(&self.case.config.table_levels())));
        inputs.push((f.tables, bytes(&self.case.tables)));
        inputs.push((f.mlp, bytes(&self.case.mlp)));
        inputs.extend(f.packed.map(|b| (b, bytes(&packed_tables(&self.case.tables)))));
        inputs.push((f.step, bytes(&[self.case.step])));
        f
    }

    /// Returns the radiance under each light alone, without occlusion.
    fn unshadowed(&self, gpu: &Gpu, metallic: bool) -> Vec<Vec<f32>> {
        let alone = |j: usize| {
            let gains: Vec<f32> = (0..LIGHTS).map(|i| f32::from(i == j)).collect();
            let mut g = Graph::new("lights");
            let (what, inputs) = self.declare(gpu, &mut g, metallic, &gains);
            let direct = g.external("direct", 12 * PIXELS as u64);
            lights(&mut g, &what, direct).unwrap();
            gpu.run(g, &inputs).get::<f32>(direct)
        };
        (0..LIGHTS).map(alone).collect()
    }
}

/// Compares images with unoccluded radiance times `visibility`. Images come from every lighting pass.
fn seen_as(gpu: &Gpu, tuning: Tuning, scene: &Scene, visibility: impl Fn(usize, usize) -> f64, tolerance: Tolerance) {
    for metallic in [false, true] {
        let alone = scene.unshadowed(gpu, metallic);
        assert!(alone.iter().all(|a| a.iter().any(|x| *x > 0.0)));
        let mut expected = vec![0.0; 3 * PIXELS];
        for i in 0..PIXELS {
            for j in 0..LIGHTS {
                (0..3).for_each(|k| expected[3 * i + k] += visibility(i, j) * f64::from(alone[j][3 * i + k]));
            }
        }
        let mut g = Graph::new("lights_field");
        let (what, mut inputs) = scene.declare(gpu, &mut g, metallic, &[1.0; LIGHTS]);
        let field = scene.field(&mut g, &mut inputs);
        let [image, direct, split, diffuse] =
            ["image", "direct", "split", "diffuse"].map(|n| g.external(n, 12 * PIXELS as u64));
        lights_field(&mut g, tuning, &what, &field, image).unwrap();
        lights_split_field(&mut g, tuning, &what, &field, split, diffuse).unwrap();
        let sums = lights_train_field(&mut g, tuning, &what, &field, direct).unwrap();
        let retained = g.external("kept", PIXELS as u64 * if metallic { 48 } else { 24 });
        g.copy("keep", sums.buffer, retained).unwrap();
        let out = gpu.run(g, &inputs);
        assert_close("image", &expected, &out.get(image), tolerance);
        assert_close("in training", &expected, &out.get(direct), tolerance);
        assert_close("in parts", &expected, &out.get(split), tolerance);
        let (whole, diffuse) = (out.get::<f32>(split), out.get::<f32>(diffuse));
        assert!(whole.iter().zip(&diffuse).all(|(w, d)| *d >= 0.0 && *d <= w * (1.0 + 1e-5)));
        assert!(out.get::<f32>(retained).iter().all(|x| x.is_finite()));
    }
}

#[test]
fn light_visibility_matches_field() {
    let gpu = Gpu::new();
    let scene = Scene::new();
    let (field, at) = (scene.case.reference(), |v: &[[f32; 3]], i: usize| Case::wide(v[i]));
    let visibility = |i, j| field.visibility(at(&scene.case.points, i), at(&scene.case.lights, j));
    // Kernels of GPUs and of CPUs.
    for cpu in [false, true] {
        seen_as(&gpu, Tuning { cpu, ..gpu.tuning() }, &scene, visibility, Tolerance::new(1e-7, 1e-4));
    }
}

/// Tests a field with 16-bit tables. Its visibility differs from that with 32-bit tables.
#[test]
fn light_visibility_matches_16_bit_tables() {
    let gpu = Gpu::new();
    let mut scene = Scene::new();
    let exact = scene.case.reference();
    scene.case.table_bits = 16;
    let (field, at) = (scene.case.reference(), |v: &[[f32; 3]], i: usize| Case::wide(v[i]));
    let of = |f: &reference::Field, i, j| f.visibility(at(&scene.case.points, i), at(&scene.case.lights, j));
    let apart = (0..PIXELS).map(|i| (of(&field, i, 0) - of(&exact, i, 0)).abs()).fold(0.0, f64::max);
    assert!(apart > 1e-5 && apart < 1e-3, "{apart}");
    seen_as(&gpu, gpu.tuning(), &scene, |i, j| of(&field, i, j), Tolerance::new(1e-7, 1e-4));
    // The second layer also uses tiles of 16-bit operands.
    let own = gpu.tuning().with(Accuracy { visibility_bits: 16, ..Accuracy::EXACT });
    let matrices = Matrices { shape: MatrixShape { rows: 16, columns: 8, depth: 16 }, units: false };
    let half = |i, j| field.visibility_half(at(&scene.case.points, i), at(&scene.case.lights, j));
    seen_as(&gpu, Tuning { matrices: Some(matrices), ..own }, &scene, half, Tolerance::new(1e-7, 2e-4));
}

/// Tests a second layer with tiles of 16-bit operands; the reference rounds them too. Layers are so large that exact
/// operands would be detected.
#[test]
fn light_visibility_matches_half_precision_field() {
    let gpu = Gpu::new();
    let mut scene = Scene::new();
    let first = 32 * scene.case.config.inputs();
    scene.case.mlp[first..].iter_mut().for_each(|w| *w *= 4.0);
    let (field, at) = (scene.case.reference(), |v: &[[f32; 3]], i: usize| Case::wide(v[i]));
    let exact = |i, j| field.visibility(at(&scene.case.points, i), at(&scene.case.lights, j));
    let half = |i, j| field.visibility_half(at(&scene.case.points, i), at(&scene.case.lights, j));
    let pairs = (0..PIXELS).flat_map(|i| (0..LIGHTS).map(move |j| (i, j)));
    let apart = pairs.map(|(i, j)| ((half(i, j) - exact(i, j)) / exact(i, j)).abs()).fold(0.0, f64::max);
    assert!(apart > 4e-4, "{apart}");
    let own = gpu.tuning().with(Accuracy { visibility_bits: 16, ..Accuracy::EXACT });
    let matrices = Matrices { shape: MatrixShape { rows: 16, columns: 8, depth: 16 }, units: false };
    seen_as(&gpu, Tuning { matrices: Some(matrices), ..own }, &scene, half, Tolerance::new(1e-7, 1e-4));
    match own.field_matrices() {
        Some(_) => seen_as(&gpu, own, &scene, half, Tolerance::new(1e-7, 1e-4)),
        None => println!("not on matrix units: {}", Matrices::for_device(gpu.device().info()).unwrap_err()),
    }
}

#[test]
fn field_gradients_under_lights_match_reference() {
    let gpu = Gpu::new();
    let mut scene = Scene::new();
    let kernels = [(false, 0.0, 32, None), (true, 2e-3, 32, None), (true, 0.0, 16, None)];
    // Those of GPUs and CPUs, whichever the device has.
    let others = [(true, 2e-3, 32, Some(false)), (true, 2e-3, 32, Some(true))];
    let kernels = kernels.into_iter().chain(others).map(|kernel| (kernel, None));
    // Products of 16-bit operands.
    let halves = [[16, 8, 16], [8, 8, 8]].map(|shape| ((true, 2e-3, 32, Some(false)), Some(tiles(shape))));
    for ((metallic, regularizer, table_bits, cpu), matrices) in kernels.chain(halves) {
        scene.case.cpu = cpu;
        scene.case.matrices = matrices;
        scene.case.step.regularizer = regularizer;
        scene.case.table_bits = table_bits;
        let alone = scene.unshadowed(&gpu, metallic);
        let options = BackwardOptions { regularized: regularizer > 0.0, ..Default::default() };
        let requested = |i: usize, j: usize| -> f64 {
            (0..3).map(|k| f64::from(scene.gradient[i][k]) * f64::from(alone[j][3 * i + k])).sum()
        };
        let expected = scene.case.expected_gradients(&options, requested);
        let mut g = Graph::new("visibility_lights_bwd");
        let (what, mut inputs) = scene.declare(&gpu, &mut g, metallic, &[1.0; LIGHTS]);
        let field = scene.field(&mut g, &mut inputs);
        let entries = scene.case.config.entries() as usize;
        let gradient = g.input("gradient", 12 * PIXELS as u64);
        let into = Gradients {
            mlp: g.external("mlp_gradient", 4 * scene.case.mlp.len() as u64),
            lights: g.external("light_gradients", 12 * LIGHTS as u64),
            tables: g.external("table_gradients", 16 * entries as u64),
            touched: g.external("touched", 4 * entries.div_ceil(32) as u64),
            scale: g.external("scale", 8),
        };
        inputs.push((gradient, bytes(&scene.gradient)));
        inputs.push((into.tables, vec![0; 16 * entries]));
        inputs.push((into.touched, vec![0; 4 * entries.div_ceil(32)]));
        // The pass adds to the lights' own gradients.
        let before = if matrices.is_some() { 0.0 } else { 100.0_f32 };
        inputs.push((into.lights, bytes(&[[before; 3]; LIGHTS])));
        let options = BackwardOptions { add_places: true, ..options };
        let tuning = scene.case.tuning(&gpu);
        visibility_lights_bwd(&mut g, tuning, &what, &field, gradient, &options, &into).unwrap();
        let out = gpu.run(g, &inputs);
        let (words, scale) = (out.get::<u32>(into.tables), out.get::<f32>(into.scale));
        let found = Found {
            mlp: out.get(into.mlp),
            lights: out.get::<f32>(into.lights).iter().map(|x| x - before).collect(),
            tables: words.chunks(2).map(|w| whole(w, scale[1])).collect(),
            words,
            touched: out.get(into.touched),
            scale: scale[0],
        };
        if matrices.is_some() {
            scene.case.rounded_gradients(options.regularized, requested).check(&found, 2e-5);
            continue;
        }
        // A value added to 100 keeps 17 bits after the binary point.
        found.check(&expected, false, 2e-5);
        let lights = expected.lights.as_flattened();
        assert_close("lights", lights, &found.lights, Tolerance::new(2e-5, 1e-3));
    }
}

/// Tests gradients of amplitudes. Radiance is proportional to amplitudes. Gradients of a light's logarithmic amplitudes
/// thus add up, per channel, to its radiance times the image's gradient, visibility included.
#[test]
fn light_gradients_scale_with_visibility() {
    let gpu = Gpu::new();
    for (table_bits, cpu) in [(32, Some(false)), (32, Some(true)), (16, None)] {
        let mut scene = Scene::new();
        scene.case = Case { table_bits, cpu, ..scene.case };
        learn_as_seen(&gpu, &scene);
    }
}

fn learn_as_seen(gpu: &Gpu, scene: &Scene) {
    let alone = scene.unshadowed(gpu, true);
    let mut g = Graph::new("lights_bwd_field");
    let (what, parameters, mut inputs) = scene.declare_with(gpu, &mut g, true, &[1.0; LIGHTS]);
    let field = scene.field(&mut g, &mut inputs);
    let gradient = g.input("gradient", 12 * PIXELS as u64);
    inputs.push((gradient, bytes(&scene.gradient)));
    let into = LightParameterGradients {
        positions: g.external("position_gradients", model().position_bytes()),
        lobes: g.external("lobe_gradients", model().lobe_bytes()),
    };
    let gradients = lights_bwd_field(&mut g, scene.case.tuning(gpu), &what, &field, gradient).unwrap();
    lights_prepare_bwd(&mut g, &what.prepared, &parameters, &gradients, None, &into).unwrap();
    let found = gpu.run(g, &inputs).get::<f32>(into.lobes);
    let reference = scene.case.reference();
    let (mut expected, mut sums) = (vec![], vec![]);
    for j in 0..LIGHTS {
        for k in 0..3 {
            let sent = |i: usize| {
                let seen = reference.visibility(Case::wide(scene.case.points[i]), Case::wide(scene.case.lights[j]));
                seen * f64::from(alone[j][3 * i + k]) * f64::from(scene.gradient[i][k])
            };
            expected.push((0..PIXELS).map(sent).sum::<f64>());
            sums.push((0..2).map(|lobe| found[6 * (2 * j + lobe) + 3 + k]).sum::<f32>());
        }
    }
    let largest = expected.iter().fold(0.0_f64, |a, e| a.max(e.abs()));
    assert_close("amplitudes", &expected, &sums, Tolerance::new(1e-5 * largest, 1e-4));
}

/// Tests gradients of normals. They are the gradients under each light alone, times its visibility.
#[test]
fn normal_gradients_scale_with_visibility() {
    let gpu = Gpu::new();
    for (table_bits, cpu) in [(32, Some(false)), (32, Some(true)), (16, None)] {
        let mut scene = Scene::new();
        scene.case = Case { table_bits, cpu, ..scene.case };
        normals_learn_as_seen(&gpu, &scene);
    }
}

fn normals_learn_as_seen(gpu: &Gpu, scene: &Scene) {
    let run = |gains: &[f32], hidden: bool| {
        let mut g = Graph::new("lights_normals_bwd_field");
        let (what, mut inputs) = scene.declare(gpu, &mut g, true, gains);
        let gradient = g.input("gradient", 12 * PIXELS as u64);
        inputs.push((gradient, bytes(&scene.gradient)));
        let normals = g.external("normals_gradient", 12 * PIXELS as u64);
        if hidden {
            let field = scene.field(&mut g, &mut inputs);
            lights_normals_bwd_field(&mut g, scene.case.tuning(gpu), &what, &field, gradient, normals).unwrap();
        } else {
            lights_normals_bwd(&mut g, &what, gradient, normals).unwrap();
        }
        gpu.run(g, &inputs).get::<f32>(normals)
    };
    let reference = scene.case.reference();
    let mut expected = vec![0.0; 3 * PIXELS];
    for j in 0..LIGHTS {
        let gains: Vec<f32> = (0..LIGHTS).map(|i| f32::from(i == j)).collect();
        let alone = run(&gains, false);
        for (i, e) in expected.iter_mut().enumerate() {
            let point = Case::wide(scene.case.points[i / 3]);
            *e += reference.visibility(point, Case::wide(scene.case.lights[j])) * f64::from(alone[i]);
        }
    }
    let largest = expected.iter().fold(0.0_f64, |a, e| a.max(e.abs()));
    assert!(largest > 0.0);
    let found = run(&[1.0; LIGHTS], true);
    assert_close("normals", &expected, &found, Tolerance::new(1e-5 * largest, 1e-4));
}
