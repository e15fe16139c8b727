//! Costs of the kernels of transport. Sizes are their push constants; a solve's iterations count as if all ran.

use super::{Cost, Counts, Stage};

/// Operations of a visited node: eight boxes of 24 each, and their order 64.
const NODE: f64 = 8.0 * 24.0 + 64.0;

/// Returns the cost of a kernel of this module, or `None` for others.
pub(super) fn kernel(s: &Stage<'_>, c: &Counts) -> Option<Cost> {
    let push = s.push;
    let (receivers, lights) = (push(0), push(1));
    let values = receivers * lights;
    let (bytes, operations) = match s.kernel {
        // Behind nine words of the enclosure. A ray visits eight nodes per level of the tree; a direction takes 60
        // operations. Nodes and discs are read once.
        "transport_rays" => {
            let (receivers, surfels, rays) = (push(9), push(10), push(9) * push(11));
            let nodes = 8.0 * surfels.max(8.0).log(8.0);
            (4.0 * rays + 32.0 * receivers + 50.0 * surfels, (nodes * NODE + 60.0) * rays)
        }
        "transport_rows" => {
            let packed = 4.0 * receivers * push(2);
            (packed + 4.0 * receivers * push(1), packed)
        }
        "transport_check" => (4.0 * push(3) + 24.0, 4.0 * push(3)),
        // A single workgroup.
        "transport_relaxation" => (12.0 * (receivers / push(1).max(1.0)).ceil() + 4.0 * push(2), 6.0 * receivers),
        "transport_begin" => (72.0 * values + 28.0 * receivers, 9.0 * values),
        "transport_adjoint_begin" => {
            let read = 12.0 * ((s.specs)("BY_RADIOSITY") + (s.specs)("BY_IRRADIANCE"));
            ((48.0 + read) * values + 28.0 * receivers, 18.0 * values)
        }
        // Values of both iterations, the sums and the source are texels of 16 bytes: three read, two written. A ray adds
        // three numbers.
        "transport_bounce" => {
            let rows = 16.0 * (s.specs)("WIDTH") * receivers;
            let rays = rows * 8.0 / (s.specs)("BITS").max(1.0);
            (rows + 80.0 * values + 16.0 * receivers, 3.0 * rays * lights + 40.0 * values)
        }
        "transport_adjoint" => {
            let rays = receivers / f64::from(f32::from_bits(push(4) as u32)).max(1e-9);
            (4.0 * rays + 80.0 * values + 20.0 * receivers, 3.0 * rays * lights + 40.0 * values)
        }
        "transport_end" => (52.0 * values + 12.0 * receivers, 9.0 * values),
        "transport_adjoint_end" => {
            let read = 12.0 * (s.specs)("BY_RADIOSITY");
            ((40.0 + read) * values + 12.0 * receivers, 9.0 * values)
        }
        // Neighbors and weights, the irradiance of all receivers once, four numbers written.
        "irradiance_gather" => {
            let gains = 4.0 * (s.specs)("GAINS");
            ((80.0 + gains) * receivers + 12.0 * push(1) * push(2), 48.0 * receivers)
        }
        // A material by surfel, a number by pair of light and receiver, six numbers written.
        "transport_source" => {
            let (surfels, lights) = (push(1), push(2));
            let material = 16.0 + 4.0 * (s.specs)("METALLIC");
            let bytes = material * surfels + (4.0 * lights + 24.0) * receivers + 24.0 * lights;
            (bytes, 60.0 * surfels + (6.0 * lights + 12.0) * receivers)
        }
        // The same, six gradients read, the material's written.
        "transport_source_bwd" => {
            let (surfels, lights) = (push(1), push(2));
            let material = 32.0 + 8.0 * (s.specs)("METALLIC");
            (
                material * surfels + (4.0 * lights + 24.0) * receivers,
                90.0 * surfels + (15.0 * lights + 20.0) * receivers,
            )
        }
        // A number read by color, one by sum, one written.
        "transport_parameters_bwd" => (48.0 * push(0) + 144.0, 9.0 * push(0)),
        // Entries, and the gradients of pixels once; five numbers written.
        "irradiance_blend_bwd" => (8.0 * c.weights + 16.0 * c.pixels + 28.0 * receivers, 10.0 * c.weights),
        // Eight entries per Gaussian; the gradients once.
        "irradiance_gather_bwd" => (80.0 * c.gaussians + 16.0 * receivers, 48.0 * c.gaussians),
        // Responses of all emitters, colors, and the sum.
        "response_sum" => (12.0 * (values + receivers + lights), 6.0 * values),
        "response_source" => (28.0 * receivers, 4.0 * receivers),
        // Numbers of direct light by pair; irradiance, reflectance and the result.
        "response_radiosity" => (4.0 * values + 36.0 * receivers + 12.0 * lights, 6.0 * values + 12.0 * receivers),
        "response_store" => ((24.0 + 8.0 * (s.specs)("DIRECT")) * receivers, 0.0),
        // A number read and four written; behind the Gaussians, the number of emitters.
        "gaussian_emission" => (20.0 * receivers + 12.0 * lights, receivers),
        _ => return None,
    };
    Some(Cost { bytes, operations, ..Default::default() })
}
