//! Graphs of the kinds of steps, built on first use, and their inputs.

use super::consistency::{Consistency, StepKind};
use super::environment_updates::EnvironmentUpdates;
use super::relit::Relit;
use super::{Intrinsic, Priors};
use crate::data::TrainingData;
use crate::error::{Result, TrainError};
use crate::regions::Regions;
use sgs_engine::DeviceBuffer;
use sgs_passes::pipeline::{COPIES, EnvironmentRefresh, IntrinsicInputs, IntrinsicStep, RelitView, ViewImages};

impl Intrinsic {
    /// Returns the kind of a step, given the scene's data.
    pub(super) fn kind(&self, step: u32) -> StepKind {
        match StepKind::of(&self.required.intrinsic, step) {
            _ if self.consistency.is_none() => StepKind::Plain,
            StepKind::Relight if !self.options.relight && !self.options.own_prior => StepKind::Plain,
            kind => kind,
        }
    }

    /// Builds the graph of a kind of step, if it does not exist.
    pub(super) fn make(&mut self, kind: StepKind) -> Result<()> {
        if self.execs[kind as usize].is_some() {
            return Ok(());
        }
        let options = kind.options(&self.options);
        let step = IntrinsicStep::new(&self.device, &self.tuning, &self.inputs(kind), &self.status, options)?;
        self.execs[kind as usize] = Some(step);
        Ok(())
    }

    /// Builds every graph that training may use, to plan or compile all of them: each kind of step, the update of the
    /// environment map, and the images for providers.
    ///
    /// # Errors
    /// If memory runs out.
    pub fn build_graphs(&mut self) -> Result<()> {
        let steps = self.required.intrinsic.steps;
        for kind in StepKind::ALL {
            if (1..=steps).any(|step| self.kind(step) == kind) {
                self.make(kind)?;
            }
        }
        let (device, tuning, inputs) = (&self.device, &self.tuning, self.inputs(StepKind::Plain));
        EnvironmentRefresh::new(device, tuning, &inputs, &self.status, &self.options)?;
        if self.options.lights.is_some() && self.consistency.is_some() {
            for shown in [Consistency::SHOWN, Relit::options(&self.bounds)] {
                RelitView::new(device, tuning, &inputs, &self.options, &shown)?;
            }
        }
        Ok(())
    }

    /// Returns the inputs that a kind of step binds, with the first part of the images.
    pub(super) fn inputs(&self, kind: StepKind) -> IntrinsicInputs<'_> {
        let regions = self.consistency.as_ref().filter(|_| kind != StepKind::Plain).map(Consistency::regions);
        IntrinsicInputs {
            parameters: &self.parameters,
            gains: Some(&self.gains),
            environment: self.environment.as_ref().map(|(e, m)| (e, m)),
            stored: self.environment_updates.as_ref().map(EnvironmentUpdates::stored),
            traced: self.traced.as_ref(),
            transport: self.room.as_ref().map(|room| &room.memory).or(self.planned_room.as_ref()),
            images: images(&self.data, &self.priors, self.relit.as_ref(), kind, 0),
            regions: regions.map(Regions::ids),
            pseudo_regions: regions.and_then(Regions::pseudo_ids),
        }
    }

    /// Drops the graphs. They are built again, for the model at that time, on next use.
    pub(super) fn forget_steps(&mut self) {
        self.execs = [None, None, None];
        self.shown = None;
    }

    /// Waits for all submitted work.
    pub(super) fn finish(&mut self) -> Result<()> {
        if let Some(updates) = &mut self.environment_updates {
            updates.finish()?;
        }
        self.execs.iter_mut().flatten().try_for_each(|e| Ok(e.finish()?))
    }
}

/// Returns the photographs of a part, and what a step compares besides them.
pub(super) fn images<'a>(
    data: &'a TrainingData,
    priors: &'a Priors,
    relit: Option<&'a Relit>,
    kind: StepKind,
    part: usize,
) -> ViewImages<'a> {
    let of = |buffers: &'a Option<Vec<DeviceBuffer>>| buffers.as_ref().and_then(|parts| parts.get(part));
    ViewImages {
        targets: &data.parts[part].targets,
        albedo: of(&priors.albedo),
        roughness: of(&priors.roughness),
        metallic: of(&priors.metallic),
        estimates: match (kind, relit) {
            (StepKind::Relight, Some(relit)) => relit.bound(part),
            _ => [None; 2 * COPIES],
        },
    }
}

pub(super) fn gone() -> TrainError {
    TrainError::Memory("There is no step any more: memory ran out when it was made.".into())
}
