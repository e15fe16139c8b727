//! `transport_lights`: irradiance of receivers from physical lights of color 1, with shadows. Kernels: `transport_lights`
//! (surfels and patches), `transport_lights_pixels` (views).
//!
//! Irradiance is linear in the color, so that dimmed and recolored lights need no new rays. The unoccluded irradiance is
//! exact: closed forms that clip lights at the receiver's horizon. Shadow rays to fixed sample points estimate the visible
//! share, weighted by the geometric term. Receivers without occluders therefore have no noise. The set of points is
//! shifted by a hash of receiver and light, so that banding becomes noise. A receiver in the dark traces no ray.
//!
//! Directional light arrives only along rays that leave the room through an opening ([`super::Outside`]). The sample points of
//! a window carry the radiance of the environment, so that a map that is not constant leaves noise without occluders, too.
//!
//! Guarantees: results are bit-identical from run to run. Points, spots and lobes nearer than about 0.03 count as if they
//! were at that distance. Inside of a sphere, the whole hemisphere is bright. Values that are not finite give 0.
//!
//! Cost of a pair of receiver and light: 32 bytes (28 of a pixel) and 4 written. About 60 operations for the closed forms of
//! points, 200 of rectangles and disks. Half of the pairs face each other; each traces one ray, or [`ShadowRays::samples`]
//! if the light has an extent. A ray of directional light tests each opening: 64 bytes and 40 operations. A window costs as much
//! as three rectangles, and 60 operations per sample for its radiance. The map is read once: 12 bytes per texel.

use super::{AreaLights, OutsideHandles, SurfelHandles};
use crate::Tuning;
use crate::kernel::{groups, stage};
use crate::shade::Surfaces;
use crate::splat::Screen;
use sgs_engine::graph::{Buffer, Graph, GraphError};
use sgs_shaders::{transport_lights as surfels, transport_lights_pixels as pixels};

/// Maximum number of sample points of a light.
pub const LIGHT_SAMPLES: u32 = 16;

/// Receivers of light.
#[derive(Clone, Copy, Debug)]
pub enum LightReceivers {
    /// Surfels, then patches: point, radius, unit normal, 0; `[count * 8]` floats.
    Surfels {
        /// Buffer of the receivers.
        receivers: Buffer,
        /// Number of receivers.
        count: u32,
    },
    /// Pixels of a view. Pixels without a surface get 0; pixels outside of the view are not written.
    Pixels {
        /// Size of the view.
        screen: Screen,
        /// Points, normals and coverage.
        surfaces: Surfaces,
    },
}

impl LightReceivers {
    /// Returns the number of receivers: from one light's irradiance to the next one's.
    pub fn count(&self) -> u32 {
        match self {
            LightReceivers::Surfels { count, .. } => *count,
            LightReceivers::Pixels { screen, .. } => screen.pixels() as u32,
        }
    }
}

/// Occluders and options of shadow rays.
#[derive(Clone, Copy, Debug)]
pub struct ShadowRays {
    /// Occluders.
    pub tree: SurfelHandles,
    /// Openings for directional light, and the environment that windows show.
    pub outside: OutsideHandles,
    /// Distance above the surface at which rays start.
    ///
    /// Openings reach past their edges by the same distance.
    pub offset: f32,
    /// Distance before the light, or the opening, at which rays end. Its fixture therefore does not occlude it.
    pub clearance: f32,
    /// Sample points of a light with an extent. Rounded up to a power of two, at most [`LIGHT_SAMPLES`].
    pub samples: u32,
    /// Seed of the sample points.
    pub seed: u32,
}

/// Writes `unit`: irradiance of color 1 of receiver i from light l at `[l * receivers + i]`, floats.
///
/// With `list` (its length, then the indices of lights, each once) only those lights are updated; the others keep their
/// values.
///
/// # Errors
/// If a buffer does not belong to the graph or is too small to be bound.
pub fn transport_lights(
    g: &mut Graph,
    t: Tuning,
    receivers: &LightReceivers,
    lights: &AreaLights,
    rays: &ShadowRays,
    list: Option<Buffer>,
    unit: Buffer,
) -> Result<(), GraphError> {
    if lights.count == 0 || receivers.count() == 0 {
        return Ok(());
    }
    let workgroup = t.workgroup.min(64);
    let (samples, listed) = (rays.samples.clamp(1, LIGHT_SAMPLES).next_power_of_two(), list.is_some());
    let light_list = list.unwrap_or(lights.records);
    let each = receivers.count().div_ceil(workgroup);
    let (count, all) = (lights.count, groups(u64::from(each) * u64::from(lights.count), 1));
    let SurfelHandles { nodes, discs } = rays.tree;
    let OutsideHandles { openings, sky, shape } = rays.outside;
    match receivers {
        LightReceivers::Surfels { receivers, count: n } => {
            let bindings = surfels::Bindings {
                surfel_nodes: nodes.into(),
                surfel_discs: discs.into(),
                receivers: (*receivers).into(),
                light_records: lights.records.into(),
                light_list: light_list.into(),
                unit: unit.into(),
                openings: openings.into(),
                sky: sky.into(),
            };
            let specs = surfels::Specs { workgroup, samples, listed };
            let push = surfels::Push {
                groups: each,
                lights: count,
                receivers: *n,
                seed: rays.seed,
                offset: rays.offset,
                clearance: rays.clearance,
                openings: shape.openings,
                sky_columns: shape.sky[0],
                sky_rows: shape.sky[1],
            };
            let bytes = bytemuck::bytes_of(&push);
            stage(g, "transport_lights", &surfels::KERNEL, bindings.entries(), specs.entries(), bytes).dispatch(all)
        }
        LightReceivers::Pixels { screen, surfaces } => {
            let bindings = pixels::Bindings {
                surfel_nodes: nodes.into(),
                surfel_discs: discs.into(),
                params: screen.step.into(),
                points: surfaces.points.into(),
                normals: surfaces.normals.into(),
                coverage: surfaces.coverage.into(),
                light_records: lights.records.into(),
                light_list: light_list.into(),
                unit: unit.into(),
                openings: openings.into(),
                sky: sky.into(),
            };
            let specs = pixels::Specs { workgroup, samples, listed };
            let push = pixels::Push {
                groups: each,
                lights: count,
                receivers: screen.pixels() as u32,
                seed: rays.seed,
                offset: rays.offset,
                clearance: rays.clearance,
                openings: shape.openings,
                sky_columns: shape.sky[0],
                sky_rows: shape.sky[1],
            };
            let bytes = bytemuck::bytes_of(&push);
            let name = "transport_lights_pixels";
            stage(g, name, &pixels::KERNEL, bindings.entries(), specs.entries(), bytes).dispatch(all)
        }
    }
}
