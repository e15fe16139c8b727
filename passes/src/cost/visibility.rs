//! Costs of the kernels of the visibility field.

use super::{Cost, Counts, Stage};

/// Operations of a pair. Multiply-adds of the split first layer, the second and the last, two operations each;
/// direction, distance and the squashing function 25.
const PAIR: f64 = 2.0 * (4.0 * 32.0 + 1024.0 + 32.0) + 25.0;

/// Operations of a pair's backward pass. Weights and inputs of the second layer, the other layers twice, the light's
/// position 60.
const PAIR_BWD: f64 = 2.0 * (2.0 * 1024.0 + 2.0 * 5.0 * 32.0 + 4.0 * 32.0) + 60.0;

/// Operations of a corner of a cell: its position and weight 12, hash 6, two features 4.
const CORNER: f64 = 22.0;

/// Returns the bytes of an entry in a lookup.
fn entry_bytes(s: &Stage<'_>) -> f64 {
    if (s.specs)("TABLE_BITS") == 16.0 { 4.0 } else { 8.0 }
}

/// Returns the cost of the field in a kernel that evaluates it at each pixel. Of the pairs, half face each other and
/// are evaluated.
pub(super) fn field(s: &Stage<'_>, c: &Counts) -> Cost {
    let levels = (s.specs)("LEVELS");
    let corners = 8.0 * levels;
    let (p, pairs) = (c.pixels, 0.5 * c.pixels * c.lights);
    Cost {
        bytes: entry_bytes(s) * corners * p,
        operations: (CORNER * corners + 2.0 * 32.0 * 2.0 * levels) * p + PAIR * pairs,
        ..Default::default()
    }
}

/// Returns the name of the kernel that computes the same in 32 bits for GPUs. Products on matrix units count as any
/// others, since the result is the same.
pub(super) fn portable(kernel: &str) -> &str {
    ["_cooperative", "_halves", "_lanes"].iter().find_map(|s| kernel.strip_suffix(s)).unwrap_or(kernel)
}

/// Returns the cost of a kernel of this module, or `None` for others.
pub(super) fn kernel(s: &Stage<'_>, c: &Counts) -> Option<Cost> {
    let spec = s.specs;
    let (p, pairs, levels) = (c.pixels, c.pixels * c.lights, spec("LEVELS"));
    let (corners, entry) = (8.0 * levels, entry_bytes(s));
    // First layer of a point.
    let project = 2.0 * 32.0 * 2.0 * levels;
    let (bytes, operations) = match portable(s.kernel) {
        "visibility" => {
            // Without the split, the first layer is recomputed for each pair, on wide subgroups with its features.
            let features = if spec("FIELD_SPREAD") == 0.0 { CORNER * corners } else { 0.0 };
            let again = if s.kernel == "visibility" && spec("SPLIT") == 0.0 { project + features } else { 0.0 };
            ((20.0 + entry * corners) * p, (CORNER * corners + project) * p + (PAIR + again) * pairs)
        }
        "visibility_encode" => ((12.0 + 128.0 + entry * corners) * p, (CORNER * corners + project) * p),
        "visibility_bwd" => {
            let (moved, parts) = (spec("REGULARIZED"), spec("PARTS"));
            ((28.0 + 128.0 * (1.0 + moved + parts)) * p, ((1.0 + moved) * PAIR + PAIR_BWD) * pairs)
        }
        // Additional cost of a pair's light. Half of the pairs face each other, and one in `SAMPLE` is evaluated.
        "visibility_lights_bwd" => {
            let (moved, taken) = (spec("REGULARIZED"), 0.5 * pairs / spec("SAMPLE").max(1.0));
            let light = super::shade::pair(spec("LOBES"));
            ((72.0 + 128.0 * (1.0 + moved + spec("PARTS"))) * p, ((1.0 + moved) * PAIR + PAIR_BWD + light) * taken)
        }
        // The kernel reads entries for the weights, and changes two sums of two words each for the tables.
        "visibility_encode_bwd" => (
            (16.0 + 128.0 * spec("PARTS") + (32.0 + entry) * corners) * p,
            (2.0 * CORNER * corners + 2.0 * project) * p,
        ),
        "visibility_reduce" => {
            let (pairs, points) = ((s.push)(0), (s.push)(1));
            let sums = 1184.0 * pairs + 64.0 * levels * points;
            (4.0 * sums, sums)
        }
        // Bits of all entries; gradients, parameters and moments of touched entries.
        "visibility_adam_packed" => (4.0 * (s.push)(0) + 84.0 * c.touched, 60.0 * c.touched),
        "visibility_adam" => (4.0 * (s.push)(0) + 80.0 * c.touched, 40.0 * c.touched),
        "visibility_adam_layers" => (28.0 * (s.push)(0), 19.0 * (s.push)(0)),
        // A single workgroup.
        "visibility_scale" => (4500.0, 2200.0),
        _ => return None,
    };
    Some(Cost { bytes, operations, ..Default::default() })
}
