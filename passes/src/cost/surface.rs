//! Costs of the kernels for fixed geometry. They use its sparse matrix, the transpose, and blended values.

use super::{Cost, Counts, Stage};

/// Operations of a sigmoid, or of its slope.
const SIGMOID: f64 = 12.0;

/// Returns the cost of a kernel of this module, or `None` for others. Values of Gaussians and gradients of pixels are
/// fetched once, not once per entry.
pub(super) fn kernel(s: &Stage<'_>, c: &Counts) -> Option<Cost> {
    let (n, p, e) = (c.gaussians, c.pixels, c.weights);
    let values = 4.0 + (s.specs)("METALLIC");
    let again = if (s.specs)("ADD") > 0.0 { 8.0 } else { 4.0 };
    // Column or row of an entry, and its weight.
    let entries = if (s.specs)("WEIGHT_BITS") == 16.0 { 6.0 * e } else { 8.0 * e };
    let (bytes, operations) = match s.kernel {
        "material_values" => (8.0 * values * n, SIGMOID * values * n),
        "materials" => (entries + 4.0 * p + 4.0 * values * (n + p), 2.0 * values * e),
        "materials_bwd" => {
            (entries + 4.0 * n + 4.0 * values * p + (4.0 + again) * values * n, 2.0 * values * e + SIGMOID * values * n)
        }
        // Sum of a row, normalized.
        "normals" => (entries + 4.0 * p + 12.0 * n + 16.0 * p, 6.0 * e + 20.0 * p),
        "normals_bwd" => (entries + 4.0 * n + 16.0 * p + 12.0 * n, 7.0 * e),
        // A rotation, a division along the ray, a normalization.
        "gbuffer" => ((24.0 + 28.0) * p, 50.0 * p),
        "surface_depth" => (28.0 * p, 8.0 * p),
        // Binary searches among sorted entries.
        "column_starts" => (4.0 * n + 4.0 * e, 2.0 * n * e.max(2.0).log2()),
        _ => return None,
    };
    Some(Cost { bytes, operations, ..Default::default() })
}
