//! The cost of what works on geometry that stands still: its sparse matrix, its transpose, and what they blend.

use super::{Cost, Counts, Stage};

/// A sigmoid, or its slope.
const SIGMOID: f64 = 12.0;

/// A kernel's cost, if it is one of these. Values of Gaussians and gradients of pixels are fetched once, not once an entry.
pub(super) fn kernel(s: &Stage<'_>, c: &Counts) -> Option<Cost> {
    let (n, p, e) = (c.gaussians, c.pixels, c.weights);
    let values = 4.0 + (s.specs)("METALLIC");
    let again = if (s.specs)("ADD") > 0.0 { 8.0 } else { 4.0 };
    // An entry's column or row and its weight.
    let entries = if (s.specs)("WEIGHT_BITS") == 16.0 { 6.0 * e } else { 8.0 * e };
    let (bytes, operations) = match s.kernel {
        "material_values" => (8.0 * values * n, SIGMOID * values * n),
        "materials" => (entries + 4.0 * p + 4.0 * values * (n + p), 2.0 * values * e),
        "materials_bwd" => {
            (entries + 4.0 * n + 4.0 * values * p + (4.0 + again) * values * n, 2.0 * values * e + SIGMOID * values * n)
        }
        // A row's sum made unit.
        "normals" => (entries + 4.0 * p + 12.0 * n + 16.0 * p, 6.0 * e + 20.0 * p),
        "normals_bwd" => (entries + 4.0 * n + 16.0 * p + 12.0 * n, 7.0 * e),
        // A turn, a division along the ray, a normal made unit.
        "gbuffer" => ((24.0 + 28.0) * p, 50.0 * p),
        "surface_depth" => (28.0 * p, 8.0 * p),
        // Searches among entries that are sorted.
        "column_starts" => (4.0 * n + 4.0 * e, 2.0 * n * e.max(2.0).log2()),
        _ => return None,
    };
    Some(Cost { bytes, operations })
}
