//! Graphs of all pipelines, built on a planning device.
//!
//! The sizes of the model are those of the settings; the scene is small. Specialization constants follow the model and the
//! device, not the number of Gaussians or pixels. Only the subgroups per tile of blending follow the size of views.

mod entries;
mod gradients;
mod parts;
mod shading;
mod training;
mod transport;
mod views;

use sgs_engine::Device;
use sgs_scene::{Scene, SceneOptions, Splats};
use sgs_synth::{SceneName, SynthOptions};

/// Width and height of the views.
const SIZE: [u32; 2] = [64, 48];

/// Builds the graphs of all pipelines.
///
/// # Errors
/// If a graph cannot be built.
pub fn build(device: &Device) -> anyhow::Result<()> {
    let folder = tempfile::tempdir()?;
    let path = folder.path().join("room");
    let options = SynthOptions {
        scene: SceneName::Box,
        views: 8,
        width: SIZE[0] as usize,
        height: SIZE[1] as usize,
        samples_per_pixel: 4,
        points: 1000,
        relit: false,
        ..Default::default()
    };
    sgs_synth::generate(&path, &options, &|_, _| {})?;
    let scene = Scene::open(&path, &SceneOptions::default())?;
    let mut splats = Splats::from_points(&scene.points, 0)?;
    training::geometry(device, &scene)?;
    training::depths(device, &path)?;
    training::intrinsic(device, &scene, &splats)?;
    training::transport(device, &scene, &splats)?;
    views::build(device)?;
    gradients::build(device)?;
    parts::build(device)?;
    let count = splats.len();
    splats.normals = Some(vec![[0.0, 0.0, 1.0]; count]);
    (splats.albedo, splats.roughness) = (Some(vec![[0.0; 3]; count]), Some(vec![0.0; count]));
    for metallic in [None, Some(vec![0.0; count])] {
        splats.metallic = metallic;
        shading::build(device, &splats)?;
        transport::build(device, &splats)?;
    }
    Ok(())
}
