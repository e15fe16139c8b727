//! Benchmark of `lights` and its backward pass under 64 lights of 12 lobes.
//!
//! A sample of pixels is checked against the reference.

use super::Context;
use crate::harness::{Rig, add_passes, bytes};
use crate::report::Report;
use crate::stats::Summary;
use sgs_engine::graph::{Buffer, Graph};
use sgs_passes::cost::Counts;
use sgs_passes::reference::brdf::{Material, unit};
use sgs_passes::reference::lights::{self as reference, Pixel, Raw};
use sgs_passes::reference::rng::Pcg;
use sgs_passes::shade::lights::{
    LightModel, LightParameterGradients, LightParameters, Lights, Shape, lights, lights_bwd, lights_materials_bwd,
    lights_normals_bwd, lights_prepare, lights_prepare_bwd, lights_regularize, lights_train,
};
use sgs_passes::shade::{PixelMaterials, Pixels, Surfaces};
use sgs_passes::splat::Screen;
use sgs_shaders::structs::Step;

pub(super) const CAMERA: [f32; 3] = [0.2, 0.1, -1.2];

/// Shaded scene: the inside of a box with a bumpy surface, and lights inside.
pub struct Lit {
    /// Points by pixel.
    pub points: Vec<[f32; 3]>,
    /// Normals by pixel.
    pub normals: Vec<[f32; 3]>,
    /// Albedo and roughness by pixel.
    pub materials: Vec<[f32; 4]>,
    /// Radiance gradients by pixel.
    pub gradient: Vec<[f32; 3]>,
    /// Positions by light.
    pub positions: Vec<[f32; 3]>,
    /// Rows of all lobes.
    pub lobes: Vec<f32>,
}

impl Lit {
    /// Returns the room as seen by a camera inside it.
    pub fn room([width, height]: [u32; 2], model: LightModel) -> Lit {
        let mut rng = Pcg::new(9);
        let mut lit = Lit {
            points: Vec::new(),
            normals: Vec::new(),
            materials: Vec::new(),
            gradient: Vec::new(),
            positions: model.start_positions([-1.3; 3], [1.3; 3]),
            lobes: model.start_lobes(),
        };
        // Few pixels have a gradient, to limit the cost of the reference. The kernels do not skip zero gradients.
        let each = ((width * height) / 200).max(1);
        lit.lobes.iter_mut().for_each(|x| *x += (0.3 * rng.normal()) as f32);
        for p in 0..width * height {
            let (x, y) =
                (f64::from(p % width) / f64::from(width) - 0.5, f64::from(p / width) / f64::from(height) - 0.5);
            let ray = unit([1.4 * x, 1.1 * y, 1.0]);
            // Intersection of the ray with the box of half side 1.5.
            let camera = CAMERA.map(f64::from);
            let reach = |i: usize| ((1.5_f64.copysign(ray[i])) - camera[i]) / ray[i];
            let face = (0..3).min_by(|&a, &b| reach(a).total_cmp(&reach(b))).unwrap_or(2);
            let point = [0, 1, 2].map(|i| (camera[i] + reach(face) * ray[i]) as f32);
            let mut normal = [0, 1, 2].map(|i| 0.1 * (9.0 * f64::from(point[(i + 1) % 3])).sin());
            normal[face] = -ray[face].signum();
            lit.points.push(point);
            lit.normals.push(unit(normal).map(|x| x as f32));
            let tile = (f64::from(point[0]) * 4.0).floor() + (f64::from(point[1]) * 4.0).floor();
            let albedo = 0.5 + 0.3 * (tile * 0.5).sin();
            lit.materials.push([albedo, 0.8 * albedo, 0.5, 0.3 + 0.5 * albedo].map(|x| x as f32));
            let share = f64::from(u8::from(p.is_multiple_of(each)));
            lit.gradient.push([0; 3].map(|_| (share * rng.range(-1.0, 1.0)) as f32));
        }
        lit
    }

    /// Returns a pixel in the form of the reference.
    pub fn pixel(&self, i: usize) -> Pixel {
        let m = self.materials[i].map(f64::from);
        let material = Material { albedo: [m[0], m[1], m[2]], roughness: m[3], metallic: 0.0 };
        Pixel { point: self.points[i].map(f64::from), normal: self.normals[i].map(f64::from), coverage: 1.0, material }
    }

    /// Returns the lights in the form of the reference.
    pub fn raw(&self, model: LightModel) -> Raw {
        Raw {
            model,
            positions: self.positions.iter().flatten().map(|&x| f64::from(x)).collect(),
            lobes: self.lobes.iter().map(|&x| f64::from(x)).collect(),
            gains: vec![1.0; model.lights as usize],
        }
    }
}

/// Description of a case that is exported for other programs.
#[derive(serde::Serialize)]
struct Case {
    pixels: usize,
    lights: u32,
    lobes: u32,
    camera: [f32; 3],
    normalizer: f32,
    milliseconds: f64,
    device: String,
}

/// Buffers of a room in a graph, and their contents.
pub struct Bound {
    pub pixels: Pixels,
    pub parameters: LightParameters,
    pub gradient: Buffer,
    pub inputs: Vec<(Buffer, Vec<u8>)>,
}

pub fn bind(g: &mut Graph, lit: &Lit, size: [u32; 2], model: LightModel) -> Bound {
    let n = lit.points.len() as u64;
    let mut values = Step::default();
    values.camera.size = size;
    values.camera.position = CAMERA;
    let step = g.uniform("step", size_of::<Step>() as u64);
    let pixels = Pixels {
        screen: Screen { step, largest: size, tile: [8, 8] },
        surfaces: Surfaces {
            points: g.input("points", 12 * n),
            normals: g.input("normals", 12 * n),
            coverage: g.input("coverage", 4 * n),
        },
        materials: PixelMaterials { materials: g.input("materials", 16 * n), metallic: None },
    };
    let parameters = LightParameters {
        positions: g.input("positions", model.position_bytes()),
        lobes: g.input("lobes", model.lobe_bytes()),
        gains: g.input("gains", model.gain_bytes()),
    };
    let gradient = g.input("radiance_gradient", 12 * n);
    let inputs = vec![
        (step, bytes(&[values])),
        (pixels.surfaces.points, bytes(&lit.points)),
        (pixels.surfaces.normals, bytes(&lit.normals)),
        (pixels.surfaces.coverage, bytes(&vec![1.0_f32; lit.points.len()])),
        (pixels.materials.materials, bytes(&lit.materials)),
        (parameters.positions, bytes(&lit.positions)),
        (parameters.lobes, bytes(&lit.lobes)),
        (parameters.gains, bytes(&vec![1.0_f32; model.lights as usize])),
        (gradient, bytes(&lit.gradient)),
    ];
    Bound { pixels, parameters, gradient, inputs }
}

/// Compares gradients of one kind with `width` values per row.
///
/// The tolerance is 1e-3 relative, or 1e-5 of the root mean square of the column.
fn compare(what: &str, width: usize, expected: &[f64], found: &[f32]) -> anyhow::Result<()> {
    for column in 0..width {
        let all = || expected.iter().zip(found).skip(column).step_by(width);
        let scale = (all().map(|(e, _)| e * e).sum::<f64>() / all().count() as f64).sqrt();
        for (e, &f) in all() {
            let off = (e - f64::from(f)).abs() > 1e-3 * e.abs() + 1e-5 * scale;
            anyhow::ensure!(!off && f.is_finite(), "The gradient of {what} is {f}, but should be {e}.");
        }
    }
    Ok(())
}

/// Measures the forward passes for rendering and training, and the backward passes.
pub fn all(c: &Context<'_>, report: &mut Report) -> anyhow::Result<()> {
    let (size, model) = (c.workload.largest, LightModel::default());
    let lit = Lit::room(size, model);
    let mut g = Graph::new("lights");
    let b = bind(&mut g, &lit, size, model);
    let n = lit.points.len();
    let prepared =
        lights_prepare(&mut g, c.tuning, "lights_prepare", b.pixels.screen.step, model, &b.parameters, None)?;
    let what = Lights {
        pixels: b.pixels,
        prepared,
        normalizer: 1.0 / model.lights as f32,
        shape: Shape::for_device(c.tuning),
    };
    let (radiance_image, direct) = (g.external("image", 12 * n as u64), g.external("direct", 12 * n as u64));
    lights(&mut g, &what, radiance_image)?;
    let sums = lights_train(&mut g, &what, direct)?;
    let materials = g.external("materials_gradient", 16 * n as u64);
    g.fill("clear_gradients", materials, 0)?;
    lights_materials_bwd(&mut g, c.tuning, &b.pixels, &sums, b.gradient, materials, None)?;
    let into = LightParameterGradients {
        positions: g.external("positions_gradient", model.position_bytes()),
        lobes: g.external("lobes_gradient", model.lobe_bytes()),
    };
    let gradients = lights_bwd(&mut g, c.tuning, &what, b.gradient)?;
    let normals = g.external("normals_gradient", 12 * n as u64);
    lights_normals_bwd(&mut g, &what, b.gradient, normals)?;
    let losses = g.external("losses", 8);
    let regularization = lights_regularize(&mut g, c.tuning, &what, &b.parameters, [0.0; 2], losses)?;
    lights_prepare_bwd(&mut g, &prepared, &b.parameters, &gradients, Some(&regularization), &into)?;
    let mut rig = Rig::new(c.device, g, b.inputs, true)?;
    let (times, _) = rig.measure(c.warmup, c.repeats)?;
    let counts = Counts { pixels: n as f64, lights: f64::from(model.lights), ..Default::default() };
    add_passes(report, rig.plan(), &times, &counts, &c.ceiling);

    let (found, gradients_found): (Vec<f32>, Vec<f32>) = (rig.get(direct)?, rig.get(materials)?);
    anyhow::ensure!(
        found.iter().zip(rig.get::<f32>(radiance_image)?).all(|(a, b)| (a - b).abs() <= 1e-5 * a.abs()),
        "lights"
    );
    let sample: Vec<usize> = (0..n).step_by((n / 200).max(1)).collect();
    let pixels: Vec<Pixel> = sample.iter().map(|&i| lit.pixel(i)).collect();
    let ready = reference::lights_prepare(&lit.raw(model));
    let (camera, normalizer) = (CAMERA.map(f64::from), f64::from(what.normalizer));
    let [diffuse, specular] = reference::lights(&pixels, &ready, camera, normalizer);
    let gradient: Vec<f64> = sample.iter().flat_map(|&i| lit.gradient[i].map(f64::from)).collect();
    let by_material = reference::lights_materials_bwd(&pixels, &ready, camera, normalizer, &gradient);
    for (s, &i) in sample.iter().enumerate() {
        for k in 0..3 {
            let e = diffuse[3 * s + k] + specular[3 * s + k];
            let f = f64::from(found[3 * i + k]);
            anyhow::ensure!((e - f).abs() <= 1e-4 * e.abs() + 1e-9, "Radiance of pixel {i} is {f}, but should be {e}.");
        }
        for k in 0..4 {
            let (e, f) = (by_material[s][k], f64::from(gradients_found[4 * i + k]));
            let off = (e - f).abs() > 1e-3 * e.abs() + 1e-6;
            anyhow::ensure!(!off, "Gradient {k} of pixel {i}'s material is {f}, but should be {e}.");
        }
    }
    let found: Vec<[f32; 3]> = rig.get(normals)?;
    let found: Vec<f32> = sample.iter().flat_map(|&i| found[i]).collect();
    let by_normal = reference::lights_normals_bwd(&pixels, &ready, camera, normalizer, &gradient);
    compare("normals", 3, &by_normal.concat(), &found)?;
    let expected = reference::lights_bwd(&lit.raw(model), &pixels, camera, normalizer, &gradient);
    compare("positions", 3, &expected.positions, &rig.get(into.positions)?)?;
    compare("lobes", model.row() as usize, &expected.lobes, &rig.get(into.lobes)?)?;
    let whole: Vec<Pixel> = (0..n).map(|i| lit.pixel(i)).collect();
    let expected = reference::lights_regularize(&lit.raw(model), &whole);
    for (e, f) in expected.iter().zip(rig.get::<f32>(losses)?) {
        anyhow::ensure!((e - f64::from(f)).abs() <= 1e-4 * e, "A regularizer is {f}, but should be {e}.");
    }
    if let Some(folder) = c.dump {
        // Exports the part for the loss only: image and gradients, without regularizers.
        let passes = ["lights_prepare", "lights_train", "lights_materials_bwd", "lights_bwd.clear", "lights_bwd"];
        let rest = ["lights_reduce", "lights_prepare_bwd"];
        let counted = times.iter().filter(|t| passes.contains(&&*t.name) || rest.contains(&&*t.name));
        let milliseconds = counted.map(|t| Summary::of(&t.nanoseconds).median * 1e-6).sum();
        let case = Case {
            pixels: n,
            lights: model.lights,
            lobes: model.lobes,
            camera: CAMERA,
            normalizer: what.normalizer,
            milliseconds,
            device: c.device.info().name.clone(),
        };
        let arrays = [
            ("points", bytes(&lit.points)),
            ("normals", bytes(&lit.normals)),
            ("materials", bytes(&lit.materials)),
            ("gradient", bytes(&lit.gradient)),
            ("positions", bytes(&lit.positions)),
            ("lobes", bytes(&lit.lobes)),
            ("radiance", bytes(&rig.get::<f32>(direct)?)),
            ("materials_gradient", bytes(&gradients_found)),
            ("positions_gradient", bytes(&rig.get::<f32>(into.positions)?)),
            ("lobes_gradient", bytes(&rig.get::<f32>(into.lobes)?)),
        ];
        std::fs::create_dir_all(folder)?;
        std::fs::write(folder.join("case.json"), serde_json::to_string_pretty(&case)?)?;
        for (name, data) in arrays {
            std::fs::write(folder.join(format!("{name}.f32")), data)?;
        }
    }
    report.check(format!("lights: radiance and all gradients from {} pixels are those of the reference", sample.len()));
    Ok(())
}
