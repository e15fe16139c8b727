//! Prepared lights that Gaussians occlude, for training and images. Kernels: `lights_train_traced`,
//! `lights_bwd_traced`, `lights_split_traced`, `lights_seen`.
//!
//! Visibility is a constant: no gradient passes through it, not even that of light positions. `lights_trace` writes a
//! byte for each pair of pixel and light, with an error of at most 1/510. The capacity ([`Traced::room`]) limits the
//! number of pixels: half a million under 64 lights. If a view fits, rays are traced once for the forward and the
//! backward pass. A larger view is processed in stretches, and the backward pass traces the rays again. Memory
//! therefore never grows with pixels times lights.
//!
//! Cost: a ray for each pair that faces, about half of them: 4.9 M at 320x240 under 64 lights, once or twice. Reading
//! the result costs a byte per pair.

use super::Traced;
use crate::Tuning;
use crate::kernel::{groups, stage};
use crate::shade::lights::backward::{OWN, cut_blocks, sum_rows};
use crate::shade::lights::forward::{lit_specs, of_lights};
use crate::shade::lights::{LightGradients, Lights, Sums};
use sgs_engine::graph::{Buffer, Graph, GraphError};
use sgs_shaders::{
    lights_bwd_traced as backward, lights_normals_bwd_traced as normals, lights_seen as mean,
    lights_split_traced as split, lights_trace as trace, lights_train_traced as train,
};

type Built<T> = Result<T, GraphError>;

/// Traced visibility of a view, stored for the backward pass.
#[derive(Clone, Copy, Debug)]
pub struct Sight {
    /// Byte per pair, light by light; only present if the whole view fits.
    pub seen: Option<Buffer>,
    /// Number of pixels between the bytes of consecutive lights.
    pub stretch: u32,
}

/// Stretch of pixels: a range of blocks of the shape's size.
#[derive(Clone, Copy, Debug)]
struct Stretch {
    /// First block, and the end of the range.
    blocks: [u32; 2],
    /// Number of pixels between the bytes of consecutive lights.
    stretch: u32,
}

/// Splits a view into stretches that fit the capacity.
fn stretches(a: &Lights, traced: &Traced) -> Vec<Stretch> {
    let block = u64::from(a.shape.block());
    let all = a.pixels.screen.pixels().div_ceil(block);
    let fit = traced.room / (u64::from(a.prepared.model.lights.max(1)) * block);
    // A stretch is a one-dimensional dispatch, limited to 65535 workgroups.
    let each = fit.clamp(1, all.clamp(1, 65535));
    let cut = |i: u64| Stretch {
        blocks: [i * each, ((i + 1) * each).min(all)].map(|b| b as u32),
        stretch: (each * block) as u32,
    };
    (0..all.div_ceil(each)).map(cut).collect()
}

/// Traces the pairs of a stretch.
fn lights_trace(g: &mut Graph, a: &Lights, traced: &Traced, s: &Stretch) -> Built<Buffer> {
    let (p, lights) = (&a.pixels, u64::from(a.prepared.model.lights.max(1)));
    let seen = g.transient("lights.seen", lights * u64::from(s.stretch));
    let bindings = trace::Bindings {
        params: p.screen.step.into(),
        prepared: a.prepared.lights.into(),
        light_list: a.prepared.list.into(),
        points: p.surfaces.points.into(),
        normals: p.surfaces.normals.into(),
        coverage: p.surfaces.coverage.into(),
        tree_nodes: traced.nodes.into(),
        tree_splats: traced.splats.into(),
        seen: seen.into(),
    };
    let specs = trace::Specs { subgroup: a.shape.subgroup, lobes: a.prepared.model.lobes };
    let (offset, clearance) = (traced.offset, traced.clearance);
    let push = trace::Push { first: s.blocks[0] * a.shape.block(), stretch: s.stretch, offset, clearance };
    stage(g, "lights_trace", &trace::KERNEL, bindings.entries(), specs.entries(), bytemuck::bytes_of(&push))
        .subgroup_size(Some(a.shape.subgroup))
        .dispatch(groups(lights * u64::from(s.stretch), a.shape.subgroup))?;
    Ok(seen)
}

/// Returns the visibility of a stretch, traced unless `before` has it.
fn found(g: &mut Graph, a: &Lights, traced: &Traced, s: &Stretch, before: Option<Buffer>) -> Built<Buffer> {
    before.map_or_else(|| lights_trace(g, a, traced, s), Ok)
}

/// Computes [`crate::shade::lights::lights_train`] with traced visibility.
///
/// # Errors
/// If a buffer does not belong to the graph or is too small to be bound.
pub fn lights_train_traced(g: &mut Graph, a: &Lights, traced: &Traced, direct: Buffer) -> Built<(Sums, Sight)> {
    let p = &a.pixels;
    let sums = g.transient("lights.sums", p.screen.pixels() * if p.materials.metallic.is_some() { 48 } else { 24 });
    let all = stretches(a, traced);
    let mut sight = Sight { seen: None, stretch: all[0].stretch };
    for s in &all {
        let seen = lights_trace(g, a, traced, s)?;
        sight.seen = (all.len() == 1).then_some(seen);
        let bindings = of_lights!(train, a, {
            seen: seen.into(),
            direct: direct.into(),
            sums: sums.into(),
        });
        let specs = train::Specs {
            subgroup: a.shape.subgroup,
            lobes: a.prepared.model.lobes,
            metallic: p.materials.metallic.is_some(),
            per_lane: a.shape.per_lane,
            spread: a.shape.spread,
            stretch: s.stretch,
        };
        let push = train::Push { normalizer: a.normalizer, block: s.blocks[0] };
        let bytes = bytemuck::bytes_of(&push);
        stage(g, "lights_train_traced", &train::KERNEL, bindings.entries(), specs.entries(), bytes)
            .subgroup_size(Some(a.shape.subgroup))
            .dispatch([s.blocks[1] - s.blocks[0], 1, 1])?;
    }
    Ok((Sums { buffer: sums }, sight))
}

/// Computes [`crate::shade::lights::lights_split`] with traced visibility. Also writes `visibility`, `[P]`, the mean
/// over the lights that are on.
///
/// # Errors
/// If a buffer does not belong to the graph or is too small to be bound.
pub fn lights_split_traced(
    g: &mut Graph,
    t: Tuning,
    a: &Lights,
    traced: &Traced,
    [direct, diffuse]: [Buffer; 2],
    visibility: Buffer,
) -> Built<()> {
    let p = &a.pixels;
    for s in &stretches(a, traced) {
        let seen = lights_trace(g, a, traced, s)?;
        let bindings = of_lights!(split, a, {
            seen: seen.into(),
            direct: direct.into(),
            diffuse: diffuse.into(),
        });
        let specs = split::Specs {
            subgroup: a.shape.subgroup,
            lobes: a.prepared.model.lobes,
            metallic: p.materials.metallic.is_some(),
            per_lane: a.shape.per_lane,
            spread: a.shape.spread,
            stretch: s.stretch,
        };
        let push = split::Push { normalizer: a.normalizer, block: s.blocks[0] };
        let bytes = bytemuck::bytes_of(&push);
        stage(g, "lights_split_traced", &split::KERNEL, bindings.entries(), specs.entries(), bytes)
            .subgroup_size(Some(a.shape.subgroup))
            .dispatch([s.blocks[1] - s.blocks[0], 1, 1])?;
        lights_seen(g, t, a, (seen, s.blocks[0] * a.shape.block(), s.stretch), visibility)?;
    }
    Ok(())
}

/// Writes the mean visibility of a stretch's pixels over the lights that are on. Takes the bytes of [`Sight`], the
/// first pixel and the number of pixels.
fn lights_seen(
    g: &mut Graph,
    t: Tuning,
    a: &Lights,
    (seen, first, stretch): (Buffer, u32, u32),
    visibility: Buffer,
) -> Built<()> {
    let bindings = mean::Bindings {
        params: a.pixels.screen.step.into(),
        light_list: a.prepared.list.into(),
        seen: seen.into(),
        visibility: visibility.into(),
    };
    let specs = mean::Specs { workgroup: t.workgroup };
    let push = mean::Push { first, stretch };
    stage(g, "lights_seen", &mean::KERNEL, bindings.entries(), specs.entries(), bytemuck::bytes_of(&push))
        .dispatch(groups(stretch.into(), t.workgroup))
}

/// Computes [`crate::shade::lights::lights_bwd`] with traced visibility. `sight` is that of the forward pass of the
/// same step.
///
/// # Errors
/// If a buffer does not belong to the graph or is too small to be bound.
pub fn lights_bwd_traced(
    g: &mut Graph,
    t: Tuning,
    a: &Lights,
    traced: &Traced,
    sight: &Sight,
    radiance_gradient: Buffer,
) -> Built<LightGradients> {
    let (model, shape) = (a.prepared.model, a.shape);
    let width = model.lights * 8 * (1 + model.lobes);
    let all = stretches(a, traced);
    let blocks = all[0].blocks[1];
    let (each, _) = cut_blocks(t, &shape, &a.prepared, blocks, 0);
    let of = |s: &Stretch| (s.blocks[1] - s.blocks[0]).div_ceil(each);
    let rows: u32 = all.iter().map(of).sum();
    let partials = g.transient("lights_bwd.partials", 4 * u64::from(width) * u64::from(rows));
    g.fill("lights_bwd.clear", partials, 0)?;
    let mut row = 0;
    for s in &all {
        let seen = found(g, a, traced, s, sight.seen)?;
        let bindings = of_lights!(backward, a, {
            seen: seen.into(),
            radiance_gradient: radiance_gradient.into(),
            partials: partials.into(),
        });
        let specs = lit_specs!(backward, a, shape, {
            lights: model.lights,
            mine: shape.spread && shape.subgroup == 8 && model.lights * (1 + model.lobes) <= OWN,
            stretch: s.stretch,
        });
        let push = backward::Push { normalizer: a.normalizer, blocks: each, block: s.blocks[0], end: s.blocks[1], row };
        let bytes = bytemuck::bytes_of(&push);
        stage(g, "lights_bwd_traced", &backward::KERNEL, bindings.entries(), specs.entries(), bytes)
            .subgroup_size(Some(shape.subgroup))
            .dispatch([of(s), 1, 1])?;
        row += of(s);
    }
    sum_rows(g, t, partials, width, rows)
}

/// Computes [`crate::shade::lights::lights_normals_bwd`] with traced visibility. Visibility is held constant. `sight`
/// is that of the forward pass of the same step.
///
/// # Errors
/// If a buffer does not belong to the graph or is too small to be bound.
pub fn lights_normals_bwd_traced(
    g: &mut Graph,
    a: &Lights,
    traced: &Traced,
    sight: &Sight,
    radiance_gradient: Buffer,
    normals_gradient: Buffer,
) -> Built<()> {
    let shape = a.shape;
    for s in &stretches(a, traced) {
        let seen = found(g, a, traced, s, sight.seen)?;
        let bindings = of_lights!(normals, a, {
            seen: seen.into(),
            radiance_gradient: radiance_gradient.into(),
            normals_gradient: normals_gradient.into(),
        });
        let specs = lit_specs!(normals, a, shape, {
            stretch: s.stretch,
        });
        let push = normals::Push { normalizer: a.normalizer, block: s.blocks[0] };
        let name = "lights_normals_bwd_traced";
        stage(g, name, &normals::KERNEL, bindings.entries(), specs.entries(), bytemuck::bytes_of(&push))
            .subgroup_size(Some(shape.subgroup))
            .dispatch([s.blocks[1] - s.blocks[0], 1, 1])?;
    }
    Ok(())
}
