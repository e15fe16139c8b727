//! What the intrinsic stage will take of the device's memory, added up before its first step.
//!
//! Promises that the sum is that of the buffers that training has, all kinds of steps that it will come to among them, plus
//! the staging memory of a checkpoint, and what looking at what could be left out takes beyond them; that is none where a first look
//! found no memory, since nothing is looked at then. Whether surfaces are kept is decided without it. Room for what views see of the geometry is measured before, on the device: how many
//! weights there are nobody can know otherwise.

use super::consistency::{Consistency, StepKind};
use crate::error::{Result, TrainError};
use crate::memory::refuse_beyond;
use crate::uniforms::uniform_bytes;
use serde::Serialize;
use sgs_engine::{Budget, Device, STAGING_BYTES};
use sgs_passes::Tuning;
use sgs_passes::pipeline::{
    EnvironmentMemory, EnvironmentRefresh, IntrinsicOptions, IntrinsicSizes, IntrinsicStatus, IntrinsicStep,
    KeptEnvironment, PSEUDO_VIEWS, RelitOptions, RelitView,
};
use sgs_passes::scene::Trainable;
use sgs_passes::shade::environment::Environment;
use sgs_passes::shade::visibility::VisibilityField;

/// Bytes of device memory by what they are for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct IntrinsicNeeds {
    /// Training photographs.
    pub photographs: u64,
    /// Priors of materials.
    pub priors: u64,
    /// What a network says of materials under other lights.
    pub estimates: u64,
    /// Regions that are compared between views.
    pub regions: u64,
    /// The Gaussians' geometry.
    pub geometry: u64,
    /// Their materials, with moments, and their normals if they are learned.
    pub materials: u64,
    /// Lights, with moments.
    pub lights: u64,
    /// The environment's texels, with moments, and its tables.
    pub environment: u64,
    /// The visibility field, with moments and gradients.
    pub visibility: u64,
    /// What training views see of the geometry, kept.
    pub surfaces: u64,
    /// The same of pseudo-views.
    pub pseudo_surfaces: u64,
    /// Transients of finding it.
    pub surface_arena: u64,
    /// Transients of moving the environment's texels, where that is not done in every step.
    pub environment_arena: u64,
    /// Transients of a step.
    pub arena: u64,
    /// Those of steps that compare albedo with pseudo-views.
    pub cross_view_arena: u64,
    /// Those of steps that compare it under other lights.
    pub relight_arena: u64,
    /// Shaded images that networks are shown, and transients of them.
    pub relit: u64,
    /// What it takes to see what could be left out, beyond staging and the transients of steps, which are given up meanwhile.
    pub looking: u64,
    /// Uniforms and reports.
    pub small: u64,
    /// Staging memory of a checkpoint.
    pub staging: u64,
}

/// What the sum is of.
pub(super) struct Sizes<'a> {
    pub inputs: IntrinsicSizes,
    pub environment: Option<&'a Environment>,
    pub options: &'a IntrinsicOptions,
    /// Under which other lights a network is shown views, if it is.
    pub relit: Option<RelitOptions>,
    /// Whether a provider of masks is shown shaded frames.
    pub asks: bool,
    /// Bytes of the Gaussians' geometry.
    pub geometry: u64,
    /// Training views whose surfaces are kept; 1 where they are worked out anew.
    pub kept: u64,
    /// Bytes of the arena that finds surfaces.
    pub surface_arena: u64,
    /// Bytes of what else that takes.
    pub surface_small: u64,
    /// Which kinds of steps there will be.
    pub kinds: [bool; StepKind::ALL.len()],
}

impl IntrinsicNeeds {
    /// Adds up.
    pub(super) fn of(device: &Device, tuning: &Tuning, s: &Sizes<'_>) -> Result<IntrinsicNeeds> {
        let o = s.options;
        let n = u64::from(o.shape.gaussians);
        let learned = |floats: u64| Trainable::bytes(floats, true);
        let mut needs = IntrinsicNeeds {
            photographs: s.inputs.targets,
            priors: [s.inputs.albedo, s.inputs.roughness, s.inputs.metallic].into_iter().flatten().sum(),
            estimates: s.inputs.estimates.into_iter().flatten().sum(),
            regions: s.inputs.regions.unwrap_or(0) + s.inputs.pseudo_regions.unwrap_or(0),
            geometry: s.geometry,
            materials: learned(3 * n)
                + learned(n)
                + if o.metallic { learned(n) } else { 0 }
                + if o.learns_normals() { learned(3 * n) } else { 0 },
            surfaces: s.kept * o.shape.bytes(),
            surface_arena: s.surface_arena,
            small: IntrinsicStatus::BYTES + s.surface_small,
            ..IntrinsicNeeds::default()
        };
        let mut largest = 24 * n;
        if let Some((model, _)) = o.lights {
            needs.lights = learned(model.position_bytes() / 4) + learned(model.lobe_bytes() / 4) + model.gain_bytes();
        }
        if let Some(e) = s.environment {
            needs.environment = learned(e.floats().into()) + EnvironmentMemory::bytes_of(e);
            largest = largest.max(8 * u64::from(e.floats()));
            if o.environment_every > 1 {
                let plan = EnvironmentRefresh::plan(tuning, e, o)?;
                needs.environment += KeptEnvironment::bytes_of(e);
                largest = largest.max(KeptEnvironment::kept_bytes_of(e));
                needs.environment_arena = plan.arena_bytes;
                needs.small += uniform_bytes(device, &plan, 1);
            }
        }
        if let Some(config) = &o.visibility {
            let bytes = VisibilityField::bytes(config, true, tuning.accuracy.table_bits);
            needs.visibility = bytes.map_err(|e| TrainError::Setting(e.to_string()))?;
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
        let frames = Some(Consistency::SHOWN).filter(|_| s.asks && compares);
        for shown in relit.iter().chain(&frames) {
            let inputs =
                IntrinsicSizes { regions: None, pseudo_regions: None, estimates: Default::default(), ..s.inputs };
            let (plan, outputs) = RelitView::plan(tuning, &inputs, s.environment, o, shown)?;
            needs.relit += plan.arena_bytes + outputs;
            needs.small += uniform_bytes(device, &plan, 1);
        }
        Ok(needs)
    }

    /// Adds what looking takes, staging with it, while no step has transients.
    pub(super) fn look(&mut self, bytes: u64) {
        self.looking = bytes.saturating_sub(self.given_up());
    }

    /// What is given up meanwhile, and taken again: transients of steps, and staging.
    pub(super) fn given_up(&self) -> u64 {
        self.arena + self.cross_view_arena + self.relight_arena + self.staging
    }

    /// Bytes of the largest arena.
    pub(super) fn largest_arena(&self) -> u64 {
        let arenas =
            [self.surface_arena, self.environment_arena, self.arena, self.cross_view_arena, self.relight_arena];
        arenas.into_iter().max().unwrap_or(0)
    }

    /// All of it.
    pub fn total(&self) -> u64 {
        self.parts().into_iter().map(|(_, bytes)| bytes).sum()
    }

    /// What for, and how many bytes.
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
            ("arena of surroundings", self.environment_arena),
            ("arena", self.arena),
            ("arena of pseudo-views", self.cross_view_arena),
            ("arena of other lights", self.relight_arena),
            ("images shown to networks", self.relit),
            ("looking at what is needed", self.looking),
            ("uniforms and reports", self.small),
            ("staging", self.staging),
        ]
    }

    /// Refuses if it does not fit.
    pub(super) fn check(&self, budget: &Budget) -> Result<()> {
        let advice = "use --scale, --views, fewer Gaussians, a smaller intrinsic.visibility.log2_table, \
                      intrinsic.lights.grid or intrinsic.environment.resolution, or a larger --memory-budget";
        refuse_beyond(budget, self.total(), &self.parts(), "The intrinsic stage", advice)
    }
}
