//! Normals learned through shading: gradients against the reference.
//!
//! Lights are unoccluded, attenuated by a visibility field, or occluded by Gaussians. Training restores perturbed
//! normals.

use sgs_config::{Settings, VisibilityKind};
use sgs_engine::graph::{Buffer, Graph};
use sgs_passes::reference::brdf::{V3, unit};
use sgs_passes::reference::lights as reference;
use sgs_passes::reference::rng::Pcg;
use sgs_passes::shade::lights::{Axes, LightModel, Lights, Shape, lights_normals_bwd, lights_prepare, lights_train};
use sgs_passes::shade::{Weights, normals, normals_bwd};
use sgs_run::{Shading, Visibility, displayed, shaded_scene};
use sgs_scene::{Image, Scene, SceneOptions, write_png};
use sgs_tests::lit::{Lit, narrow};
use sgs_tests::rooms::Room;
use sgs_tests::{Gpu, Place, Tolerance, assert_close, worst};
use sgs_train::{Geometry, Intrinsic};

const MODEL: LightModel = LightModel { lights: 4, lobes: 3, axes: Axes::Free };

/// View whose normals are blended from a few Gaussians.
struct Seen {
    case: Lit,
    /// Gaussians and their weights, by pixel.
    rows: Vec<Vec<(usize, f64)>>,
    /// Normals of the Gaussians, of any length.
    normals: Vec<V3>,
    /// Bits of a stored weight.
    weight_bits: u32,
}

impl Seen {
    fn random(size: [usize; 2], gaussians: usize, seed: u32) -> Seen {
        let mut case = Lit::random(size, MODEL, seed % 2 == 1, seed);
        let mut rng = Pcg::new(seed + 5);
        let normals = (0..gaussians).map(|_| [0; 3].map(|_| narrow(rng.range(-1.0, 1.0)))).collect();
        let mut rows: Vec<Vec<(usize, f64)>> = Vec::new();
        for p in 0..case.pixels.len() {
            let first = p % gaussians;
            let mut row: Vec<(usize, f64)> =
                (0..1 + p % 4).map(|k| ((first + k * k) % gaussians, rng.range(0.1, 1.0))).collect();
            row.sort_by_key(|e| e.0);
            row.dedup_by_key(|e| e.0);
            let sum: f64 = row.iter().map(|e| e.1).sum();
            row.iter_mut().for_each(|e| e.1 = narrow(e.1 / sum));
            rows.push(row);
        }
        // One pixel is empty and has no row.
        case.pixels[size[0] / 2].coverage = 0.0;
        rows[size[0] / 2].clear();
        Seen { case, rows, normals, weight_bits: 32 }
    }

    /// Rounds the weights to 16 bits and selects 16-bit storage.
    fn in_16_bits(mut self) -> Seen {
        self.rows.iter_mut().flatten().for_each(|e| e.1 = (e.1 * 65535.0).round() / 65535.0);
        Seen { weight_bits: 16, ..self }
    }

    /// Returns the pixels with normals blended from `normals`.
    fn pixels(&self, normals: &[V3]) -> Vec<reference::Pixel> {
        let mut pixels = self.case.pixels.clone();
        for (pixel, row) in pixels.iter_mut().zip(&self.rows) {
            let mut sum = [0.0; 3];
            row.iter().for_each(|(g, w)| (0..3).for_each(|k| sum[k] += w * normals[*g][k]));
            pixel.normal = if row.is_empty() { [0.0; 3] } else { unit(sum) };
        }
        pixels
    }

    fn loss(&self, normals: &[V3]) -> f64 {
        let c = &self.case;
        let [d, s] = reference::lights(&self.pixels(normals), &c.lights(), c.camera, c.normalizer());
        d.iter().zip(&s).zip(&c.gradient).map(|((d, s), g)| (d + s) * g).sum()
    }

    /// Computes the expected gradient by central differences of the reference.
    fn expected(&self) -> Vec<f64> {
        let mut normals = self.normals.clone();
        let mut found = Vec::new();
        for i in 0..3 * normals.len() {
            let x = normals[i / 3][i % 3];
            let mut at = |x: f64| {
                normals[i / 3][i % 3] = x;
                self.loss(&normals)
            };
            let slope = (at(x + 1e-6) - at(x - 1e-6)) / 2e-6;
            normals[i / 3][i % 3] = x;
            found.push(slope);
        }
        found
    }

    /// Declares the weight matrix in a graph and adds its contents to `inputs`.
    fn weights(&self, g: &mut Graph, inputs: &mut Vec<(Buffer, Vec<u8>)>) -> Weights {
        let count = self.rows.iter().map(Vec::len).sum::<usize>();
        let mut put = |name: &str, data: Vec<u8>| {
            let buffer = g.input(name, data.len() as u64);
            inputs.push((buffer, data));
            buffer
        };
        let words = |v: &[u32]| bytemuck::cast_slice(v).to_vec();
        // The weights are exact in 16 bits.
        let floats = |v: &[f32]| match self.weight_bits {
            16 => {
                let parts = |w: &f32| (w * 65535.0).round() as u32;
                let word = |pair: &[f32]| parts(&pair[0]) | pair.get(1).map_or(0, parts) << 16;
                words(&v.chunks(2).map(word).collect::<Vec<_>>())
            }
            _ => bytemuck::cast_slice(v).to_vec(),
        };
        let (mut starts, mut columns, mut weights) = (vec![0], vec![], vec![]);
        for row in &self.rows {
            columns.extend(row.iter().map(|e| e.0 as u32));
            weights.extend(row.iter().map(|e| e.1 as f32));
            starts.push(columns.len() as u32);
        }
        assert_eq!(columns.len(), count);
        let (mut column_starts, mut rows, mut row_weights) = (vec![0], vec![], vec![]);
        for i in 0..self.normals.len() {
            for (p, row) in self.rows.iter().enumerate() {
                for (_, w) in row.iter().filter(|e| e.0 == i) {
                    rows.push(p as u32);
                    row_weights.push(*w as f32);
                }
            }
            column_starts.push(rows.len() as u32);
        }
        Weights {
            row_starts: put("row_starts", words(&starts)),
            columns: put("columns", words(&columns)),
            weights: put("weights", floats(&weights)),
            column_starts: put("column_starts", words(&column_starts)),
            rows: put("rows", words(&rows)),
            row_weights: put("row_weights", floats(&row_weights)),
            bits: self.weight_bits,
        }
    }

    /// Returns radiance and the gradient of the Gaussians' normals.
    fn run(&self, gpu: &Gpu) -> [Vec<f32>; 2] {
        let t = gpu.tuning();
        let mut g = Graph::new("learned_normals");
        let largest = self.case.size.map(|s| s as u32);
        let mut bound = self.case.bind(&mut g, largest);
        let weights = self.weights(&mut g, &mut bound.inputs);
        let bytes = 12 * self.normals.len() as u64;
        let source = g.input("gaussian_normals", bytes);
        let flat: Vec<f32> = self.normals.iter().flatten().map(|x| *x as f32).collect();
        bound.inputs.push((source, bytemuck::cast_slice(&flat).to_vec()));
        let screen = bound.pixels.screen;
        let learned = normals(&mut g, &t, &screen, source, &weights).unwrap();
        bound.pixels.surfaces = learned.of(&bound.pixels.surfaces);
        let model = self.case.raw.model;
        let prepared =
            lights_prepare(&mut g, t, "lights_prepare", screen.step, model, &bound.parameters, None).unwrap();
        let shape = Shape { per_lane: 2, ..Shape::for_device(t) };
        let what = Lights { pixels: bound.pixels, prepared, normalizer: self.case.normalizer() as f32, shape };
        let direct = g.external("direct", 12 * self.case.pixels.len() as u64);
        lights_train(&mut g, &what, direct).unwrap();
        let by_pixel = g.transient("normals_gradient", 12 * self.case.pixels.len() as u64);
        lights_normals_bwd(&mut g, &what, bound.gradient, by_pixel).unwrap();
        let gradient = g.external("grad_normals", bytes);
        normals_bwd(&mut g, &t, &learned, &weights, self.normals.len() as u32, by_pixel, gradient).unwrap();
        let out = gpu.run(g, &bound.inputs);
        [out.get(direct), out.get(gradient)]
    }
}

fn tolerance(expected: &[f64]) -> Tolerance {
    let largest = expected.iter().fold(0.0_f64, |a, b| a.max(b.abs()));
    Tolerance::new(2e-5 * largest, 1e-3)
}

#[test]
fn normal_gradients_match_differences_of_the_reference() {
    let gpu = Gpu::new();
    let cases = [(1, [7, 5], 5), (2, [17, 9], 40), (3, [31, 4], 1)].map(|(seed, size, n)| Seen::random(size, n, seed));
    for seen in cases.into_iter().chain([Seen::random([17, 9], 40, 2).in_16_bits()]) {
        let [direct, gradient] = seen.run(&gpu);
        let c = &seen.case;
        let [d, s] = reference::lights(&seen.pixels(&seen.normals), &c.lights(), c.camera, c.normalizer());
        let whole: Vec<f64> = d.iter().zip(&s).map(|(d, s)| d + s).collect();
        assert_close("radiance", &whole, &direct, tolerance(&whole));
        let expected = seen.expected();
        assert!(expected.iter().any(|e| e.abs() > 1e-3));
        assert_close("gradient of normals", &expected, &gradient, tolerance(&expected));
        assert!(seen.run(&gpu) == [direct, gradient], "not the same every time");
        // The comparison detects errors of 1 % in every fifth number.
        let scaled: Vec<f32> =
            expected.iter().enumerate().map(|(i, x)| (x * if i % 5 == 0 { 1.01 } else { 1.0 }) as f32).collect();
        assert!(worst(&expected, &scaled, tolerance(&expected)).is_some_and(|w| w.3 > 1.0));
    }
}

/// Gradients stay finite for canceling, zero, huge and tiny normals.
///
/// Zero, tiny and canceling normals have zero gradients.
#[test]
fn extremes_are_finite() {
    let gpu = Gpu::new();
    for scale in [0.0, 1e-30, 1e-6, 1e20] {
        let mut seen = Seen::random([9, 9], 6, 4);
        seen.normals.iter_mut().flatten().for_each(|x| *x = narrow(*x * scale));
        let found = seen.run(&gpu);
        assert!(found.iter().flatten().all(|x| x.is_finite()), "normals times {scale}");
        assert!(scale > 1e-3 || found[1].iter().all(|x| *x == 0.0), "normals times {scale}");
    }
    let mut seen = Seen::random([8, 2], 2, 6);
    seen.normals = vec![[0.3, -0.4, 0.5], [-0.3, 0.4, -0.5]];
    seen.rows.iter_mut().for_each(|row| *row = vec![(0, 0.5), (1, 0.5)]);
    assert!(seen.run(&gpu).iter().flatten().all(|x| *x == 0.0));
}

fn settings(steps: u32) -> Settings {
    let mut s = Settings::default();
    s.geometry.steps = 60;
    s.geometry.densify.until = 0.0;
    let i = &mut s.intrinsic;
    i.steps = steps;
    i.environment.resolution = 0;
    (i.lights.grid, i.lights.start, i.visibility.kind) = (2, 200.0, VisibilityKind::None);
    (i.rates.materials, i.rates.lights, i.rates.normals) = (0.0, 0.0, 0.02);
    (i.losses.albedo_smooth, i.losses.roughness_smooth, i.losses.light_position, i.losses.light_value) =
        (0.0, 0.0, 0.0, 0.0);
    s
}

/// Computes the mean angle between pixel normals of the training views, in degrees.
fn apart(gpu: &Gpu, scene: &Scene, a: &sgs_scene::Splats, b: &sgs_scene::Splats) -> f64 {
    let (mut sum, mut count) = (0.0, 0.0);
    let mut shading = [a, b].map(|s| {
        Shading::new(gpu.device(), shaded_scene(gpu.device(), s, None, None, &Visibility::None).unwrap()).unwrap()
    });
    for &i in &scene.split.train {
        let [x, y] = [0, 1].map(|k| shading[k].shade(&scene.views[i].camera).unwrap().normal().data);
        for (p, q) in x.chunks_exact(3).zip(y.chunks_exact(3)) {
            let dot: f64 = p.iter().zip(q).map(|(p, q)| f64::from(p * q)).sum();
            sum += dot.clamp(-1.0, 1.0).acos().to_degrees();
            count += 1.0;
        }
    }
    sum / count
}

/// Training restores perturbed normals from rendered photographs.
///
/// Photographs are the stage's own renders of true normals under the initial lights. Only normals are trained.
#[test]
fn training_restores_perturbed_normals() {
    let place = Place::new(Room { priors: true, ..Room::default() });
    let gpu = Gpu::new();
    let options = SceneOptions::default();
    let scene = Scene::open(&place.path("scene"), &options).unwrap();
    let s = settings(160);
    let mut geometry = Geometry::new(gpu.device(), &scene, &s, None).unwrap();
    geometry.train(60, |_| {}, || true).unwrap();
    let splats = geometry.splats().unwrap();
    drop(geometry);
    let start = Intrinsic::new(gpu.device(), &scene, &s, &splats).unwrap();
    let (right, lights) = (start.splats().unwrap(), start.lights().unwrap());
    drop(start);
    let shown = shaded_scene(gpu.device(), &right, lights.as_ref(), None, &Visibility::None).unwrap();
    let mut shading = Shading::new(gpu.device(), shown).unwrap();
    for view in &scene.views {
        let rendered: Image = displayed(&shading.shade(&view.camera).unwrap().radiance([0.0; 3]));
        let mean = rendered.data.iter().sum::<f32>() / rendered.data.len() as f32;
        println!("{}: mean {mean}", view.camera.name);
        assert!((0.2..0.8).contains(&mean), "images are too dark or too bright: {mean}");
        write_png(&view.image_path, &rendered).unwrap();
    }
    let scene = Scene::open(&place.path("scene"), &options).unwrap();
    // Half of the normals lean one way, half another.
    let mut bent = right.clone();
    for (i, n) in bent.normals.as_mut().unwrap().iter_mut().enumerate() {
        let lean = if i % 2 == 0 { [0.0, 0.5, 0.3] } else { [0.4, 0.1, -0.4] };
        let length = n.iter().map(|x| x * x).sum::<f32>().sqrt();
        (0..3).for_each(|k| n[k] += length * lean[k]);
    }
    let train = |resumed_at: Option<u32>| {
        let mut training = Intrinsic::new(gpu.device(), &scene, &s, &bent).unwrap();
        if let Some(at) = resumed_at {
            let file = place.path("state");
            training.train(at, |_| {}, || true).unwrap();
            training.save(&file).unwrap();
            training = Intrinsic::new(gpu.device(), &scene, &s, &bent).unwrap();
            training.restore(&file).unwrap();
        }
        training.train(160, |_| {}, || true).unwrap();
        (training.splats().unwrap(), training.lights().unwrap())
    };
    let (learned, lit) = train(None);
    assert!(learned.albedo == right.albedo && learned.roughness == right.roughness && lit == lights, "others moved");
    let (before, after) = (apart(&gpu, &scene, &right, &bent), apart(&gpu, &scene, &right, &learned));
    println!("normals are {before} degrees off before, {after} after");
    assert!(before > 10.0 && after < 0.6 * before, "normals are {before} degrees off before, {after} after");
    assert!(train(Some(31)).0 == learned, "an interruption matters");
}
