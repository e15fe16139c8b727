//! Surfaces under an environment, and everything that a device makes of them at once.

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

/// Place of the camera.
pub const CAMERA: [f32; 3] = [0.25, -0.5, 1.5];
/// Columns and rows that smoothness is measured on.
pub const MAP: [u32; 2] = [64, 32];
/// Weight of smoothness.
pub const WEIGHT: f32 = 0.75;

/// As bytes.
pub fn bytes<T: bytemuck::NoUninit>(data: &[T]) -> Vec<u8> {
    bytemuck::cast_slice(data).to_vec()
}

/// An environment with smoothness on a small map.
pub fn made(size: u32) -> Environment {
    Environment::new(size, &EnvironmentOptions { smoothness: Some(MAP), ..Default::default() }).unwrap()
}

/// Texels as a room has them: a gradient, noise, a few that are very bright.
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

/// Everything that a device makes of an environment, surfaces and a gradient.
pub struct Found {
    /// All levels.
    pub radiance: Vec<f32>,
    /// Light on each pixel.
    pub ambient: Vec<f32>,
    /// The diffuse part of it.
    pub diffuse: Vec<f32>,
    /// Gradients, added to [`BEFORE`].
    pub materials: Vec<f32>,
    /// Likewise.
    pub metallic: Vec<f32>,
    /// Fixed point, low words first.
    pub texel_sums: Vec<u32>,
    /// Gradients.
    pub texels: Vec<f32>,
    /// Without its weight.
    pub smoothness: f64,
}

/// What it is made from.
#[derive(Clone, Copy)]
pub struct Given<'g> {
    /// The environment.
    pub e: &'g Environment,
    /// Its texels.
    pub texels: &'g [f32],
    /// Surfaces.
    pub pixels: &'g [Pixel],
    /// By the light on them.
    pub gradient: &'g [f32],
    /// With smoothness.
    pub smooth: bool,
    /// With metallic.
    pub metallic: bool,
    /// Whether lanes add up first, as wide subgroups do.
    pub merge: bool,
}

/// What gradients of materials begin with.
pub const BEFORE: f32 = 0.5;

/// Runs every stage once.
pub fn run(gpu: &Gpu, t: &Tuning, given: &Given<'_>) -> Found {
    let (e, pixels) = (given.e, given.pixels);
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
        metallic: given.metallic.then_some(metallic),
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
    let back = if given.merge { Tuning { subgroup_size: 32, ..*t } } else { *t };
    environment_diffuse(&mut g, t, e, &tables, &view, &filtered, diffuse).unwrap();
    let by_metallic = given.metallic.then_some(metallic_gradient);
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
    let smooth = environment_smoothness(&mut g, t, e, &tables, texels, WEIGHT).filter(|_| given.smooth);
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
        (texels, bytes(given.texels)),
        (points, floats(&|p| p.point.to_vec())),
        (normals, floats(&|p| p.normal.to_vec())),
        (coverage, floats(&|p| vec![p.coverage])),
        (materials, floats(&|p| [&p.albedo[..], &[p.roughness]].concat())),
        (metallic, floats(&|p| vec![p.metallic])),
        (radiance_gradient, bytes(given.gradient)),
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

/// Numbers as 32 bits hold them.
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

/// Of length 1.
pub fn unit(d: [f64; 3]) -> [f64; 3] {
    let length = d.iter().map(|x| x * x).sum::<f64>().sqrt();
    d.map(|x| x / length)
}

/// A pixel whose normal stands at an angle of cosine `facing` to the view.
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

/// Ordinary surfaces, and those that could go wrong. No roughness lies where the levels or the table bend.
pub fn surfaces(seed: u32) -> Vec<Pixel> {
    let mut rng = Pcg::new(seed);
    let mut all = Vec::new();
    for roughness in [0.01, 0.05, 0.09, 0.2, 0.3, 0.45, 0.6, 0.9, 0.999] {
        for facing in [1.0, 0.9, 0.5, 0.1, 1e-3, -0.5] {
            all.push(pixel(&mut rng, roughness, facing));
        }
    }
    // Mirrored directions along edges and to corners of the cube, and normals there.
    for d in
        [[1.0, 1.0, 0.2], [1.0, -1.0, 1.0], [-1.0, -1.0, -1.0], [0.3, 1.0, -1.0], [1.0, 0.999, 0.998], [0.0, 0.0, 1.0]]
    {
        let mut p = pixel(&mut rng, 0.15, 0.7);
        p.normal = unit(d);
        all.push(narrow(p));
        let mut q = pixel(&mut rng, 0.5, 1.0);
        q.normal = unit(d);
        let (camera, n) = (CAMERA.map(f64::from), unit(d));
        // Seen along the normal: mirrored into it.
        q.point = std::array::from_fn(|k| camera[k] - 2.0 * n[k]);
        all.push(narrow(Pixel { roughness: 0.31, ..q }));
    }
    // Not shaded, and just so.
    all.push(Pixel { coverage: 0.0009, ..pixel(&mut rng, 0.4, 0.5) });
    all.push(narrow(Pixel { coverage: 0.0011, ..pixel(&mut rng, 0.4, 0.5) }));
    all.push(Pixel { normal: [0.0; 3], ..pixel(&mut rng, 0.4, 0.5) });
    all
}
