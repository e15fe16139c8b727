//! Benchmark of `region_mask` and `carry_mask`, checked against their references.
//!
//! A third of the training view is carried to a camera beside it.

use super::Context;
use crate::harness::{Rig, add_passes, bytes};
use crate::report::Report;
use glam::{DMat3, DVec2, DVec3};
use sgs_engine::graph::Graph;
use sgs_passes::cost::Counts;
use sgs_passes::loss::{CarryOptions, Seen, carry_mask, pack_mask, pack_regions, region_mask};
use sgs_passes::pipeline as gpu;
use sgs_passes::reference::project::Camera;
use sgs_passes::reference::region_mask as reference;
use sgs_passes::reference::region_mask::{Carried, View};
use sgs_passes::reference::rng::Pcg;
use sgs_passes::splat::{Blended, Channels, Screen, wanted_words};
use sgs_shaders::structs::Step;

const REGION: u16 = 7;
/// Channels of the training view and of a pseudo-view.
const CHANNELS: [Channels; 2] =
    [Channels { colors: true, normals: true, depth: true }, Channels { colors: false, normals: false, depth: true }];
/// Distance from a threshold within which single precision may decide either way.
const UNSURE: f64 = 2e-3;

/// Returns a wall with relief at depth 3, seen by a camera displaced by `aside`.
fn view(size: [u32; 2], aside: f64, rng: &mut Pcg) -> View {
    let side = size.map(f64::from);
    let camera = Camera {
        rotation: DMat3::from_rotation_y(0.2 * aside),
        translation: DVec3::new(-aside, 0.1 * aside, 0.05),
        focal: DVec2::splat(0.8 * side[0]),
        center: DVec2::new(0.48 * side[0], 0.53 * side[1]),
        size,
        near: 0.01,
        radial: 0.0,
    };
    let pixels = size[0] as usize * size[1] as usize;
    let single = |v: f64| f64::from(v as f32);
    let transmittance: Vec<f64> = (0..pixels).map(|_| single(rng.range(0.0, 0.2))).collect();
    let depth = transmittance.iter().map(|t| single((1.0 - t) * rng.range(2.95, 3.05))).collect();
    View { camera, depth, transmittance }
}

fn on_gpu(c: &Camera) -> gpu::Camera {
    let row = |i: usize| {
        let r = c.rotation.row(i);
        [r.x as f32, r.y as f32, r.z as f32, c.translation[i] as f32]
    };
    gpu::Camera {
        world_to_camera: [row(0), row(1), row(2)],
        near: c.near as f32,
        focal: c.focal.as_vec2().to_array(),
        center: c.center.as_vec2().to_array(),
        size: c.size,
        ..Default::default()
    }
}

/// Fails if a pixel is wrong, except where single precision may decide either way.
fn compare(expected: &[Carried], found: &[u32]) -> anyhow::Result<()> {
    for (p, e) in expected.iter().enumerate() {
        let bit = found[p / 32] >> (p % 32) & 1 == 1;
        anyhow::ensure!(e.margin <= UNSURE || bit == e.inside, "Pixel {p} of the carried mask is wrong.");
    }
    Ok(())
}

/// Measures both passes.
pub fn both(c: &Context<'_>, report: &mut Report) -> anyhow::Result<()> {
    let size = c.workload.largest;
    let pixels = size[0] as usize * size[1] as usize;
    let mut rng = Pcg::new(12);
    let views = [view(size, 0.0, &mut rng), view(size, 0.3, &mut rng)];
    let ids: Vec<u16> = (0..pixels).map(|p| if p as u32 % size[0] < size[0] / 3 { REGION } else { 1 }).collect();
    let mut g = Graph::new("masks");
    let mut inputs = Vec::new();
    let mut seen = Vec::new();
    for (i, (view, channels)) in views.iter().zip(CHANNELS).enumerate() {
        let step = g.uniform(format!("step{i}"), size_of::<Step>() as u64);
        let values = Step { camera: on_gpu(&view.camera), region: u32::from(REGION), ..Default::default() };
        let count = channels.count() as usize;
        let mut image = vec![0.0_f32; pixels * count];
        view.depth.iter().enumerate().for_each(|(p, d)| image[p * count + count - 2] = *d as f32);
        let left: Vec<f32> = view.transmittance.iter().map(|t| *t as f32).collect();
        let blended = Blended {
            image: g.input(format!("image{i}"), 4 * image.len() as u64),
            transmittance: g.input(format!("transmittance{i}"), 4 * pixels as u64),
        };
        inputs.extend([
            (step, bytes(&[values])),
            (blended.image, bytes(&image)),
            (blended.transmittance, bytes(&left)),
        ]);
        seen.push(Seen { screen: Screen { step, largest: size, tile: c.tuning.tile }, blended, channels });
    }
    let packed = pack_regions(&ids);
    let region_ids = g.input("ids", 4 * packed.len() as u64);
    inputs.push((region_ids, bytes(&packed)));
    let words = 4 * wanted_words(pixels as u64);
    let (mask, into) = (g.external("mask", words), g.external("carried", words));
    region_mask(&mut g, c.tuning, &seen[0].screen, region_ids, mask)?;
    let options = CarryOptions::default();
    carry_mask(&mut g, c.tuning, "carry_mask", &seen[0], mask, &seen[1], options, into)?;
    let mut rig = Rig::new(c.device, g, inputs, true)?;
    let (times, _) = rig.measure(c.warmup, c.repeats)?;

    let trained = reference::region_mask(&ids, u32::from(REGION));
    let (opacity, tolerance) = (f64::from(options.least_opacity), f64::from(options.tolerance));
    let expected = reference::carry_mask(&views[0], &trained, &views[1], opacity, tolerance);
    let masked = expected.iter().filter(|e| e.inside).count();
    let counts = Counts { pixels: pixels as f64, masked: masked as f64, ..Default::default() };
    add_passes(report, rig.plan(), &times, &counts, &c.ceiling);
    anyhow::ensure!(rig.get::<u32>(mask)? == pack_mask(&trained), "The training view's region is wrong.");
    compare(&expected, &rig.get::<u32>(into)?)?;
    report.check(format!(
        "masks: the region, and {masked} pixels of {pixels} that it is carried to, are the references'"
    ));
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn single_wrong_bit_is_detected() {
        let carried = [Carried { inside: true, margin: 1.0 }, Carried { inside: false, margin: 0.0 }];
        assert!(compare(&carried, &[1]).is_ok() && compare(&carried, &[3]).is_ok());
        assert!(compare(&carried, &[0]).is_err());
    }
}
