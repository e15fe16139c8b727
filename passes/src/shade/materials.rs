//! `material_values`, `materials`, `materials_bwd`: Gaussians' materials at pixels.
//!
//! Roughness is 0.09 + 0.9 sigmoid(raw) as in SGS-Intrinsic. Albedo is 0.01 + 0.98 sigmoid(raw) ([`ALBEDO_RANGE`]).
//! SGS-Intrinsic uses 0.09 + 0.9, which cannot get darker than a third of white on a screen. Metallic, if enabled, is
//! sigmoid(raw). The weights of the view are constants ([`super::weights`]), so that the image is linear in the values.
//! Exact gradients are sums over the columns of the matrix, in pixel order.
//!
//! Cost: 16 bytes read and written per Gaussian and about 60 operations (four exponentials). A matrix entry costs 24
//! bytes (22 with 16-bit weights) and 8 operations forward, and the same backward. Metallic adds a quarter.

use super::{Rows, Weights};
use crate::Tuning;
use crate::kernel::{groups, stage};
use crate::splat::Screen;
use sgs_engine::graph::{Buffer, Graph, GraphError, Slice};
use sgs_shaders::{material_values, materials as kernel, materials_bwd as backward};

/// Lowest albedo, and the range above it, as in files.
pub const ALBEDO_RANGE: [f32; 2] = [0.01, 0.98];

/// Raw materials of the Gaussians, or their gradients.
#[derive(Clone, Copy, Debug)]
pub struct RawMaterials {
    /// Lowest albedo, and the range above it.
    pub albedo_range: [f32; 2],
    /// Raw albedo, `[Gaussians * 3]` floats.
    pub albedo: Buffer,
    /// Raw roughness, `[Gaussians]` floats.
    pub roughness: Buffer,
    /// Raw metallic, `[Gaussians]` floats, if enabled.
    pub metallic: Option<Buffer>,
}

/// Materials of the pixels of a view, or their gradients.
#[derive(Clone, Copy, Debug)]
pub struct PixelMaterials {
    /// Linear albedo and roughness, `[pixels * 4]` floats.
    pub materials: Buffer,
    /// Metallic, `[pixels]` floats.
    pub metallic: Option<Buffer>,
}

/// Blends the materials of a view. `values` ([`values`]) serve all views of a step.
///
/// # Errors
/// If the graph rejects a pass.
pub fn materials(
    g: &mut Graph,
    t: &Tuning,
    screen: &Screen,
    values: &PixelMaterials,
    weights: impl Into<Rows>,
    into: &PixelMaterials,
) -> Result<(), GraphError> {
    let weights = weights.into();
    let bindings = kernel::Bindings {
        params: screen.step.into(),
        row_starts: weights.row_starts.into(),
        columns: weights.columns.into(),
        weights: weights.weights.into(),
        values: values.materials.into(),
        metallic_values: values.metallic.unwrap_or(values.materials).into(),
        materials: into.materials.into(),
        metallic: or_nothing(g, into.metallic).into(),
    };
    let metallic = into.metallic.is_some();
    let specs = kernel::Specs { workgroup: t.workgroup, metallic, weight_bits: weights.bits };
    stage(g, "materials", &kernel::KERNEL, bindings.entries(), specs.entries(), &[])
        .dispatch(groups(screen.pixels(), t.workgroup))
}

/// Activates the materials of all `gaussians`. [`materials`] blends the result, which has one entry per Gaussian
/// instead of per pixel.
///
/// # Errors
/// If the graph rejects the pass.
pub fn values(g: &mut Graph, t: &Tuning, raw: &RawMaterials, gaussians: u32) -> Result<PixelMaterials, GraphError> {
    let n = u64::from(gaussians);
    let into = PixelMaterials {
        materials: g.transient("material_values", 16 * n),
        metallic: raw.metallic.map(|_| g.transient("metallic_values", 4 * n)),
    };
    let bindings = material_values::Bindings {
        albedo: raw.albedo.into(),
        roughness: raw.roughness.into(),
        metallic: raw.metallic.unwrap_or(raw.roughness).into(),
        values: into.materials.into(),
        metallic_values: or_nothing(g, into.metallic).into(),
    };
    let [albedo_low, albedo_range] = raw.albedo_range;
    let metallic = raw.metallic.is_some();
    let specs = material_values::Specs { workgroup: t.workgroup, metallic, albedo_low, albedo_range };
    stage(g, "material_values", &material_values::KERNEL, bindings.entries(), specs.entries(), &[])
        .dispatch(groups(n, t.workgroup))?;
    Ok(into)
}

/// Backward pass of [`materials`] and [`values`]. Computes the gradients of the raw materials of all `gaussians`. The
/// gradients are overwritten, or added to those of other views of the step if `add`.
///
/// # Errors
/// If the graph rejects the pass.
#[expect(clippy::too_many_arguments, reason = "declares a kernel")]
pub fn materials_bwd(
    g: &mut Graph,
    t: &Tuning,
    raw: &RawMaterials,
    weights: &Weights,
    gaussians: u32,
    gradient: &PixelMaterials,
    add: bool,
    into: &RawMaterials,
) -> Result<(), GraphError> {
    let bindings = backward::Bindings::<Slice> {
        column_starts: weights.column_starts.into(),
        rows: weights.rows.into(),
        row_weights: weights.row_weights.into(),
        materials_gradient: gradient.materials.into(),
        metallic_gradient: gradient.metallic.unwrap_or(gradient.materials).into(),
        albedo: raw.albedo.into(),
        roughness: raw.roughness.into(),
        metallic: raw.metallic.unwrap_or(raw.roughness).into(),
        grad_albedo: into.albedo.into(),
        grad_roughness: into.roughness.into(),
        grad_metallic: or_nothing(g, into.metallic).into(),
    };
    let metallic = raw.metallic.is_some();
    let [albedo_low, albedo_range] = raw.albedo_range;
    let weight_bits = weights.bits;
    let specs = backward::Specs { workgroup: t.workgroup, metallic, add, weight_bits, albedo_low, albedo_range };
    let mut pass = stage(g, "materials_bwd", &backward::KERNEL, [], specs.entries(), &[]);
    for (name, slice) in bindings.entries() {
        let nothing = name == "grad_metallic" && !metallic;
        let overwritten = nothing || !add && name.starts_with("grad_");
        pass = if overwritten { pass.bind_discard(name, slice) } else { pass.bind(name, slice) };
    }
    pass.subgroup_size(Some(t.subgroup_size)).dispatch(groups(8 * u64::from(gaussians), t.workgroup))
}

/// Returns the buffer, or a placeholder word that specialized kernels never touch. Kernels may not write the memory of
/// another binding.
fn or_nothing(g: &mut Graph, buffer: Option<Buffer>) -> Buffer {
    buffer.unwrap_or_else(|| g.transient("no_metallic", 4))
}
