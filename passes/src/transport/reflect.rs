//! `transport_reflect`: radiance of surfels and patches that reaches the specular lobe of each pixel of a view.
//!
//! Rays go about the mirrored view direction. Their half vectors are visible normals of GGX (Heitz 2018) at a Hammersley set
//! that a hash of the pixel turns. A pixel smoother than [`ReflectionRays::mirror`] has one ray, others have
//! [`ReflectionRays::rays`], each weighted by G2 / G1. A ray meets the radiosity of receivers, which is the radiance that
//! leaves them; discs and patches are interpolated. The mean replaces the irradiance over pi that
//! [`super::transport_shade`] multiplies by the hemispherical albedo of the lobe. From [`ReflectionRays::fade`] to
//! [`ReflectionRays::diffuse`] it fades into that value. Rougher pixels trace no ray.
//!
//! Surfaces of emitters do not emit here: their highlights are those of [`super::transport_shade`]. A room of constant
//! radiance reflects that radiance at every roughness. Results are bit-identical from run to run. Values that are not
//! finite leave the irradiance over pi.
//!
//! Cost of a pixel: 76 bytes. A ray takes about 150 operations and two traversals, of which the second one visits only what
//! lies in the window; 80 bytes and about 200 operations per visited node, 32 bytes and 25 operations per tested disc, 12
//! bytes per disc in the window.

use super::{Enclosure, SurfelHandles};
use crate::Tuning;
use crate::kernel::{groups, stage};
use crate::shade::Pixels;
use sgs_engine::graph::{Buffer, Graph, GraphError};
use sgs_shaders::transport_reflect as kernel;

/// Surfaces that pixels reflect, and options of the rays.
#[derive(Clone, Copy, Debug)]
pub struct ReflectionRays {
    /// Tree of the surfels.
    pub tree: SurfelHandles,
    /// Box that closes the scene.
    pub enclosure: Enclosure,
    /// Number of surfels.
    pub surfels: u32,
    /// Radiosity of surfels, then patches, `[receivers * 3]` floats, as a radiance.
    pub radiosity: Buffer,
    /// Distance above the surface at which rays begin.
    pub offset: f32,
    /// Depth behind the first disc of a ray in which discs count; above 0.
    pub window: f32,
    /// Seed of the directions.
    pub seed: u32,
    /// Number of rays of a pixel that is no mirror; at least 1.
    pub rays: u32,
    /// Roughness below which a pixel has one ray, in the mirrored direction.
    pub mirror: f32,
    /// Roughness from which reflections fade.
    pub fade: f32,
    /// Roughness from which there are none; above `fade`.
    pub diffuse: f32,
}

/// Returns the bytes of a view's irradiance with reflections.
pub fn reflection_bytes(pixels: u64) -> u64 {
    32 * pixels
}

/// Writes the reflected radiance of a view's pixels.
///
/// `irradiance` is `[pixels * 8]` floats: gathered irradiance and gain by pixel, which are read, then reflected radiance and
/// the number of rays by pixel. Pixels without a surface or a normal get 0.
///
/// # Errors
/// If a buffer does not belong to the graph or is too small to be bound.
pub fn transport_reflect(
    g: &mut Graph,
    t: &Tuning,
    pixels: &Pixels,
    a: &ReflectionRays,
    irradiance: Buffer,
) -> Result<(), GraphError> {
    let bindings = kernel::Bindings {
        surfel_nodes: a.tree.nodes.into(),
        surfel_discs: a.tree.discs.into(),
        params: pixels.screen.step.into(),
        points: pixels.surfaces.points.into(),
        normals: pixels.surfaces.normals.into(),
        coverage: pixels.surfaces.coverage.into(),
        materials: pixels.materials.materials.into(),
        radiosity: a.radiosity.into(),
        irradiance: irradiance.into(),
    };
    let workgroup = t.workgroup.min(64);
    let specs = kernel::Specs { workgroup, rays: a.rays.max(1) };
    let push = kernel::Push {
        enclosure: a.enclosure.shape(),
        surfels: a.surfels,
        pixels: pixels.screen.pixels() as u32,
        seed: a.seed,
        offset: a.offset,
        window: a.window,
        mirror: a.mirror,
        fade: a.fade,
        diffuse: a.diffuse,
    };
    let bytes = bytemuck::bytes_of(&push);
    stage(g, "transport_reflect", &kernel::KERNEL, bindings.entries(), specs.entries(), bytes)
        .dispatch(groups(pixels.screen.pixels(), workgroup))
}
