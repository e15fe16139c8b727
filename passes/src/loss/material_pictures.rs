//! `material_pictures`, `material_pictures_bwd`: shaded materials as pictures that priors and other views can be compared
//! with, and the way back.
//!
//! Albedo is linear where light is; priors, and everything that people look at, are in sRGB (IEC 61966-2-1), cut off at black
//! and white. Roughness is shown as three equal channels, so that what compares colors compares roughness too.
//!
//! Promises: every pixel of the view is written, nothing behind them is touched; pixels whose coverage is below 1e-3 are
//! black and get no gradient, nor does a channel that was cut off or is not finite. Each pixel belongs to one invocation.
//! Leaves to others what the gradients of the pictures are: a pixel of theirs must have been written.
//!
//! Cost a pixel: 20 bytes read, 24 written (12 without roughness), 3 powers; backward 44 and 16 bytes read, 16 written.

use crate::Tuning;
use crate::kernel::{groups, stage};
use sgs_engine::graph::{Buffer, Graph, GraphError};
use sgs_shaders::{material_pictures as forward, material_pictures_bwd as backward};

/// Materials of a view.
#[derive(Clone, Copy, Debug)]
pub struct Materials {
    /// Uniform `Step`: size of the view.
    pub step: Buffer,
    /// `[P * 4]` floats: albedo (linear), roughness.
    pub materials: Buffer,
    /// `[P]` floats: blended opacity.
    pub coverage: Buffer,
    /// Columns and rows that no view exceeds, each for itself.
    pub largest: [u32; 2],
}

/// Pictures of materials, or their gradients.
#[derive(Clone, Copy, Debug)]
pub struct MaterialPictures {
    /// `[P * 3]` floats: albedo in sRGB.
    pub albedo: Buffer,
    /// `[P * 3]` floats: roughness, three equal channels; of its gradient, the sum of three counts.
    pub roughness: Option<Buffer>,
}

impl Materials {
    fn pixels(&self) -> u64 {
        u64::from(self.largest[0]) * u64::from(self.largest[1])
    }
}

/// Declares room for pictures of the largest view, or for their gradients.
pub fn pictures(g: &mut Graph, name: &str, largest: [u32; 2], roughness: bool) -> MaterialPictures {
    let bytes = 12 * u64::from(largest[0]) * u64::from(largest[1]);
    let albedo = g.transient(format!("{name}.albedo"), bytes);
    MaterialPictures { albedo, roughness: roughness.then(|| g.transient(format!("{name}.roughness"), bytes)) }
}

/// Adds the pass that writes `into`.
///
/// # Errors
/// If a buffer does not belong to the graph or is too small to be bound.
pub fn material_pictures(
    g: &mut Graph,
    tuning: Tuning,
    a: &Materials,
    into: &MaterialPictures,
) -> Result<(), GraphError> {
    // What is absent is bound to something that the specialized kernel never touches.
    let roughness = into.roughness.unwrap_or_else(|| g.transient("material_pictures.unused", 12));
    let bindings = forward::Bindings {
        params: a.step.into(),
        materials: a.materials.into(),
        coverage: a.coverage.into(),
        albedo_srgb: into.albedo.into(),
        roughness_gray: roughness.into(),
    };
    let specs = forward::Specs { workgroup: tuning.workgroup, roughness: into.roughness.is_some() };
    stage(g, "material_pictures", &forward::KERNEL, bindings.entries(), specs.entries(), &[])
        .dispatch(groups(a.pixels(), tuning.workgroup))
}

/// Adds the pass that adds what `gradients` come to to `materials_gradient` (`[P * 4]` floats).
///
/// # Errors
/// If a buffer does not belong to the graph or is too small to be bound.
pub fn material_pictures_bwd(
    g: &mut Graph,
    tuning: Tuning,
    a: &Materials,
    gradients: &MaterialPictures,
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
    stage(g, "material_pictures_bwd", &backward::KERNEL, bindings.entries(), specs.entries(), &[])
        .dispatch(groups(a.pixels(), tuning.workgroup))
}
