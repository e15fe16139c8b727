//! `semantic_prepare`, `semantic_loss`, `decoder_gradient`: losses of blended features through the decoder.
//!
//! SGS-Intrinsic, stage I. Features f are sampled from the image at the samples of a view's target map (bilinear; first
//! and last samples coincide with first and last pixels). They are decoded to v = W f + b = A f'. With target t and the
//! classes' unit text embeddings T:
//! * `weight_semantic`: mean of 1 - cos(v, t) over the samples whose target is finite and not zero.
//! * `weight_semantic_class`: mean cross-entropy of the softmax of (T v / |v|) / temperature against the target's
//!   label, over the samples that have a label.
//!
//! Only two products are 512 wide: the targets with A, and one of the gradient. The rest uses |v|² = f'ᵀ(AᵀA)f' and T v
//! = (T A) f'. A decoded vector has no direction if it is shorter than 1e-3 of its terms' size, or than 1e-8. The terms
//! are those of every feature and the bias, taken as orthogonal. Cosine and logits are 0 then, without a gradient.
//! Features may have any magnitude: they are divided by their largest first. A sample with non-finite features
//! contributes nothing and is counted.
//!
//! Guarantees: every feature channel of the gradient is written at the selected pixels and nowhere else, by gathering,
//! without atomics. Results are bit-identical between runs on a device. The caller adds other gradients of these
//! channels afterwards, and runs Adam ([`crate::optim::decoder_step`]).
//!
//! Lanes fetch shared data together and exchange it by subgroup operations. These are rows of the decoder and, in
//! `semantic_samples`, rows of the small matrices; there the 32 features of an item are spread over the lanes. CPUs
//! gain too: a number from memory costs a subgroup as much as sixty multiply-adds there.
//!
//! Cost for M samples and C classes. `semantic_project`: 1024 + 144 bytes and 33 792 operations per sample;
//! `semantic_outer` the same. `semantic_samples`: 912 bytes and about 7000 + 270 C operations. `semantic_gather`: 128
//! bytes per sample and per pixel that it touches, and one bit per pixel. Memory: 272 bytes per sample and 72 KiB per
//! run of samples, independent of the image size.

use crate::Tuning;
use crate::kernel::{groups, stage};
use crate::scene::{AUGMENTED, EMBEDDING, FEATURES};
use sgs_engine::graph::{Buffer, Graph, GraphError};
use sgs_shaders::structs::SemanticTarget;
use sgs_shaders::{
    decoder_gradient as gradient_kernel, semantic_gather, semantic_outer, semantic_prepare as prepare_kernel,
    semantic_project, semantic_reduce, semantic_samples, semantic_target,
};

/// Largest number of workgroups that sum for the decoder. Each writes (33 + C) rows of sums.
const MOST_GROUPS: u64 = 256;

/// Bytes of a row of 33 floats, padded.
const ROW: u64 = 144;

/// Smallest number of rows in a part of the decoder.
const LEAST_ROWS: u64 = 16;

/// Smallest number of samples in a run of `semantic_outer`.
const LEAST_RUN: u32 = 64;

/// Decoder and classes.
#[derive(Clone, Copy, Debug)]
pub struct Head {
    /// `[512 * 33]` floats: rows of 32 weights and a bias.
    pub decoder: Buffer,
    /// `[classes * 512]` floats, each row of unit length ([`normalize_embeddings`]).
    pub embeddings: Buffer,
    /// Number of classes, at least one.
    pub classes: u32,
}

/// Small matrices that replace the decoder in a step.
#[derive(Clone, Copy, Debug)]
pub struct Prepared {
    /// Rows of 33 floats, padded to 36: the 33 rows of AᵀA, then those of T A by class.
    pub matrices: Buffer,
    /// Sums for `decoder_gradient`, in rows of the same layout. Zero at first; losses add to them.
    pub accumulated: Buffer,
    /// Number of classes.
    pub classes: u32,
    /// Kernel sizes of the passes that computed the matrices.
    pub tuning: Tuning,
}

/// Targets of all views, one after the other.
#[derive(Clone, Copy, Debug)]
pub struct SemanticTargets {
    /// `[samples * 256]` words of two half floats.
    pub features: Buffer,
    /// `[samples]` of `SemanticTarget`, from [`semantic_targets`].
    pub targets: Buffer,
    /// Number of samples in the largest map.
    pub largest: u32,
}

/// Inputs of a training view's semantic loss. The view's map is the step's `semantic_size` and `semantic_offset`. The
/// means are over its `semantic_valid` and `semantic_labeled`.
#[derive(Clone, Copy, Debug)]
pub struct SemanticLoss {
    /// Uniform `Step`.
    pub step: Buffer,
    /// `[P * channels]` floats.
    pub image: Buffer,
    /// Floats of a pixel of `image` and of its gradient.
    pub channels: u32,
    /// Channel of the first of the 32 features.
    pub first: u32,
    /// Upper bounds of the width and height of all views, in pixels.
    pub largest: [u32; 2],
    /// Targets of the features.
    pub targets: SemanticTargets,
    /// One bit per pixel: selection of the pixels whose gradient is written. It must include the pixels that samples
    /// touch.
    pub wanted: Buffer,
}

/// Results of the loss.
#[derive(Clone, Copy, Debug)]
pub struct SemanticSums {
    /// By workgroup: 1 - cos, cross-entropy, number of samples that did not count.
    pub sums: Buffer,
    /// Number of workgroups.
    pub count: u32,
    /// By run, 512 padded rows of 33: the term of the decoder's gradient that needs the targets.
    pub outer: Buffer,
    /// Number of runs.
    pub runs: u32,
}

/// Scales rows of 512 to unit length. A row of zeros, or with a non-finite number, becomes zeros.
pub fn normalize_embeddings(rows: &[f32]) -> Vec<f32> {
    let unit = |row: &[f32]| {
        let length = row.iter().map(|&x| f64::from(x).powi(2)).sum::<f64>().sqrt();
        let scale = if length > 0.0 && length.is_finite() { 1.0 / length } else { 0.0 };
        row.iter().map(|&x| if scale > 0.0 { (f64::from(x) * scale) as f32 } else { 0.0 }).collect::<Vec<f32>>()
    };
    rows.chunks(EMBEDDING).flat_map(unit).collect()
}

/// Adds the pass that precomputes `targets`, `[samples]` of `SemanticTarget`. It runs once. The label is the class of
/// the largest cosine, or the entry of `provided` (one word per sample; out of range means none).
///
/// # Errors
/// If a buffer does not belong to the graph or is too small to be bound.
#[expect(clippy::too_many_arguments, reason = "declares a kernel")]
pub fn semantic_targets(
    g: &mut Graph,
    tuning: Tuning,
    features: Buffer,
    embeddings: Buffer,
    classes: u32,
    provided: Option<Buffer>,
    samples: u32,
    targets: Buffer,
) -> Result<(), GraphError> {
    let bindings = semantic_target::Bindings {
        features: features.into(),
        embeddings: embeddings.into(),
        labels: provided.unwrap_or(features).into(),
        targets: targets.into(),
    };
    let specs = semantic_target::Specs { subgroup: tuning.subgroup_size, classes, has_labels: provided.is_some() };
    let push = semantic_target::Push { samples };
    let pass = stage(
        g,
        "semantic_target",
        &semantic_target::KERNEL,
        bindings.entries(),
        specs.entries(),
        bytemuck::bytes_of(&push),
    );
    pass.subgroup_size(Some(tuning.subgroup_size)).dispatch(groups(u64::from(samples), 1))
}

/// Adds the passes that compute the decoder's small matrices. They run once per step, before all losses with the same
/// head.
///
/// # Errors
/// If a buffer does not belong to the graph or is too small to be bound.
pub fn semantic_prepare(g: &mut Graph, tuning: Tuning, head: &Head) -> Result<Prepared, GraphError> {
    let bytes = count_rows(head.classes) * ROW;
    let prepared = Prepared {
        matrices: g.transient("semantic.matrices", bytes),
        accumulated: g.transient("semantic.accumulated", bytes),
        classes: head.classes,
        tuning,
    };
    let subgroup = tuning.subgroup_size;
    let per_lane = rows_per_lane(tuning);
    let blocks = count_rows(head.classes).div_ceil(u64::from(per_lane * subgroup));
    let parts = decoder_parts(tuning, blocks);
    let partials = g.transient("semantic.parts", u64::from(parts) * bytes);
    let bindings = prepare_kernel::Bindings {
        decoder: head.decoder.into(),
        embeddings: head.embeddings.into(),
        partials: partials.into(),
    };
    let specs = prepare_kernel::Specs { subgroup, per_lane, classes: head.classes, parts };
    stage(g, "semantic_prepare", &prepare_kernel::KERNEL, bindings.entries(), specs.entries(), &[])
        .subgroup_size(Some(subgroup))
        .dispatch(groups(blocks * u64::from(parts), 1))?;
    sum_parts(g, tuning, "semantic_prepare", partials, prepared.matrices, bytes / 4, parts, false)?;
    g.fill("semantic.clear", prepared.accumulated, 0)?;
    Ok(prepared)
}

/// Returns the number of rows in the sums of the decoder's gradient.
fn count_rows(classes: u32) -> u64 {
    AUGMENTED as u64 + u64::from(classes)
}

/// Returns the number of rows of 33 floats that a lane holds in registers. Kernels with few other registers use it.
fn rows_per_lane(tuning: Tuning) -> u32 {
    (32 / tuning.subgroup_size).max(2)
}

/// Returns the number of workgroups for `items` that come in chunks of `piece`. A workgroup may take several chunks, in
/// batches of `rounds` loop iterations each.
pub(super) fn batch_groups(tuning: Tuning, items: u64, piece: u32, rounds: u32) -> u32 {
    let batch = u64::from(tuning.subgroup_size * tuning.tiles());
    let all = items.div_ceil(batch) * u64::from(rounds);
    // The work that a workgroup does only once takes less than a quarter of the iterations.
    let enough = MOST_GROUPS.min(u64::from(tuning.workers)).max(all.div_ceil(u64::from(tuning.rounds) / 4 * 3));
    items.div_ceil(u64::from(piece)).clamp(1, enough) as u32
}

/// Returns the number of parts into which the decoder's rows are split. Without a split, each of `blocks` workgroups
/// would process all rows. The parts are about as many as occupy the device.
fn decoder_parts(tuning: Tuning, blocks: u64) -> u32 {
    let parts = u64::from(tuning.workers).div_ceil(blocks.max(1)).next_power_of_two();
    parts.min(EMBEDDING as u64 / LEAST_ROWS) as u32
}

/// Declares the sums of `groups` workgroups.
pub(super) fn partials(g: &mut Graph, name: &str, classes: u32, groups: u32) -> Buffer {
    g.transient(format!("{name}.partials"), u64::from(groups) * count_rows(classes) * ROW)
}

/// Adds the pass that adds the workgroups' sums to those of the step.
pub(super) fn reduce(
    g: &mut Graph,
    tuning: Tuning,
    name: &str,
    partials: Buffer,
    prepared: &Prepared,
    count: u32,
) -> Result<(), GraphError> {
    sum_parts(g, tuning, name, partials, prepared.accumulated, count_rows(prepared.classes) * ROW / 4, count, true)
}

/// Adds the pass that sums `count` runs of `width` values. With `add` it adds them to `into`, otherwise it overwrites
/// `into`.
#[expect(clippy::too_many_arguments, reason = "declares a kernel")]
fn sum_parts(
    g: &mut Graph,
    tuning: Tuning,
    name: &str,
    partials: Buffer,
    into: Buffer,
    width: u64,
    count: u32,
    add: bool,
) -> Result<(), GraphError> {
    let sharing = if count > 8 && !tuning.narrow() { 8 } else { 1 };
    let specs = semantic_reduce::Specs { workgroup: tuning.workgroup, add, parts: sharing };
    let push = semantic_reduce::Push { width: width as u32, groups: count };
    let name = format!("{name}.reduce");
    let pass = stage(g, &name, &semantic_reduce::KERNEL, [], specs.entries(), bytemuck::bytes_of(&push));
    let pass = pass.bind("partials", partials);
    // Overwritten values are not read.
    let pass = if add { pass.bind("accumulated", into) } else { pass.bind_discard("accumulated", into) };
    pass.dispatch(groups(width, tuning.workgroup / sharing))
}

/// Adds the loss of a training view. Writes the feature channels of `grad_image` at the selected pixels, and adds to
/// `prepared.accumulated`.
///
/// # Errors
/// If a buffer does not belong to the graph or is too small to be bound.
pub fn semantic_loss(
    g: &mut Graph,
    tuning: Tuning,
    a: &SemanticLoss,
    head: &Head,
    prepared: &Prepared,
    grad_image: Buffer,
) -> Result<SemanticSums, GraphError> {
    let subgroup = tuning.subgroup_size;
    let samples = u64::from(a.targets.largest);
    let per_lane = (64 / tuning.subgroup_size).max(2);
    let blocks = samples.div_ceil(u64::from(subgroup * per_lane)).max(1);
    let parts = decoder_parts(tuning, blocks);
    let products = g.transient("semantic.products", u64::from(parts) * samples * ROW);
    let bindings = semantic_project::Bindings {
        params: a.step.into(),
        features: a.targets.features.into(),
        decoder: head.decoder.into(),
        products: products.into(),
    };
    let specs = semantic_project::Specs { subgroup, per_lane, parts };
    let push = semantic_project::Push { largest: a.targets.largest };
    let bytes = bytemuck::bytes_of(&push);
    stage(g, "semantic_project", &semantic_project::KERNEL, bindings.entries(), specs.entries(), bytes)
        .subgroup_size(Some(subgroup))
        .dispatch(groups(blocks * u64::from(parts), 1))?;

    let tiles = tuning.tiles();
    let count = batch_groups(tuning, samples, subgroup * tiles, 512 + 2 * head.classes);
    let grad_features = g.transient("semantic.grad_features", samples * 4 * FEATURES as u64);
    let sums = g.transient("semantic.sums", u64::from(count) * 12);
    let partials = partials(g, "semantic", head.classes, count);
    let bindings = semantic_samples::Bindings {
        params: a.step.into(),
        image: a.image.into(),
        targets: a.targets.targets.into(),
        matrices: prepared.matrices.into(),
        products: products.into(),
        grad_features: grad_features.into(),
        partials: partials.into(),
        sums: sums.into(),
    };
    let specs =
        semantic_samples::Specs { subgroup, tiles, classes: head.classes, channels: a.channels, first: a.first, parts };
    let push = semantic_samples::Push { largest: a.targets.largest };
    let bytes = bytemuck::bytes_of(&push);
    stage(g, "semantic_samples", &semantic_samples::KERNEL, bindings.entries(), specs.entries(), bytes)
        .subgroup_size(Some(subgroup))
        .dispatch([count, 1, 1])?;
    reduce(g, tuning, "semantic", partials, prepared, count)?;
    gather(g, tuning, a, grad_features, grad_image)?;
    let (outer, runs) = outer(g, tuning, a, products)?;
    Ok(SemanticSums { sums, count, outer, runs })
}

/// Adds the pass that gathers the gradient of sampled features at pixels.
fn gather(
    g: &mut Graph,
    tuning: Tuning,
    a: &SemanticLoss,
    grad_features: Buffer,
    grad_image: Buffer,
) -> Result<(), GraphError> {
    let bindings = semantic_gather::Bindings {
        params: a.step.into(),
        grad_features: grad_features.into(),
        pixel_mask: a.wanted.into(),
        grad_image: grad_image.into(),
    };
    let subgroup = tuning.subgroup_size;
    // Wide subgroups spread the channels of a pixel over 8 lanes; in narrow ones a lane sums all channels of its pixel.
    let across = if tuning.narrow() { 1 } else { 8 };
    let pixels = u64::from(a.largest[0]) * u64::from(a.largest[1]);
    let lane_pixels = tuning.lane_pixels(pixels);
    let specs = semantic_gather::Specs { subgroup, channels: a.channels, first: a.first, across, lane_pixels };
    let blocks = pixels.div_ceil(u64::from(lane_pixels * subgroup)).max(1);
    stage(g, "semantic_gather", &semantic_gather::KERNEL, bindings.entries(), specs.entries(), &[])
        .subgroup_size(Some(subgroup))
        .dispatch([blocks.min(1 << 15) as u32, 1, 1])
}

/// Adds the pass that sums t (s f')ᵀ over samples, by runs. Returns the sums and the number of runs.
fn outer(g: &mut Graph, tuning: Tuning, a: &SemanticLoss, rows: Buffer) -> Result<(Buffer, u32), GraphError> {
    // A lane's rows are pairs; see rows_per_lane().
    let words = rows_per_lane(tuning);
    let stripes = EMBEDDING as u32 / (2 * words * tuning.subgroup_size);
    let most = (tuning.workers / stripes).max(1);
    let split = a.targets.largest.div_ceil(most).max(LEAST_RUN);
    let runs = a.targets.largest.div_ceil(split).max(1);
    let outer = g.transient("semantic.outer", u64::from(runs) * EMBEDDING as u64 * ROW);
    let bindings = semantic_outer::Bindings {
        params: a.step.into(),
        features: a.targets.features.into(),
        rows: rows.into(),
        outer: outer.into(),
    };
    let specs = semantic_outer::Specs { subgroup: tuning.subgroup_size, words, splits: runs };
    let push = semantic_outer::Push { split };
    let push = bytemuck::bytes_of(&push);
    stage(g, "semantic_outer", &semantic_outer::KERNEL, bindings.entries(), specs.entries(), push)
        .subgroup_size(Some(tuning.subgroup_size))
        .dispatch(groups(u64::from(runs * stripes), 1))?;
    Ok((outer, runs))
}

/// Adds the pass that writes `gradient`, `[512 * 33]` floats. It combines the results of all losses. `sums`: results of
/// the training view, if it has targets.
///
/// # Errors
/// If a buffer does not belong to the graph or is too small to be bound.
pub fn decoder_gradient(
    g: &mut Graph,
    tuning: Tuning,
    head: &Head,
    prepared: &Prepared,
    sums: Option<&SemanticSums>,
    gradient: Buffer,
) -> Result<(), GraphError> {
    let bindings = gradient_kernel::Bindings {
        decoder: head.decoder.into(),
        embeddings: head.embeddings.into(),
        outer: sums.map_or(head.decoder, |s| s.outer).into(),
        accumulated: prepared.accumulated.into(),
        gradient: gradient.into(),
    };
    let (subgroup, tiles) = (tuning.subgroup_size, tuning.tiles());
    let splits = sums.map_or(0, |s| s.runs);
    let specs = gradient_kernel::Specs { subgroup, tiles, classes: head.classes, splits };
    stage(g, "decoder_gradient", &gradient_kernel::KERNEL, bindings.entries(), specs.entries(), &[])
        .subgroup_size(Some(subgroup))
        .dispatch(groups(EMBEDDING as u64, tiles * subgroup))
}

/// Returns the mask of the pixels that samples of a map touch, row by row. `size`: of the image; `map`: of the map.
pub fn sampled_pixels(size: [u32; 2], map: [u32; 2]) -> Vec<bool> {
    // As in semantic.glsl: first and last pixel coincide with first and last sample.
    let axis = |k: usize| {
        let mut touched = vec![false; size[k] as usize];
        let steps = map[k].max(2) - 1;
        for i in 0..map[k] {
            let across = i * if map[k] > 1 { size[k] - 1 } else { 0 };
            touched[(across / steps) as usize] = true;
            if across % steps > 0 {
                touched[(across / steps + 1) as usize] = true;
            }
        }
        touched
    };
    let [columns, rows] = [axis(0), axis(1)];
    rows.iter().flat_map(|&y| columns.iter().map(move |&x| x && y)).collect()
}

/// Returns the numbers of valid and of labeled samples in a map. They are the step's `semantic_valid` and
/// `semantic_labeled`.
pub fn count_targets(targets: &[SemanticTarget]) -> [u32; 2] {
    let valid = targets.iter().filter(|t| t.inverse_norm > 0.0).count();
    let labeled = targets.iter().filter(|t| t.label != super::NO_LABEL).count();
    [valid as u32, labeled as u32]
}
