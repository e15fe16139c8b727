//! Gaussians for ray tracing, with the same numbers for the reference.

use crate::lit::narrow;
use sgs_passes::reference::rng::Pcg;
use sgs_passes::reference::traced::{self as reference, Splat, V3};
use sgs_passes::scene::{GaussianData, Group};

/// Converts Gaussians of the reference to the GPU's layout.
pub fn splat_data(splats: &[Splat]) -> GaussianData {
    let mut d = GaussianData::default();
    let f = |x: f64| x as f32;
    for s in splats {
        d.groups[Group::Means as usize].extend(s.mean.map(f));
        d.groups[Group::LogScales as usize].extend(s.log_scale.map(f));
        d.groups[Group::Rotations as usize].extend(s.rotation.map(f));
        d.groups[Group::OpacityLogits as usize].push(f(s.opacity_logit));
    }
    d
}

/// Draws Gaussians of all kinds between the pixels of a case and its lights.
///
/// The kinds are spherical, flat, elongated, large and tiny; opacities range from faint to opaque.
pub fn random_splats(count: usize, seed: u32) -> Vec<Splat> {
    let mut rng = Pcg::new(seed);
    let typical = (1.0 / (count as f64).cbrt()).ln() - 0.5;
    (0..count)
        .map(|_| {
            let kind = rng.next_u32() % 8;
            let flat: V3 = match kind {
                0..3 => [0.0; 3],
                3..5 => [-4.0, 0.0, 0.0],
                5 => [-3.0, 1.0, -3.0],
                6 => [1.0, 1.0, 1.0],
                _ => [-6.0; 3],
            };
            let mut q = [rng.normal(), rng.normal(), rng.normal(), rng.normal()];
            if rng.uniform() < 0.02 {
                q = [0.0; 4];
            }
            Splat {
                mean: std::array::from_fn(|_| narrow(rng.range(-1.4, 1.4))),
                log_scale: std::array::from_fn(|k| narrow(typical + flat[k] + 0.3 * rng.normal())),
                rotation: q.map(narrow),
                opacity_logit: narrow(rng.range(-7.0, 4.0)),
            }
        })
        .map(|s| if s.rotation == [0.0; 4] { Splat { rotation: [1.0, 0.0, 0.0, 0.0], ..s } } else { s })
        .collect()
}

/// Bounds the transmittance error of a ray due to discontinuities.
///
/// A Gaussian adds to the bound if its alpha is near the threshold or its peak is near an end of the ray.
pub fn doubt(splats: &[Splat], from: V3, to: V3) -> f64 {
    let v: V3 = std::array::from_fn(|k| to[k] - from[k]);
    let reach = v.iter().map(|x| x * x).sum::<f64>().sqrt();
    let along = v.map(|x| x / reach);
    let mut doubt = 0.0;
    for s in splats {
        let m = reference::meet(s, from, along);
        if m.at.abs().min((m.at - reach).abs()) < 1e-4 {
            doubt += m.alpha;
        }
        let [more, less] = [2e-3, -2e-3].map(|d| Splat { opacity_logit: s.opacity_logit + d, ..*s });
        let [a, b] = [more, less].map(|s| reference::meet(&s, from, along));
        if (a.alpha > 0.0) != (b.alpha > 0.0) || (a.before > 0.0) != (b.before > 0.0) {
            doubt += 0.005;
        }
    }
    doubt
}
