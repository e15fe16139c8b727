//! Graphs of bounced light: the matrix of a room, its solve, lights of views, and shading.

use super::SIZE;
use super::shading::{dark, scene as shade};
use sgs_engine::Device;
use sgs_passes::Tuning;
use sgs_passes::pipeline::{
    FrameEmitter, Responder, ShadedTransport, SurfaceShape, TransportOptions, TransportScene, ViewLights,
};
use sgs_passes::transport::{
    AreaLight, Enclosure, LightShape, Nearest, NearestOptions, Opening, Outside, Sky, SolveOptions, SurfelTree,
    Surfels, nearest_surfels,
};
use sgs_run::{Visibility, shaded_scene};
use sgs_scene::Splats;
use std::sync::Arc;

/// Builds all.
pub fn build(device: &Device, splats: &Splats) -> anyhow::Result<()> {
    let settings = sgs_config::Settings::default().transport;
    let tuning = Tuning::for_device(device.info());
    let surfels = floor();
    let (tree, enclosure) = (SurfelTree::new(&surfels)?, Enclosure::new([-2.0; 3], [2.0; 3], 1.0)?);
    let options = TransportOptions { rays: settings.rays, samples: 8, seed: 1, offset: 0.01, clearance: 0.02 };
    let make = || TransportScene::new(device, tuning, (&surfels, &tree), &enclosure, options);
    let lights = lights();
    let near = NearestOptions { normal_length: 0.2, least_distance: 0.01 };
    let normals = splats.normals.clone().unwrap_or_default();
    let nearest = nearest_surfels(&splats.means, &normals, &surfels, &near);
    let shape = SurfaceShape { largest: SIZE, gaussians: splats.len() as u32, weights: 1 << 12, weight_bits: 32 };
    let opening = Opening { corner: [0.0; 3], edge_u: [1.0, 0.0, 0.0], edge_v: [0.0, 1.0, 0.0] };
    let sky = Sky::new(&[1.0; 24], [4, 2]);
    anyhow::ensure!(sky.is_some(), "The environment behind the openings is refused.");
    for outside in [Outside::default(), Outside { openings: vec![opening], sky }] {
        let room = Arc::new(make()?.lit_by_first(surfels.len() as u32)?.with_outside(&outside)?);
        ViewLights::new(device, &room, &lights, &shape)?;
        let unit = room.unit_light(&lights)?;
        let values = vec![0.5; 3 * room.receivers() as usize];
        for accelerated in [false, true] {
            room.solve(&values, &values, &SolveOptions { accelerated, ..Default::default() })?;
        }
        room.responses(&values, &unit, &SolveOptions::default())?;
        let light = |scene: &Arc<TransportScene>| fixed(device, scene, &lights, &nearest, splats.len());
        let mut all = vec![light(&room)?];
        all.push(light(&room)?.with_radiosity(device, &values)?);
        all.push(light(&room)?.with_gains(device, &vec![0.0; splats.len()])?);
        let emitters: Vec<FrameEmitter> = lights.iter().copied().map(FrameEmitter::of).collect();
        let responses = vec![0.0; 3 * unit.len()];
        let numbers = vec![1; splats.len()];
        let responding =
            || ShadedTransport::with_responses(device, Arc::clone(&room), &emitters, &nearest, &responses, &numbers);
        for direct in [false, true] {
            let plain = responding()?;
            let shaded = if direct { plain.with_direct_light(device, &unit, &values)? } else { plain };
            Responder::new(device, tuning, &shaded, &values)?;
            all.push(shaded);
        }
        for transport in all {
            let mut scene = shaded_scene(device, splats, None, None, &Visibility::None)?;
            scene.transport = Some(transport.clone());
            let mut other = shaded_scene(device, splats, None, None, &Visibility::None)?;
            other.transport = Some(transport);
            shade(device, scene, Some(other), &dark())?;
        }
    }
    Ok(())
}

/// Returns light that does not change.
fn fixed(
    device: &Device,
    scene: &Arc<TransportScene>,
    lights: &[AreaLight],
    nearest: &Nearest,
    gaussians: usize,
) -> sgs_engine::Result<ShadedTransport> {
    let irradiance = vec![0.0; 3 * scene.receivers() as usize];
    ShadedTransport::new(device, Arc::clone(scene), lights, nearest, &irradiance, &vec![[0.0; 3]; gaussians])
}

/// Returns surfels on a floor.
fn floor() -> Surfels {
    let points = (0..256).map(|i| [(i % 16) as f32 * 0.1 - 0.8, 0.0, (i / 16) as f32 * 0.1 - 0.8]).collect();
    Surfels { points, normals: vec![[0.0, 1.0, 0.0]; 256], radii: vec![0.1; 256] }
}

/// Returns a light with an extent, and one without.
fn lights() -> Vec<AreaLight> {
    let shapes =
        [LightShape::Sphere { center: [0.0, 1.0, 0.0], radius: 0.1 }, LightShape::Point { position: [0.5, 1.0, 0.0] }];
    shapes.into_iter().map(|shape| AreaLight { shape, color: [1.0; 3] }).collect()
}
