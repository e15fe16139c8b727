//! Costs of the shading kernels. Half of the pairs of pixel and light are assumed to face each other.

use super::{Cost, Counts, Stage};

/// Operations of every pair: direction, distance and cosine.
const RAY: f64 = 20.0;

/// Operations of a lobe at a direction: scaled difference 6, its square 5, exponential 4, three channels 6.
const LOBE: f64 = 21.0;

/// Operations of a surface in a light: half vector 20, highlight and masking 45, sums 35.
const SURFACE: f64 = 100.0;

/// Additional operations of training: logarithmic derivative by roughness, and three sums.
const BY_ROUGHNESS: f64 = 35.0;

/// Operations of a lobe's backward pass. The forward pass, weights 3, their product with amplitudes 5, contributions to
/// axis, sharpness and amplitudes 11, the derivative by the direction 8.
const LOBE_BWD: f64 = 48.0;

/// Operations of a surface's backward pass. The forward pass without the sums, the derivatives of masking, highlight
/// and Fresnel term, the position.
const SURFACE_BWD: f64 = 200.0;

/// Bytes of a pixel. Point 3, normal 3, coverage 1, material 4.
const PIXEL_BYTES: f64 = 44.0;

/// Returns the cost of a kernel of this module, or `None` for others. With the visibility field it is the cost of the
/// plain kernel, plus the field at each pixel and at each pair that faces each other.
pub(super) fn kernel(s: &Stage<'_>, c: &Counts) -> Option<Cost> {
    match super::visibility::portable(s.kernel).strip_suffix("_field") {
        Some(kernel) => {
            let plain = plain(&Stage { kernel, ..*s }, c)?;
            let field = super::visibility::field(s, c);
            let (bytes, operations) = (plain.bytes + field.bytes, plain.operations + field.operations);
            Some(Cost { bytes, operations, ..Default::default() })
        }
        None => plain(s, c),
    }
}

/// Returns the operations of a pair that faces each other.
pub(super) fn pair(lobes: f64) -> f64 {
    RAY + LOBE * lobes + SURFACE
}

fn plain(s: &Stage<'_>, c: &Counts) -> Option<Cost> {
    let spec = s.specs;
    let (lobes, p) = (spec("LOBES"), c.pixels);
    let metallic = spec("METALLIC");
    let facing = 0.5 * (LOBE * lobes + SURFACE);
    let (bytes, operations) = match s.kernel {
        "lights_prepare" => {
            let rows = (s.push)(0) * lobes;
            (56.0 * rows, 60.0 * rows)
        }
        "lights" => ((PIXEL_BYTES + 12.0 + 4.0 * metallic) * p, c.lights * (RAY + facing) * p),
        "lights_split" => ((PIXEL_BYTES + 24.0 + 4.0 * metallic) * p, c.lights * (RAY + facing) * p),
        // Also one byte per pair.
        "lights_train_traced" => {
            let left = 36.0 + 28.0 * metallic + c.lights;
            ((PIXEL_BYTES + left) * p, c.lights * (RAY + facing + 0.5 * BY_ROUGHNESS) * p)
        }
        "lights_train" => {
            let left = 36.0 + 28.0 * metallic;
            ((PIXEL_BYTES + left) * p, c.lights * (RAY + facing + 0.5 * BY_ROUGHNESS) * p)
        }
        "lights_bwd" | "lights_bwd_traced" => {
            let rows = 4.0 * 8.0 * spec("LIGHTS") * (1.0 + lobes) * s.groups;
            let facing = 0.5 * (LOBE_BWD * lobes + SURFACE_BWD);
            ((PIXEL_BYTES + 12.0 + 4.0 * metallic) * p + rows, c.lights * (RAY + facing) * p)
        }
        "lights_reduce" => {
            let sums = (s.push)(0) * (s.push)(1);
            (4.0 * sums, sums)
        }
        "lights_normals_bwd" | "lights_normals_bwd_traced" => {
            let facing = 0.5 * (LOBE * lobes + SURFACE_BWD);
            ((PIXEL_BYTES + 24.0 + 4.0 * metallic) * p, c.lights * (RAY + facing) * p)
        }
        // Three differences, their square, a comparison and its selection.
        "lights_near" => (16.0 * p + 8.0 * c.lights * s.groups, 10.0 * c.lights * p),
        "lights_regularize" => {
            let sums = (s.push)(0) * (s.push)(1);
            (8.0 * sums + 24.0 * (s.push)(0) * lobes, 2.0 * sums + 20.0 * (s.push)(0) * lobes)
        }
        "lights_prepare_bwd" => {
            let rows = (s.push)(0) * lobes;
            (100.0 * rows, 80.0 * rows)
        }
        "lights_materials_bwd" => ((24.0 + 4.0 + 12.0 + 32.0) * p, 20.0 * p),
        "lights_materials_bwd_metallic" => ((48.0 + 8.0 + 16.0 + 12.0 + 40.0) * p, 60.0 * p),
        _ => return None,
    };
    Some(Cost { bytes, operations, ..Default::default() })
}
