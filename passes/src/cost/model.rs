//! Costs of the kernels. The line of a number that is not obvious names its terms.

use super::{Cost, Counts, Stage};

/// Operations of projecting one Gaussian. Camera space 18, rotation matrix 30, its product with scales and the camera's
/// rotation 60. Rows of the Jacobian 20, covariance and determinant 35, triangular factor 25, four exponentials 16.
const PROJECT: f64 = 204.0;

/// Bytes of the three columns that projection reads. Mean 3, opacity 1, log scale 3 and an unused number, quaternion 4.
const SHAPE_BYTES: f64 = 48.0;

/// Operations of the backward pass of projection. Covariance 60, Jacobian 50, matrices 115, quaternion 50, the forward
/// values recomputed 204.
const PROJECT_BWD: f64 = 479.0;

/// Operations of an Adam step of one scalar. Two moments 7, corrections, root and division 12.
const ADAM: f64 = 19.0;

/// Operations of rounding a scalar and its moments at random and of unpacking them. Random bits 14, moments 9, half
/// precision 12, unpacking 5.
const ROUND: f64 = 40.0;

/// Bytes of a splat's footprint. Mean 2, factor 3, opacity 1.
const SPLAT_BYTES: f64 = 24.0;

/// Returns the operations of evaluating spherical harmonics up to a degree. They include the dot product with three
/// channels.
fn harmonics(degree: f64) -> f64 {
    (degree + 1.0).powi(2) * (3.0 * 2.0 + 4.0)
}

/// Returns the cost of a kernel of any module. `elements`: number of elements of a primitive.
pub(super) fn kernel(s: &Stage<'_>, c: &Counts, elements: f64) -> Option<Cost> {
    let spec = s.specs;
    let (n, v, e, p) = (c.gaussians, c.visible, c.entries, c.pixels);
    let channels = spec("CHANNELS");
    // Bytes that blending fetches for an entry: its index, its splat, footprint and features. Then bytes that it writes
    // backward.
    let words = channels - if spec("COLOR_BITS") == 16.0 { 1.0 } else { 0.0 };
    let fetched = 8.0 + SPLAT_BYTES + 4.0 * words;
    let own = if spec("STATISTIC") > 0.0 { 2.0 } else { 0.0 };
    let gradients = 4.0 * (6.0 + channels + spec("WEIGHTS") + own);
    // Bytes of reading and writing the moments of columns, and operations of an Adam step of one scalar.
    let compact = spec("COMPACT") > 0.0;
    let moments_of = |columns: f64| if compact { 32.0 * columns } else { 64.0 * columns };
    let moments = moments_of(spec("MOMENT_COLUMNS"));
    let adam = if compact { ADAM + ROUND } else { ADAM };
    let (bytes, operations) = match s.kernel {
        // Also one bit per Gaussian.
        "project_count" => ((SHAPE_BYTES + 0.125) * n, PROJECT * n),
        "project" => {
            let degree = spec("SH_DEGREE");
            // Whole columns of four numbers; two of them in 16 bytes if compact.
            let harmonic_columns = (0.75 * (degree + 1.0).powi(2)).ceil();
            let packed = if compact { (harmonic_columns / 2.0).ceil() } else { harmonic_columns };
            let read = 16.0 * packed + 16.0 * spec("HAS_NORMALS");
            // Id, depth, number of tiles, footprint, features. Tiles are counted row by row: about 3 rows of 30.
            let written = 12.0 + SPLAT_BYTES + 4.0 * words;
            (0.125 * n + (SHAPE_BYTES + read + written) * v, (PROJECT + harmonics(degree) + 90.0) * v)
        }
        "intersect" => ((16.0 + SPLAT_BYTES) * v + 8.0 * e, 90.0 * v + 10.0 * e),
        "tile_ranges" => (4.0 * e, 2.0 * e),
        // Ranges of the tiles; the first push constant is their number.
        "long_tiles" => (8.0 * (s.push)(0), 2.0 * (s.push)(0)),
        // A pair: distance 2, factor 5, square 3, exponential 4, opacity and thresholds 3, transmittance 3; 2 per
        // channel. Further parts of a tile fetch its entries from a cache.
        "blend" => (fetched * e + 4.0 * (channels + 1.0) * p, (20.0 + 2.0 * channels) * c.pairs),
        // Also the checkpoints: the state of a tile's pixels before each bucket of entries.
        "blend_buckets" => {
            let checkpoints = 4.0 * (channels + 1.0) * checkpoint_pixels(s) * e;
            (fetched * e + 4.0 * (channels + 1.0) * p + checkpoints, (20.0 + 2.0 * channels) * c.pairs)
        }
        // Reads the checkpoints, and for each bucket the gradients and debts of its tile. Pixels run 1 + SUBGROUP / pixels
        // times as long as there are pixels, because the lanes start one after the other.
        "blend_bwd_bucket" => {
            let pixels = spec("TILE_WIDTH") * spec("TILE_HEIGHT");
            let rounds = 1.0 + spec("SUBGROUP") / pixels.max(1.0);
            let states = 8.0 * (channels + 1.0) * checkpoint_pixels(s) * e;
            let operations = (45.0 + 4.0 * channels + 8.0 * own) * rounds * c.pairs;
            ((fetched + gradients) * e + states, operations)
        }
        // As above, and weights and debts 8, the derivative of alpha 8, six moments 9; 4 per channel.
        "blend_bwd" | "blend_bwd_splat" => {
            ((fetched + gradients) * e + 4.0 * (channels + 1.0) * p, (45.0 + 4.0 * channels + 8.0 * own) * c.pairs)
        }
        // Each addition to a sum reads and writes it.
        "blend_bwd_atomic" => {
            let operations = 45.0 + 4.0 * channels + 8.0 * own;
            ((fetched + 2.0 * gradients) * e + 4.0 * (channels + 1.0) * p, operations * c.pairs)
        }
        // Separable window without margins: 11 taps, down and across, on 4 (backward 3) values of 3 channels. Pixels
        // are interleaved: reading three channels fetches all.
        "photometric" => ((4.0 * channels + 4.0 + 36.0) * p, 3.0 * (4.0 * 11.0 * 4.0 + 60.0) * p),
        "blend_debt" => ((8.0 * (channels + 1.0) + 4.0) * p, 2.0 * (channels + 1.0) * p),
        "photometric_bwd_in_place" => ((36.0 + 12.0 + 4.0 + 12.0 + 4.0) * p, 3.0 * (3.0 * 11.0 * 4.0 + 22.0) * p),
        "photometric_bwd" => ((36.0 + 4.0 * channels + 4.0 + 12.0) * p, 3.0 * (3.0 * 11.0 * 4.0 + 20.0) * p),
        "geometry_loss" => ((56.0 + 4.0 * spec("DEPTH_PRIOR")) * p, 450.0 * p),
        "depth_fit" => (12.0 * p, 15.0 * p),
        "project_bwd_adam" => {
            // Every column of a visible Gaussian and of both its moments, read and written.
            let gaussian = 32.0 * spec("COLUMNS") + moments + 12.0 + 4.0 * words + 32.0 * spec("STATISTICS");
            let arithmetic = PROJECT_BWD + 2.0 * harmonics(spec("SH_DEGREE")) + adam * c.width;
            let summed = if spec("REDUCED") > 0.0 { v } else { e };
            (gradients * summed + gaussian * v, (6.0 + channels) * summed + arithmetic * v)
        }
        "camera_bwd" => {
            let gaussian = 16.0 * spec("COLUMNS") + 12.0 + 4.0 * words;
            let arithmetic = PROJECT_BWD + harmonics(spec("SH_DEGREE")) + 50.0;
            let summed = if spec("REDUCED") > 0.0 { v } else { e };
            (gradients * summed + gaussian * v, (6.0 + channels) * summed + arithmetic * v)
        }
        "view_gain" => ((4.0 * channels + 12.0) * p, 3.0 * p),
        "view_gain_bwd" => ((8.0 * channels + 12.0) * p, 9.0 * p),
        // Elements that a view does not see, counted as if no element was visible.
        "adam" => (28.0 * elements, ADAM * elements),
        // Only place, shape and opacity where zero gradients move nothing; gradients of other views are rows of 11.
        "adam_unseen" => {
            let sparse = spec("SPARSE") > 0.0;
            let columns = if sparse { 3.0 } else { spec("MOMENT_COLUMNS") };
            let all = if sparse { 32.0 * columns + moments_of(columns) } else { 32.0 * spec("COLUMNS") + moments };
            ((all + 44.0 * spec("EXTRA") + 4.0) * n, 4.0 * adam * columns * n)
        }
        "adam_unseen_features" => (24.0 * spec("WIDTH") * n, ADAM * spec("WIDTH") * n),
        // Most Gaussians are opaque and stay: one column each.
        "position_noise" => (16.0 * n, 10.0 * n),
        // One number of a column; memory moves in larger pieces.
        "opacity_reset" => ((32.0 + moments_of(1.0)) * n, 4.0 * n),
        // A single workgroup, which takes little time.
        "loss_sum" | "report" | "intrinsic_report" | "work" | "regroup" | "densify_plan" | "relocate_plan"
        | "depth_fit_solve" | "view_place" | "view_step" => (64.0, 16.0),
        _ => {
            return primitive(s, elements)
                .or_else(|| densify(s, c))
                .or_else(|| super::meaning::kernel(s, c))
                .or_else(|| super::shade::kernel(s, c))
                .or_else(|| super::surface::kernel(s, c))
                .or_else(|| super::environment::kernel(s, c))
                .or_else(|| super::area_lights::kernel(s, c))
                .or_else(|| super::visibility::kernel(s, c))
                .or_else(|| super::material::kernel(s, c))
                .or_else(|| super::transport::kernel(s, c));
        }
    };
    Some(Cost { bytes, operations, ..Default::default() })
}

/// Returns the pixels whose state a kernel of buckets handles, by entry.
fn checkpoint_pixels(s: &Stage<'_>) -> f64 {
    (s.specs)("TILE_WIDTH") * (s.specs)("TILE_HEIGHT") / (s.specs)("BUCKET").max(1.0)
}

/// Returns the cost of a scan or sort of `n` elements.
fn primitive(s: &Stage<'_>, n: f64) -> Option<Cost> {
    let spec = s.specs;
    // A block is the elements of one workgroup; `radix_scatter_direct` has workgroups of one subgroup.
    let workgroup = if spec("WORKGROUP") > 0.0 { spec("WORKGROUP") } else { spec("SUBGROUP") };
    let blocks = (n / (workgroup * spec("ITEMS")).max(1.0)).ceil();
    let counters = 4.0 * blocks * spec("BITS").exp2();
    let (bytes, operations) = match s.kernel {
        "scan_reduce" => (4.0 * n, n),
        "scan_gather" => (12.0 * n, n),
        "scan_down" | "scan_down_in_place" => (8.0 * n, 2.0 * n),
        // Block sums in rows, one per workgroup; the second push constant is the size of a block.
        "scan_spine" => {
            let sums = s.groups * (n / (s.push)(1).max(1.0)).ceil();
            (8.0 * sums, 2.0 * sums)
        }
        "radix_histogram" => (4.0 * n + counters, 3.0 * n),
        "radix_scatter" | "radix_scatter_direct" => {
            let read = if spec("IOTA") > 0.0 { 4.0 } else { 8.0 };
            let written = if spec("WRITE_KEYS") > 0.0 { 8.0 } else { 4.0 };
            ((read + written) * n + counters, 12.0 * n)
        }
        _ => return None,
    };
    Some(Cost { bytes, operations, ..Default::default() })
}

/// Returns the cost of a densification kernel. 80 bytes of parameters and statistics decide; flags, ranks and lists
/// follow; then the copies.
fn densify(s: &Stage<'_>, c: &Counts) -> Option<Cost> {
    let n = c.gaussians;
    let bytes = match s.kernel {
        "densify_decide" => 84.0 * n,
        "densify_flags" => 16.0 * n,
        "densify_slots" => 8.0 * n + 4.0 * c.moved,
        "densify_assign" => 16.0 * n + 20.0 * c.moved,
        // A column or a feature, and its moments, are read once and written up to twice.
        "densify_move" => {
            let spec = s.specs;
            let moments = if spec("COMPACT") > 0.0 { 48.0 } else { 96.0 } * spec("MOMENT_COLUMNS");
            (16.0 + 48.0 * spec("COLUMNS") + moments) * c.moved
        }
        "densify_move_features" => (16.0 + 36.0 * (s.specs)("WIDTH")) * c.moved,
        "densify_split" => 112.0 * c.moved,
        "relocate_weigh" => (64.0 + 16.0) * n,
        // A search of the sums for each copy, which a cache holds in part.
        "relocate_draw" => (24.0 + 32.0) * c.moved,
        "relocate_correct" => 4.0 * n + 64.0 * c.moved,
        _ => return None,
    };
    Some(Cost { bytes, operations: bytes / 4.0, ..Default::default() })
}
