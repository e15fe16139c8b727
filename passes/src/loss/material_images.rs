//! `material_images`, `material_images_bwd`: images of materials in the form of priors, and the backward pass.
//!
//! Albedo is linear in shading. Priors and displayed images are in sRGB (IEC 61966-2-1), clipped at black and white.
//! Roughness has three equal channels, so that losses of colors apply to it too.
//!
//! Guarantees: every pixel of the view is written, nothing after them is changed. Pixels with a coverage below 1e-3 are
//! black and get no gradient; neither does a channel that was clipped or is not finite. Each pixel belongs to one
//! invocation. The caller supplies the gradients of the images; each of their pixels must have been written.
//!
//! Cost per pixel: 20 bytes read, 24 written (12 without roughness), 3 powers; backward 44 and 16 bytes read, 16
//! written.

use crate::Tuning;
use crate::kernel::{groups, stage};
use sgs_engine::graph::{Buffer, Graph, GraphError};
use sgs_shaders::{material_images as forward, material_images_bwd as backward};

/// Materials of a view.
#[derive(Clone, Copy, Debug)]
pub struct Materials {
    /// Uniform `Step`: size of the view.
    pub step: Buffer,
    /// `[P * 4]` floats: albedo (linear), roughness.
    pub materials: Buffer,
    /// `[P]` floats: blended opacity.
    pub coverage: Buffer,
    /// Upper bounds of the width and height of all views, in pixels.
    pub largest: [u32; 2],
}

/// Images of materials, or their gradients.
#[derive(Clone, Copy, Debug)]
pub struct MaterialImages {
    /// `[P * 3]` floats: albedo in sRGB.
    pub albedo: Buffer,
    /// `[P * 3]` floats: roughness in three equal channels. The sum of the three counts in its gradient.
    pub roughness: Option<Buffer>,
}

impl Materials {
    fn pixels(&self) -> u64 {
        u64::from(self.largest[0]) * u64::from(self.largest[1])
    }
}

/// Declares buffers for images of the largest view, or for their gradients.
pub fn images(g: &mut Graph, name: &str, largest: [u32; 2], roughness: bool) -> MaterialImages {
    let bytes = 12 * u64::from(largest[0]) * u64::from(largest[1]);
    let albedo = g.transient(format!("{name}.albedo"), bytes);
    MaterialImages { albedo, roughness: roughness.then(|| g.transient(format!("{name}.roughness"), bytes)) }
}

/// Adds the pass that writes the images `into`.
///
/// # Errors
/// If a buffer does not belong to the graph or is too small to be bound.
pub fn material_images(g: &mut Graph, tuning: Tuning, a: &Materials, into: &MaterialImages) -> Result<(), GraphError> {
    // Absent outputs are bound to a buffer that the specialized kernel never writes.
    let roughness = into.roughness.unwrap_or_else(|| g.transient("material_images.unused", 12));
    let bindings = forward::Bindings {
        params: a.step.into(),
        materials: a.materials.into(),
        coverage: a.coverage.into(),
        albedo_srgb: into.albedo.into(),
        roughness_gray: roughness.into(),
    };
    let specs = forward::Specs { workgroup: tuning.workgroup, roughness: into.roughness.is_some() };
    stage(g, "material_images", &forward::KERNEL, bindings.entries(), specs.entries(), &[])
        .dispatch(groups(a.pixels(), tuning.workgroup))
}

/// Adds the pass that propagates `gradients` to the materials. Adds to `materials_gradient` (`[P * 4]` floats).
///
/// # Errors
/// If a buffer does not belong to the graph or is too small to be bound.
pub fn material_images_bwd(
    g: &mut Graph,
    tuning: Tuning,
    a: &Materials,
    gradients: &MaterialImages,
    materials_gradient: Buffer,
) -> Result<(), GraphError> {
    let bindings = backward::Bindings {
        params: a.step.into(),
        materials: a.materials.into(),
        coverage: a.coverage.into(),
        albedo_gradient: gradients.albedo.into(),
        roughness_gradient: gradients.roughness.unwrap_or(gradients.albedo).into(),
        materials_gradient: materials_gradient.into(),
    };
    let specs = backward::Specs { workgroup: tuning.workgroup, roughness: gradients.roughness.is_some() };
    stage(g, "material_images_bwd", &backward::KERNEL, bindings.entries(), specs.entries(), &[])
        .dispatch(groups(a.pixels(), tuning.workgroup))
}
