//! Surfaces under an environment map, and all results of the device for them.

use sgs_engine::graph::{Buffer, Graph};
use sgs_passes::Tuning;
use sgs_passes::reference::environment::Pixel;
use sgs_passes::reference::rng::Pcg;
use sgs_passes::shade::environment::{
    Environment, EnvironmentOptions, EnvironmentView, environment, environment_bwd, environment_diffuse,
    environment_filter, environment_filter_bwd, environment_smoothness,
};
use sgs_shaders::structs::Step;

use crate::Gpu;

/// Position of the camera.
pub const CAMERA: [f32; 3] = [0.25, -0.5, 1.5];
/// Columns and rows of the smoothness map.
pub const MAP: [u32; 2] = [64, 32];
/// Weight of the smoothness loss.
pub const WEIGHT: f32 = 0.75;

/// Returns the bytes of a slice.
pub fn bytes<T: bytemuck::NoUninit>(data: &[T]) -> Vec<u8> {
    bytemuck::cast_slice(data).to_vec()
}

/// Creates an environment map with smoothness on a small map.
pub fn made(size: u32) -> Environment {
    Environment::new(size, &EnvironmentOptions { smoothness: Some(MAP), ..Default::default() }).unwrap()
}

/// Returns texels that resemble a room: a gradient, noise and a few very bright texels.
pub fn room(e: &Environment, seed: u32) -> Vec<f32> {
    let mut rng = Pcg::new(seed);
    let mut texels = e.start(seed);
    for t in texels.chunks_mut(3) {
        if rng.uniform() < 0.01 {
            t.fill((30.0 * rng.uniform()) as f32);
        }
    }
    texels
}

/// Results of the device for an environment map, surfaces and a gradient.
pub struct Found {
    /// Filtered radiance of all levels.
    pub radiance: Vec<f32>,
    /// Environment light on each pixel.
    pub ambient: Vec<f32>,
    /// Diffuse component of the environment light.
    pub diffuse: Vec<f32>,
    /// Gradients of the materials, added to [`BEFORE`].
    pub materials: Vec<f32>,
    /// Gradients of metallic, added to [`BEFORE`].
    pub metallic: Vec<f32>,
    /// Gradient sums of the texels in fixed point, low words first.
    pub texel_sums: Vec<u32>,
    /// Gradients of the texels.
    pub texels: Vec<f32>,
    /// Smoothness loss without its weight.
    pub smoothness: f64,
}

/// Inputs of [`run`].
#[derive(Clone, Copy)]
pub struct Case<'g> {
    /// Environment map.
    pub e: &'g Environment,
    /// Texels of the environment map.
    pub texels: &'g [f32],
    /// Shaded surfaces.
    pub pixels: &'g [Pixel],
    /// Gradient of the loss with respect to the environment light of each pixel.
    pub gradient: &'g [f32],
    /// Whether the smoothness loss contributes.
    pub smooth: bool,
    /// Whether the surfaces have metallic.
    pub metallic: bool,
    /// Whether a subgroup adds up its gradients first, as subgroups of 32 do.
    pub merge: bool,
}

/// Initial value of the gradients of materials.
pub const BEFORE: f32 = 0.5;

/// Runs every pass once.
pub fn run(gpu: &Gpu, t: &Tuning, case: &Case<'_>) -> Found {
    let (e, pixels) = (case.e, case.pixels);
    let count = pixels.len() as u64;
    let mut g = Graph::new("environment");
    let tables = e.declare(&mut g);
    let step = g.uniform("step", size_of::<Step>() as u64);
    let texels = g.input("texels", 4 * u64::from(e.floats()));
    let [points, normals, radiance_gradient] = ["points", "normals", "gradient"].map(|n| g.input(n, 12 * count));
    let coverage = g.input("coverage", 4 * count);
    let materials = g.input("materials", 16 * count);
    let metallic = g.input("metallic", 4 * count);
    let view = EnvironmentView {
        step,
        points,
        normals,
        coverage,
        materials,
        metallic: case.metallic.then_some(metallic),
        pixels: count,
    };
    let ambient = g.external("ambient", 12 * count);
    let diffuse = g.external("diffuse", 12 * count);
    let materials_gradient = g.external("materials_gradient", 16 * count);
    let metallic_gradient = g.external("metallic_gradient", 4 * count);
    let gradient = g.external("texel_gradient", 4 * u64::from(e.floats()));
    let radiance = g.external("radiance", 12 * u64::from(e.filtered_texels()));
    let sums_out = g.external("sums", 24 * u64::from(e.filtered_texels()));

    let filtered = environment_filter(&mut g, t, e, &tables, texels).unwrap();
    environment(&mut g, t, e, &tables, &view, &filtered, ambient).unwrap();
    let back = if case.merge { Tuning { subgroup_size: 32, ..*t } } else { *t };
    environment_diffuse(&mut g, t, e, &tables, &view, &filtered, diffuse).unwrap();
    let by_metallic = case.metallic.then_some(metallic_gradient);
    let sums = environment_bwd(
        &mut g,
        &back,
        e,
        &tables,
        &view,
        &filtered,
        radiance_gradient,
        materials_gradient,
        by_metallic,
    )
    .unwrap();
    let smooth = environment_smoothness(&mut g, t, e, &tables, texels, WEIGHT).filter(|_| case.smooth);
    environment_filter_bwd(&mut g, t, e, &tables, &filtered, &sums, smooth.as_ref(), gradient).unwrap();
    g.copy("radiance", filtered.radiance, radiance).unwrap();
    g.copy("sums", sums.texel_sums, sums_out).unwrap();
    let smooth_out = smooth.map(|s| {
        let out = g.external("smooth", 4 * u64::from(s.groups));
        g.copy("smooth", s.sums, out).unwrap();
        out
    });

    let mut values = Step::default();
    values.camera.size = [count as u32, 1];
    values.camera.position = CAMERA;
    let floats = |f: &dyn Fn(&Pixel) -> Vec<f64>| -> Vec<u8> {
        bytes(&pixels.iter().flat_map(f).map(|x| x as f32).collect::<Vec<f32>>())
    };
    let mut inputs: Vec<(Buffer, Vec<u8>)> = vec![
        (step, bytes(&[values])),
        (texels, bytes(case.texels)),
        (points, floats(&|p| p.point.to_vec())),
        (normals, floats(&|p| p.normal.to_vec())),
        (coverage, floats(&|p| vec![p.coverage])),
        (materials, floats(&|p| [&p.albedo[..], &[p.roughness]].concat())),
        (metallic, floats(&|p| vec![p.metallic])),
        (radiance_gradient, bytes(case.gradient)),
        (materials_gradient, bytes(&vec![BEFORE; 4 * pixels.len()])),
        (metallic_gradient, bytes(&vec![BEFORE; pixels.len()])),
    ];
    inputs.extend(e.contents(&tables));
    let out = gpu.run(g, &inputs);
    Found {
        radiance: out.get(radiance),
        ambient: out.get(ambient),
        diffuse: out.get(diffuse),
        materials: out.get(materials_gradient),
        metallic: out.get(metallic_gradient),
        texel_sums: out.get(sums_out),
        texels: out.get(gradient),
        smoothness: smooth_out.map_or(0.0, |b| out.get::<f32>(b).iter().map(|x| f64::from(*x)).sum()),
    }
}

/// Rounds the numbers of a pixel to 32-bit floats.
pub fn narrow(p: Pixel) -> Pixel {
    let n = |x: f64| f64::from(x as f32);
    Pixel {
        point: p.point.map(n),
        normal: p.normal.map(n),
        coverage: n(p.coverage),
        albedo: p.albedo.map(n),
        roughness: n(p.roughness),
        metallic: n(p.metallic),
    }
}

/// Returns the vector scaled to length 1.
pub fn unit(d: [f64; 3]) -> [f64; 3] {
    let length = d.iter().map(|x| x * x).sum::<f64>().sqrt();
    d.map(|x| x / length)
}

/// Draws a pixel whose normal and view direction have the cosine `facing`.
pub fn pixel(rng: &mut Pcg, roughness: f64, facing: f64) -> Pixel {
    let point: [f64; 3] = std::array::from_fn(|_| f64::from(rng.range(-2.0, 2.0) as f32));
    let view = unit(std::array::from_fn(|k| f64::from(CAMERA[k]) - point[k]));
    let other = unit([rng.normal(), rng.normal(), rng.normal()]);
    let along: f64 = (0..3).map(|k| other[k] * view[k]).sum();
    let across = unit(std::array::from_fn(|k| other[k] - along * view[k]));
    let sine = (1.0 - facing * facing).max(0.0).sqrt();
    narrow(Pixel {
        point,
        normal: std::array::from_fn(|k| facing * view[k] + sine * across[k]),
        coverage: 1.0,
        albedo: [rng.range(0.1, 0.95), rng.range(0.1, 0.95), rng.range(0.1, 0.95)],
        roughness,
        metallic: rng.uniform(),
    })
}

/// Returns ordinary surfaces and corner cases.
///
/// No roughness lies at a kink of the level interpolation or of the table, where gradients jump.
pub fn surfaces(seed: u32) -> Vec<Pixel> {
    let mut rng = Pcg::new(seed);
    let mut all = Vec::new();
    for roughness in [0.01, 0.05, 0.09, 0.2, 0.3, 0.45, 0.6, 0.9, 0.999] {
        for facing in [1.0, 0.9, 0.5, 0.1, 1e-3, -0.5] {
            all.push(pixel(&mut rng, roughness, facing));
        }
    }
    // Normals and mirrored directions along edges and toward corners of the cube map.
    for d in
        [[1.0, 1.0, 0.2], [1.0, -1.0, 1.0], [-1.0, -1.0, -1.0], [0.3, 1.0, -1.0], [1.0, 0.999, 0.998], [0.0, 0.0, 1.0]]
    {
        let mut p = pixel(&mut rng, 0.15, 0.7);
        p.normal = unit(d);
        all.push(narrow(p));
        let mut q = pixel(&mut rng, 0.5, 1.0);
        q.normal = unit(d);
        let (camera, n) = (CAMERA.map(f64::from), unit(d));
        // A view along the normal mirrors into the normal.
        q.point = std::array::from_fn(|k| camera[k] - 2.0 * n[k]);
        all.push(narrow(Pixel { roughness: 0.31, ..q }));
    }
    // Coverage just below and just above the shading threshold, and a normal of length 0.
    all.push(Pixel { coverage: 0.0009, ..pixel(&mut rng, 0.4, 0.5) });
    all.push(narrow(Pixel { coverage: 0.0011, ..pixel(&mut rng, 0.4, 0.5) }));
    all.push(Pixel { normal: [0.0; 3], ..pixel(&mut rng, 0.4, 0.5) });
    all
}
