//! Pixels under lights, for the kernels of `shade` and their references.
//!
//! Kernels and references get the same numbers.

use crate::{Gpu, Tolerance, assert_close};
use sgs_engine::graph::{Buffer, Graph};
use sgs_passes::reference::brdf::{Material, V3, unit};
use sgs_passes::reference::lights::{self as reference, Pixel, Raw};
use sgs_passes::reference::rng::Pcg;
use sgs_passes::shade::lights::{
    LightModel, LightParameterGradients, LightParameters, Lights, Perturbation, Shape, lights, lights_bwd,
    lights_materials_bwd, lights_normals_bwd, lights_prepare_bwd, lights_prepare_culled, lights_split, lights_train,
};
use sgs_passes::shade::{PixelMaterials, Pixels, Surfaces};
use sgs_passes::splat::Screen;
use sgs_shaders::structs::Step;

/// Number of pixels in the buffers after the view's pixels.
pub const SPARE: usize = 7;

/// View of pixels and a set of lights; all numbers are exact in 32-bit floats.
#[derive(Clone, Debug)]
pub struct Lit {
    /// Columns and rows.
    pub size: [usize; 2],
    /// Surface and material of each pixel.
    pub pixels: Vec<Pixel>,
    /// Whether metallic has a buffer.
    pub metallic: bool,
    /// Raw parameters of the lights.
    pub raw: Raw,
    /// Position of the camera.
    pub camera: V3,
    /// Gradient with respect to the radiance, by pixel and channel.
    pub gradient: Vec<f64>,
    /// Seed of the device's random numbers.
    pub seed: u32,
    /// Initial value of the gradients of materials.
    pub before: f32,
}

/// Rounds to single precision.
pub fn narrow(x: f64) -> f64 {
    f64::from(x as f32)
}

fn narrow3(x: V3) -> V3 {
    x.map(narrow)
}

fn floats(values: impl IntoIterator<Item = f64>) -> Vec<u8> {
    values.into_iter().flat_map(|x| (x as f32).to_le_bytes()).collect()
}

/// Buffers of a case in a graph, with their contents.
#[derive(Clone, Debug)]
pub struct Bound {
    /// Buffers of the pixels.
    pub pixels: Pixels,
    /// Buffers of the lights.
    pub parameters: LightParameters,
    /// Gradient with respect to the radiance.
    pub gradient: Buffer,
    /// Contents of the buffers.
    pub inputs: Vec<(Buffer, Vec<u8>)>,
}

impl Lit {
    /// Draws pixels in a cube of side 2, materials of all kinds and lights around them.
    pub fn random(size: [usize; 2], model: LightModel, metallic: bool, seed: u32) -> Lit {
        let mut rng = Pcg::new(seed);
        let mut vector = |scale: f64| narrow3([0; 3].map(|_| scale * rng.range(-1.0, 1.0)));
        let count = size[0] * size[1];
        let places: Vec<V3> = (0..count).map(|_| vector(1.0)).collect();
        let normals: Vec<V3> = (0..count).map(|_| narrow3(unit(vector(1.0)))).collect();
        let positions = (0..model.lights).flat_map(|_| vector(1.5)).collect();
        let mut rng = Pcg::new(seed + 1000);
        let mut lobes = Vec::new();
        for _ in 0..model.lights * model.lobes {
            (0..model.row() - 4).for_each(|_| lobes.push(narrow(0.7 * rng.normal())));
            lobes.push(narrow(rng.range(-1.0, 3.0)));
            (0..3).for_each(|_| lobes.push(narrow(rng.range(-4.0, 0.5))));
        }
        let material = |rng: &mut Pcg| Material {
            albedo: [0; 3].map(|_| narrow(rng.range(0.05, 0.95))),
            roughness: narrow(rng.range(0.09, 0.99)),
            metallic: if metallic { narrow(rng.uniform()) } else { 0.0 },
        };
        let pixels = places.into_iter().zip(normals).map(|(point, normal)| Pixel {
            point,
            normal,
            coverage: 1.0,
            material: material(&mut rng),
        });
        let pixels = pixels.collect();
        Lit {
            size,
            pixels,
            metallic,
            raw: Raw { model, positions, lobes, gains: vec![1.0; model.lights as usize] },
            camera: narrow3([0.4, -0.3, -4.0]),
            gradient: (0..3 * count).map(|_| narrow(rng.normal())).collect(),
            seed: 77,
            before: BEFORE,
        }
    }

    /// Returns the normalizer of the radiance: one over the number of lights.
    pub fn normalizer(&self) -> f64 {
        narrow(1.0 / f64::from(self.raw.model.lights))
    }

    /// Returns the lights of the reference.
    pub fn lights(&self) -> Vec<Option<reference::Light>> {
        reference::lights_prepare(&self.raw)
    }

    /// Declares the case in a graph, for views of up to `largest`.
    pub fn bind(&self, g: &mut Graph, largest: [u32; 2]) -> Bound {
        let room = (self.pixels.len() + SPARE) as u64;
        let p = &self.pixels;
        let mut inputs = Vec::new();
        let mut input = |g: &mut Graph, name: &str, width: u64, data: Vec<u8>| {
            let buffer = g.input(name, 4 * width * room);
            // NaN after the view's pixels would show in the results if a kernel read them.
            let spare = f32::NAN.to_le_bytes().repeat((width * SPARE as u64) as usize);
            inputs.push((buffer, [data, spare].concat()));
            buffer
        };
        let points = input(g, "points", 3, floats(p.iter().flat_map(|p| p.point)));
        let normals = input(g, "normals", 3, floats(p.iter().flat_map(|p| p.normal)));
        let coverage = input(g, "coverage", 1, floats(p.iter().map(|p| p.coverage)));
        let material = |m: Material| [m.albedo[0], m.albedo[1], m.albedo[2], m.roughness];
        let materials = input(g, "materials", 4, floats(p.iter().flat_map(|p| material(p.material))));
        let metal = floats(p.iter().map(|p| p.material.metallic));
        let metallic = self.metallic.then(|| input(g, "metallic", 1, metal));
        let gradient = input(g, "radiance_gradient", 3, floats(self.gradient.iter().copied()));
        let step = g.uniform("step", size_of::<Step>() as u64);
        let mut values = Step { seed: self.seed, ..Default::default() };
        values.camera.size = self.size.map(|s| s as u32);
        values.camera.position = self.camera.map(|x| x as f32);
        inputs.push((step, bytemuck::bytes_of(&values).to_vec()));
        let model = self.raw.model;
        let parameters = LightParameters {
            positions: g.input("positions", model.position_bytes()),
            lobes: g.input("lobes", model.lobe_bytes()),
            gains: g.input("gains", model.gain_bytes()),
        };
        inputs.push((parameters.positions, floats(self.raw.positions.iter().copied())));
        inputs.push((parameters.lobes, floats(self.raw.lobes.iter().copied())));
        inputs.push((parameters.gains, floats(self.raw.gains.iter().copied())));
        let pixels = Pixels {
            screen: Screen { step, largest, tile: [8, 8] },
            surfaces: Surfaces { points, normals, coverage },
            materials: PixelMaterials { materials, metallic },
        };
        Bound { pixels, parameters, gradient, inputs }
    }
}

/// Results of the light kernels for the view's pixels.
#[derive(Clone, Debug)]
pub struct Found {
    /// Radiance.
    pub direct: Vec<f32>,
    /// Radiance from the split kernel, and its diffuse component.
    pub split: [Vec<f32>; 2],
    /// Gradients of albedo and roughness by pixel, including the initial value.
    pub materials: Vec<f32>,
    /// Gradients of metallic, including the initial value.
    pub metallic: Vec<f32>,
    /// Gradients of the light positions.
    pub positions: Vec<f32>,
    /// Gradients of the lobes, by row.
    pub lobes: Vec<f32>,
    /// Gradients of the normals.
    pub normals: Vec<f32>,
}

/// Initial value of the gradients of materials in random cases.
pub const BEFORE: f32 = 0.5;

/// Runs every light kernel on a case, in a view of up to `largest`.
///
/// # Panics
/// If a kernel writes after the view's pixels, or if variants of a kernel disagree.
pub fn run(gpu: &Gpu, shape: Shape, case: &Lit, largest: [u32; 2], perturbation: Option<&Perturbation>) -> Found {
    run_culled(gpu, shape, case, largest, perturbation, 0.0)
}

/// Runs the kernels as [`run`] does, with culled lights.
///
/// `missing` bounds the irradiance that culling removes from a pixel.
///
/// # Panics
/// Like [`run`].
pub fn run_culled(
    gpu: &Gpu,
    shape: Shape,
    case: &Lit,
    largest: [u32; 2],
    perturbation: Option<&Perturbation>,
    missing: f32,
) -> Found {
    let tuning = gpu.tuning();
    let mut g = Graph::new("lights");
    let mut bound = case.bind(&mut g, largest);
    let pixels = bound.pixels;
    let step = pixels.screen.step;
    let model = case.raw.model;
    let prepared =
        lights_prepare_culled(&mut g, tuning, "lights_prepare", step, model, &bound.parameters, perturbation, missing)
            .unwrap();
    let what = Lights { pixels, prepared, normalizer: case.normalizer() as f32, shape };
    let room = (case.pixels.len() + SPARE) as u64;
    let [direct, again, whole, diffuse] =
        ["direct", "again", "whole", "diffuse"].map(|name| g.external(name, 12 * room));
    lights(&mut g, &what, direct).unwrap();
    lights_split(&mut g, &what, whole, diffuse).unwrap();
    let sums = lights_train(&mut g, &what, again).unwrap();
    let materials = g.external("materials_gradient", 16 * room);
    let metallic = g.external("metallic_gradient", 4 * room);
    let requested = case.metallic.then_some(metallic);
    lights_materials_bwd(&mut g, tuning, &pixels, &sums, bound.gradient, materials, requested).unwrap();
    let into = LightParameterGradients {
        positions: g.external("positions_gradient", model.position_bytes()),
        lobes: g.external("lobes_gradient", model.lobe_bytes()),
    };
    let gradients = lights_bwd(&mut g, tuning, &what, bound.gradient).unwrap();
    lights_prepare_bwd(&mut g, &prepared, &bound.parameters, &gradients, None, &into).unwrap();
    let normals = g.external("normals_gradient", 12 * room);
    lights_normals_bwd(&mut g, &what, bound.gradient, normals).unwrap();
    bound
        .inputs
        .push((materials, vec![case.before; 4 * case.pixels.len()].iter().flat_map(|x| x.to_le_bytes()).collect()));
    bound.inputs.push((metallic, vec![case.before; case.pixels.len()].iter().flat_map(|x| x.to_le_bytes()).collect()));
    let out = gpu.run(g, &bound.inputs);
    let n = case.pixels.len();
    let radiance = |buffer| {
        let all: Vec<f32> = out.get(buffer);
        assert!(all[3 * n..].iter().all(|x| x.to_bits() == u32::MAX), "pixels behind the view were written");
        all[..3 * n].to_vec()
    };
    let found = Found {
        direct: radiance(direct),
        split: [radiance(whole), radiance(diffuse)],
        materials: out.get::<f32>(materials)[..4 * n].to_vec(),
        metallic: out.get::<f32>(metallic)[..n].to_vec(),
        positions: out.get(into.positions),
        lobes: out.get(into.lobes),
        normals: radiance(normals),
    };
    // These variants share the body of the kernel, so they must give the same radiance.
    for other in [radiance(again), found.split[0].clone()] {
        assert_close(
            "variant",
            &found.direct.iter().map(|x| f64::from(*x)).collect::<Vec<_>>(),
            &other,
            Tolerance::new(1e-30, 2e-6),
        );
    }
    found
}
