//! Random Gaussians in front of a camera, and variants with rounding errors.

use super::signed;
use crate::scenes::Rng;
use glam::{DMat3, DVec2, DVec3};
use proptest::prelude::*;
use sgs_passes::reference::project::{Camera, Gaussians};

/// Draws a 32-bit float of either sign, log-uniform between powers of ten.
fn single(low: f64, high: f64) -> impl Strategy<Value = f64> {
    signed(low, high).prop_map(|x| f64::from(x as f32))
}

/// Gaussian with its position relative to the camera.
#[derive(Clone, Debug)]
struct One {
    depth: f64,
    across: [f64; 2],
    log_scale: [f64; 3],
    rotation: [f64; 4],
    logit: f64,
    color: [f64; 3],
}

prop_compose! {
    /// Draws a Gaussian of any shape and opacity, in the view or a little beside it.
    fn gaussian()(
        depth in -2.5..5.0_f64,
        across in [-1.2..1.2_f64, -1.2..1.2_f64],
        log_scale in [-20.0..18.0_f64, -20.0..18.0_f64, -20.0..18.0_f64],
        rotation in [single(-20.0, 17.0), single(-20.0, 17.0), single(-20.0, 17.0), single(-20.0, 17.0)],
        logit in -30.0..30.0_f64,
        color in [-1.5..1.5_f64, -1.5..1.5_f64, -1.5..1.5_f64],
    ) -> One {
        One { depth: 10_f64.powf(depth), across, log_scale, rotation, logit, color }
    }
}

prop_compose! {
    /// Draws up to 11 Gaussians and a camera of up to 39 x 39 pixels.
    pub fn scene()(
        all in prop::collection::vec(gaussian(), 1..12),
        size in [1..40_u32, 1..40_u32],
        width in 1.0..170.0_f64,
        turn in [-3.0..3.0_f64, -1.5..1.5_f64, -3.0..3.0_f64],
        away in [single(-3.0, 2.0), single(-3.0, 2.0), single(-3.0, 2.0)],
    ) -> (Gaussians, Camera) {
        place(&all, size, width, turn, away)
    }
}

prop_compose! {
    /// Draws up to 3 Gaussians in small images, with higher spherical harmonics bands.
    pub fn few()(
        all in prop::collection::vec(gaussian(), 1..4),
        size in [1..20_u32, 1..20_u32],
        width in 1.0..170.0_f64,
        turn in [-3.0..3.0_f64, -1.5..1.5_f64, -3.0..3.0_f64],
        away in [single(-3.0, 2.0), single(-3.0, 2.0), single(-3.0, 2.0)],
        degree in 0..4_usize,
        bands in prop::collection::vec(-1.0..1.0_f64, 3 * 3 * (3 + 5 + 7)),
    ) -> (Gaussians, Camera) {
        let (mut g, camera) = place(&all, size, width, turn, away);
        let mut bands = bands.into_iter().map(|x| f64::from(x as f32));
        for band in 1..=degree {
            g.sh[band] = bands.by_ref().take(3 * (2 * band + 1) * g.len()).collect();
        }
        (g, camera)
    }
}

/// Creates a camera with a pose, and the Gaussians in front of it.
fn place(all: &[One], size: [u32; 2], width: f64, turn: [f64; 3], away: [f64; 3]) -> (Gaussians, Camera) {
    let single = |v: f64| f64::from(v as f32);
    let focal = single(0.5 * f64::from(size[0]) / (0.5 * width.to_radians()).tan());
    let rotation = DMat3::from_euler(glam::EulerRot::XYZ, turn[0], turn[1], turn[2]);
    // Rounded to single precision like the GPU's rotation.
    let rotation = DMat3::from_cols_array(&rotation.to_cols_array().map(single));
    let half = 0.5 * f64::from(size[0].max(size[1])) / focal;
    let camera = Camera {
        rotation,
        translation: DVec3::from_array(away.map(single)),
        focal: DVec2::splat(focal),
        center: DVec2::new(0.5 * f64::from(size[0]), 0.5 * f64::from(size[1])),
        size,
        near: f64::from(0.01_f32),
        // Half of the cameras have distortion as training may learn it.
        radial: if away[0] > 0.0 { single(0.1 * (1e3 * turn[0]).sin()) } else { 0.0 },
    };
    let mut g = Gaussians::default();
    for one in all {
        let seen = DVec3::new(one.across[0] * half * one.depth, one.across[1] * half * one.depth, one.depth);
        let mean = rotation.inverse() * (seen - camera.translation);
        g.means.extend(mean.to_array().map(single));
        g.log_scales.extend(one.log_scale.map(single));
        g.rotations.extend(one.rotation.map(single));
        g.opacity_logits.push(single(one.logit));
        g.sh[0].extend(one.color.map(single));
    }
    (g, camera)
}

/// Returns true if single precision moves a center by more than 1/1000 pixel.
///
/// Only double precision gives the position of such a center.
pub fn blurred(g: &Gaussians, camera: &Camera) -> bool {
    g.means.chunks_exact(3).any(|m| {
        let mean = DVec3::from_slice(m);
        let depth = (camera.rotation * mean + camera.translation).z.max(camera.near);
        let size = mean.length() + camera.translation.length();
        camera.focal.x * f64::from(f32::EPSILON) * size / depth > 1e-3
    })
}

/// Returns Gaussians with rounding errors of single precision.
///
/// Every number moves by a few units in the last place, up or down, by random numbers of the seed `way`.
pub fn rounded(g: &Gaussians, camera: &Camera, way: u64) -> Gaussians {
    let mut other = g.clone();
    let mut random = Rng::new(way);
    for (i, x) in other.means.iter_mut().enumerate() {
        let size = g.means[3 * (i / 3)..][..3].iter().map(|x| x * x).sum::<f64>().sqrt();
        *x += 2e-7 * (size + camera.translation.length()) * random.between(-1.0, 1.0);
    }
    for group in [&mut other.log_scales, &mut other.opacity_logits] {
        group.iter_mut().for_each(|x| *x += 2e-6 * random.between(-1.0, 1.0));
    }
    for quaternion in other.rotations.chunks_exact_mut(4) {
        let size = quaternion.iter().map(|x| x * x).sum::<f64>().sqrt();
        quaternion.iter_mut().for_each(|x| *x += 3e-7 * size * random.between(-1.0, 1.0));
    }
    other
}
