//! Room with emitters on disk, created without training.

use crate::rooms::{self, Room};
use crate::runs;
use glam::Vec3;
use sgs_config::{Settings, TransportSettings, VisibilityKind};
use sgs_passes::transport::LightShape;
use sgs_run::{EmitterFile, EmitterRow, EnclosureRow, OpeningRow, RunDirectory, SKY, read_emitters, write_emitters};
use sgs_scene::{Image, Splats, write_environment};
use std::path::Path;

/// Distance of neighboring Gaussians of a wall.
const SPACING: f32 = 0.25;

/// Names of the emitters of [`fabricate_emitting`].
pub const EMITTERS: [&str; 3] = ["window 1", "light 1", "light 2"];

fn logit(value: f32) -> f32 {
    (value / (1.0 - value)).ln()
}

/// Returns the inside of a box as flat Gaussians with materials.
///
/// `half`: half the side lengths. Linear albedo of the walls: low x, high x, low y, high y, low z, high z.
pub fn walls(half: Vec3, all: &[[f32; 3]; 6]) -> Splats {
    let mut s = Splats::default();
    let (mut normals, mut albedo) = (Vec::new(), Vec::new());
    for (wall, color) in all.iter().enumerate() {
        let axis = wall / 2;
        let sign = if wall.is_multiple_of(2) { -1.0 } else { 1.0 };
        let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
        let [rows, columns] = [u, v].map(|k| (2.0 * half[k] / SPACING) as u32);
        for i in 0..rows * columns {
            let mut place = Vec3::ZERO;
            place[axis] = sign * half[axis];
            place[u] = SPACING * ((i % rows) as f32 + 0.5) - half[u];
            place[v] = SPACING * ((i / rows) as f32 + 0.5) - half[v];
            let mut scale = Vec3::splat(0.6 * SPACING);
            scale[axis] = 0.01;
            let mut normal = Vec3::ZERO;
            normal[axis] = -sign;
            s.means.push(place.into());
            s.log_scales.push(scale.map(f32::ln).into());
            s.rotations.push([1.0, 0.0, 0.0, 0.0]);
            s.opacity_logits.push(logit(0.99));
            normals.push(normal.into());
            albedo.push(color.map(logit));
        }
    }
    s.sh[0] = vec![0.0; 3 * s.len()];
    s.roughness = Some(vec![logit(0.8); s.len()]);
    (s.normals, s.albedo) = (Some(normals), Some(albedo));
    s
}

/// Writes the scene `ROOT/scene` and the run `ROOT/run` with emitters.
///
/// Their names are [`EMITTERS`]; the last is off.
/// Gaussians of the far wall belong to the window.
pub fn fabricate_emitting(root: &Path) {
    let scene = root.join("scene");
    std::fs::create_dir_all(&scene).expect("a directory");
    Room::default().write(&scene);
    let half = rooms::WALLS.as_vec3();
    let mut splats = walls(half, &rooms::ALBEDO);
    let window = |mean: &[f32; 3]| mean[2] > 0.99 * half.z && mean[0].abs() < 0.5 && mean[1].abs() < 0.5;
    splats.emitters = Some(splats.means.iter().map(|mean| u32::from(window(mean))).collect());
    let run = RunDirectory::create(&root.join("run")).expect("a directory");
    let mut settings = Settings { scene, ..Settings::default() };
    settings.intrinsic.visibility.kind = VisibilityKind::None;
    run.write_settings(&settings).expect("settings");
    splats.write_ply(&run.path("scene.ply")).expect("a PLY file");
    let shapes = [
        LightShape::Rectangle { corner: [-0.5, 0.5, half.z - 0.01], edge_u: [0.0, -1.0, 0.0], edge_v: [1.0, 0.0, 0.0] },
        LightShape::Sphere { center: [0.4, -0.3, 0.4], radius: 0.1 },
        LightShape::Point { position: [-0.6, 0.3, 0.0] },
    ];
    let colors = [[0.5, 0.6, 1.0], [12.0, 9.0, 6.0], [0.2, 0.6, 0.3]];
    let row = |i: usize| EmitterRow { name: EMITTERS[i].into(), on: i < 2, color: colors[i], shape: shapes[i] };
    let [low, high] = [-1.01 * half, 1.01 * half].map(|corner| corner.to_array());
    let enclosure = EnclosureRow { low, high, albedo: [[0.5, 0.4, 0.3]; 6] };
    let transport = TransportSettings { surfels: 256, ..TransportSettings::default() };
    let file = EmitterFile::new(enclosure, transport, (0..3).map(row).collect());
    file.check().expect("valid emitters");
    write_emitters(&run.emitters(), &file).expect("emitters.json");
}

/// Opening of [`fabricate_windowed`], in the far wall.
pub fn opening() -> OpeningRow {
    let z = rooms::WALLS.z as f32 - 0.01;
    OpeningRow { corner: [-0.5, -0.5, z], edge_u: [0.0, 1.0, 0.0], edge_v: [1.0, 0.0, 0.0] }
}

/// Writes scene and run of [`fabricate_emitting`], with a window onto a sky.
pub fn fabricate_windowed(root: &Path) {
    fabricate_emitting(root);
    let run = root.join("run");
    let mut file = read_emitters(&run.join("emitters.json")).expect("emitters.json");
    let window = &mut file.emitters[0];
    (window.shape, window.color) = (opening().window(), [1.0, 0.8, 0.6]);
    (file.openings, file.environment) = (vec![opening()], Some(SKY.to_owned()));
    write_emitters(&run.join("emitters.json"), &file).expect("emitters.json");
    write_environment(&run.join(SKY), &sky(5)).expect("sky.exr");
}

/// Returns an environment, brighter above the horizon.
pub fn sky(seed: u64) -> Image {
    let mut data = runs::map(32, seed);
    data[..3 * 32 * 8].iter_mut().for_each(|v| *v *= 4.0);
    Image { width: 32, height: 16, channels: 3, data }
}
