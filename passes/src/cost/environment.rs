//! Costs of the kernels of the environment map and of traced visibility.

use super::{Cost, Counts, Stage};

/// Operations of one product of texel and weight: distance 8, lobe 9 with its division, three channels and the weight
/// 8.
const PRODUCT: f64 = 25.0;
/// Operations of a bilinear lookup: position 30, texels 60, three channels 24.
const LOOKUP: f64 = 114.0;
/// Operations of a surface: view 12, mirrored direction 10, level and table 60, colors 20.
const SURFACE: f64 = 102.0;

/// Returns the cost of a kernel of this module, or `None` for others.
pub(super) fn kernel(s: &Stage<'_>, c: &Counts) -> Option<Cost> {
    let size = (s.push)(0);
    let texels = 6.0 * size * size;
    let p = c.pixels;
    let (bytes, operations) = match s.kernel {
        // `texels` are those of the generated mip level.
        "environment_mips" => (60.0 * texels, 12.0 * texels),
        // A cone of squared reach e covers e / 4 of the sphere.
        "environment_prefilter" | "environment_prefilter_bwd" => {
            let reach = f64::from(f32::from_bits((s.push)(2) as u32));
            (28.0 * texels, PRODUCT * texels * texels * reach / 4.0)
        }
        "environment" => (56.0 * p, (3.0 * LOOKUP + SURFACE) * p),
        "environment_scale" => (32.0 * p, 20.0 * p),
        // Twelve texels, each with three sums of two words.
        "environment_bwd" => (84.0 * p, (6.0 * LOOKUP + 2.0 * SURFACE + 36.0 * 20.0) * p),
        "environment_collect" => (40.0 * size, 20.0 * size),
        "environment_gather" => (52.0 * size, 24.0 * size),
        "environment_clamp" => (8.0 * size, size),
        "environment_mips_bwd" => (24.0 * texels, 18.0 * texels),
        // About ten entries per row.
        "environment_smoothness" => (108.0 * size, 150.0 * size),
        // Four texels and weights; five pixels; a texel of a cube finer than the map occurs in one lookup or two.
        "environment_map" => (92.0 * size, 32.0 * size),
        "environment_map_smoothness" => (72.0 * size * (s.push)(1), 40.0 * size * (s.push)(1)),
        "environment_map_bwd" => (46.0 * size, 14.0 * size),
        "environment_background" => (12.0 * p, (LOOKUP + 20.0) * p),
        // A ray visits eight nodes per level, with eight boxes of 24 operations each, and as many Gaussians.
        "visibility_traced" => {
            let nodes = 8.0 * c.gaussians.max(8.0).log(8.0);
            (32.0 * p, nodes * (8.0 * 24.0 + 64.0) * p)
        }
        // Half of the pairs face each other.
        "lights_trace" => {
            let nodes = 8.0 * c.gaussians.max(8.0).log(8.0);
            ((28.0 + c.lights) * p, 0.5 * c.lights * nodes * (8.0 * 24.0 + 64.0) * p)
        }
        _ => return None,
    };
    Some(Cost { bytes, operations, ..Default::default() })
}
