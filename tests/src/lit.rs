//! Pixels under lights: cases for the kernels of `shade`, with the same numbers for their references.

use sgs_engine::graph::{Buffer, Graph};
use sgs_passes::reference::brdf::{Material, V3, unit};
use sgs_passes::reference::lights::{self as twin, Pixel, Raw};
use sgs_passes::reference::rng::Pcg;
use sgs_passes::shade::lights::{LightModel, LightParameters};
use sgs_passes::shade::{PixelMaterials, Pixels, Surfaces};
use sgs_passes::splat::Screen;
use sgs_shaders::structs::Step;

/// Pixels beyond the view's that buffers have.
pub const SPARE: usize = 7;

/// A view of pixels and a set of lights; all numbers are those of 32 bits.
#[derive(Clone, Debug)]
pub struct Lit {
    /// Columns and rows.
    pub size: [usize; 2],
    /// By pixel.
    pub pixels: Vec<Pixel>,
    /// Whether metallic has a buffer.
    pub metallic: bool,
    /// Raw parameters.
    pub raw: Raw,
    /// The camera's place.
    pub camera: V3,
    /// By pixel and channel: gradient of the radiance.
    pub gradient: Vec<f64>,
    /// Of random numbers.
    pub seed: u32,
}

/// A number as 32 bits hold it.
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
    /// The pixels.
    pub pixels: Pixels,
    /// The lights.
    pub parameters: LightParameters,
    /// Gradient of the radiance.
    pub gradient: Buffer,
    /// What the buffers hold.
    pub inputs: Vec<(Buffer, Vec<u8>)>,
}

impl Lit {
    /// Random pixels in a cube of side 2, materials of all kinds, lights around them.
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
        }
    }

    /// The normalizer of the light.
    pub fn normalizer(&self) -> f64 {
        narrow(1.0 / f64::from(self.raw.model.lights))
    }

    /// The reference's lights.
    pub fn lights(&self) -> Vec<Option<twin::Light>> {
        twin::lights_prepare(&self.raw)
    }

    /// Puts the case into a graph, for views of up to `largest`.
    pub fn bind(&self, g: &mut Graph, largest: [u32; 2]) -> Bound {
        let room = (self.pixels.len() + SPARE) as u64;
        let p = &self.pixels;
        let mut inputs = Vec::new();
        let mut input = |g: &mut Graph, name: &str, width: u64, data: Vec<u8>| {
            let buffer = g.input(name, 4 * width * room);
            // What lies behind the view would be noticed.
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
