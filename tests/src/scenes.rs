//! Small scenes of Gaussians for tests: ordinary Gaussians and corner cases.

use glam::{DMat3, DVec2, DVec3};
use sgs_passes::pipeline as gpu;
use sgs_passes::reference::project::{Camera, Gaussians};
use sgs_passes::scene::{GaussianData, Group, SEMANTIC_FEATURES};

/// Small deterministic random generator (PCG hash of a counter).
#[derive(Clone, Debug)]
pub struct Rng(u64);

impl Rng {
    /// Creates a generator from a seed.
    pub fn new(seed: u64) -> Rng {
        Rng(seed.wrapping_mul(0x9E37_79B9_7F4A_7C15))
    }

    /// Draws a number uniformly from [0, 1).
    pub fn unit(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        let x = ((self.0 >> ((self.0 >> 59) + 5)) ^ self.0).wrapping_mul(12605985483714917081);
        ((x ^ (x >> 43)) >> 11) as f64 / (1u64 << 53) as f64
    }

    /// Draws a number uniformly between two numbers.
    pub fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.unit()
    }
}

/// Returns a camera near the origin that looks along +z.
///
/// A small rotation keeps the scene from being axis-aligned.
pub fn camera(size: [u32; 2]) -> Camera {
    let rotation = DMat3::from_euler(glam::EulerRot::XYZ, 0.05, -0.08, 0.03);
    let width = f64::from(size[0]);
    Camera {
        rotation,
        translation: DVec3::new(0.1, -0.05, 0.2),
        focal: DVec2::new(0.8 * width, 0.83 * width),
        center: DVec2::new(0.47 * width, 0.52 * f64::from(size[1])),
        size,
        near: 0.01,
        radial: 0.0,
    }
}

/// Converts a camera to the GPU's layout.
pub fn gpu_camera(c: &Camera) -> gpu::Camera {
    let row = |i: usize| {
        let r = c.rotation.row(i);
        [r.x as f32, r.y as f32, r.z as f32, c.translation[i] as f32]
    };
    let position = -(c.rotation.transpose() * c.translation);
    gpu::Camera {
        world_to_camera: [row(0), row(1), row(2)],
        position: position.as_vec3().to_array(),
        near: c.near as f32,
        focal: [c.focal.x as f32, c.focal.y as f32],
        center: [c.center.x as f32, c.center.y as f32],
        size: c.size,
        tiles: [0, 0],
        radial: c.radial as f32,
    }
}

/// Rounds to single precision, so that device and reference use equal numbers.
fn single(v: f64) -> f64 {
    f64::from(v as f32)
}

/// Returns `count` ordinary Gaussians in front of the camera.
pub fn ordinary(count: usize, degree: usize, normals: bool, seed: u64) -> Gaussians {
    let mut r = Rng::new(seed);
    let mut g = Gaussians::default();
    for _ in 0..count {
        let z = r.between(1.0, 6.0);
        g.means.extend([single(r.between(-0.7, 0.7) * z), single(r.between(-0.6, 0.6) * z), single(z)]);
        for _ in 0..3 {
            g.log_scales.push(single(r.between(-4.5, -1.5)));
        }
        for _ in 0..4 {
            g.rotations.push(single(r.between(-1.0, 1.0)));
        }
        g.opacity_logits.push(single(r.between(-3.0, 3.0)));
        for band in 0..=degree {
            for _ in 0..3 * (2 * band + 1) {
                let size = if band == 0 { 1.5 } else { 0.4 };
                g.sh[band].push(single(r.between(-size, size)));
            }
        }
        if normals {
            g.normals.extend((0..3).map(|_| single(r.between(-1.0, 1.0))));
        }
    }
    g
}

/// Returns corner cases of Gaussians in one image.
///
/// They include extreme anisotropy and size, Gaussians through the near plane and beside the view, quaternions that are
/// not unit, and opacities at both ends.
pub fn hard(seed: u64) -> Gaussians {
    let mut g = ordinary(60, 3, false, seed);
    let mut r = Rng::new(seed + 1);
    let mut add = |mean: [f64; 3], scale: [f64; 3], q: [f64; 4], logit: f64| {
        g.means.extend(mean.map(single));
        g.log_scales.extend(scale.map(single));
        g.rotations.extend(q.map(single));
        g.opacity_logits.push(single(logit));
        for band in 0..4 {
            for _ in 0..3 * (2 * band + 1) {
                g.sh[band].push(single(r.between(-0.8, 0.8)));
            }
        }
    };
    let q = [0.9, 0.1, -0.3, 0.35];
    add([0.2, 0.1, 3.0], [0.5, -9.0, -9.0], q, 1.0); // elongated
    add([-0.4, 0.2, 2.5], [1.5, -14.0, -12.0], [0.3, 0.2, 0.1, -0.8], 2.0); // extremely elongated and thin
    add([0.3, -0.3, 4.0], [-0.5, -0.7, -12.0], q, 0.5); // disc
    add([0.0, 0.0, 30.0], [3.0, 3.2, 2.5], q, -1.0); // large, behind all others
    add([0.0, 0.0, 5.0], [7.5, 7.5, 7.5], q, -3.5); // constant over the whole image
    add([0.1, 0.0, 0.05], [-4.0, -3.5, -4.5], q, 0.0); // close
    add([0.3, 0.2, -0.15], [0.5, 0.4, 0.3], q, 3.0); // around the near plane, just in front of it
    add([0.0, 0.0, -3.0], [0.0, 0.0, 0.0], q, 3.0); // behind
    add([4.0, 0.3, 2.0], [0.2, 0.0, -0.3], q, 1.0); // center beside the view, footprint inside
    add([0.5, 0.5, 3.0], [-20.0, -30.0, -18.0], q, 2.0); // below the smallest scale
    add([-0.5, -0.4, 3.5], [-3.0, -2.0, -2.5], [0.0; 4], 1.0); // zero quaternion
    add([-0.5, 0.4, 3.6], [-3.0, -2.0, -1.5], [3e18, -2e18, 1e18, 5e17], 1.0); // huge quaternion
    add([-0.2, 0.4, 3.7], [-3.0, -2.0, -1.5], [3e-18, -2e-18, 1e-18, 5e-19], 1.0); // tiny quaternion
    add([0.6, -0.2, 3.1], [-2.0, -2.2, -1.8], q, 30.0); // opaque
    add([0.1, -0.5, 3.2], [-2.0, -2.2, -1.8], q, -5.53); // barely above 1/255
    add([0.4, -0.5, 3.2], [-2.0, -2.2, -1.8], q, -30.0); // invisible
    add([1e6, 1e6, 1e6], [-2.0, -2.2, -1.8], q, 1.0); // far away
    g
}

/// Returns Gaussians that cover a large part of the view or all of it.
///
/// They are faint, so that all of them show. Some are spherical, some long and slanted, some flat. Every fourth covers
/// the whole view.
pub fn large(count: usize, degree: usize, seed: u64) -> Gaussians {
    let mut g = ordinary(count, degree, false, seed);
    let mut r = Rng::new(seed + 100);
    for i in 0..count {
        let z = g.means[3 * i + 2];
        let scale = match i % 4 {
            0 => [3.0; 3],
            1 => [r.between(-0.5, 0.5), -5.0, -5.0],
            2 => [-1.0, -0.5, -6.0],
            _ => [r.between(-1.5, -0.5); 3],
        };
        g.log_scales[3 * i..3 * i + 3].copy_from_slice(&scale.map(|s| single(s + z.ln())));
        g.opacity_logits[i] = single(r.between(-3.0, -1.0));
    }
    g
}

/// Adds a rectangle of flat Gaussians that face along z.
///
/// The Gaussians are so opaque and dense that nothing shines through. `low` and `high` are two corners of the rectangle
/// at the given z.
pub fn sheet(g: &mut Gaussians, low: [f64; 2], high: [f64; 2], z: f64, spacing: f64) {
    let count = [0, 1].map(|k| ((high[k] - low[k]) / spacing).round() as usize);
    for i in 0..=count[0] * (count[1] + 1) + count[1] {
        let at = [i / (count[1] + 1), i % (count[1] + 1)];
        g.means.extend([0, 1].map(|k| single(low[k] + spacing * at[k] as f64)));
        g.means.push(single(z));
        let flat = (0.5 * spacing).ln();
        g.log_scales.extend([single(flat), single(flat), -9.0]);
        g.rotations.extend([1.0, 0.0, 0.0, 0.0]);
        g.opacity_logits.push(4.0);
        g.sh[0].extend([0.5, 0.0, -0.5]);
    }
}

/// Adds semantic features to Gaussians.
pub fn with_semantics(mut g: Gaussians, seed: u64) -> Gaussians {
    let mut r = Rng::new(seed);
    g.semantics = (0..g.len() * SEMANTIC_FEATURES as usize).map(|_| single(r.between(-1.0, 1.0))).collect();
    g
}

/// Converts reference Gaussians to the GPU's layout.
pub fn data(g: &Gaussians) -> GaussianData {
    let single = |v: &[f64]| v.iter().map(|x| *x as f32).collect::<Vec<f32>>();
    let mut d = GaussianData::default();
    d.groups[Group::Means as usize] = single(&g.means);
    d.groups[Group::LogScales as usize] = single(&g.log_scales);
    d.groups[Group::Rotations as usize] = single(&g.rotations);
    d.groups[Group::OpacityLogits as usize] = single(&g.opacity_logits);
    for band in 0..4 {
        d.groups[Group::Sh0 as usize + band] = single(&g.sh[band]);
    }
    d.groups[Group::Normals as usize] = single(&g.normals);
    d.groups[Group::Semantics as usize] = single(&g.semantics);
    d
}
