//! Graph of a geometry step.
//!
//! The order of declarations is the order of dependencies: all reads of parameters precede their updates.

use super::inputs::{InputHandles, SemanticHandles};
use super::pseudo::{self, Pseudo};
use super::{GeometryOptions, PSEUDO_VIEWS};
use crate::Tuning;
use crate::kernel::stage;
use crate::loss::{
    DepthFit, Fit, GeometryLoss, Photometric, SemanticLoss, decoder_gradient, depth_fit, geometry_loss, loss_sum,
    photometric, photometric_bwd, photometric_bwd_in_place, semantic_loss, semantic_prepare, semantic_sum,
    wanted_samples,
};
use crate::optim::{
    Adam, AdamUnseen, CameraParts, EPSILON, Rate, ViewGradients, ViewStatus, adam as adam_pass, adam_unseen,
    adam_unseen_features, camera_bwd, camera_part_bytes, decoder_step, position_noise, view_gain, view_gain_bwd,
    view_place, view_step,
};
use crate::pipeline::RING;
use crate::pipeline::status::StatusHandles;
use crate::scene::{AUGMENTED, EMBEDDING, FEATURES, Group, Handles};
use crate::splat::{
    BackwardKernel, Blended, Buckets, Channels, Entries, EntryFeatures, ExtraGradients, FeatureAdam, FusedAdam,
    PixelGradients, Screen, Statistic, Visible, Wanted, blend_bwd, blend_debt, blend_features, blend_features_bwd,
    blend_for, features_bwd, features_bwd_adam, intersect, project, project_bwd_adam, statistic_debt, wanted_words,
};
use sgs_engine::graph::{Buffer, Graph, GraphError};
use sgs_shaders::report;

pub(super) type Built<T> = std::result::Result<T, GraphError>;

/// Bytes per pixel of a feature image.
pub(super) const FEATURE_BYTES: u64 = 4 * FEATURES as u64;

/// Rendered view within a step.
pub(super) struct Rendering {
    pub screen: Screen,
    pub visible: Visible,
    pub entries: Entries,
    pub blended: Blended,
    pub channels: Channels,
    /// Checkpoints for the backward pass of the channels, if its kernel uses them.
    pub buckets: Option<Buckets>,
}

/// Projects, sorts and blends a view, for a backward kernel.
#[expect(clippy::too_many_arguments, reason = "declares the passes of a view")]
pub(super) fn render(
    g: &mut Graph,
    t: &Tuning,
    step: Buffer,
    gaussians: &Handles,
    status: &StatusHandles,
    channels: Channels,
    o: &GeometryOptions,
    backward: BackwardKernel,
) -> Built<Rendering> {
    let screen = Screen { step, largest: o.largest, tile: t.tile };
    let visible = project(g, t, &screen, gaussians, channels)?;
    let entries = intersect(g, t, &screen, &visible, o.entry_capacity, status.flags)?;
    let blended = Blended {
        image: g.transient("image", 4 * u64::from(channels.count()) * screen.pixels()),
        transmittance: g.transient("transmittance", 4 * screen.pixels()),
    };
    let buckets = blend_for(g, t, &screen, &visible, &entries, &blended, backward)?;
    Ok(Rendering { screen, visible, entries, blended, channels, buckets })
}

/// Uniforms of a step.
#[derive(Clone, Copy, Debug)]
pub(super) struct Steps {
    /// Uniform of the training view.
    pub step: Buffer,
    /// Uniforms of the pseudo-views, if present.
    pub pseudo: Option<[Buffer; PSEUDO_VIEWS]>,
}

pub(super) fn build(
    g: &mut Graph,
    t: &Tuning,
    steps: &Steps,
    gaussians: &Handles,
    status: &StatusHandles,
    inputs: &InputHandles,
    o: &GeometryOptions,
) -> Built<()> {
    // Passes of this view use its learned camera; the uniforms of other views stay as they are.
    let step = match inputs.views.as_ref().filter(|views| views.kinds.moves_pixels()) {
        Some(views) => view_place(g, steps.step, views)?,
        None => steps.step,
    };
    let t = &Tuning { distorted: t.distorted || inputs.views.as_ref().is_some_and(|views| views.kinds.lens), ..*t };
    let view = render(g, t, step, gaussians, status, o.channels, o, o.backward)?;
    let screen = view.screen;
    let stats = g.transient("loss_stats", size_of::<sgs_shaders::structs::LossStats>() as u64);
    let (mut gradient, gains) = appearance(g, t, &view, steps.step, inputs, o, stats)?;
    gradient.buckets = view.buckets;
    let meaning = match &inputs.semantics {
        Some(s) => Some(meaning(
            g,
            t,
            &MeaningInputs { steps, view: &view, gaussians, status, inputs, semantics: s, o },
            stats,
        )?),
        None => None,
    };
    let mut entry_gradients =
        blend_bwd(g, t, &screen, &view.visible, &view.entries, &gradient, o.backward, o.statistics.is_some())?;
    entry_gradients.features = meaning.as_ref().map(|m| m.entries).filter(|_| o.semantic_geometry);
    let extra = meaning.as_ref().and_then(|m| m.pseudo.as_ref()).and_then(|p| p.extra);
    let seen =
        (o.dense_adam || extra.is_some() || o.mcmc).then(|| g.transient("seen", 4 * u64::from(gaussians.capacity)));
    if let Some(seen) = seen {
        g.fill("clear_seen", seen, 0)?;
    }
    let statistics = o.statistics.is_some();
    let adam = FusedAdam { flags: status.flags, skipped: status.skipped, statistics, seen, extra, regularize: o.mcmc };
    if let Some(views) = &inputs.views {
        let cameras = match views.kinds.moves_pixels() {
            true => {
                let lens = views.kinds.lens;
                let parts = g.transient("camera_parts", camera_part_bytes(t, &view.visible, lens));
                let into = CameraParts { parts, lens };
                camera_bwd(g, t, &screen, gaussians, &view.visible, &entry_gradients, into)?;
                Some(parts)
            }
            false => None,
        };
        let status = ViewStatus { flags: status.flags, skipped: status.skipped };
        view_step(g, t, step, view.visible.work, views, &ViewGradients { cameras, gains }, &status)?;
    }
    project_bwd_adam(g, t, &screen, gaussians, &view.visible, &entry_gradients, &adam)?;
    if let (Some(meaning), Some(moments)) = (&meaning, gaussians.moments) {
        let moments = moments.semantics;
        match &meaning.pseudo {
            None => {
                let seen = seen.filter(|_| o.dense_adam);
                let adam = FeatureAdam { step, flags: status.flags, moments, skipped: status.skipped, seen };
                features_bwd_adam(g, t, gaussians, &view.visible, &meaning.entries, &adam)?;
            }
            Some(pseudo) => {
                features_bwd(g, t, &view.visible, &meaning.entries, pseudo.grad_features)?;
                let all = Adam {
                    step,
                    live: gaussians.work,
                    flags: status.flags,
                    flag_words: 1,
                    width: Group::Semantics.width(),
                    capacity: u64::from(gaussians.capacity),
                    rate: Rate::Semantics,
                    skip_zero: !o.dense_adam,
                    epsilon: EPSILON,
                    gradients: pseudo.grad_features,
                    parameters: gaussians.semantics,
                    moments,
                    skipped: status.skipped,
                };
                adam_pass(g, *t, "adam.semantics", &all)?;
            }
        }
    }
    if let Some(seen) = seen {
        let features_done = meaning.as_ref().is_some_and(|m| m.pseudo.is_some());
        let unseen_step = UnseenStep { step, seen, extra, dense: o.dense_adam, regularize: o.mcmc, features_done };
        unseen(g, t, gaussians, status, &unseen_step)?;
    }
    if o.mcmc {
        position_noise(g, t, step, gaussians, status.flags)?;
    }
    let wanted = meaning.and_then(|m| m.pseudo).map(|p| p.wanted);
    let bindings = report::Bindings {
        params: step.into(),
        gaussians: gaussians.work.into(),
        visible: view.visible.work.slice,
        required: view.entries.wanted.into(),
        required0: wanted.map_or(view.entries.wanted, |w| w[0]).into(),
        required1: wanted.map_or(view.entries.wanted, |w| w[1]).into(),
        flags: status.flags.into(),
        skipped: status.skipped.into(),
        losses: stats.into(),
        reports: status.reports.into(),
    };
    let specs = report::Specs { ring: RING, pseudo: if wanted.is_some() { PSEUDO_VIEWS as u32 } else { 0 } };
    stage(g, "report", &report::KERNEL, bindings.entries(), specs.entries(), &[]).dispatch([1, 1, 1])
}

/// Adds the losses of appearance: colors, normals, depth. `given` is the uniform of the step without learned numbers.
fn appearance(
    g: &mut Graph,
    t: &Tuning,
    view: &Rendering,
    given: Buffer,
    inputs: &InputHandles,
    o: &GeometryOptions,
    stats: Buffer,
) -> Built<(PixelGradients, Option<(Buffer, u32)>)> {
    let (screen, step, channels) = (&view.screen, view.screen.step, o.channels.count());
    let gains = inputs.views.as_ref().filter(|views| views.kinds.gains);
    if let Some(views) = gains {
        view_gain(g, t, screen, views, channels, view.blended.image)?;
    }
    let loss = Photometric { step, image: view.blended.image, targets: inputs.targets, channels, largest: o.largest };
    let partials = photometric(g, *t, &loss)?;
    let color_alone = !o.channels.normals && !o.channels.depth;
    if color_alone && gains.is_none() {
        let mut gradient = photometric_bwd_in_place(g, *t, &loss, &partials)?;
        // Among the losses of a step, only that of features is not a color loss.
        let apart = inputs.semantics.is_some() && o.semantic_geometry;
        gradient.statistic = own_statistic(o).filter(|_| apart).map(|which| (which, gradient.debt));
        loss_sum(g, *t, step, (partials.sums, partials.count), None, stats)?;
        return Ok((gradient, None));
    }
    let gradient = Blended {
        image: g.transient("grad_image", 4 * u64::from(channels) * screen.pixels()),
        transmittance: g.transient("grad_transmittance", 4 * screen.pixels()),
    };
    photometric_bwd(g, *t, &loss, &partials, gradient.image)?;
    let loss = GeometryLoss {
        step,
        image: view.blended.image,
        channels,
        normals: o.channels.normals.then_some(3),
        depth: o.channels.depth.then_some(channels - 2),
        transmittance: view.blended.transmittance,
        targets: inputs.targets,
        priors: inputs.normals,
        depth_priors: inputs.depths.map(|d| d.0),
        depth_line: None,
        depth_lens: match (inputs.depths, &inputs.views) {
            (Some((_, Fit::Sensor)), Some(views)) if views.kinds.lens => Some(given),
            _ => None,
        },
        largest: o.largest,
    };
    let others = if color_alone {
        g.fill("clear_grad_transmittance", gradient.transmittance, 0)?;
        None
    } else {
        let depth_line = match (inputs.depths, loss.depth) {
            (Some((priors, fit)), Some(depth)) if !fit.is_metric() => {
                let shift = fit == Fit::ScaleShift;
                let GeometryLoss { image, transmittance, .. } = loss;
                Some(depth_fit(g, *t, &DepthFit { step, image, channels, depth, transmittance, priors, shift })?)
            }
            _ => None,
        };
        let loss = GeometryLoss { depth_line, ..loss };
        Some(geometry_loss(g, *t, &loss, gradient.image, gradient.transmittance)?)
    };
    loss_sum(g, *t, step, (partials.sums, partials.count), others, stats)?;
    let mut owed = blend_debt(g, t, screen, channels, &view.blended, &gradient)?;
    if let Some(which) = own_statistic(o) {
        let debt = statistic_debt(g, t, screen, channels, &view.blended, &gradient, which)?;
        owed.statistic = Some((which, debt));
    }
    // The debt is the same before and after: the factors of image and gradient cancel.
    let gains = match gains {
        Some(views) => Some(view_gain_bwd(g, t, screen, views, channels, view.blended.image, gradient.image)?),
        None => None,
    };
    Ok((owed, gains))
}

/// Returns the densification statistic, unless it covers all gradients.
fn own_statistic(o: &GeometryOptions) -> Option<Statistic> {
    o.statistics.filter(|which| *which != Statistic::Total)
}

/// Output of the feature losses.
struct Meaning {
    /// Feature gradients at the entries of the training view.
    entries: EntryFeatures,
    /// Gradients from the pseudo-views.
    pseudo: Option<Pseudo>,
}

/// Inputs of [`meaning`].
struct MeaningInputs<'a> {
    steps: &'a Steps,
    view: &'a Rendering,
    gaussians: &'a Handles,
    status: &'a StatusHandles,
    inputs: &'a InputHandles,
    semantics: &'a SemanticHandles,
    o: &'a GeometryOptions,
}

/// Adds the semantic losses and the update of the decoder.
fn meaning(g: &mut Graph, t: &Tuning, all: &MeaningInputs<'_>, stats: Buffer) -> Built<Meaning> {
    let &MeaningInputs { steps, view, gaussians, status, inputs, semantics: s, o } = all;
    let (screen, step) = (&view.screen, view.screen.step);
    let region = match steps.pseudo {
        Some(pseudo) => pseudo::Region::of(g, t, view, inputs, o, pseudo)?,
        None => None,
    };
    let wanted = g.transient("wanted", 4 * wanted_words(screen.pixels()));
    let mask = region.as_ref().map(|r| r.mask);
    wanted_samples(g, *t, screen, mask, s.targets.targets, wanted)?;
    let image = g.transient("feature_image", FEATURE_BYTES * screen.pixels());
    let dense = region.is_some() || 2 * u64::from(s.targets.largest) >= screen.pixels();
    let shown = Wanted { pixels: wanted, dense };
    blend_features(g, t, screen, gaussians, &view.visible, &view.entries, shown, image)?;
    let prepared = semantic_prepare(g, *t, &s.head)?;
    let gradient = g.transient("grad_feature_image", FEATURE_BYTES * screen.pixels());
    let channels = Group::Semantics.width();
    let loss = SemanticLoss { step, image, channels, first: 0, largest: screen.largest, targets: s.targets, wanted };
    let sums = semantic_loss(g, *t, &loss, &s.head, &prepared, gradient)?;
    let mut left = None;
    if let Some(region) = region {
        let head = (&s.head, &prepared);
        let training = pseudo::Training { view, head, image, gradient };
        let (views, losses) = region.compare(g, t, gaussians, status, &training, o)?;
        semantic_sum(g, *t, step, Some(&sums), Some((&losses.0, &losses.1)), stats)?;
        left = Some(views);
    } else {
        semantic_sum(g, *t, step, Some(&sums), None, stats)?;
    }
    let grad_decoder = g.transient("grad_decoder", 4 * (EMBEDDING * AUGMENTED) as u64);
    decoder_gradient(g, *t, &s.head, &prepared, Some(&sums), grad_decoder)?;
    decoder_step(g, *t, step, &s.decoder, grad_decoder, status.flags, status.skipped)?;
    let pseudo = match left {
        Some(views) => Some(views.gather(g, t, gaussians, o)?),
        None => None,
    };
    let (visible, entries) = (&view.visible, &view.entries);
    let entries = blend_features_bwd(g, t, screen, gaussians, visible, entries, shown, image, gradient)?;
    Ok(Meaning { entries, pseudo })
}

/// Step of Gaussians that the view does not see.
struct UnseenStep {
    step: Buffer,
    /// Words of the Gaussians that the view has updated.
    seen: Buffer,
    /// Gradients from pseudo-views.
    extra: Option<ExtraGradients>,
    /// Whether all groups are updated, also without gradients.
    dense: bool,
    /// Whether opacities and scales are regularized.
    regularize: bool,
    /// Whether semantic features are updated elsewhere.
    features_done: bool,
}

/// Adds Adam for Gaussians that the view does not see.
///
/// Updates groups with gradients from pseudo-views or regularizers; with `dense`, all groups.
fn unseen(g: &mut Graph, t: &Tuning, gaussians: &Handles, status: &StatusHandles, all: &UnseenStep) -> Built<()> {
    let &UnseenStep { step, seen, extra, dense, regularize, features_done } = all;
    let Some(moments) = gaussians.moments else { return Ok(()) };
    let rest =
        AdamUnseen { step, flags: status.flags, seen, extra, sparse: !dense, regularize, skipped: status.skipped };
    adam_unseen(g, t, gaussians, &moments, &rest)?;
    if dense && gaussians.model.semantics && !features_done {
        adam_unseen_features(g, t, gaussians, &moments, &rest)?;
    }
    Ok(())
}
