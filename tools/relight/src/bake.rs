//! Bakes a relit scene to plain spherical harmonics.
//!
//! Geometry and opacity stay unchanged; any viewer shows the colors. Viewers blend display-referred colors, but shading
//! yields light of blended materials. No color per Gaussian is thus exact. Colors start with the shading of each
//! Gaussian alone ([`Shading::shade_centers`]). They are then trained on relit images, as the geometry stage trains on
//! photographs, with all other parameters fixed.

use crate::error::{RelightError, Result};
use glam::DVec3;
use rayon::prelude::*;
use sgs_config::{Backward, Filter, PseudoOptions, Rates, Settings, ViewRates};
use sgs_engine::Device;
use sgs_evaluate::metrics;
use sgs_passes::Tuning;
use sgs_passes::pipeline::Renderer;
use sgs_passes::scene::{Gaussians, Model};
use sgs_passes::splat::Channels;
use sgs_run::harmonics::{CONSTANT, Least, basis};
use sgs_run::{Shading, camera, displayed, gaussian_data};
use sgs_scene::{Camera, Image, Scene, Splats, linear_to_srgb};
use sgs_train::{Geometry, Progress, PseudoViews};

/// Options of baking.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BakeOptions {
    /// Highest band of the harmonics, 0 to 3.
    pub degree: u32,
    /// Number of training steps on images; 0 leaves the colors of single Gaussians.
    pub steps: u32,
    /// Background color, display-referred.
    pub background: [f32; 3],
}

/// Maximum number of training images, unless there are more training views.
const IMAGES: usize = 96;

/// Maximum number of viewpoints for shading single Gaussians.
const PLACES: usize = 32;

/// Learning rates of the constant and of the other bands, by round of steps.
const RATES: [[f64; 2]; 3] = [[0.03, 4e-3], [0.01, 2e-3], [3e-3, 8e-4]];

/// Ridge weight that pulls poorly constrained higher bands to zero.
///
/// Few viewpoints do not separate the bands.
const RIDGE: f64 = 0.3;

/// Weight of a color seen from behind.
const BEHIND: f64 = 0.02;

/// Returns the cameras for which colors are optimized.
///
/// Training views of the scene, and pseudo-views between them if these are few.
///
/// # Errors
/// If the split names a view that does not exist.
pub fn bake_cameras(scene: &Scene, options: &PseudoOptions) -> Result<Vec<Camera>> {
    let mut cameras: Vec<Camera> = scene.split.train.iter().map(|v| scene.views[*v].camera.clone()).collect();
    let pseudo = PseudoViews::new(scene, options)?;
    let between = |which: usize| (0..pseudo.views()).map(move |v| (v, which));
    for (view, which) in between(0).chain(between(1)) {
        if cameras.len() >= IMAGES {
            break;
        }
        cameras.push(pseudo.camera(view, which, pseudo.poses() / 2));
    }
    Ok(cameras)
}

/// Result of baking.
#[derive(Clone, Debug)]
pub struct Baked {
    /// Unchanged geometry, opacity and normals, with new colors; no materials or features.
    pub splats: Splats,
    /// Mean PSNR against the relit images at the given cameras.
    pub psnr: f64,
}

/// Fits colors to the shading of splats. Calls `on_report` with the number of each step.
///
/// # Errors
/// If `cameras` is empty, memory runs out or the device fails.
pub fn bake(
    device: &Device,
    splats: &Splats,
    shading: &mut Shading,
    cameras: &[Camera],
    options: &BakeOptions,
    mut on_report: impl FnMut(u32),
) -> Result<Baked> {
    if cameras.is_empty() {
        return Err(RelightError::Edit("Baking needs cameras, but there are none.".into()));
    }
    let mut baked = splats.clone();
    (baked.albedo, baked.roughness, baked.metallic, baked.semantic) = (None, None, None, None);
    baked.sh = alone(splats, shading, cameras, options.degree.min(3) as usize)?;
    let images = images(shading, cameras, options.background)?;
    let mut before = 0;
    for (round, rates) in RATES.into_iter().enumerate() {
        let last = options.steps * (round as u32 + 1) / RATES.len() as u32;
        if last == before {
            continue;
        }
        let settings = settings(options, baked.antialiased, rates, last - before);
        let mut training = Geometry::on_images(device, &images, &settings, &baked)?;
        let report = |p: &Progress| {
            if let Progress::Step(r) = p {
                on_report(before + r.step);
            }
        };
        training.train(last - before, report, || true)?;
        // Only the colors are taken, so all other values stay bitwise equal.
        baked.sh = training.splats()?.sh;
        before = last;
    }
    let psnr = apart(device, &baked, &images, options.background)?;
    Ok(Baked { splats: baked, psnr })
}

/// Renders relit images, display-referred.
fn images<'a>(shading: &mut Shading, cameras: &'a [Camera], background: [f32; 3]) -> Result<Vec<(&'a Camera, Image)>> {
    cameras.iter().map(|c| Ok((c, displayed(&shading.shade(c)?.radiance(background))))).collect()
}

/// Returns settings that train only colors.
fn settings(options: &BakeOptions, mip: bool, [sh0, sh_rest]: [f64; 2], steps: u32) -> Settings {
    let mut s = Settings::default();
    let g = &mut s.geometry;
    g.steps = steps;
    g.sh_degree = options.degree.min(3).into();
    g.background = options.background;
    g.filter = if mip { Filter::Mip } else { Filter::Dilated };
    (g.normals, g.semantics, g.densify.until) = (false, false, 0.0);
    (g.losses.depth_smooth, g.losses.depth_variance, g.losses.correspondence) = (0.0, 0.0, 0.0);
    // A kernel selected by timing would make the result depend on the measurement.
    g.backward = Backward::Pixel;
    g.rates = Rates {
        factor: 1.0,
        means: [0.0; 2],
        views: ViewRates::Fixed([0.0; 4]),
        scales: 0.0,
        rotations: 0.0,
        opacities: 0.0,
        normals: 0.0,
        semantics: 0.0,
        decoder: 0.0,
        sh0,
        sh_rest,
    };
    s
}

/// Fits harmonics to the shading of each Gaussian alone.
///
/// Shading is at the center, as seen from the positions of the cameras.
fn alone(splats: &Splats, shading: &mut Shading, cameras: &[Camera], degree: usize) -> Result<[Vec<f32>; 4]> {
    let every = cameras.len().div_ceil(PLACES);
    let places: Vec<DVec3> = cameras.iter().step_by(every).map(Camera::position).collect();
    let mut seen = Vec::new();
    for place in &places {
        seen.push(shading.shade_centers(splats, place.as_vec3().to_array())?);
    }
    let terms = (degree + 1) * (degree + 1);
    let fit = |i: usize| -> Vec<f64> {
        let center = DVec3::from(splats.means[i].map(f64::from));
        let normal = splats.normals.as_ref().map_or(DVec3::ZERO, |n| DVec3::from(n[i].map(f64::from)));
        let views: Vec<([f64; 16], f64, [f64; 3])> = (places.iter().zip(&seen))
            .map(|(place, colors)| {
                let toward = (center - place).normalize_or(DVec3::Z);
                let weight = if toward.dot(normal) <= 0.0 { 1.0 } else { BEHIND };
                let shown = [0, 1, 2].map(|c| f64::from(linear_to_srgb(colors[3 * i + c].clamp(0.0, 1.0))) - 0.5);
                (basis(toward), weight, shown)
            })
            .collect();
        let total: f64 = views.iter().map(|v| v.1).sum();
        let mut found = vec![0.0; 3 * terms];
        for c in 0..3 {
            let mean = views.iter().map(|v| v.1 * v.2[c]).sum::<f64>() / total.max(1e-12);
            let mut least = Least::new(terms);
            views.iter().for_each(|(row, weight, shown)| least.add(&row[..terms], shown[c] - mean, *weight));
            for (k, value) in least.solve(RIDGE).into_iter().enumerate() {
                found[3 * k + c] = value;
            }
            found[c] += mean / CONSTANT;
        }
        found
    };
    let found: Vec<Vec<f64>> = (0..splats.len()).into_par_iter().map(fit).collect();
    Ok(std::array::from_fn(|band| {
        if band > degree {
            return Vec::new();
        }
        let range = 3 * band * band..3 * (band + 1) * (band + 1);
        found.iter().flat_map(|f| f[range.clone()].iter().map(|v| *v as f32)).collect()
    }))
}

/// Returns the mean PSNR between splats as a viewer shows them and relit images.
///
/// Both are display-referred.
///
/// # Errors
/// If memory runs out or the device fails.
pub fn baked_psnr(
    device: &Device,
    baked: &Splats,
    shading: &mut Shading,
    cameras: &[Camera],
    background: [f32; 3],
) -> Result<f64> {
    apart(device, baked, &images(shading, cameras, background)?, background)
}

/// Returns the mean PSNR between splats as a viewer shows them and images.
fn apart(device: &Device, baked: &Splats, images: &[(&Camera, Image)], background: [f32; 3]) -> Result<f64> {
    let model = Model { sh_degree: baked.sh_degree() as u32, normals: false, semantics: false, mip: baked.antialiased };
    let gaussians = Gaussians::with(device, model, baked.len() as u32, false, false)?;
    gaussians.upload(device, &gaussian_data(baked, model))?;
    let channels = Channels { colors: true, normals: false, depth: false };
    let mut renderer = Renderer::new(device, Tuning::for_device(device.info()), &gaussians, [1, 1], channels)?;
    let mut sum = 0.0;
    for (view, theirs) in images {
        let rendered = renderer.render(&gaussians, &camera(view), model.sh_degree, background)?;
        let data = rendered.image.iter().map(|v| v.clamp(0.0, 1.0)).collect();
        let ours = Image { width: rendered.size[0], height: rendered.size[1], channels: rendered.channels, data };
        sum += metrics::psnr(&ours, theirs, None)?;
    }
    Ok(sum / images.len().max(1) as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bake_settings_are_valid_and_train_only_colors() {
        for degree in 0..=3 {
            let s = settings(&BakeOptions { degree, steps: 30, background: [0.0; 3] }, degree == 0, RATES[0], 30);
            assert!(s.check().is_ok());
            let r = s.geometry.rates;
            assert_eq!([r.means[0], r.means[1], r.scales, r.rotations, r.opacities, r.normals], [0.0; 6]);
            assert!(r.sh0 > 0.0 && r.sh_rest > 0.0 && s.geometry.sh_degree == degree.into());
        }
    }
}
