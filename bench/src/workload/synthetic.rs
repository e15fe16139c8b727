//! Deterministic synthetic room.
//!
//! Its photographs are rendered from known Gaussians on the measured device. Training starts from other points of the
//! same surfaces. Losses and gradients therefore resemble those of a real scene.

use super::{Workload, room, settings};
use glam::{DMat3, DVec3};
use sgs_engine::{Device, Location};
use sgs_passes::Tuning;
use sgs_passes::loss::octahedral_encode;
use sgs_passes::pipeline::{Camera, RenderedImage, Renderer};
use sgs_passes::scene::{Gaussians, Group, Model};
use sgs_passes::splat::Channels;
use sgs_run::gaussian_data;
use sgs_scene::{PointCloud, Splats};

/// Number of views on the ring.
const VIEWS: u32 = 12;

/// Radius of the ring in meters.
const RING: f64 = 1.3;

/// Number of ground-truth Gaussians: enough for photographic detail, few enough to upload at once.
const TRUTH: std::ops::RangeInclusive<u32> = 40_000..=400_000;

/// Options of the room.
#[derive(Clone, Copy, Debug)]
pub struct Synthetic {
    /// Number of initial Gaussians.
    pub gaussians: u32,
    /// Width and height of the views.
    pub size: [u32; 2],
    /// Whether to train normals and depth with their priors.
    pub normals: bool,
    /// Whether densification is enabled.
    pub densify: bool,
    /// Degree of the spherical harmonics.
    pub sh_degree: u32,
}

/// Creates the room.
///
/// # Errors
/// If memory runs out or the device fails.
pub fn synthetic(device: &Device, s: &Synthetic) -> anyhow::Result<Workload> {
    let views: Vec<Camera> = (0..VIEWS).map(|i| view(i, s.size)).collect();
    let images = photographs(device, s, &views)?;
    let pixels = s.size[0] * s.size[1];
    let words = u64::from(VIEWS) * u64::from(pixels);
    let targets = device.buffer("targets", 4 * words, Location::Device)?;
    let normals = if s.normals { Some(device.buffer("normal_priors", 4 * words, Location::Device)?) } else { None };
    for (i, rendered) in images.iter().enumerate() {
        let offset = 4 * i as u64 * u64::from(pixels);
        let channels = rendered.channels as usize;
        let packed: Vec<u32> = rendered.image.chunks_exact(channels).map(pack).collect();
        device.upload(&targets, offset, bytemuck::cast_slice(&packed))?;
        if let Some(normals) = &normals {
            let packed = rendered.image.chunks_exact(channels).map(|p| octahedral_encode([p[3], p[4], p[5]]));
            device.upload(normals, offset, bytemuck::cast_slice(&packed.collect::<Vec<u32>>()))?;
        }
    }
    let model = Model { sh_degree: s.sh_degree, normals: s.normals, ..Default::default() };
    // Points as from a reconstruction.
    let cloud = room::points(s.gaussians as usize, 2);
    let start = gaussian_data(&Splats::from_points(&cloud, s.sh_degree as usize)?, model);
    Ok(Workload {
        name: "synthetic room".to_owned(),
        model,
        start,
        targets,
        normals,
        semantics: None,
        correspondence: None,
        views: views.into_iter().enumerate().map(|(i, c)| (c, i as u32 * pixels)).collect(),
        largest: s.size,
        extent: 1.1 * RING,
        settings: settings(s.densify, s.sh_degree),
    })
}

/// Returns a camera on the ring that looks slightly down across the room.
///
/// The horizontal field of view is 75°.
fn view(index: u32, size: [u32; 2]) -> Camera {
    let angle = std::f64::consts::TAU * f64::from(index) / f64::from(VIEWS);
    let position = DVec3::new(RING * angle.cos(), 0.15, RING * angle.sin());
    let forward = (DVec3::new(0.0, -0.35, 0.0) - position).normalize();
    let right = forward.cross(DVec3::Y).normalize();
    let down = forward.cross(right);
    let rotation = DMat3::from_cols(right, down, forward).transpose();
    let translation = -(rotation * position);
    let row = |i: usize| {
        let r = rotation.row(i);
        [r.x as f32, r.y as f32, r.z as f32, translation[i] as f32]
    };
    let focal = 0.5 * f64::from(size[0]) / 37.5_f64.to_radians().tan();
    Camera {
        world_to_camera: [row(0), row(1), row(2)],
        position: position.as_vec3().to_array(),
        near: 0.01,
        focal: [focal as f32; 2],
        center: [0.5 * size[0] as f32, 0.5 * size[1] as f32],
        size,
        tiles: [0, 0],
        radial: 0.0,
    }
}

/// Renders the ground truth: opaque splats, sized by their share of the surface area.
fn photographs(device: &Device, s: &Synthetic, views: &[Camera]) -> anyhow::Result<Vec<RenderedImage>> {
    let count = s.gaussians.clamp(*TRUTH.start(), *TRUTH.end());
    let cloud = room::points(count as usize, 1);
    let model = Model { sh_degree: 0, normals: s.normals, ..Default::default() };
    let mut data = gaussian_data(&splats(&cloud), model);
    let size = (0.6 * (room::area() / f64::from(count)).sqrt()).ln() as f32;
    data.groups[Group::LogScales as usize].fill(size);
    data.groups[Group::OpacityLogits as usize].fill(3.0);
    let gaussians = Gaussians::new(device, model, count, false)?;
    gaussians.upload(device, &data)?;
    let channels = Channels { colors: true, normals: s.normals, depth: false };
    let mut renderer = Renderer::new(device, Tuning::for_device(device.info()), &gaussians, s.size, channels)?;
    views.iter().map(|c| Ok(renderer.render(&gaussians, c, 0, [0.0; 3])?)).collect()
}

/// Returns splats without the nearest-neighbor search for their scales.
fn splats(cloud: &PointCloud) -> Splats {
    let n = cloud.len();
    let colors = cloud.colors.iter().flatten().flatten();
    Splats {
        means: cloud.positions.clone(),
        log_scales: vec![[0.0; 3]; n],
        rotations: vec![[1.0, 0.0, 0.0, 0.0]; n],
        opacity_logits: vec![0.0; n],
        sh: [colors.map(|c| (c - 0.5) / sgs_scene::SH_C0).collect(), vec![], vec![], vec![]],
        normals: cloud.normals.clone(),
        ..Default::default()
    }
}

fn pack(p: &[f32]) -> u32 {
    let byte = |v: f32| (v.clamp(0.0, 1.0) * 255.0 + 0.5) as u32;
    byte(p[0]) | byte(p[1]) << 8 | byte(p[2]) << 16 | 0xff00_0000
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cameras_are_rigid_and_on_the_ring() {
        for i in 0..VIEWS {
            let c = super::super::reference_camera(&view(i, [64, 48]));
            assert!((c.rotation.determinant() - 1.0).abs() < 1e-6);
            let at = -(c.rotation.transpose() * c.translation);
            assert!((at.x.hypot(at.z) - RING).abs() < 1e-6 && (at.y - 0.15).abs() < 1e-6);
            // World up points to the upper half of the image.
            assert!((c.rotation * DVec3::Y).y < 0.0);
        }
    }
}
