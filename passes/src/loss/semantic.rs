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
//! (T A) f'. A decoded vector shorter than 1e-3 of its parts (or than 1e-8) has no direction: cosine and logits 0, no
//! gradient. Features may have any size: they are divided by their largest first. A sample whose features are not finite
//! adds nothing and is counted.
//!
//! Promises: every feature channel of every pixel's gradient is written, by a gather, without atomics; the same bits from
//! run to run on a device. Leaves to the caller: adding other gradients of these channels afterwards, and Adam
//! ([`crate::scene::decoder_step`]).
//!
//! Cost, of M samples and C classes. `semantic_project`: 1024 + 132 bytes and 33 792 operations a sample, `semantic_outer`
//! the same; `semantic_samples`: 912 bytes and about 6900 + 270 C operations; `semantic_gather`: 128 bytes a sample and a
//! pixel. The memory is 260 bytes a sample, whatever the size of the picture.

use crate::Tuning;
use crate::kernel::{groups, stage};
use crate::scene::{AUGMENTED, EMBEDDING, FEATURES};
use sgs_engine::graph::{Buffer, Graph, GraphError};
use sgs_shaders::structs::SemanticTarget;
use sgs_shaders::{
    decoder_gradient as gradient_kernel, semantic_gather, semantic_outer, semantic_prepare as prepare_kernel,
    semantic_project, semantic_reduce, semantic_samples, semantic_target,
};

/// Most workgroups that sum up for the decoder; each leaves (33 + C) x 33 sums.
const MOST_GROUPS: u64 = 256;

/// Samples and pixels of a workgroup.
pub(super) const SAMPLES: u32 = 128;

/// Samples of a run of `semantic_outer`.
const SPLIT: u32 = 2048;

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
    /// `[33 * 33]`: AᵀA.
    pub gram: Buffer,
    /// `[classes * 33]`: T A.
    pub text: Buffer,
    /// `[(33 + classes) * 33]`, zero at first: the sums that `decoder_gradient` makes of; losses add to them.
    pub accumulated: Buffer,
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
}

/// What the loss leaves.
#[derive(Clone, Copy, Debug)]
pub struct SemanticSums {
    /// By workgroup: 1 - cos, cross-entropy, samples that did not count.
    pub sums: Buffer,
    /// Number of workgroups.
    pub count: u32,
    /// `[runs * 512 * 33]`: the part of the decoder's gradient that needs the targets.
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
    let specs = semantic_target::Specs { subgroup: tuning.subgroup_size, classes, given: given.is_some() };
    let push = semantic_target::Push { samples };
    let pass = stage(
        g,
        "semantic_target",
        &semantic_target::KERNEL,
        bindings.entries(),
        specs.entries(),
        bytemuck::bytes_of(&push),
    );
    pass.dispatch(groups(u64::from(samples), 1))
}

/// Adds the passes that make the decoder's small matrices. Once a step, before every loss that has the same head.
///
/// # Errors
/// If a buffer does not belong to the graph or is too small to be bound.
pub fn semantic_prepare(g: &mut Graph, tuning: Tuning, head: &Head) -> Result<Prepared, GraphError> {
    let row = 4 * AUGMENTED as u64;
    let prepared = Prepared {
        gram: g.transient("semantic.gram", AUGMENTED as u64 * row),
        text: g.transient("semantic.text", u64::from(head.classes) * row),
        accumulated: g.transient("semantic.accumulated", rows(head.classes) * row),
    };
    let bindings = prepare_kernel::Bindings {
        decoder: head.decoder.into(),
        embeddings: head.embeddings.into(),
        gram: prepared.gram.into(),
        text: prepared.text.into(),
    };
    let specs = prepare_kernel::Specs { workgroup: tuning.workgroup, classes: head.classes };
    stage(g, "semantic_prepare", &prepare_kernel::KERNEL, bindings.entries(), specs.entries(), &[])
        .dispatch(groups(rows(head.classes), 1))?;
    g.fill("semantic.clear", prepared.accumulated, 0)?;
    Ok(prepared)
}

/// Rows of the sums that become the decoder's gradient.
fn rows(classes: u32) -> u64 {
    AUGMENTED as u64 + u64::from(classes)
}

/// Workgroups for so many samples, each of which may take several rounds.
pub(super) fn sample_groups(count: u64) -> u32 {
    count.div_ceil(u64::from(SAMPLES)).clamp(1, MOST_GROUPS) as u32
}

/// Sums of `groups` workgroups, zero at first.
pub(super) fn partials(g: &mut Graph, name: &str, classes: u32, groups: u32) -> Result<Buffer, GraphError> {
    let buffer = g.transient(format!("{name}.partials"), u64::from(groups) * rows(classes) * 4 * AUGMENTED as u64);
    g.fill(format!("{name}.clear"), buffer, 0)?;
    Ok(buffer)
}

/// Adds the workgroups' sums to those of the step.
pub(super) fn reduce(
    g: &mut Graph,
    tuning: Tuning,
    name: &str,
    partials: Buffer,
    accumulated: Buffer,
    classes: u32,
    count: u32,
) -> Result<(), GraphError> {
    let width = rows(classes) * AUGMENTED as u64;
    let bindings = semantic_reduce::Bindings { partials: partials.into(), accumulated: accumulated.into() };
    let specs = semantic_reduce::Specs { workgroup: tuning.workgroup };
    let push = semantic_reduce::Push { width: width as u32, groups: count };
    let name = format!("{name}.reduce");
    stage(g, &name, &semantic_reduce::KERNEL, bindings.entries(), specs.entries(), bytemuck::bytes_of(&push))
        .dispatch(groups(width, tuning.workgroup / 8))
}

/// Adds the loss of a training view: writes the feature channels of `grad_image`, and adds to `prepared.accumulated`.
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
    let samples = u64::from(a.targets.largest);
    let products = g.transient("semantic.products", samples * 4 * AUGMENTED as u64);
    let bindings = semantic_project::Bindings {
        params: a.step.into(),
        features: a.targets.features.into(),
        decoder: head.decoder.into(),
        products: products.into(),
    };
    let specs = semantic_project::Specs { workgroup: 96 };
    stage(g, "semantic_project", &semantic_project::KERNEL, bindings.entries(), specs.entries(), &[])
        .dispatch(groups(samples, 64))?;

    let count = sample_groups(samples);
    let grad_features = g.transient("semantic.grad_features", samples * 4 * FEATURES as u64);
    let sums = g.transient("semantic.sums", u64::from(count) * 12);
    let partials = partials(g, "semantic", head.classes, count)?;
    let bindings = semantic_samples::Bindings {
        params: a.step.into(),
        image: a.image.into(),
        targets: a.targets.targets.into(),
        gram: prepared.gram.into(),
        text: prepared.text.into(),
        products: products.into(),
        grad_features: grad_features.into(),
        partials: partials.into(),
        sums: sums.into(),
    };
    let specs =
        semantic_samples::Specs { workgroup: SAMPLES, classes: head.classes, channels: a.channels, first: a.first };
    stage(g, "semantic_samples", &semantic_samples::KERNEL, bindings.entries(), specs.entries(), &[])
        .dispatch([count, 1, 1])?;
    reduce(g, tuning, "semantic", partials, prepared.accumulated, head.classes, count)?;

    let bindings = semantic_gather::Bindings {
        params: a.step.into(),
        grad_features: grad_features.into(),
        grad_image: grad_image.into(),
    };
    let specs = semantic_gather::Specs { workgroup: tuning.workgroup, channels: a.channels, first: a.first };
    let items = u64::from(a.largest[0]) * u64::from(a.largest[1]) * FEATURES as u64 / 4;
    stage(g, "semantic_gather", &semantic_gather::KERNEL, bindings.entries(), specs.entries(), &[])
        .dispatch(groups(items, tuning.workgroup))?;

    let runs = a.targets.largest.div_ceil(SPLIT).max(1);
    let outer = g.transient("semantic.outer", u64::from(runs) * 4 * (EMBEDDING * AUGMENTED) as u64);
    let bindings = semantic_outer::Bindings {
        params: a.step.into(),
        features: a.targets.features.into(),
        rows: products.into(),
        outer: outer.into(),
    };
    let specs = semantic_outer::Specs { workgroup: 96, split: SPLIT, splits: runs };
    stage(g, "semantic_outer", &semantic_outer::KERNEL, bindings.entries(), specs.entries(), &[])
        .dispatch(groups(u64::from(runs) * EMBEDDING as u64 / 64, 1))?;
    Ok(SemanticSums { sums, count, outer, runs })
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
    let specs = gradient_kernel::Specs {
        workgroup: tuning.workgroup,
        classes: head.classes,
        splits: sums.map_or(0, |s| s.runs),
    };
    stage(g, "decoder_gradient", &gradient_kernel::KERNEL, bindings.entries(), specs.entries(), &[])
        .dispatch(groups((EMBEDDING * AUGMENTED) as u64, tuning.workgroup))
}

/// How many of a map's samples say something, and how many have a class: the step's `semantic_valid` and
/// `semantic_labeled`.
pub fn count_targets(targets: &[SemanticTarget]) -> [u32; 2] {
    let valid = targets.iter().filter(|t| t.inverse_norm > 0.0).count();
    let labeled = targets.iter().filter(|t| t.label != super::NO_LABEL).count();
    [valid as u32, labeled as u32]
}
