//! Device memory that the intrinsic stage will need, summed before its first step.
//!
//! Guarantees: the sum equals the sizes of the buffers that training has, for all kinds of steps that will occur. It
//! includes the staging memory of a checkpoint, and the additional memory of automatic measurements. The latter is zero
//! if a trial before the first step found too little memory, since no measurement runs then. The decision to store
//! surfaces ignores measurements. The memory of a view's visible geometry is measured on the device beforehand, since
//! the number of blending weights cannot be predicted.

use super::consistency::{Consistency, StepKind};
use crate::error::{Requirement, Result};
use crate::memory::refuse_beyond;
use crate::uniforms::uniform_bytes;
use serde::Serialize;
use sgs_engine::{Budget, Device, STAGING_BYTES};
use sgs_passes::Tuning;
use sgs_passes::pipeline::{
    EnvironmentMemory, EnvironmentRefresh, IntrinsicOptions, IntrinsicSizes, IntrinsicStatus, IntrinsicStep,
    PSEUDO_VIEWS, RelitOptions, RelitView, StoredEnvironment,
};
use sgs_passes::scene::Trainable;
use sgs_passes::shade::environment::Environment;
use sgs_passes::shade::visibility::VisibilityField;

/// Bytes of device memory by purpose.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct IntrinsicNeeds {
    /// Training photographs.
    pub photographs: u64,
    /// Priors of materials.
    pub priors: u64,
    /// Estimates of a provider for materials under other lights.
    pub estimates: u64,
    /// Regions that are compared between views.
    pub regions: u64,
    /// Geometry of the Gaussians.
    pub geometry: u64,
    /// Materials of the Gaussians with moments, and learned normals.
    pub materials: u64,
    /// Lights, with moments.
    pub lights: u64,
    /// Texels of the environment map with moments, and its tables.
    pub environment: u64,
    /// Visibility field, with moments and gradients.
    pub visibility: u64,
    /// Stored surfaces: visible geometry of the training views.
    pub surfaces: u64,
    /// Surfaces of pseudo-views.
    pub pseudo_surfaces: u64,
    /// Transients of surface construction.
    pub surface_arena: u64,
    /// Transients of environment map updates that do not run in every step.
    pub environment_arena: u64,
    /// Transients of a plain step.
    pub arena: u64,
    /// Transients of steps that compare albedo with pseudo-views.
    pub cross_view_arena: u64,
    /// Transients of steps that compare albedo under other lights.
    pub relight_arena: u64,
    /// Shaded images for providers, and their transients.
    pub relit: u64,
    /// Additional memory of automatic measurements.
    /// Counted beyond staging and the transients of steps, which are released meanwhile.
    pub looking: u64,
    /// Uniforms and reports.
    pub small: u64,
    /// Staging memory of a checkpoint.
    pub staging: u64,
}

/// Inputs of the sum.
pub(super) struct Sizes<'a> {
    /// Inputs of a step.
    pub inputs: IntrinsicSizes,
    /// Number of buffers that photographs, priors and estimates each take.
    pub parts: u64,
    pub environment: Option<&'a Environment>,
    pub options: &'a IntrinsicOptions,
    /// Other lights under which a provider is shown views, if any.
    pub relit: Option<RelitOptions>,
    /// Whether a provider of masks is shown shaded frames.
    pub queries_masks: bool,
    /// Bytes of the Gaussians' geometry.
    pub geometry: u64,
    /// Number of training views with stored surfaces; 1 if each step recomputes them.
    pub surfaces: u64,
    /// Bytes of the arena of surface construction.
    pub surface_arena: u64,
    /// Other bytes of surface construction.
    pub surface_small: u64,
    /// Kinds of steps that will occur.
    pub kinds: [bool; StepKind::ALL.len()],
}

impl IntrinsicNeeds {
    /// Sums the memory of the stage.
    pub(super) fn of(device: &Device, tuning: &Tuning, s: &Sizes<'_>) -> Result<IntrinsicNeeds> {
        let o = s.options;
        let n = u64::from(o.shape.gaussians);
        let learned = |floats: u64| Trainable::bytes(floats, true);
        let mut needs = IntrinsicNeeds {
            photographs: s.parts * s.inputs.targets,
            priors: s.parts
                * [s.inputs.albedo, s.inputs.roughness, s.inputs.metallic].into_iter().flatten().sum::<u64>(),
            estimates: s.parts * s.inputs.estimates.into_iter().flatten().sum::<u64>(),
            regions: s.inputs.regions.unwrap_or(0) + s.inputs.pseudo_regions.unwrap_or(0),
            geometry: s.geometry,
            materials: learned(3 * n)
                + learned(n)
                + if o.metallic { learned(n) } else { 0 }
                + if o.learns_normals() { learned(3 * n) } else { 0 },
            surfaces: s.surfaces * o.shape.bytes(),
            surface_arena: s.surface_arena,
            small: IntrinsicStatus::BYTES + s.surface_small,
            ..IntrinsicNeeds::default()
        };
        let mut largest = 24 * n;
        if let Some((model, _)) = o.lights {
            needs.lights = learned(model.position_bytes() / 4) + learned(model.lobe_bytes() / 4) + model.gain_bytes();
        }
        if let Some(transport) = &o.transport {
            let shape = &transport.shape;
            needs.lights = shape.bytes() + learned(3 * u64::from(shape.lights)) + learned(18) + learned(n);
            needs.surfaces += s.surfaces * o.view_light_bytes();
        }
        if let Some(e) = s.environment {
            needs.environment = learned(e.floats().into()) + EnvironmentMemory::bytes_of(e);
            largest = largest.max(8 * u64::from(e.floats()));
            if o.environment_every > 1 {
                let plan = EnvironmentRefresh::plan(tuning, e, o)?;
                needs.environment += StoredEnvironment::bytes_of(e);
                largest = largest.max(StoredEnvironment::stored_bytes_of(e));
                needs.environment_arena = plan.arena_bytes;
                needs.small += uniform_bytes(device, &plan, 1);
            }
        }
        if let Some(config) = &o.visibility {
            let bytes = VisibilityField::bytes(config, true, tuning.accuracy.visibility_bits);
            needs.visibility =
                bytes.map_err(|e| Requirement::Size { setting: "intrinsic.visibility", reason: e.to_string() })?;
            largest = largest.max(16 * u64::from(config.entries()));
        }
        if let Some(tree) = &o.traced {
            needs.visibility = tree.sizes.iter().sum();
            largest = largest.max(tree.sizes[0]).max(tree.sizes[1]);
        }
        needs.staging = STAGING_BYTES.min(largest);
        for (kind, due) in StepKind::ALL.into_iter().zip(s.kinds) {
            if !due {
                continue;
            }
            let regions = s.inputs.regions.filter(|_| kind != StepKind::Plain);
            let estimates = if kind == StepKind::Relight { s.inputs.estimates } else { Default::default() };
            let pseudo_regions = s.inputs.pseudo_regions.filter(|_| kind != StepKind::Plain);
            let inputs = IntrinsicSizes { regions, pseudo_regions, estimates, ..s.inputs };
            let plan = IntrinsicStep::plan(tuning, &inputs, s.environment, &kind.options(o))?;
            needs.small += uniform_bytes(device, &plan, o.frames_in_flight);
            match kind {
                StepKind::Plain => needs.arena = plan.arena_bytes,
                StepKind::CrossView => {
                    needs.cross_view_arena = plan.arena_bytes;
                    needs.pseudo_surfaces = PSEUDO_VIEWS as u64 * o.shape.bytes();
                }
                StepKind::Relight => needs.relight_arena = plan.arena_bytes,
            }
        }
        let relit = s.relit.filter(|_| s.kinds[StepKind::Relight as usize]);
        let compares = s.kinds[StepKind::CrossView as usize] || s.kinds[StepKind::Relight as usize];
        let frames = Some(Consistency::SHOWN).filter(|_| s.queries_masks && compares);
        for shown in relit.iter().chain(&frames) {
            let inputs =
                IntrinsicSizes { regions: None, pseudo_regions: None, estimates: Default::default(), ..s.inputs };
            let (plan, outputs) = RelitView::plan(tuning, &inputs, s.environment, o, shown)?;
            needs.relit += plan.arena_bytes + outputs;
            needs.small += uniform_bytes(device, &plan, 1);
        }
        Ok(needs)
    }

    /// Adds the memory of a measurement, staging included.
    /// No step has transients meanwhile.
    pub(super) fn poll(&mut self, bytes: u64) {
        self.looking = bytes.saturating_sub(self.released());
    }

    /// Returns the memory released during a measurement: step transients and staging.
    pub(super) fn released(&self) -> u64 {
        self.arena + self.cross_view_arena + self.relight_arena + self.staging
    }

    /// Returns the number of bytes of the largest arena.
    pub(super) fn largest_arena(&self) -> u64 {
        let arenas =
            [self.surface_arena, self.environment_arena, self.arena, self.cross_view_arena, self.relight_arena];
        arenas.into_iter().max().unwrap_or(0)
    }

    /// Returns the total number of bytes.
    pub fn total(&self) -> u64 {
        self.parts().into_iter().map(|(_, bytes)| bytes).sum()
    }

    /// Returns all entries with names and bytes.
    pub fn parts(&self) -> [(&'static str, u64); 20] {
        [
            ("photographs", self.photographs),
            ("priors of materials", self.priors),
            ("estimates under other lights", self.estimates),
            ("regions", self.regions),
            ("geometry", self.geometry),
            ("materials", self.materials),
            ("lights", self.lights),
            ("environment", self.environment),
            ("visibility field", self.visibility),
            ("surfaces of views", self.surfaces),
            ("surfaces of pseudo-views", self.pseudo_surfaces),
            ("arena of surfaces", self.surface_arena),
            ("arena of the environment map", self.environment_arena),
            ("arena", self.arena),
            ("arena of pseudo-views", self.cross_view_arena),
            ("arena of other lights", self.relight_arena),
            ("images shown to networks", self.relit),
            ("looking at what is needed", self.looking),
            ("uniforms and reports", self.small),
            ("staging", self.staging),
        ]
    }

    /// Rejects needs that exceed the budget.
    pub(super) fn check(&self, budget: &Budget, in_room: bool) -> Result<()> {
        let (stage, advice) = match in_room {
            true => (
                "The transport stage",
                "use --scale, --views, fewer Gaussians, a smaller transport.surfels, or a larger --memory-budget",
            ),
            false => (
                "The intrinsic stage",
                "use --scale, --views, fewer Gaussians, a smaller intrinsic.visibility.log2_table, \
                 intrinsic.lights.grid or intrinsic.environment.resolution, or a larger --memory-budget",
            ),
        };
        refuse_beyond(budget, self.total(), &self.parts(), stage, advice)
    }
}
