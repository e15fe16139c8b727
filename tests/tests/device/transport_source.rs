//! Reflectance and source of receivers against their references.
//!
//! So is the gradient of blended irradiance. Gradients are tested against finite differences.

use sgs_engine::graph::{Buffer, Graph};
use sgs_passes::pipeline::Step;
use sgs_passes::reference::rng::Pcg;
use sgs_passes::reference::transport::{RoomParameters, SurfelMaterial, V3, blend, source};
use sgs_passes::shade::{PixelMaterials, Weights};
use sgs_passes::transport::{
    BlendGradients, ParameterGradients, SourceGradients, SourceInputs, Sources, irradiance_blend_bwd, transport_source,
    transport_source_bwd,
};
use sgs_tests::{Gpu, Tolerance, assert_close, finite_difference};

/// Inputs of a graph that is being built.
#[derive(Default)]
struct Inputs(Vec<(Buffer, Vec<u8>)>);

impl Inputs {
    fn floats(&mut self, g: &mut Graph, name: &str, values: impl IntoIterator<Item = f64>) -> Buffer {
        self.bytes(g, name, values.into_iter().flat_map(|x| (x as f32).to_le_bytes()).collect())
    }

    fn words(&mut self, g: &mut Graph, name: &str, values: impl IntoIterator<Item = usize>) -> Buffer {
        self.bytes(g, name, values.into_iter().flat_map(|x| (x as u32).to_le_bytes()).collect())
    }

    fn bytes(&mut self, g: &mut Graph, name: &str, mut bytes: Vec<u8>) -> Buffer {
        bytes.resize(bytes.len().max(4), 0);
        let buffer = g.input(name, bytes.len() as u64);
        self.0.push((buffer, bytes));
        buffer
    }
}

fn narrow(x: f64) -> f64 {
    f64::from(x as f32)
}

fn three(rng: &mut Pcg, low: f64, high: f64) -> V3 {
    [0; 3].map(|_| narrow(rng.range(low, high)))
}

/// A room, and gradients by its reflectance, source and colors of lights.
struct Case {
    room: RoomParameters,
    metallic: bool,
    by_reflectance: Vec<V3>,
    by_source: Vec<V3>,
    by_colors: Vec<V3>,
}

struct Found {
    reflectance: Vec<f32>,
    source: Vec<f32>,
    colors: Vec<f32>,
    materials: Vec<f32>,
    metallic: Vec<f32>,
    log_colors: Vec<f32>,
    enclosure: Vec<f32>,
}

impl Case {
    fn random(surfels: usize, patches: usize, lights: usize, metallic: bool, seed: u32) -> Case {
        let mut rng = Pcg::new(seed);
        let rng = &mut rng;
        let material = |rng: &mut Pcg| SurfelMaterial {
            albedo: three(rng, 0.0, 1.0),
            roughness: narrow(rng.range(0.03, 1.0)),
            metallic: if metallic { narrow(rng.range(0.0, 1.0)) } else { 0.0 },
        };
        let all = surfels + patches;
        let dark = |x: f64| if x < 0.5 { 0.0 } else { x };
        let room = RoomParameters {
            surfels: (0..surfels).map(|_| material(rng)).collect(),
            enclosure: (0..6).map(|_| three(rng, -3.0, 3.0)).collect(),
            faces: (0..patches).map(|i| i * 6 / patches.max(1)).collect(),
            unit: (0..lights).map(|_| (0..all).map(|_| dark(narrow(rng.range(0.0, 2.0)))).collect()).collect(),
            log_colors: (0..lights).map(|_| three(rng, -4.0, 4.0)).collect(),
        };
        Case {
            room,
            metallic,
            by_reflectance: (0..all).map(|_| three(rng, -1.0, 1.0)).collect(),
            by_source: (0..all).map(|_| three(rng, -1.0, 1.0)).collect(),
            by_colors: (0..lights).map(|_| three(rng, -1.0, 1.0)).collect(),
        }
    }

    fn run(&self, gpu: &Gpu) -> Found {
        let (r, t) = (&self.room, gpu.tuning());
        let (surfels, lights) = (r.surfels.len(), r.log_colors.len());
        let receivers = surfels + r.faces.len();
        let mut g = Graph::new("transport_source");
        let mut inputs = Inputs::default();
        let four = |m: &SurfelMaterial| [m.albedo[0], m.albedo[1], m.albedo[2], m.roughness];
        let materials = inputs.floats(&mut g, "materials", r.surfels.iter().flat_map(four));
        let metallic = inputs.floats(&mut g, "metallic", r.surfels.iter().map(|m| m.metallic));
        let a = SourceInputs {
            receivers: receivers as u32,
            surfels: surfels as u32,
            lights: lights as u32,
            materials: PixelMaterials { materials, metallic: self.metallic.then_some(metallic) },
            enclosure: inputs.floats(&mut g, "enclosure", r.enclosure.iter().copied().flatten()),
            faces: inputs.words(&mut g, "faces", r.faces.iter().copied()),
            unit: inputs.floats(&mut g, "unit", r.unit.iter().flatten().copied()),
            log_colors: inputs.floats(&mut g, "log_colors", r.log_colors.iter().copied().flatten()),
        };
        let output = |g: &mut Graph, name: &str, floats: usize| g.external(name, 4 * floats.max(1) as u64);
        let into = Sources {
            reflectance: output(&mut g, "reflectance", 3 * receivers),
            source: output(&mut g, "source", 3 * receivers),
            colors: output(&mut g, "colors", 3 * lights),
        };
        transport_source(&mut g, &t, &a, &into).unwrap();
        let gradients = SourceGradients {
            reflectance: inputs.floats(&mut g, "by_reflectance", self.by_reflectance.iter().copied().flatten()),
            source: inputs.floats(&mut g, "by_source", self.by_source.iter().copied().flatten()),
            colors: inputs.floats(&mut g, "by_colors", self.by_colors.iter().copied().flatten()),
        };
        let of_metallic = output(&mut g, "metallic_gradient", surfels);
        let back = ParameterGradients {
            materials: PixelMaterials {
                materials: output(&mut g, "materials_gradient", 4 * surfels),
                metallic: self.metallic.then_some(of_metallic),
            },
            log_colors: output(&mut g, "colors_gradient", 3 * lights),
            enclosure: output(&mut g, "enclosure_gradient", 18),
        };
        transport_source_bwd(&mut g, &t, &a, &gradients, &back).unwrap();
        let out = gpu.run(g, &inputs.0);
        let get = |buffer: Buffer, floats: usize| -> Vec<f32> { out.get::<f32>(buffer)[..floats].to_vec() };
        Found {
            reflectance: get(into.reflectance, 3 * receivers),
            source: get(into.source, 3 * receivers),
            colors: get(into.colors, 3 * lights),
            materials: get(back.materials.materials, 4 * surfels),
            metallic: if self.metallic { get(of_metallic, surfels) } else { Vec::new() },
            log_colors: get(back.log_colors, 3 * lights),
            enclosure: get(back.enclosure, 18),
        }
    }

    fn loss(&self, room: &RoomParameters) -> f64 {
        let s = source(room);
        let sum =
            |a: &[V3], b: &[V3]| -> f64 { a.iter().zip(b).map(|(a, b)| a[0] * b[0] + a[1] * b[1] + a[2] * b[2]).sum() };
        let colors: Vec<V3> = room.log_colors.iter().map(|c| c.map(f64::exp)).collect();
        sum(&s.reflectance, &self.by_reflectance) + sum(&s.source, &self.by_source) + sum(&colors, &self.by_colors)
    }

    /// Returns the central difference of the loss along one number of the room.
    fn slope(&self, change: impl Fn(&mut RoomParameters, f64)) -> f64 {
        finite_difference(&mut [0.0], 0, 1e-6, |x| {
            let mut room = self.room.clone();
            change(&mut room, x[0]);
            self.loss(&room)
        })
    }

    fn check(&self, gpu: &Gpu) {
        let (found, right) = (self.run(gpu), source(&self.room));
        let close = |what: &str, right: Vec<f64>, is: &[f32]| {
            let largest = right.iter().fold(1e-3_f64, |a, b| a.max(b.abs()));
            assert_close(what, &right, is, Tolerance::new(2e-5 * largest, 1e-4));
        };
        close("reflectance", right.reflectance.concat(), &found.reflectance);
        close("source", right.source.concat(), &found.source);
        close("colors", self.room.log_colors.iter().flat_map(|c| c.map(f64::exp)).collect(), &found.colors);
        let mut materials = Vec::new();
        for i in 0..self.room.surfels.len() {
            materials.extend((0..3).map(|k| self.slope(|r, x| r.surfels[i].albedo[k] += x)));
            materials.push(self.slope(|r, x| r.surfels[i].roughness += x));
        }
        close("materials", materials, &found.materials);
        if self.metallic {
            let metallic = (0..self.room.surfels.len()).map(|i| self.slope(|r, x| r.surfels[i].metallic += x));
            close("metallic", metallic.collect(), &found.metallic);
        }
        let slopes = |count: usize, of: fn(&mut RoomParameters) -> &mut Vec<V3>| -> Vec<f64> {
            (0..3 * count).map(|i| self.slope(|r, x| of(r)[i / 3][i % 3] += x)).collect()
        };
        close("log colors", slopes(self.room.log_colors.len(), |r| &mut r.log_colors), &found.log_colors);
        close("enclosure", slopes(6, |r| &mut r.enclosure), &found.enclosure);
    }
}

#[test]
fn sources_and_gradients_match_reference() {
    let gpu = Gpu::new();
    for (seed, metallic) in [(1, true), (2, false)] {
        Case::random(67, 23, 3, metallic, seed).check(&gpu);
    }
    // Without lights, without patches, and with one of each.
    Case::random(5, 6, 0, true, 3).check(&gpu);
    Case::random(40, 0, 2, false, 4).check(&gpu);
    Case::random(1, 1, 1, true, 5).check(&gpu);
}

/// Tests black, white and metallic surfels, extreme faces and lights.
#[test]
fn extreme_rooms_match_reference() {
    let gpu = Gpu::new();
    let mut case = Case::random(27, 12, 2, true, 6);
    for (i, m) in case.room.surfels.iter_mut().enumerate() {
        m.albedo = [[0.0; 3], [1.0; 3], [0.5, 0.0, 1.0]][i % 3];
        m.roughness = [0.0, 1.0, 0.4].map(narrow)[i / 3 % 3];
        m.metallic = [0.0, 1.0, 0.5][i / 9 % 3];
    }
    case.room.enclosure[0] = [-30.0, 30.0, 0.0];
    case.room.log_colors = vec![[-40.0, 10.0, 0.0], [9.0, -9.0, 2.0]];
    let found = case.run(&gpu);
    let right = source(&case.room);
    assert_close("reflectance", &right.reflectance.concat(), &found.reflectance, Tolerance::new(1e-6, 1e-5));
    assert_close("source", &right.source.concat(), &found.source, Tolerance::new(1e-5, 1e-4));
    let all = [&found.materials, &found.metallic, &found.log_colors, &found.enclosure];
    assert!(all.iter().all(|v| v.iter().all(|x| x.is_finite())));
}

#[test]
fn gradients_of_blended_irradiance_match_reference() {
    let gpu = Gpu::new();
    let mut rng = Pcg::new(9);
    let (size, gaussians, pull) = ([7_usize, 5_usize], 13_usize, 0.75_f64);
    let pixels = size[0] * size[1];
    // The last Gaussian is seen nowhere, the first everywhere.
    let rows: Vec<Vec<(usize, f64)>> = (0..pixels)
        .map(|p| {
            let others = (1..gaussians - 1).filter(|i| (p + i) % 3 == 0);
            std::iter::once(0).chain(others).map(|i| (i, narrow(rng.range(0.0, 1.0)))).collect()
        })
        .collect();
    let irradiance: Vec<V3> = (0..gaussians).map(|_| three(&mut rng, 0.0, 3.0)).collect();
    let log_gains: Vec<f64> = (0..gaussians).map(|_| narrow(rng.range(-1.5, 1.5))).collect();
    let gradient: Vec<[f64; 4]> = (0..pixels).map(|_| [0; 4].map(|_| narrow(rng.range(-1.0, 1.0)))).collect();
    let columns: Vec<Vec<(usize, f64)>> = (0..gaussians)
        .map(|i| {
            let of_row = |(p, row): (usize, &Vec<(usize, f64)>)| row.iter().find(|e| e.0 == i).map(|e| (p, e.1));
            rows.iter().enumerate().filter_map(of_row).collect()
        })
        .collect();
    let starts = |rows: &[Vec<(usize, f64)>]| -> Vec<usize> {
        let mut starts = vec![0];
        rows.iter().for_each(|row| starts.push(starts[starts.len() - 1] + row.len()));
        starts
    };

    let mut g = Graph::new("irradiance_blend_bwd");
    let mut inputs = Inputs::default();
    let step = g.uniform("step", size_of::<Step>() as u64);
    let mut values = Step::default();
    values.camera.size = size.map(|s| s as u32);
    inputs.0.push((step, bytemuck::bytes_of(&values).to_vec()));
    let weights = Weights {
        row_starts: inputs.words(&mut g, "row_starts", starts(&rows)),
        columns: inputs.words(&mut g, "columns", rows.iter().flatten().map(|e| e.0)),
        weights: inputs.floats(&mut g, "weights", rows.iter().flatten().map(|e| e.1)),
        column_starts: inputs.words(&mut g, "column_starts", starts(&columns)),
        rows: inputs.words(&mut g, "rows", columns.iter().flatten().map(|e| e.0)),
        row_weights: inputs.floats(&mut g, "row_weights", columns.iter().flatten().map(|e| e.1)),
        bits: 32,
    };
    let a = BlendGradients {
        step,
        gaussians: gaussians as u32,
        weights: &weights,
        pixels: inputs.floats(&mut g, "gradient", gradient.iter().copied().flatten()),
        log_gains: inputs.floats(&mut g, "log_gains", log_gains.iter().copied()),
        pull: pull as f32,
    };
    let of_values = g.external("values_gradient", 16 * gaussians as u64);
    let of_gains = g.external("gains_gradient", 4 * gaussians as u64);
    irradiance_blend_bwd(&mut g, &gpu.tuning(), &a, of_values, of_gains).unwrap();
    let out = gpu.run(g, &inputs.0);

    // Irradiance, then log gains.
    let mut x: Vec<f64> = irradiance.iter().flatten().chain(&log_gains).copied().collect();
    let loss = |x: &[f64]| -> f64 {
        let irradiance: Vec<V3> = x[..3 * gaussians].chunks_exact(3).map(|c| [c[0], c[1], c[2]]).collect();
        let log_gains = &x[3 * gaussians..];
        let of_pixel = |(row, gradient): (&Vec<(usize, f64)>, &[f64; 4])| -> f64 {
            let blended = blend(row, &irradiance, log_gains);
            let pulled: f64 = row.iter().map(|(i, weight)| weight * log_gains[*i] * log_gains[*i]).sum();
            (0..4).map(|k| gradient[k] * blended[k]).sum::<f64>() + pull / pixels as f64 * pulled
        };
        rows.iter().zip(&gradient).map(of_pixel).sum()
    };
    let slopes: Vec<f64> = (0..x.len()).map(|i| finite_difference(&mut x, i, 1e-6, loss)).collect();
    let found: Vec<f32> = out.get(of_values);
    let rgb: Vec<f32> = found.chunks_exact(4).flat_map(|v| [v[0], v[1], v[2]]).collect();
    assert_close("irradiance", &slopes[..3 * gaussians], &rgb, Tolerance::new(1e-5, 1e-4));
    assert_close("log gains", &slopes[3 * gaussians..], &out.get::<f32>(of_gains), Tolerance::new(1e-5, 1e-4));
    // The fourth number of the values is the gradient by the gain itself, without the pull.
    let gain = |i: usize| -> f64 { columns[i].iter().map(|(p, weight)| weight * gradient[*p][3]).sum() };
    let is: Vec<f32> = found.chunks_exact(4).map(|v| v[3]).collect();
    assert_close("gains", &(0..gaussians).map(gain).collect::<Vec<_>>(), &is, Tolerance::new(1e-5, 1e-4));
    assert_eq!(found[4 * (gaussians - 1)..], [0.0; 4]);
}
