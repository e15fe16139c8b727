//! Costs of the kernels of material losses.

use super::{Cost, Counts, Stage};

/// Operations of encoding three channels in sRGB, or of its slope. Three powers take a logarithm and an exponential
/// each.
const ENCODE: f64 = 3.0 * 12.0;

/// Pixels of the levels after the first, relative to the first; then of all levels.
const COARSE: f64 = 1.0 / 4.0 + 1.0 / 16.0 + 1.0 / 64.0;
const LEVELS: f64 = 1.0 + COARSE;

/// Returns the cost of a kernel of this module, or `None` for others.
pub(super) fn kernel(s: &Stage<'_>, c: &Counts) -> Option<Cost> {
    let spec = s.specs;
    let p = c.pixels;
    // Pixels are interleaved: reading one channel of roughness fetches three.
    let gray = 12.0 * spec("ROUGHNESS");
    let light = 12.0 * (spec("DIRECT") + spec("AMBIENT"));
    let (bytes, operations) = match s.kernel {
        "material_images" => ((20.0 + 12.0 + gray) * p, ENCODE * p),
        "material_images_bwd" => ((20.0 + 12.0 + gray + 32.0) * p, (ENCODE + 9.0) * p),
        // The kernel also encodes the background.
        "compose" => ((4.0 + light + 12.0) * p, (2.0 * ENCODE + 12.0) * p),
        "compose_bwd" => ((4.0 + light + 24.0) * p, (2.0 * ENCODE + 18.0) * p),
        "gray_image" => (20.0 * p, 3.0 * p),
        "gray_image_bwd" => (24.0 * p, 6.0 * p),
        // Sobel filters of seven channels 80, six exponentials 24, signs and sums 30, transposed filters of four 84.
        "edge_aware" => ((12.0 + 4.0 + 24.0 + 3.0 * gray) * p, 218.0 * p),
        "msg_difference" => {
            let priors = 4.0 + 4.0 * spec("ROUGHNESS");
            ((12.0 + gray + priors + 4.0 + spec("MASKED") / 8.0 + 20.0) * p, 10.0 * p)
        }
        // Tents are two pixels wide: each pixel lies in four per level, with a weight, four values and two shares.
        "msg_levels" => (20.0 * (1.0 + COARSE) * p, 3.0 * 4.0 * 18.0 * p),
        // Filters of four channels 48, four magnitudes 40, transposed filters 84.
        "msg_slopes" => (36.0 * LEVELS * p, 172.0 * LEVELS * p),
        // Four pixels of four channels on three levels.
        "msg_bwd" => {
            let square = 16.0 * spec("SQUARE");
            ((4.0 + 16.0 * LEVELS + square + 24.0 + 2.0 * gray) * p, 3.0 * 50.0 * p)
        }
        "cross_sums" => (p / 8.0 + 12.0 * c.masked, 4.0 * c.masked),
        "cross_view_bwd" => (p / 8.0 + 24.0 * c.masked, 3.0 * c.masked),
        // A single workgroup, which takes little time.
        "msg_sum" | "cross_view" | "material_sum" => (64.0, 16.0),
        _ => return None,
    };
    Some(Cost { bytes, operations, ..Default::default() })
}
