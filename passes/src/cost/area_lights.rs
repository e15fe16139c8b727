//! Costs of physical lights. Half of the pairs of receiver and light face each other and trace rays.

use super::{Cost, Counts, Stage};

/// Operations of the unoccluded irradiance of a pair, in the mean over the shapes.
const EXACT: f64 = 120.0;

/// Operations of a sample point: hash, position, geometric term, direction and length of the ray.
const SAMPLE: f64 = 80.0;

/// Operations of the test of an opening by a ray: plane 16, place in the rectangle 24.
const OPENING: f64 = 40.0;

/// Operations of the radiance of the environment along a ray: two angles 40, bilinear lookup 20.
const SKY: f64 = 60.0;

/// Operations of a pair in shading: representative point 70, half vector and highlight 65, sums 30.
const PAIR: f64 = 165.0;

/// Operations of a pair's gradients: those of shading, logarithmic derivative 35, sums and colors 40.
const PAIR_BWD: f64 = 240.0;

/// Operations of a reflected ray: half vector, direction, weight, sums.
const REFLECTION: f64 = 150.0;

/// Returns the operations of a ray through a tree of discs: eight boxes of 24 and two discs of 25 per level.
fn ray(discs: f64) -> f64 {
    discs.max(8.0).log(8.0) * (8.0 * 24.0 + 2.0 * 25.0)
}

/// Returns the cost of a kernel of this module, or `None` for others. `gaussians` counts the surfels of the tree, `pixels`
/// the receivers.
pub(super) fn kernel(s: &Stage<'_>, c: &Counts) -> Option<Cost> {
    let (p, spec) = (c.pixels, s.specs);
    let metallic = spec("METALLIC");
    let (bytes, operations) = match s.kernel {
        "transport_lights" | "transport_lights_pixels" => {
            let receiver = if s.kernel == "transport_lights" { 32.0 } else { 28.0 };
            let rays = spec("SAMPLES") * (SAMPLE + ray(c.gaussians));
            let outside = spec("SAMPLES") * (OPENING * c.openings * c.suns + SKY * c.windows);
            let shared = 32.0 * c.gaussians + 64.0 * c.openings + 12.0 * c.sky;
            ((receiver + 4.0 * c.lights) * p + shared, (c.lights * (EXACT + 0.5 * rays) + 0.5 * outside) * p)
        }
        // Point, normal, coverage, material, irradiance, radiance; terms.
        "transport_shade" => {
            let pixel = 28.0 + 16.0 + 16.0 + 12.0 + 4.0 * metallic + 16.0 * spec("EMISSION") + 48.0 * spec("TERMS");
            let pixel = pixel + 16.0 * spec("REFLECTIONS");
            ((pixel + 4.0 * c.lights) * p, (80.0 + 0.5 * PAIR * c.lights) * p)
        }
        // Point, normal, coverage, material, irradiance, reflected radiance. Every pixel traces, twice a ray.
        "transport_reflect" => {
            let rays = spec("RAYS") * (REFLECTION + 2.0 * ray(c.gaussians));
            (76.0 * p + (32.0 + 12.0) * c.gaussians, rays * p)
        }
        // As above; gradients of radiance, material (twice) and irradiance.
        "transport_shade_bwd" => {
            let pixel = 28.0 + 16.0 + 16.0 + 12.0 + 32.0 + 16.0 + 12.0 * metallic + 16.0 * spec("EMISSION");
            ((pixel + 4.0 * c.lights) * p + 12.0 * c.lights * s.groups, (120.0 + 0.5 * PAIR_BWD * c.lights) * p)
        }
        _ => return None,
    };
    Some(Cost { bytes, operations, ..Default::default() })
}
