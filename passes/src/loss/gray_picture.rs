//! `gray_picture`, `gray_picture_bwd`: one number a pixel, as metallic, as a picture that colors' losses compare.
//!
//! Promises: every pixel of the view is written, black where there is no surface; backward adds, to covered pixels alone.
//! Cost a pixel: 8 bytes read, 12 written; backward 20 read, 4 written.

use crate::Tuning;
use crate::kernel::{groups, stage};
use crate::splat::Screen;
use sgs_engine::graph::{Buffer, Graph, GraphError};
use sgs_shaders::{gray_picture as forward, gray_picture_bwd as backward};

/// Adds the pass that writes `picture`, `[P * 3]`, from `values` and `coverage`, `[P]` each.
///
/// # Errors
/// If a buffer does not belong to the graph or is too small to be bound.
pub fn gray_picture(
    g: &mut Graph,
    t: Tuning,
    screen: &Screen,
    values: Buffer,
    coverage: Buffer,
    picture: Buffer,
) -> Result<(), GraphError> {
    let bindings = forward::Bindings {
        params: screen.step.into(),
        values: values.into(),
        coverage: coverage.into(),
        picture: picture.into(),
    };
    let specs = forward::Specs { workgroup: t.workgroup };
    stage(g, "gray_picture", &forward::KERNEL, bindings.entries(), specs.entries(), &[])
        .dispatch(groups(screen.pixels(), t.workgroup))
}

/// Adds the pass that adds to `gradient`, `[P]`, what `picture_gradient`, `[P * 3]`, comes to.
///
/// # Errors
/// If a buffer does not belong to the graph or is too small to be bound.
pub fn gray_picture_bwd(
    g: &mut Graph,
    t: Tuning,
    screen: &Screen,
    picture_gradient: Buffer,
    coverage: Buffer,
    gradient: Buffer,
) -> Result<(), GraphError> {
    let bindings = backward::Bindings {
        params: screen.step.into(),
        picture_gradient: picture_gradient.into(),
        coverage: coverage.into(),
        gradient: gradient.into(),
    };
    let specs = backward::Specs { workgroup: t.workgroup };
    stage(g, "gray_picture_bwd", &backward::KERNEL, bindings.entries(), specs.entries(), &[])
        .dispatch(groups(screen.pixels(), t.workgroup))
}
