//! A relit scene as plain spherical harmonics: geometry and opacity as they are, colors that any viewer shows.
//!
//! What a viewer blends is display-referred colors, and what shading gives is light of blended materials: no color by
//! Gaussian is right in itself. So colors begin with what each Gaussian would show alone ([`Shading::shade_centers`]), and
//! are then trained on relit pictures as the geometry stage trains them on photographs, with nothing else moving.

use crate::error::{RelightError, Result};
use glam::DVec3;
use rayon::prelude::*;
use sgs_config::{Backward, PseudoOptions, Rates, Settings};
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

/// How colors are found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BakeOptions {
    /// Highest band of the harmonics, 0 to 3.
    pub degree: u32,
    /// Steps of training on pictures; 0 leaves the colors that each Gaussian has alone.
    pub steps: u32,
    /// Color behind everything, display-referred.
    pub background: [f32; 3],
}

/// Pictures to train on, at most, unless there are more training views.
const PICTURES: usize = 96;

/// Places from which Gaussians are looked at alone, at most.
const PLACES: usize = 32;

/// Rates of the constant and of the other bands, one round of steps after the other.
const RATES: [[f64; 2]; 3] = [[0.03, 4e-3], [0.01, 2e-3], [3e-3, 8e-4]];

/// How strongly higher bands are pulled to zero, where few places tell them apart.
const RIDGE: f64 = 0.3;

/// The weight of a color as seen from behind.
const BEHIND: f64 = 0.02;

/// The cameras that colors are to be right from: a scene's training views, and pseudo-views between them where these are few.
///
/// # Errors
/// If the split names a view that does not exist.
pub fn bake_cameras(scene: &Scene, options: &PseudoOptions) -> Result<Vec<Camera>> {
    let mut cameras: Vec<Camera> = scene.split.train.iter().map(|v| scene.views[*v].camera.clone()).collect();
    let pseudo = PseudoViews::new(scene, options)?;
    let between = |which: usize| (0..pseudo.views()).map(move |v| (v, which));
    for (view, which) in between(0).chain(between(1)) {
        if cameras.len() >= PICTURES {
            break;
        }
        cameras.push(pseudo.camera(view, which, pseudo.poses() / 2));
    }
    Ok(cameras)
}

/// What baking comes to.
#[derive(Clone, Debug)]
pub struct Baked {
    /// Geometry, opacity and normals as they were, and new colors; nothing else.
    pub splats: Splats,
    /// Mean PSNR from the relit pictures at the cameras that colors were found for.
    pub psnr: f64,
}

/// Finds colors for splats as they are shaded. `heard` is told of steps.
///
/// # Errors
/// If there are no cameras, memory runs out or the device fails.
pub fn bake(
    device: &Device,
    splats: &Splats,
    shading: &mut Shading,
    cameras: &[Camera],
    options: &BakeOptions,
    mut heard: impl FnMut(u32),
) -> Result<Baked> {
    if cameras.is_empty() {
        return Err(RelightError::Edit("Baking needs cameras, but there are none.".into()));
    }
    let mut baked = splats.clone();
    (baked.albedo, baked.roughness, baked.metallic, baked.semantic) = (None, None, None, None);
    baked.sh = alone(splats, shading, cameras, options.degree.min(3) as usize)?;
    let pictures = pictures(shading, cameras, options.background)?;
    let mut before = 0;
    for (round, rates) in RATES.into_iter().enumerate() {
        let last = options.steps * (round as u32 + 1) / RATES.len() as u32;
        if last == before {
            continue;
        }
        let settings = settings(options, rates, last - before);
        let mut training = Geometry::on_images(device, &pictures, &settings, &baked)?;
        let said = |p: &Progress| {
            if let Progress::Step(r) = p {
                heard(before + r.step);
            }
        };
        training.train(last - before, said, || true)?;
        // Nothing else may have moved, not by a bit.
        baked.sh = training.splats()?.sh;
        before = last;
    }
    let psnr = apart(device, &baked, &pictures, options.background)?;
    Ok(Baked { splats: baked, psnr })
}

/// Relit pictures, display-referred.
fn pictures<'a>(
    shading: &mut Shading,
    cameras: &'a [Camera],
    background: [f32; 3],
) -> Result<Vec<(&'a Camera, Image)>> {
    cameras.iter().map(|c| Ok((c, displayed(&shading.shade(c)?.radiance(background))))).collect()
}

/// Training in which only colors move.
fn settings(options: &BakeOptions, [sh0, sh_rest]: [f64; 2], steps: u32) -> Settings {
    let mut s = Settings::default();
    let g = &mut s.geometry;
    g.steps = steps;
    (g.sh_degree, g.sh_interval) = (options.degree.min(3).into(), 0);
    g.background = options.background;
    (g.normals, g.semantics, g.correspondence, g.densify.enabled) = (false, false, false, false);
    (g.depth_smooth, g.depth_variance) = (false, false);
    // What is measured on the device would be another result on another day.
    g.backward = Backward::Pixel;
    g.rates = Rates {
        factor: 1.0,
        means: 0.0,
        means_final: 0.0,
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

/// The colors of Gaussians that are shaded alone, at their centers, from the places of cameras: harmonics closest to them.
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

/// Mean PSNR between splats as a viewer shows them and relit pictures, both display-referred.
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
    apart(device, baked, &pictures(shading, cameras, background)?, background)
}

/// Mean PSNR between splats as a viewer shows them and pictures.
fn apart(device: &Device, baked: &Splats, pictures: &[(&Camera, Image)], background: [f32; 3]) -> Result<f64> {
    let model = Model { sh_degree: baked.sh_degree() as u32, normals: false, semantics: false };
    let gaussians = Gaussians::with(device, model, baked.len() as u32, false, false)?;
    gaussians.upload(device, &gaussian_data(baked, model))?;
    let channels = Channels { colors: true, normals: false, depth: false };
    let mut renderer = Renderer::new(device, Tuning::for_device(device.info()), &gaussians, [1, 1], channels)?;
    let mut sum = 0.0;
    for (view, theirs) in pictures {
        let picture = renderer.render(&gaussians, &camera(view), model.sh_degree, background)?;
        let data = picture.image.iter().map(|v| v.clamp(0.0, 1.0)).collect();
        let ours = Image { width: picture.size[0], height: picture.size[1], channels: picture.channels, data };
        sum += metrics::psnr(&ours, theirs, None)?;
    }
    Ok(sum / pictures.len().max(1) as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_colors_move_and_the_settings_are_possible() {
        for degree in 0..=3 {
            let s = settings(&BakeOptions { degree, steps: 30, background: [0.0; 3] }, RATES[0], 30);
            assert!(s.check().is_ok());
            let r = s.geometry.rates;
            assert_eq!([r.means, r.means_final, r.scales, r.rotations, r.opacities, r.normals], [0.0; 6]);
            assert!(r.sh0 > 0.0 && r.sh_rest > 0.0 && s.geometry.sh_degree == degree.into());
        }
    }
}
