//! The graph of a step. The order of declarations is the order of what depends on what: everything reads parameters
//! before anything moves them.

use super::GeometryOptions;
use super::inputs::{InputHandles, SemanticHandles};
use crate::Tuning;
use crate::kernel::stage;
use crate::loss::{
    GeometryLoss, Photometric, SemanticLoss, SemanticSums, decoder_gradient, geometry_loss, loss_sum, photometric,
    photometric_bwd, photometric_bwd_in_place, semantic_loss, semantic_prepare, semantic_sum, wanted_samples,
};
use crate::optim::{AdamUnseen, Rate, adam_unseen};
use crate::pipeline::RING;
use crate::pipeline::status::StatusHandles;
use crate::scene::{AUGMENTED, EMBEDDING, Group, Handles, decoder_step};
use crate::splat::{
    Blended, Entries, EntryFeatures, FeatureAdam, FusedAdam, PixelGradients, Screen, Visible, blend, blend_bwd,
    blend_debt, blend_features, blend_features_bwd, features_bwd_adam, intersect, project, project_bwd_adam,
    wanted_words,
};
use sgs_engine::graph::{Buffer, Graph, GraphError};
use sgs_shaders::report;

type Built<T> = std::result::Result<T, GraphError>;

/// A view on its way through a step.
struct Rendering {
    screen: Screen,
    visible: Visible,
    entries: Entries,
    blended: Blended,
}

pub(super) fn build(
    g: &mut Graph,
    t: &Tuning,
    step: Buffer,
    gaussians: &Handles,
    status: &StatusHandles,
    inputs: &InputHandles,
    o: &GeometryOptions,
) -> Built<()> {
    let screen = Screen { step, largest: o.largest, tile: t.tile };
    let visible = project(g, t, &screen, gaussians, o.channels)?;
    let entries = intersect(g, t, &screen, &visible, o.entry_capacity, status.flags)?;
    let blended = Blended {
        image: g.transient("image", 4 * u64::from(o.channels.count()) * screen.pixels()),
        transmittance: g.transient("transmittance", 4 * screen.pixels()),
    };
    blend(g, t, &screen, &visible, &entries, &blended)?;
    let view = Rendering { screen, visible, entries, blended };
    let stats = g.transient("loss_stats", size_of::<sgs_shaders::structs::LossStats>() as u64);
    let gradient = appearance(g, t, &view, inputs, o, stats)?;
    let meaning = match &inputs.semantics {
        Some(s) => Some(meaning(g, t, &view, gaussians, status, s, stats)?),
        None => None,
    };
    let mut entry_gradients =
        blend_bwd(g, t, &screen, &view.visible, &view.entries, &gradient, o.backward, o.statistics)?;
    entry_gradients.features = meaning.filter(|_| o.semantic_geometry);
    let seen = o.dense_adam.then(|| g.transient("seen", 4 * u64::from(gaussians.capacity)));
    if let Some(seen) = seen {
        g.fill("clear_seen", seen, 0)?;
    }
    let adam = FusedAdam { flags: status.flags, skipped: status.skipped, statistics: o.statistics, seen, extra: None };
    project_bwd_adam(g, t, &screen, gaussians, &view.visible, &entry_gradients, &adam)?;
    if let (Some(features), Some(moments)) = (meaning, gaussians.moments) {
        let adam = FeatureAdam { step, flags: status.flags, moments: moments[Group::Semantics as usize], seen };
        features_bwd_adam(g, t, gaussians, &view.visible, &features, &adam)?;
    }
    if let Some(seen) = seen {
        unseen(g, t, step, gaussians, status, seen)?;
    }
    let bindings = report::Bindings {
        params: step.into(),
        gaussians: gaussians.work.into(),
        visible: view.visible.work.slice,
        wanted: view.entries.wanted.into(),
        flags: status.flags.into(),
        skipped: status.skipped.into(),
        losses: stats.into(),
        reports: status.reports.into(),
    };
    let specs = report::Specs { ring: RING };
    stage(g, "report", &report::KERNEL, bindings.entries(), specs.entries(), &[]).dispatch([1, 1, 1])
}

/// The losses of what is seen: colors, normals, depth.
fn appearance(
    g: &mut Graph,
    t: &Tuning,
    view: &Rendering,
    inputs: &InputHandles,
    o: &GeometryOptions,
    stats: Buffer,
) -> Built<PixelGradients> {
    let (screen, step, channels) = (&view.screen, view.screen.step, o.channels.count());
    let loss = Photometric { step, image: view.blended.image, targets: inputs.targets, channels, largest: o.largest };
    let partials = photometric(g, *t, &loss)?;
    if !o.channels.normals && !o.channels.depth {
        let gradient = photometric_bwd_in_place(g, *t, &loss, &partials)?;
        loss_sum(g, *t, step, (partials.sums, partials.count), None, stats)?;
        return Ok(gradient);
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
        largest: o.largest,
    };
    let sums = geometry_loss(g, *t, &loss, gradient.image, gradient.transmittance)?;
    loss_sum(g, *t, step, (partials.sums, partials.count), Some((sums.sums, sums.count)), stats)?;
    blend_debt(g, t, screen, channels, &view.blended, &gradient)
}

/// The losses of what features mean, and the decoder's step.
fn meaning(
    g: &mut Graph,
    t: &Tuning,
    view: &Rendering,
    gaussians: &Handles,
    status: &StatusHandles,
    s: &SemanticHandles,
    stats: Buffer,
) -> Built<EntryFeatures> {
    let (screen, step) = (&view.screen, view.screen.step);
    let width = Group::Semantics.width();
    let wanted = g.transient("wanted", 4 * wanted_words(screen.pixels()));
    wanted_samples(g, *t, screen, None, s.targets.targets, wanted)?;
    let image = g.transient("feature_image", 4 * u64::from(width) * screen.pixels());
    blend_features(g, t, screen, gaussians, &view.visible, &view.entries, wanted, image)?;
    let prepared = semantic_prepare(g, *t, &s.head)?;
    let gradient = g.transient("grad_feature_image", 4 * u64::from(width) * screen.pixels());
    let loss = SemanticLoss { step, image, channels: width, first: 0, largest: screen.largest, targets: s.targets };
    let sums: SemanticSums = semantic_loss(g, *t, &loss, &s.head, &prepared, gradient)?;
    semantic_sum(g, *t, step, Some(&sums), None, stats)?;
    let grad_decoder = g.transient("grad_decoder", 4 * (EMBEDDING * AUGMENTED) as u64);
    decoder_gradient(g, *t, &s.head, &prepared, Some(&sums), grad_decoder)?;
    decoder_step(g, *t, step, &s.decoder, grad_decoder, status.flags, status.skipped)?;
    blend_features_bwd(g, t, screen, gaussians, &view.visible, &view.entries, wanted, image, gradient)
}

/// The learning rate that a group follows.
fn rate(group: Group) -> Rate {
    match group {
        Group::Means => Rate::Means,
        Group::LogScales => Rate::Scales,
        Group::Rotations => Rate::Rotations,
        Group::OpacityLogits => Rate::Opacities,
        Group::Sh0 => Rate::Sh0,
        Group::Sh1 | Group::Sh2 | Group::Sh3 => Rate::ShRest,
        Group::Normals => Rate::Normals,
        Group::Semantics => Rate::Semantics,
    }
}

/// Dense Adam for what the view did not see.
fn unseen(
    g: &mut Graph,
    t: &Tuning,
    step: Buffer,
    gaussians: &Handles,
    status: &StatusHandles,
    seen: Buffer,
) -> Built<()> {
    let Some(moments) = gaussians.moments else { return Ok(()) };
    for group in gaussians.model.groups() {
        let rest = AdamUnseen {
            step,
            live: gaussians.work,
            flags: status.flags,
            seen,
            width: group.width(),
            rate: rate(group),
            parameters: gaussians.group(group),
            moments: moments[group as usize],
            gradients: None,
            sparse: false,
            skipped: status.skipped,
        };
        adam_unseen(g, t, &format!("adam_unseen.{}", group.name()), &rest)?;
    }
    Ok(())
}
