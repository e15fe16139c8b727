//! References of `blend` and of the whole render, in double precision on the CPU. Without tiles: every splat is
//! evaluated at every pixel of its box, nearest first.

use crate::Accuracy;
use crate::scene::SEMANTIC_FEATURES;

use super::project::{Camera, Gaussians, Projected, project_at};
use glam::DVec2;

/// Result of blending.
#[derive(Clone, Debug)]
pub struct Blended {
    /// Image composited over the background, `[pixels * channels]`. The background has the first three channels.
    /// Semantic features come last.
    pub image: Vec<f64>,
    /// Transmittance, `[pixels]`.
    pub transmittance: Vec<f64>,
    /// Whether single and double precision may legitimately differ at a pixel. Reasons: a value is close to one of the
    /// thresholds (1/255, 0.99, 1e-4 or their replacements). Two depths may be ordered either way in single precision.
    /// A color lies between two stored values.
    pub doubtful: Vec<bool>,
}

/// Blends projected splats, nearest first.
pub fn blend(splats: &[Projected], size: [u32; 2], channels: usize, background: [f64; 3]) -> Blended {
    blend_at(splats, size, channels, background, &Accuracy::EXACT)
}

/// Blends like [`blend`] at a given accuracy. The exponential is always exact.
pub fn blend_at(splats: &[Projected], size: [u32; 2], channels: usize, background: [f64; 3], a: &Accuracy) -> Blended {
    let (alpha_min, transmittance_min) = (f64::from(a.alpha_min), f64::from(a.transmittance_min));
    let pixels = size[0] as usize * size[1] as usize;
    let mut image = vec![0.0; pixels * channels];
    let mut transmittance = vec![1.0; pixels];
    let mut doubtful = vec![false; pixels];
    let mut stopped = vec![false; pixels];
    let mut last: Vec<Option<&Projected>> = vec![None; pixels];
    for s in splats {
        let reach = s.reach() + 1.0;
        let low = (s.mean - reach).floor().max(DVec2::ZERO);
        let high = (s.mean + reach).ceil().min(DVec2::new(f64::from(size[0]), f64::from(size[1])) - 1.0);
        if low.x > high.x || low.y > high.y {
            continue;
        }
        for y in low.y as usize..=high.y as usize {
            for x in low.x as usize..=high.x as usize {
                let at = y * size[0] as usize + x;
                if stopped[at] {
                    continue;
                }
                let raw = s.alpha(DVec2::new(x as f64 + 0.5, y as f64 + 0.5));
                let near = |a: f64, b: f64| (a - b).abs() < 2e-3 * b;
                doubtful[at] |= near(raw, alpha_min);
                let alpha = raw.min(0.99);
                if alpha < alpha_min {
                    continue;
                }
                let t = transmittance[at];
                let next = t * (1.0 - alpha);
                let unordered = last[at].is_some_and(|before| {
                    if a.depth_bits >= 31 {
                        s.depth - before.depth < 1e-6 * s.depth
                    } else {
                        s.key - before.key <= 1 && (s.key_doubtful || before.key_doubtful)
                    }
                });
                doubtful[at] |= near(next, transmittance_min) || unordered;
                doubtful[at] |= alpha * t * s.color_doubt > 1e-6;
                last[at] = Some(s);
                stopped[at] = next < transmittance_min;
                if stopped[at] && !a.keep_last {
                    continue;
                }
                for (c, f) in s.features.iter().enumerate().take(channels) {
                    image[at * channels + c] += alpha * t * f;
                }
                transmittance[at] = next;
            }
        }
    }
    for at in 0..pixels {
        for c in 0..channels.min(3) {
            image[at * channels + c] += transmittance[at] * background[c];
        }
    }
    Blended { image, transmittance, doubtful }
}

/// Projects and blends Gaussians.
pub fn render(g: &Gaussians, camera: &Camera, sh_degree: usize, depth: bool, background: [f64; 3]) -> Blended {
    render_at(g, camera, sh_degree, depth, background, &Accuracy::EXACT)
}

/// Renders like [`render`] at a given accuracy.
pub fn render_at(
    g: &Gaussians,
    camera: &Camera,
    sh_degree: usize,
    depth: bool,
    background: [f64; 3],
    a: &Accuracy,
) -> Blended {
    let channels = 3 + if g.normals.is_empty() { 0 } else { 3 } + if depth { 2 } else { 0 };
    let channels = channels + if g.semantics.is_empty() { 0 } else { SEMANTIC_FEATURES as usize };
    blend_at(&project_at(g, camera, sh_degree, depth, a), camera.size, channels, background, a)
}
