//! `semantic_prepare`, `semantic_loss`, `decoder_gradient`: what is asked of blended features through the decoder.
//!
//! SGS-Intrinsic, stage I. Features f, sampled from the picture at the samples of a view's target map (bilinear, first
//! and last of both on each other), are decoded to v = W f + b = A f'. With target t and the classes' texts T of length
//! one:
//! * `weight_semantic`: mean of 1 - cos(v, t) over the samples whose target is finite and not zero.
//! * `weight_semantic_class`: mean cross-entropy of the softmax over (T v / |v|) / temperature to the target's label, over
//!   the samples that have one.
//!
//! Nothing 512 wide is formed but one product of the targets with A and one of the gradient: |v|² = f'ᵀ(AᵀA)f' and T v =
//! (T A) f'. A decoded vector shorter than 1e-3 of its parts (those of every feature and the bias, as if none were
//! along another), or than 1e-8, has no direction: cosine and logits 0, no gradient. Features may have any size: they are divided by their largest first. A sample whose features are not finite
//! adds nothing and is counted.
//!
//! Promises: at wanted pixels every feature channel of the gradient is written, by a gather, without atomics, and nowhere
//! else; the same bits from run to run on a device. Leaves to the caller: adding other gradients of these channels afterwards, and Adam
//! ([`crate::scene::decoder_step`]).
//!
//! What many need is fetched by lanes together and handed round: rows of the decoder, and in `semantic_samples`, where the
//! 32 features of an item lie over the lanes, rows of the small matrices. That suits processors too, on which a number
//! from memory costs a subgroup as much as sixty multiply-adds.
//!
//! Cost, of M samples and C classes. `semantic_project`: 1024 + 144 bytes and 33 792 operations a sample, `semantic_outer`
//! the same; `semantic_samples`: 912 bytes and about 7000 + 270 C operations; `semantic_gather`: 128 bytes a sample and a
//! pixel that it touches, a bit a pixel. The memory is 272 bytes a sample and 72 KiB a run of samples, whatever the size
//! of the picture.

use crate::Tuning;
use crate::kernel::{groups, stage};
use crate::scene::{AUGMENTED, EMBEDDING, FEATURES};
use sgs_engine::graph::{Buffer, Graph, GraphError};
use sgs_shaders::structs::SemanticTarget;
use sgs_shaders::{
    decoder_gradient as gradient_kernel, semantic_gather, semantic_outer, semantic_prepare as prepare_kernel,
    semantic_project, semantic_reduce, semantic_samples, semantic_target,
};

/// Most workgroups that sum up for the decoder; each leaves (33 + C) rows of sums.
const MOST_GROUPS: u64 = 256;

/// Bytes of a row of 33 numbers, padded.
const ROW: u64 = 144;

/// Fewest rows of a part of the decoder.
const LEAST_ROWS: u64 = 16;

/// Fewest samples of a run of `semantic_outer`.
const LEAST_RUN: u32 = 64;

/// The decoder and the classes.
#[derive(Clone, Copy, Debug)]
pub struct Head {
    /// `[512 * 33]` floats: rows of 32 weights and a bias.
    pub decoder: Buffer,
    /// `[classes * 512]` floats, each row of length one ([`normalize_embeddings`]).
    pub embeddings: Buffer,
    /// How many classes, at least one.
    pub classes: u32,
}

/// What stands for the decoder in a step.
#[derive(Clone, Copy, Debug)]
pub struct Prepared {
    /// Rows of 33 numbers, padded to 36: the 33 of AᵀA, then those of T A by class.
    pub matrices: Buffer,
    /// Rows likewise, zero at first: the sums that `decoder_gradient` makes of; losses add to them.
    pub accumulated: Buffer,
    /// How many classes.
    pub classes: u32,
    /// Kernel sizes that it was made with.
    pub tuning: Tuning,
}

/// The targets of all views, one behind the other.
#[derive(Clone, Copy, Debug)]
pub struct SemanticTargets {
    /// `[samples * 256]` words of two halves.
    pub features: Buffer,
    /// `[samples]` of `SemanticTarget`, by [`semantic_targets`].
    pub targets: Buffer,
    /// Samples of the largest map.
    pub largest: u32,
}

/// What the loss of a training view works on. The view's map is the step's `semantic_size` and `semantic_offset`; the
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
    /// Columns and rows that no view exceeds, each for itself.
    pub largest: [u32; 2],
    /// What the features should become.
    pub targets: SemanticTargets,
    /// A bit a pixel: where somebody wants the gradient. Pixels that samples touch must be among them.
    pub wanted: Buffer,
}

/// What the loss leaves.
#[derive(Clone, Copy, Debug)]
pub struct SemanticSums {
    /// By workgroup: 1 - cos, cross-entropy, samples that did not count.
    pub sums: Buffer,
    /// Number of workgroups.
    pub count: u32,
    /// By run, 512 padded rows of 33: the part of the decoder's gradient that needs the targets.
    pub outer: Buffer,
    /// Number of runs.
    pub runs: u32,
}

/// Rows of 512 brought to length one; a row of zeros, or with a number that is not finite, becomes zeros.
pub fn normalize_embeddings(rows: &[f32]) -> Vec<f32> {
    let unit = |row: &[f32]| {
        let length = row.iter().map(|&x| f64::from(x).powi(2)).sum::<f64>().sqrt();
        let scale = if length > 0.0 && length.is_finite() { 1.0 / length } else { 0.0 };
        row.iter().map(|&x| if scale > 0.0 { (f64::from(x) * scale) as f32 } else { 0.0 }).collect::<Vec<f32>>()
    };
    rows.chunks(EMBEDDING).flat_map(unit).collect()
}

/// Adds the pass that works out what targets say, once: `targets`, `[samples]` of `SemanticTarget`. The label is the
/// class of the largest cosine, or the one in `given` (a word a sample; out of range means none).
///
/// # Errors
/// If a buffer does not belong to the graph or is too small to be bound.
pub fn semantic_targets(
    g: &mut Graph,
    tuning: Tuning,
    features: Buffer,
    embeddings: Buffer,
    classes: u32,
    given: Option<Buffer>,
    samples: u32,
    targets: Buffer,
) -> Result<(), GraphError> {
    let bindings = semantic_target::Bindings {
        features: features.into(),
        embeddings: embeddings.into(),
        labels: given.unwrap_or(features).into(),
        targets: targets.into(),
    };
    let specs = semantic_target::Specs { subgroup: tuning.subgroup_size, classes, has_labels: given.is_some() };
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

/// Adds the passes that make the decoder's small matrices. Once a step, before every loss that has the same head.
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

/// Rows of the sums that become the decoder's gradient.
fn count_rows(classes: u32) -> u64 {
    AUGMENTED as u64 + u64::from(classes)
}

/// Rows of 33 numbers that a lane has in registers where not much else is there.
fn rows_per_lane(tuning: Tuning) -> u32 {
    (32 / tuning.subgroup_size).max(2)
}

/// Workgroups for so many items that come in pieces of `piece`. Each may take several of them, in batches of so many
/// rounds of loops.
pub(super) fn batch_groups(tuning: Tuning, items: u64, piece: u32, rounds: u32) -> u32 {
    let batch = u64::from(tuning.subgroup_size * tuning.tiles());
    let all = items.div_ceil(batch) * u64::from(rounds);
    // What a workgroup does but once is less than a quarter.
    let enough = MOST_GROUPS.min(u64::from(tuning.workers)).max(all.div_ceil(u64::from(tuning.rounds) / 4 * 3));
    items.div_ceil(u64::from(piece)).clamp(1, enough) as u32
}

/// Into how many parts the decoder's rows are cut where so many workgroups would each go through all of them: about as
/// many as keep the device busy.
fn decoder_parts(tuning: Tuning, blocks: u64) -> u32 {
    let parts = u64::from(tuning.workers).div_ceil(blocks.max(1)).next_power_of_two();
    parts.min(EMBEDDING as u64 / LEAST_ROWS) as u32
}

/// Sums of `groups` workgroups.
pub(super) fn partials(g: &mut Graph, name: &str, classes: u32, groups: u32) -> Buffer {
    g.transient(format!("{name}.partials"), u64::from(groups) * count_rows(classes) * ROW)
}

/// Adds the workgroups' sums to those of the step.
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

/// Adds the pass that adds up `count` runs of `width` sums: to what is in `into`, or in place of it.
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
    // What is replaced is not read.
    let pass = if add { pass.bind("accumulated", into) } else { pass.bind_discard("accumulated", into) };
    pass.dispatch(groups(width, tuning.workgroup / sharing))
}

/// Adds the loss of a training view: writes the feature channels of `grad_image` at the wanted pixels, and adds to
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

/// The gradient of sampled features, back to pixels.
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
    // Many lanes have the pixels of several side by side; few have more to do in each.
    let across = if tuning.narrow() { 1 } else { 8 };
    let specs = semantic_gather::Specs { subgroup, channels: a.channels, first: a.first, across };
    let blocks = (u64::from(a.largest[0]) * u64::from(a.largest[1])).div_ceil(u64::from(32 * subgroup)).max(1);
    stage(g, "semantic_gather", &semantic_gather::KERNEL, bindings.entries(), specs.entries(), &[])
        .subgroup_size(Some(subgroup))
        .dispatch([blocks.min(1 << 15) as u32, 1, 1])
}

/// The sums over samples of t (s f')ᵀ, by runs of samples; how many runs.
fn outer(g: &mut Graph, tuning: Tuning, a: &SemanticLoss, rows: Buffer) -> Result<(Buffer, u32), GraphError> {
    // Rows of a lane are pairs; see rows_per_lane().
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

/// Adds the pass that writes `gradient`, `[512 * 33]` floats, from what all losses left. `sums`: of the training view, if
/// it has targets.
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

/// The pixels of a picture of that size that the samples of a map touch, row by row.
pub fn sampled_pixels(size: [u32; 2], map: [u32; 2]) -> Vec<bool> {
    // As in semantic.glsl: first and last pixel and sample coincide.
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

/// How many of a map's samples say something, and how many have a class: the step's `semantic_valid` and
/// `semantic_labeled`.
pub fn count_targets(targets: &[SemanticTarget]) -> [u32; 2] {
    let valid = targets.iter().filter(|t| t.inverse_norm > 0.0).count();
    let labeled = targets.iter().filter(|t| t.label != super::NO_LABEL).count();
    [valid as u32, labeled as u32]
}
