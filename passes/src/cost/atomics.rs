//! Atomic operations of the kernels on device memory.
//!
//! Counts assume that every pixel is covered and no addend is zero. Shared memory does not count: `radix_histogram`,
//! `radix_scatter`, `carry_mask`, `long_tiles` and `lights_near` have 0. Operations of a subgroup as a whole count as 0:
//! `environment_scale`, the totals of `densify_decide`, and the iterations of transport. So do operations on errors, such
//! as those on gradients that are not finite (`adam`, `view_step`).

use super::{Counts, Stage};

/// Corners of a cell of the visibility field, each with two features.
const CORNERS: f64 = 8.0;

/// Returns the atomic operations of a kernel on device memory; 0 for most kernels.
pub(super) fn count(s: &Stage<'_>, c: &Counts) -> f64 {
    let spec = s.specs;
    match s.kernel {
        // An addition for each gradient of an entry.
        "blend_bwd_atomic" => {
            let statistic = if spec("STATISTIC") > 0.0 { 2.0 } else { 0.0 };
            (6.0 + spec("CHANNELS") + spec("WEIGHTS") + statistic) * c.entries
        }
        // The lower words of two features for each corner of each level; a bit for each touched entry. Few upper words change.
        "visibility_encode_bwd" => 2.0 * CORNERS * spec("LEVELS") * c.pixels + c.touched,
        // Twelve texels, each with three sums, whose upper words rarely change.
        "environment_bwd" => 36.0 * c.pixels,
        // About one for each Gaussian that is cloned, split or pruned.
        "densify_decide" | "densify_assign" | "relocate_draw" => c.moved,
        // The class of each pixel of a region.
        "region_sums" if spec("CLASSIFY") > 0.0 => c.masked,
        _ => 0.0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn atomics_are_those_on_device_memory() {
        let specs = |name: &str| match name {
            "CHANNELS" => 3.0,
            "WEIGHTS" => 1.0,
            "LEVELS" => 16.0,
            _ => 0.0,
        };
        let counts =
            Counts { entries: 1000.0, pixels: 10.0, touched: 7.0, moved: 5.0, masked: 3.0, ..Default::default() };
        let of = |kernel: &str| count(&Stage { kernel, specs: &specs, push: &|_| 0.0, groups: 1.0 }, &counts);
        assert_eq!(of("blend_bwd_atomic"), 10_000.0);
        assert_eq!(of("visibility_encode_bwd"), 256.0 * 10.0 + 7.0);
        assert_eq!(of("environment_bwd"), 360.0);
        assert_eq!(of("relocate_draw"), 5.0);
        // The histogram of a sort is in shared memory. Without classes, a region has no histogram.
        assert_eq!([of("radix_histogram"), of("region_sums"), of("blend_bwd")], [0.0; 3]);
    }
}
