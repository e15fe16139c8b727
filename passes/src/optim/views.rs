//! `view_place`, `view_gain`, `camera_bwd`, `view_step`: cameras and colors of views that training corrects.
//!
//! The camera of a step is placed on the device before projection, and its gradient is taken before the Gaussians change. Cost
//! per step: a uniform and 112 bytes a view, read and written. With cameras or the lens, what [`project_bwd`](crate::splat::project_bwd)
//! reads, read once more. With colors, 24 bytes read and 12 written a pixel, and an image of gradients beside the image.

use crate::Tuning;
use crate::kernel::{groups, stage};
use crate::prim::Records;
use crate::scene::{Handles, ViewHandles, ViewKinds};
use crate::splat::{EntryGradients, Screen, Visible, backward_specs};
use sgs_engine::graph::{Buffer, Graph, GraphError};
use sgs_shaders::structs::Step;
use sgs_shaders::{camera_bwd as bwd, view_gain, view_gain_bwd, view_place, view_step as kernel};

/// Gradients by what is learned of a view, in parts.
#[derive(Clone, Copy, Debug)]
pub struct ViewGradients {
    /// `[parts * 6]` by turn and shift, of workgroups of visible splats; `[parts * 10]` with the lens.
    pub cameras: Option<Buffer>,
    /// `[parts * 3]` by the logarithms of color factors, of workgroups of pixels; `[parts * 4]` with the lens.
    pub gains: Option<(Buffer, u32)>,
}

/// Returns a step with the learned camera and lens of its view. Later passes use it in place of `step`.
///
/// # Errors
/// If a buffer does not belong to the graph or is too small to be bound.
pub fn view_place(g: &mut Graph, step: Buffer, views: &ViewHandles) -> Result<Buffer, GraphError> {
    let placed = g.transient("placed_step", size_of::<Step>() as u64);
    let bindings = view_place::Bindings { params: step.into(), views: views.views.into(), placed: placed.into() };
    let specs = view_place::Specs { lens: views.kinds.lens, ..Default::default() };
    stage(g, "view_place", &view_place::KERNEL, bindings.entries(), specs.entries(), &[]).dispatch([1, 1, 1])?;
    Ok(placed)
}

/// Multiplies the colors of an image by the factors of its view, in place.
///
/// # Errors
/// If a buffer does not belong to the graph or is too small to be bound.
pub fn view_gain(
    g: &mut Graph,
    t: &Tuning,
    screen: &Screen,
    views: &ViewHandles,
    channels: u32,
    image: Buffer,
) -> Result<(), GraphError> {
    let bindings = view_gain::Bindings { params: screen.step.into(), views: views.views.into(), image: image.into() };
    let specs = view_gain::Specs { workgroup: t.workgroup, channels, lens: views.kinds.lens };
    stage(g, "view_gain", &view_gain::KERNEL, bindings.entries(), specs.entries(), &[])
        .dispatch(groups(screen.pixels(), t.workgroup))
}

/// Takes gradients back through [`view_gain()`], in place. `image` has the factors. Returns the gradients by their
/// logarithms, in parts.
///
/// # Errors
/// If a buffer does not belong to the graph or is too small to be bound.
pub fn view_gain_bwd(
    g: &mut Graph,
    t: &Tuning,
    screen: &Screen,
    views: &ViewHandles,
    channels: u32,
    image: Buffer,
    grad_image: Buffer,
) -> Result<(Buffer, u32), GraphError> {
    let count = screen.pixels().div_ceil(u64::from(t.workgroup)) as u32;
    let width = if views.kinds.lens { 16 } else { 12 };
    let parts = g.transient("gain_parts", width * u64::from(count));
    let bindings = view_gain_bwd::Bindings {
        params: screen.step.into(),
        views: views.views.into(),
        image: image.into(),
        grad_image: grad_image.into(),
        gain_parts: parts.into(),
    };
    let specs = view_gain_bwd::Specs { workgroup: t.workgroup, channels, lens: views.kinds.lens };
    stage(g, "view_gain_bwd", &view_gain_bwd::KERNEL, bindings.entries(), specs.entries(), &[])
        .subgroup_size(Some(t.subgroup_size))
        .dispatch(groups(screen.pixels(), t.workgroup))?;
    Ok((parts, count))
}

/// Result of [`camera_bwd()`].
#[derive(Clone, Copy, Debug)]
pub struct CameraParts {
    /// `[parts * 6]` by turn and shift, [`camera_part_bytes`]. With the lens, `[parts * 10]`: also by the logarithm of the
    /// focal lengths, by the shift of the principal point in focal lengths, and by radial distortion.
    pub parts: Buffer,
    /// Whether it includes the lens.
    pub lens: bool,
}

/// Computes the gradient by the pose of the camera, before the parameters change.
///
/// # Errors
/// If the graph rejects the pass.
pub fn camera_bwd(
    g: &mut Graph,
    t: &Tuning,
    screen: &Screen,
    gaussians: &Handles,
    visible: &Visible,
    entries: &EntryGradients,
    into: CameraParts,
) -> Result<(), GraphError> {
    let bindings = bwd::Bindings {
        params: screen.step.into(),
        visible: visible.work.slice,
        splat_ids: visible.ids.into(),
        entry_starts: entries.starts.into(),
        tile_counts: visible.tile_counts.into(),
        features: visible.features.into(),
        entry_gradients: entries.gradients.into(),
        entry_features: entries.features.map_or(entries.gradients, |f| f.values).into(),
        entry_flags: entries.features.map_or(visible.ids, |f| f.flags).into(),
        parameters: gaussians.parameters.into(),
        camera_parts: into.parts.into(),
    };
    // The gradient by distortion is learned with the lens.
    let t = &Tuning { distorted: t.distorted || into.lens, ..*t };
    let specs = backward_specs!(bwd, t, gaussians, visible, entries, { lens: into.lens, });
    stage(g, "camera_bwd", &bwd::KERNEL, bindings.entries(), specs.entries(), &[])
        .subgroup_size(Some(t.subgroup_size))
        .dispatch_indirect(visible.work.slice.buffer, visible.work.slice.offset)
}

/// Returns the bytes of the parts of a camera's gradient.
pub fn camera_part_bytes(t: &Tuning, visible: &Visible, lens: bool) -> u64 {
    let bytes = if lens { 40 } else { 24 };
    bytes * u64::from(visible.capacity).div_ceil(u64::from(t.workgroup)).max(1)
}

/// Status words of [`view_step()`].
#[derive(Clone, Copy, Debug)]
pub struct ViewStatus {
    /// Flag word. If it is not zero, the step changes nothing.
    pub flags: Buffer,
    /// Counter of gradients that are not finite.
    pub skipped: Buffer,
}

/// Runs Adam for the view of a step, and makes the means over all views zero. `visible` counts the splats of the step.
///
/// # Errors
/// If a buffer does not belong to the graph or is too small to be bound.
pub fn view_step(
    g: &mut Graph,
    t: &Tuning,
    step: Buffer,
    visible: Records,
    views: &ViewHandles,
    gradients: &ViewGradients,
    status: &ViewStatus,
) -> Result<(), GraphError> {
    let (gains, gain_parts) = gradients.gains.unwrap_or((status.flags, 0));
    let bindings = kernel::Bindings {
        params: step.into(),
        visible: visible.slice,
        flags: status.flags.into(),
        camera_parts: gradients.cameras.unwrap_or(status.flags).into(),
        gain_parts: gains.into(),
        views: views.views.into(),
        skipped: status.skipped.into(),
    };
    let ViewKinds { cameras, lens, .. } = views.kinds;
    let specs = kernel::Specs { cameras, gains: gradients.gains.is_some(), lens, ..Default::default() };
    let push = kernel::Push { count: views.count, per_group: t.workgroup, gain_parts };
    stage(g, "view_step", &kernel::KERNEL, bindings.entries(), specs.entries(), bytemuck::bytes_of(&push))
        .dispatch([1, 1, 1])
}
