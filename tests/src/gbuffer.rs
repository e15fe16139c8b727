//! G-buffer, weight matrix of a view and material render, on a device.

use crate::{Gpu, scenes};
use sgs_engine::graph::{Buffer, Graph};
use sgs_passes::pipeline::Step;
use sgs_passes::reference::gbuffer::Materials;
use sgs_passes::reference::project::{Camera, Gaussians};
use sgs_passes::scene::{Gaussians as GpuGaussians, Model};
use sgs_passes::shade::{
    GBUFFER_CHANNELS, PixelMaterials, RawMaterials, Room, Surfaces, Weights, gbuffer, materials, materials_bwd,
    unpacked_weights, values, weight_words, weights,
};
use sgs_passes::splat::{Blended, Screen, blend, intersect, project};

/// Capacity of tile entries.
pub const ROOM: u32 = 1 << 17;

/// View of Gaussians with materials, and the loss gradient of its pixels.
#[derive(Clone, Debug)]
pub struct Case {
    /// Gaussians with normals.
    pub scene: Gaussians,
    /// Camera of the view.
    pub camera: Camera,
    /// Materials of the Gaussians.
    pub raw: Materials,
    /// Gradient with respect to albedo, roughness and metallic of every pixel.
    pub gradient: Vec<[f64; 5]>,
    /// Capacity of the matrix, in entries.
    pub room: u32,
    /// Bits of a weight: 16 or 32.
    pub bits: u32,
}

impl Case {
    /// Creates a case with random materials and gradients.
    ///
    /// Raw materials lie within `reach` of zero. `metals`: whether the Gaussians have metallic.
    pub fn new(scene: Gaussians, camera: Camera, metals: bool, reach: f64) -> Case {
        let pixels = (camera.size[0] * camera.size[1]) as usize;
        let raw = random_materials(scene.len(), metals, reach, 3);
        Case { scene, camera, raw, gradient: random_gradient(pixels, 5), room: ROOM, bits: 32 }
    }
}

/// Results of the device: surfaces, matrix, transpose, materials and gradients.
pub struct Found {
    /// Surface points in world space.
    pub points: Vec<[f32; 3]>,
    /// Normals in world space, unit or zero.
    pub normals: Vec<[f32; 3]>,
    /// Opacity of each pixel.
    pub coverage: Vec<f32>,
    /// First entry of each pixel's row: `[pixels + 1]`.
    pub row_starts: Vec<u32>,
    /// Gaussian of each entry.
    pub columns: Vec<u32>,
    /// Weight of each entry.
    pub weights: Vec<f32>,
    /// First entry of each Gaussian's column: `[Gaussians + 1]`.
    pub column_starts: Vec<u32>,
    /// Pixel of each entry of the transpose.
    pub rows: Vec<u32>,
    /// Weight of each entry of the transpose.
    pub row_weights: Vec<f32>,
    /// Nonzero if a capacity was exceeded.
    pub flags: u32,
    /// Number of entries that the matrix needs.
    pub wanted: u32,
    /// Albedo and roughness of each pixel.
    pub materials: Vec<[f32; 4]>,
    /// Metallic of each pixel, or empty.
    pub metallic: Vec<f32>,
    /// Gradient with respect to raw albedo.
    pub grad_albedo: Vec<f32>,
    /// Gradient with respect to raw roughness.
    pub grad_roughness: Vec<f32>,
    /// Gradient with respect to raw metallic, or empty.
    pub grad_metallic: Vec<f32>,
}

impl Found {
    /// Returns the entries of a pixel's row.
    pub fn row(&self, pixel: usize) -> std::ops::Range<usize> {
        self.row_starts[pixel] as usize..self.row_starts[pixel + 1] as usize
    }
}

fn bytes<T: bytemuck::Pod>(values: &[T]) -> Vec<u8> {
    bytemuck::cast_slice(values).to_vec()
}

fn single(values: &[f64]) -> Vec<u8> {
    bytes(&values.iter().map(|v| *v as f32).collect::<Vec<f32>>())
}

/// Runs all passes from projection to the gradients of the materials.
pub fn run(gpu: &Gpu, case: &Case) -> Found {
    let Case { scene, camera, raw, gradient, room, bits } = case;
    let (room, bits) = (*room, *bits);
    let (t, pixels) = (gpu.tuning(), u64::from(camera.size[0]) * u64::from(camera.size[1]));
    let n = scene.len() as u32;
    let mut g = Graph::new("gbuffer");
    let step = g.uniform("step", size_of::<Step>() as u64);
    let screen = Screen { step, largest: camera.size, tile: t.tile };
    let model = Model { sh_degree: 0, normals: true, semantics: false, mip: false };
    let gaussians = GpuGaussians::new(gpu.device(), model, n, false).unwrap();
    let handles = gaussians.declare(&mut g, false);
    let visible = project(&mut g, &t, &screen, &handles, GBUFFER_CHANNELS).unwrap();
    let flags = g.external("flags", 4);
    let wanted = g.external("wanted", 4);
    let entries = intersect(&mut g, &t, &screen, &visible, ROOM, flags).unwrap();
    let blended =
        Blended { image: g.transient("image", 20 * pixels), transmittance: g.transient("transmittance", 4 * pixels) };
    blend(&mut g, &t, &screen, &visible, &entries, &blended).unwrap();
    let surfaces = Surfaces {
        points: g.external("points", 12 * pixels),
        normals: g.external("normals_seen", 12 * pixels),
        coverage: g.external("coverage", 4 * pixels),
    };
    gbuffer(&mut g, &t, &screen, &blended, &surfaces).unwrap();
    let mut words = |name: &str, count: u64| g.external(name, 4 * count);
    let matrix = Weights {
        row_starts: words("row_starts", pixels + 1),
        columns: words("columns", room.into()),
        weights: words("weights", weight_words(room, bits)),
        column_starts: words("column_starts", u64::from(n) + 1),
        rows: words("rows", room.into()),
        row_weights: words("row_weights", weight_words(room, bits)),
        bits,
    };
    let space = Room { capacity: room, gaussians: n, flags, wanted };
    weights(&mut g, &t, &screen, &visible, &entries, surfaces.coverage, &space, &matrix).unwrap();
    let metals = !raw.metallic.is_empty();
    let floats = |g: &mut Graph, name: &str, width: u64| g.external(name, 4 * width * u64::from(n));
    let albedo_range = raw.albedo_range.map(|v| v as f32);
    let provided = RawMaterials {
        albedo_range,
        albedo: floats(&mut g, "albedo", 3),
        roughness: floats(&mut g, "roughness", 1),
        metallic: metals.then(|| floats(&mut g, "metallic", 1)),
    };
    let rendered = PixelMaterials {
        materials: g.external("materials", 16 * pixels),
        metallic: metals.then(|| g.external("metallic_seen", 4 * pixels)),
    };
    let active = values(&mut g, &t, &provided, n).unwrap();
    materials(&mut g, &t, &screen, &active, &matrix, &rendered).unwrap();
    let requested = PixelMaterials {
        materials: g.external("materials_gradient", 16 * pixels),
        metallic: metals.then(|| g.external("metallic_gradient", 4 * pixels)),
    };
    let grads = RawMaterials {
        albedo_range,
        albedo: floats(&mut g, "grad_albedo", 3),
        roughness: floats(&mut g, "grad_roughness", 1),
        metallic: metals.then(|| floats(&mut g, "grad_metallic", 1)),
    };
    materials_bwd(&mut g, &t, &provided, &matrix, n, &requested, false, &grads).unwrap();
    let mut values = Step { camera: scenes::gpu_camera(camera), ..Default::default() };
    values.camera.tiles = [camera.size[0].div_ceil(t.tile[0]), camera.size[1].div_ceil(t.tile[1])];
    let data = scenes::data(scene);
    let four: Vec<f32> = gradient.iter().flat_map(|v| [v[0], v[1], v[2], v[3]].map(|v| v as f32)).collect();
    let one: Vec<f32> = gradient.iter().map(|v| v[4] as f32).collect();
    let mut inputs: Vec<(Buffer, Vec<u8>)> = vec![
        (step, bytes(&[values])),
        (flags, bytes(&[0u32])),
        (provided.albedo, single(&raw.albedo)),
        (provided.roughness, single(&raw.roughness)),
        (requested.materials, bytes(&four)),
    ];
    inputs.extend(handles.contents(&data));
    if let (Some(metallic), Some(gradient)) = (provided.metallic, requested.metallic) {
        inputs.push((metallic, single(&raw.metallic)));
        inputs.push((gradient, bytes(&one)));
    }
    let out = gpu.run(g, &inputs);
    let of_words = |words: Vec<u32>| match bits {
        16 => unpacked_weights(&words, room as usize),
        _ => words.into_iter().map(f32::from_bits).collect(),
    };
    Found {
        points: out.get(surfaces.points),
        normals: out.get(surfaces.normals),
        coverage: out.get(surfaces.coverage),
        row_starts: out.get(matrix.row_starts),
        columns: out.get(matrix.columns),
        weights: of_words(out.get(matrix.weights)),
        column_starts: out.get(matrix.column_starts),
        rows: out.get(matrix.rows),
        row_weights: of_words(out.get(matrix.row_weights)),
        flags: out.get::<u32>(flags)[0],
        wanted: out.get::<u32>(wanted)[0],
        materials: out.get(rendered.materials),
        metallic: rendered.metallic.map(|b| out.get(b)).unwrap_or_default(),
        grad_albedo: out.get(grads.albedo),
        grad_roughness: out.get(grads.roughness),
        grad_metallic: grads.metallic.map(|b| out.get(b)).unwrap_or_default(),
    }
}

fn random_materials(n: usize, metals: bool, reach: f64, seed: u64) -> Materials {
    let mut r = scenes::Rng::new(seed);
    let mut many = |count: usize| (0..count).map(|_| f64::from(r.between(-reach, reach) as f32)).collect::<Vec<_>>();
    // Two albedo ranges: the range of files and the published range.
    let albedo_range = if metals { [0.09, 0.9] } else { [0.01, 0.98] };
    let (albedo, roughness) = (many(3 * n), many(n));
    Materials { albedo, roughness, metallic: if metals { many(n) } else { Vec::new() }, albedo_range }
}

fn random_gradient(pixels: usize, seed: u64) -> Vec<[f64; 5]> {
    let mut r = scenes::Rng::new(seed);
    (0..pixels).map(|_| [(); 5].map(|()| f64::from(r.between(-1.0, 1.0) as f32))).collect()
}
