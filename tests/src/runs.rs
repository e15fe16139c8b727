//! Run directories with the files of the intrinsic stage, created without training.

use crate::field;
use crate::scenes::{self, Rng};
use sgs_config::{Settings, VisibilityKind};
use sgs_passes::scene::Model;
use sgs_passes::shade::visibility::FieldConfig;
use sgs_run::{LightFile, LightRow, LobeRow, RunDirectory, VisibilityFile, splats, write_lights};
use sgs_scene::{Image, Splats, write_environment};
use std::path::Path;

/// Optional contents of a run besides materials and lights.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Parts {
    /// Whether the Gaussians have metallic.
    pub metallic: bool,
    /// Whether the run has an environment map.
    pub environment: bool,
    /// Source of shadows. `Field` adds a field with random weights.
    pub visibility: VisibilityKind,
}

impl Parts {
    /// All optional contents.
    pub const ALL: Parts = Parts { metallic: true, environment: true, visibility: VisibilityKind::Field };
    /// No optional contents.
    pub const NONE: Parts = Parts { metallic: false, environment: false, visibility: VisibilityKind::None };
}

/// Number of lights of a run.
pub const LIGHTS: usize = 4;

/// Returns splats with materials in front of [`scenes::camera`].
///
/// Most normals face the camera.
pub fn with_materials(count: usize, metallic: bool, seed: u64) -> Splats {
    let model = Model { sh_degree: 1, normals: true, ..Default::default() };
    let mut s = splats(&scenes::data(&scenes::ordinary(count, 1, true, seed)), model);
    let mut r = Rng::new(seed + 100);
    let mut raw = || r.between(-2.0, 2.0) as f32;
    s.normals.iter_mut().flatten().for_each(|n| n[2] = -0.3 - n[2].abs());
    s.albedo = Some((0..count).map(|_| [raw(), raw(), raw()]).collect());
    s.roughness = Some((0..count).map(|_| raw()).collect());
    s.metallic = metallic.then(|| (0..count).map(|_| raw()).collect());
    s
}

/// Returns a latitude-longitude map of random radiance, three floats per pixel.
pub fn map(width: u32, seed: u64) -> Vec<f32> {
    let mut r = Rng::new(seed);
    (0..3 * width * width / 2).map(|_| r.between(0.0, 2.0) as f32).collect()
}

/// Creates a run directory with [`LIGHTS`] lights, the third of which is off.
pub fn fabricate(root: &Path, parts: Parts) {
    let run = RunDirectory::create(root).expect("a directory");
    let mut settings = Settings::default();
    settings.intrinsic.environment.resolution = 16;
    settings.intrinsic.visibility.kind = parts.visibility;
    run.write_settings(&settings).expect("settings");
    with_materials(220, parts.metallic, 11).write_ply(&run.path("scene.ply")).expect("a PLY file");
    let mut r = Rng::new(21);
    let mut vector = |low: f64, high: f64| [0; 3].map(|_| r.between(low, high) as f32);
    let mut light = |i: usize| {
        let lobes = (0..1 + i % 3).map(|k| LobeRow {
            axis: [[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [0.6, 0.0, -0.8]][k],
            sharpness: 0.5 * k as f32,
            amplitude: vector(1.0, 6.0),
        });
        let lobes = lobes.collect();
        LightRow { position: vector(-0.8, 0.8), gain: if i == 2 { 0.0 } else { 1.0 + 0.5 * i as f32 }, lobes }
    };
    let lights = LightFile::new(0.25, (0..LIGHTS).map(&mut light).collect());
    write_lights(&run.path("lights.json"), &lights).expect("lights");
    if parts.environment {
        let image = Image::from_data(32, 16, 3, map(32, 5)).expect("a map");
        write_environment(&run.path("environment.exr"), &image).expect("an environment map");
    }
    if parts.visibility == VisibilityKind::Field {
        let config = FieldConfig::new(4, 10, 4, 40);
        let case = field::Case::random(config, 1, 1, 3);
        let (low, high) = ([-6.0, -6.0, -1.0], [6.0, 6.0, 8.0]);
        let field = VisibilityFile { config, low, high, tables: case.tables, mlp: case.mlp };
        field.save(&run.path("visibility.safetensors")).expect("a field");
    }
}
