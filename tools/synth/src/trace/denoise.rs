//! Denoiser: clean images from a noisy film.
//!
//! Diffuse radiance is divided by the diffuse albedo before filtering and multiplied by it afterwards, so texture is
//! not blurred. Specular radiance is filtered separately, over smaller distances for smoother surfaces. Directly
//! visible lights are not filtered.

use glam::Vec3;

use crate::scene::MAX_GROUPS;
use crate::trace::film::Film;
use crate::trace::filter::{Estimate, Guide, MAX_PASSES, Strictness, filter};

/// Linear image, rows from the top.
pub(crate) type Image = Vec<Vec3>;

const DIFFUSE: Strictness = Strictness { brightness: 3.0, normal: 48.0, plane: 1.0 };

const SPECULAR: Strictness = Strictness { brightness: 2.5, normal: 96.0, plane: 1.0 };

/// Returns the image under a weight for each light group.
///
/// Weights multiply the colors of the scene's lights.
pub(crate) fn image(film: &Film, footprint: f32, weights: &[Vec3; MAX_GROUPS], denoise: bool) -> Image {
    let mix = |groups: &[Vec3; MAX_GROUPS]| -> Vec3 { groups.iter().zip(weights).map(|(c, w)| *c * *w).sum() };
    if !denoise {
        let plain = |p: &crate::trace::film::Pixel| mix(&p.diffuse) + mix(&p.specular) + mix(&p.emitted);
        return film.pixels.iter().map(plain).collect();
    }
    // Relighting weights scale the noise too: variances get the square of the largest weight.
    let bright = weights.iter().map(|w| w.max_element()).fold(0.0, f32::max);
    let diffuse: Vec<Estimate> = film
        .pixels
        .iter()
        .map(|p| Estimate {
            color: mix(&p.diffuse) / p.diffuse_albedo.max(Vec3::splat(1e-3)),
            variance: p.diffuse_variance * bright * bright,
        })
        .collect();
    let specular: Vec<Estimate> = film
        .pixels
        .iter()
        .map(|p| Estimate { color: mix(&p.specular), variance: p.specular_variance * bright * bright })
        .collect();
    let passes = vec![MAX_PASSES; film.pixels.len()];
    let by_roughness: Vec<u8> = film
        .features
        .iter()
        .map(|f| match f.roughness {
            r if r < 0.12 => 1,
            r if r < 0.25 => 2,
            r if r < 0.4 => 3,
            _ => 4,
        })
        .collect();
    let guide = |passes| Guide { width: film.width, height: film.height, features: &film.features, footprint, passes };
    let diffuse = filter(diffuse, &guide(&passes), &DIFFUSE);
    let specular = filter(specular, &guide(&by_roughness), &SPECULAR);
    film.pixels
        .iter()
        .zip(diffuse.iter().zip(&specular))
        .map(|(p, (d, s))| d.color * p.diffuse_albedo.max(Vec3::splat(1e-3)) + s.color + mix(&p.emitted))
        .collect()
}
