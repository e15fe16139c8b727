//! `gray_image`, `gray_image_bwd`: gray image of one value per pixel.
//!
//! Losses that compare colors use the image, for example of metallic.
//!
//! Guarantees: every pixel of the view is written, black where no surface is. Backward adds to covered pixels only.
//! Cost per pixel: 8 bytes read, 12 written; backward 20 read, 4 written.

use crate::Tuning;
use crate::kernel::{groups, stage};
use crate::splat::Screen;
use sgs_engine::graph::{Buffer, Graph, GraphError};
use sgs_shaders::{gray_image as forward, gray_image_bwd as backward};

/// Adds the pass that writes `image`, `[P * 3]`. `values` and `coverage` have shape `[P]`.
///
/// # Errors
/// If a buffer does not belong to the graph or is too small to be bound.
pub fn gray_image(
    g: &mut Graph,
    t: Tuning,
    screen: &Screen,
    values: Buffer,
    coverage: Buffer,
    image: Buffer,
) -> Result<(), GraphError> {
    let bindings = forward::Bindings {
        params: screen.step.into(),
        values: values.into(),
        coverage: coverage.into(),
        image: image.into(),
    };
    let specs = forward::Specs { workgroup: t.workgroup };
    stage(g, "gray_image", &forward::KERNEL, bindings.entries(), specs.entries(), &[])
        .dispatch(groups(screen.pixels(), t.workgroup))
}

/// Adds the pass that adds the gradient of the values to `gradient`, `[P]`. `image_gradient`: `[P * 3]`.
///
/// # Errors
/// If a buffer does not belong to the graph or is too small to be bound.
pub fn gray_image_bwd(
    g: &mut Graph,
    t: Tuning,
    screen: &Screen,
    image_gradient: Buffer,
    coverage: Buffer,
    gradient: Buffer,
) -> Result<(), GraphError> {
    let bindings = backward::Bindings {
        params: screen.step.into(),
        image_gradient: image_gradient.into(),
        coverage: coverage.into(),
        gradient: gradient.into(),
    };
    let specs = backward::Specs { workgroup: t.workgroup };
    stage(g, "gray_image_bwd", &backward::KERNEL, bindings.entries(), specs.entries(), &[])
        .dispatch(groups(screen.pixels(), t.workgroup))
}
