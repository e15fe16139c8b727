//! Costs of the semantic kernels.

use super::{Cost, Counts, Stage};

/// Number of features; with the bias's constant; width of decoded vectors; bytes of the decoder.
const FEATURES: f64 = 32.0;
const AUGMENTED: f64 = 33.0;
const EMBEDDING: f64 = 512.0;
/// Padded floats of a row of 33 in buffers that only kernels read.
const PITCH: f64 = 36.0;
const DECODER_BYTES: f64 = 4.0 * EMBEDDING * AUGMENTED;

/// Operations of one sample. The product with the Gram matrix, its square's share of the decoder's sums, lengths and
/// scaling.
const SAMPLE: f64 = 4.0 * AUGMENTED * AUGMENTED + 400.0;

/// Operations of one class of a sample. Its logit, its term of the gradient, its row of the decoder's sums, two
/// exponentials.
const CLASS: f64 = 2.0 * AUGMENTED + 2.0 * FEATURES + 2.0 * AUGMENTED + 18.0;

/// Returns the cost of a kernel of this module, or `None` for others.
pub(super) fn kernel(s: &Stage<'_>, c: &Counts) -> Option<Cost> {
    let spec = s.specs;
    let (classes, m, p) = (spec("CLASSES"), c.samples, c.pixels);
    let text = 4.0 * classes * EMBEDDING;
    let target = 2.0 * EMBEDDING;
    // Contributions of samples or pixels to the decoder are summed by workgroup; these sums take additional memory.
    let small = 4.0 * PITCH * (AUGMENTED + classes);
    // Pixels that samples touch.
    let touched = p.min(4.0 * m);
    // All entries are assumed to lie in tiles with selected pixels. Pairs are those of blending, times the share of
    // selected pixels.
    let pairs = c.pairs * c.wanted / p.max(1.0);
    let fetched = 8.0 + 24.0 + 4.0 * FEATURES;
    let left = 4.0 * (6.0 + FEATURES);
    let (bytes, operations) = match s.kernel {
        "wanted_samples" => (p / 8.0, 20.0 * p),
        // A pair as in blending; 2 operations per feature, backward 4.
        "blend_features" => {
            (fetched * c.entries + p / 8.0 + 4.0 * FEATURES * c.wanted, (20.0 + 2.0 * FEATURES) * pairs)
        }
        // If the backward pass takes several dispatches, the first carries the cost of all.
        "blend_features_bwd" if (s.push)(0) == 0.0 => {
            let bytes = (fetched + left) * c.entries + p / 8.0 + 8.0 * FEATURES * c.wanted;
            (bytes, (45.0 + 4.0 * FEATURES) * pairs)
        }
        "features_bwd" => {
            (4.0 * FEATURES * c.entries + (12.0 + 8.0 * FEATURES) * c.visible, FEATURES * (c.entries + c.visible))
        }
        "features_bwd_adam" => {
            let bytes = 4.0 * FEATURES * c.entries + (12.0 + 24.0 * FEATURES) * c.visible;
            (bytes, FEATURES * (c.entries + 19.0 * c.visible))
        }
        "project_bwd_features" => (28.0 * c.entries + 144.0 * c.visible, 6.0 * c.entries + 300.0 * c.visible),
        "semantic_target" => ((target + 8.0) * m + text, 2.0 * EMBEDDING * (1.0 + classes) * m),
        "semantic_prepare" => {
            let operations = 2.0 * EMBEDDING * AUGMENTED * (AUGMENTED + classes);
            (DECODER_BYTES + text + small * spec("PARTS"), operations)
        }
        "semantic_project" => {
            let products = 4.0 * PITCH * spec("PARTS");
            ((target + products) * m + DECODER_BYTES, 2.0 * EMBEDDING * AUGMENTED * m)
        }
        "semantic_outer" => {
            let sums = 4.0 * EMBEDDING * PITCH * spec("SPLITS");
            ((target + 4.0 * AUGMENTED) * m + sums, 2.0 * EMBEDDING * AUGMENTED * m)
        }
        // A sample reads the features of up to four pixels and its target's products. It writes products and a
        // gradient.
        "semantic_samples" => {
            let read = 4.0 * FEATURES * touched + (8.0 + 4.0 * AUGMENTED * spec("PARTS")) * m;
            (read + 4.0 * (AUGMENTED + FEATURES) * m + small * s.groups, (SAMPLE + CLASS * classes) * m)
        }
        "semantic_gather" => (4.0 * FEATURES * (m + touched) + p / 8.0, 8.0 * FEATURES * m + 20.0 * touched),
        "semantic_reduce" => {
            let (width, groups) = ((s.push)(0), (s.push)(1));
            (4.0 * width * (groups + 2.0), width * groups)
        }
        "decoder_gradient" => {
            let splits = spec("SPLITS");
            let sums = splits + 2.0 * (AUGMENTED + classes);
            (DECODER_BYTES * (splits + 2.0) + text + small, EMBEDDING * AUGMENTED * sums)
        }
        "region_sums" => {
            let class = if spec("CLASSIFY") > 0.0 { 2.0 * AUGMENTED * classes } else { 0.0 };
            (4.0 * FEATURES * c.masked + p / 8.0, (FEATURES + class) * c.masked)
        }
        "region_finish" => (4.0 * AUGMENTED * (s.push)(0), AUGMENTED * (s.push)(0)),
        "correspondence_bwd" => {
            let bytes = 8.0 * FEATURES * c.masked + p / 8.0 + small * s.groups;
            (bytes, (SAMPLE + CLASS * classes) * c.masked)
        }
        "correspondence_train_bwd" => (12.0 * FEATURES * c.masked + p / 8.0, 2.0 * FEATURES * c.masked),
        "region_mask" => (2.0 * p + p / 8.0, 3.0 * p),
        // Depth and transmittance of every pixel; those of the training view for pixels that land in the region.
        // Projection and unprojection 40, bounds 8, two depths 10.
        "carry_mask" => {
            let arrived = (4.0 * spec("TRAINED_CHANNELS") + 4.0) * c.masked;
            ((4.0 * spec("CHANNELS") + 4.0) * p + p / 4.0 + arrived, 58.0 * p)
        }
        "semantic_labels" => {
            ((4.0 * FEATURES + 8.0) * p, (2.0 * AUGMENTED * AUGMENTED + 4.0 * AUGMENTED * classes) * p)
        }
        "semantic_sum" => (64.0, 16.0),
        _ => return None,
    };
    Some(Cost { bytes, operations, ..Default::default() })
}
