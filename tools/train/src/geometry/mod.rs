//! Geometry stage: steps, densification, growth.
//!
//! Guarantees: the result depends on the scene, the settings and the seed alone. It does not depend on initial buffer
//! sizes, on the times of checkpoints, or on interruptions. A step in the steady state waits only for the step two
//! before it. The host reads reports of finished steps only.

mod backward;
mod bands;
mod capacity;
pub(crate) mod checkpoint;
mod choice;
mod decision;
mod expect;
mod fit;
mod graphs;
mod grow;
mod inputs;
mod lens;
mod log;
mod poll;
mod prepare;
mod stage;
mod state;
mod thin;

use crate::correspondence::Correspondence;
use crate::data::TrainingData;
use crate::decision::Decision;
use crate::divergence::{RollBack, Watch};
use crate::error::Result;
use crate::idle::IdleLoss;
use crate::memory::Needs;
use crate::reduce::LEAST;
use crate::region_provider::FrameRendering;
use crate::schedule::Schedule;
use crate::semantics::SemanticData;
use backward::kernel_of;
pub(crate) use bands::Bands;
use capacity::{entries_of, entries_with, first_entry_capacity, next_room};
pub use expect::Sight;
pub(crate) use fit::Growth;
use fit::last_that;
use glam::DVec3;
use inputs::GeometryInputs;
pub use log::StepLog;
use sgs_config::{Backward, Settings};
use sgs_engine::exec::PassTime;
use sgs_engine::{Device, DeviceBuffer};
use sgs_passes::Tuning;
use sgs_passes::pipeline::{
    DensifyStats, DensifyStep, GeometryOptions, GeometryStep, InputSizes, Inputs, LearnedView, Masks, OpacityReset,
    PSEUDO_VIEWS, Status, Step, StepReport,
};
use sgs_passes::scene::{Decoder, Gaussians, LearnedViews, ViewKinds};
use sgs_run::{LearnedCameras, LearnedLens, LearnedViewRow, SemanticHead, splats};
use sgs_scene::{Camera, Splats, Unit};
pub use thin::{MANY_POINTS, MOST_THINNED};

/// Number of replays in flight.
const IN_FLIGHT: usize = 2;

/// Number of steps before the choice of the backward kernel. They use the pixel kernel.
const WARM: u32 = 16;

/// Progress of the stage.
#[derive(Clone, Debug)]
pub enum Progress {
    /// A step is finished.
    Step(StepReport),
    /// Gaussians were added and removed after a step.
    Densified {
        /// Step after which densification ran.
        step: u32,
        /// Counts of the densification.
        stats: DensifyStats,
    },
    /// A decision about the model was made.
    Decided(Decision),
}

/// Geometry stage of one scene.
pub struct Geometry {
    device: Device,
    tuning: Tuning,
    settings: Settings,
    schedule: Schedule,
    data: TrainingData,
    /// Semantic targets, and the decoder that gives features a meaning.
    semantics: Option<(SemanticData, Decoder)>,
    /// Pseudo-views and regions that are compared between views.
    correspondence: Option<Correspondence>,
    gaussians: Gaussians,
    /// What is learned of the training views, if anything is.
    views: Option<(LearnedViews, ViewKinds)>,
    /// Cameras of the training views as given, in the unit of this stage.
    cameras: Vec<Camera>,
    status: Status,
    /// Executor of a step. Absent only while it is rebuilt: the old memory is freed before the new memory is allocated.
    exec: Option<GeometryStep>,
    densify: Option<DensifyStep>,
    reset: Option<OpacityReset>,
    options: GeometryOptions,
    /// Limit of the number of Gaussians in densification.
    most: u32,
    needs: Needs,
    /// Last submitted step.
    submitted: u32,
    /// Last step whose report was evaluated without an overflow.
    done: u32,
    /// Last step after which densification and reset have run. An overflow may return to a step before it.
    settled: u32,
    /// Divergence detection.
    watch: Watch,
    /// Rollbacks after divergence.
    roll_backs: Vec<RollBack>,
    /// State of the search for the number of spherical-harmonics bands. None if the number is fixed.
    bands: Option<Bands>,
    /// Unit of lengths in this stage, in the scene's unit.
    unit: Unit,
    /// Decisions about the model.
    decisions: Vec<Decision>,
    /// Losses that have a weight and cannot run.
    idle: Vec<IdleLoss>,
    /// Sizes of the training data.
    inputs: InputSizes,
    /// Bytes that training may use in all. `promised`: whether the settings limit memory.
    allowed: u64,
    promised: bool,
    growth: Growth,
}

impl Geometry {
    /// Returns the number of finished steps.
    pub fn step(&self) -> u32 {
        self.done
    }

    /// Returns the names of the classes, if the scene has semantic priors.
    pub fn classes(&self) -> Option<&[String]> {
        self.semantics.as_ref().map(|(data, _)| data.text.labels.as_slice())
    }

    /// Returns the source of regions in pseudo-views, if the stage uses pseudo-views.
    pub fn masks(&self) -> Option<Masks> {
        self.correspondence.as_ref().map(Correspondence::masks)
    }

    /// Returns the ring of the steps' reports, for drivers that run no kernels.
    pub fn reports(&self) -> &DeviceBuffer {
        self.status.reports()
    }

    /// Returns the device.
    pub fn device(&self) -> &Device {
        &self.device
    }

    /// Returns the Gaussians on the device, in [`Geometry::unit`].
    pub fn gaussians(&self) -> &Gaussians {
        &self.gaussians
    }

    /// Returns the unit of lengths on the device, in the scene's unit.
    pub fn unit(&self) -> Unit {
        self.unit
    }

    /// Trains until `last` steps are finished or `go_on` returns false. Returns with no work in flight.
    ///
    /// # Errors
    /// If the device fails or training diverges.
    pub fn train(
        &mut self,
        last: u32,
        mut on_report: impl FnMut(&Progress),
        mut go_on: impl FnMut() -> bool,
    ) -> Result<()> {
        while self.done < last && go_on() {
            // Always after the same step, so that neither stops nor cached choices change the result.
            let undecided = self.settings.geometry.backward == Backward::Auto && self.submitted < last;
            if undecided && self.submitted >= WARM && self.drain(&mut on_report)? && self.done >= WARM {
                self.decide_backward()?;
            }
            if self.submitted < last {
                self.submit_next()?;
                self.poll(self.submitted.saturating_sub(IN_FLIGHT as u32), &mut on_report)?;
            }
            let due = self.schedule.densify(self.submitted).is_some() || self.schedule.reset(self.submitted);
            let due = due || self.bands_due(self.submitted);
            let due = due && self.settled < self.submitted;
            if due || self.submitted == last {
                let clean = self.drain(&mut on_report)?;
                if clean && due {
                    self.settled = self.submitted;
                    self.after(self.submitted, &mut on_report)?;
                }
            }
        }
        // Repeats until no overflow discards steps; discarded steps count as not done.
        while !self.drain(&mut on_report)? {}
        Ok(())
    }

    fn submit_next(&mut self) -> Result<()> {
        let step = self.submitted + 1;
        // The graph of a step depends on its number alone, also when the step runs again.
        let due = step >= self.settings.geometry.correspondence_from;
        let pseudo = self.correspondence.as_ref().filter(|_| due).map(Correspondence::masks);
        if pseudo != self.options.pseudo {
            self.exec()?.finish()?;
            self.options.pseudo = pseudo;
            self.rebuild()?;
        }
        let mut values = self.values(step);
        if !due || self.correspondence.is_none() {
            self.exec_of(step)?.submit(&values)?;
        } else {
            let pseudo = self.pseudo_views(&mut values)?;
            match pseudo {
                Some(pseudo) => self.exec_of(step)?.submit_views(&values, &pseudo)?,
                None => {
                    // The provider has failed and training may continue without it.
                    self.correspondence = None;
                    return self.submit_next();
                }
            };
        }
        self.submitted = step;
        Ok(())
    }

    /// Makes the uniforms of a step's pseudo-views.
    fn pseudo_views(&mut self, values: &mut Step) -> Result<Option<[Step; PSEUDO_VIEWS]>> {
        let (view, seed) = (self.view(values.step), self.settings.seed);
        let poll = FrameRendering {
            sh_degree: values.sh_degree,
            background: self.settings.geometry.background,
            largest: self.options.largest,
            entries: self.options.entry_capacity,
        };
        if self.correspondence.as_ref().is_some_and(Correspondence::polls) {
            self.exec()?.finish()?;
        }
        match &mut self.correspondence {
            Some(c) => c.steps(&self.device, &self.gaussians, &poll, seed, view, values),
            None => Ok(None),
        }
    }

    /// Makes the uniform of a step.
    fn values(&self, step: u32) -> Step {
        self.values_after(step, self.halvings(step))
    }

    /// Returns how often the photograph of a step is halved.
    fn halvings(&self, step: u32) -> u32 {
        // Regions are stored at full size.
        let compares = self.correspondence.is_some() && step >= self.settings.geometry.correspondence_from;
        let most = if compares { 0 } else { self.schedule.halvings(step).min(self.data.halvings) };
        let view = self.view(step);
        let map = self.semantics.as_ref().map_or([0, 0], |(data, _)| data.views[view].size);
        let fits = |halvings: &u32| {
            let size = self.data.reduced(view, *halvings).0.size;
            size.iter().zip(map).all(|(n, cells)| *n >= cells.max(LEAST))
        };
        (1..=most).take_while(fits).last().unwrap_or(0)
    }

    /// Makes the uniform of a step whose photograph is halved this often.
    fn values_after(&self, step: u32, halvings: u32) -> Step {
        let view = self.view(step);
        let (camera, offset) = self.data.reduced(view, halvings);
        let mut values = self.schedule.step(step, &camera, offset);
        values.view = view as u32;
        if let Some((data, _)) = &self.semantics {
            data.views[view].fill(&mut values);
        }
        values
    }

    /// Frees the executors, which can be rebuilt, because their memory is needed.
    fn forget_steps(&mut self) {
        self.densify = None;
        self.reset = None;
        self.exec = None;
    }

    fn rebuild(&mut self) -> Result<()> {
        self.forget_steps();
        let mut inputs = Inputs {
            targets: &self.data.parts[0].targets,
            normals: self.data.parts[0].normals.as_ref(),
            depths: self.data.parts[0].depths.as_ref().map(|depths| (depths, self.data.fit)),
            semantics: self.semantics.as_ref().map(|(data, decoder)| data.inputs(decoder)),
            regions: None,
            pseudo_regions: None,
            views: self.views.as_ref().map(|(views, kinds)| (views, *kinds)),
        };
        if let (Some(c), Some(_)) = (&self.correspondence, self.options.pseudo) {
            c.bind(&mut inputs);
        }
        let (device, gaussians, status) = (&self.device, &self.gaussians, &self.status);
        self.exec = Some(GeometryStep::new(device, &self.tuning, gaussians, &inputs, status, self.options)?);
        Ok(())
    }

    /// Returns the executor of the step. Rebuilds it if an earlier attempt failed.
    fn exec(&mut self) -> Result<&mut GeometryStep> {
        if self.exec.is_none() {
            self.rebuild()?;
        }
        Ok(self.exec.as_mut().expect("invariant: rebuild creates the step"))
    }

    /// Returns the executor with the photographs of a step's view.
    fn exec_of(&mut self, step: u32) -> Result<&mut GeometryStep> {
        let view = self.view(step);
        self.exec()?;
        let exec = self.exec.as_mut().expect("invariant: exec() creates the step");
        if self.data.parts.len() > 1 {
            let part = self.data.part(view);
            exec.use_photographs(&part.targets, part.normals.as_ref(), part.depths.as_ref())?;
        }
        Ok(exec)
    }

    /// Runs the work between steps: trial of bands, densification and reset of opacities.
    fn after(&mut self, step: u32, on_report: &mut impl FnMut(&Progress)) -> Result<()> {
        if self.bands_due(step) {
            self.turn_bands(step, on_report)?;
        }
        if let Some(settings) = self.schedule.densify(step) {
            self.densify(step, settings, on_report)?;
        }
        if self.schedule.reset(step) {
            if self.reset.is_none() {
                self.reset = Some(OpacityReset::new(&self.device, &self.tuning, &self.gaussians)?);
            }
            if let Some(reset) = &mut self.reset {
                reset.run()?;
            }
            self.watch.restart(step);
        }
        Ok(())
    }

    fn decide(&mut self, decision: Decision, on_report: &mut impl FnMut(&Progress)) {
        tracing::info!("{decision}");
        self.decisions.push(decision.clone());
        on_report(&Progress::Decided(decision));
    }

    /// Returns the estimated device memory of the first step.
    pub fn needs(&self) -> &Needs {
        &self.needs
    }

    /// Returns the semantic head, if the Gaussians have features.
    ///
    /// # Errors
    /// If the device fails.
    pub fn head(&self) -> Result<Option<SemanticHead>> {
        let Some((data, decoder)) = &self.semantics else { return Ok(None) };
        let temperature = self.settings.geometry.temperature;
        Ok(Some(SemanticHead { decoder: decoder.download(&self.device)?, text: data.text.clone(), temperature }))
    }

    /// Returns the settings, with the choices that training made by measurement.
    pub fn settings(&self) -> &Settings {
        &self.settings
    }

    /// Returns the current Gaussians in the scene's unit.
    ///
    /// # Errors
    /// If the device fails.
    pub fn splats(&self) -> Result<Splats> {
        let splats = splats(&self.gaussians.download(&self.device)?, self.gaussians.model);
        Ok(splats.in_unit(self.unit.inverse()))
    }

    /// Returns the learned cameras, exposures and lens, if any.
    ///
    /// Lengths are in the scene's unit.
    ///
    /// # Errors
    /// If the device fails.
    pub fn learned_views(&self) -> Result<Option<LearnedCameras>> {
        let Some((views, _)) = &self.views else { return Ok(None) };
        let row = |(view, camera): (LearnedView, &Camera)| {
            let vector = |i: usize| DVec3::from([0, 1, 2].map(|k| f64::from(view.values[i + k])));
            let camera = camera.moved(vector(0), vector(3)).in_unit(self.unit.inverse());
            LearnedViewRow::of(&camera, [6, 7, 8].map(|i| view.values[i].exp()))
        };
        let mut numbers = views.download(&self.device)?;
        let lens = numbers.pop().map_or_else(LearnedLens::default, |lens| {
            let [focal, x, y, vignetting, distortion, ..] = lens.values;
            LearnedLens {
                focal: f64::from(focal).exp(),
                center: [x, y].map(f64::from),
                vignetting,
                distortion: distortion.into(),
            }
        });
        Ok(Some(LearnedCameras { views: numbers.into_iter().zip(&self.cameras).map(row).collect(), lens }))
    }

    /// Turns per-pass timestamps on or off.
    ///
    /// # Errors
    /// If the device fails.
    pub fn set_timestamps(&mut self, on: bool) -> Result<()> {
        self.exec()?.finish()?;
        self.options.timestamps = on;
        self.rebuild()
    }

    /// Returns the times of the passes since the last call.
    pub fn take_times(&mut self) -> Vec<PassTime> {
        self.exec.as_mut().map_or_else(Vec::new, |e| e.executor().take_times())
    }

    /// Returns the executor of the step, for its plan.
    ///
    /// # Errors
    /// If the executor has to be rebuilt and memory runs out.
    pub fn executor(&mut self) -> Result<&mut sgs_engine::exec::Executor> {
        Ok(self.exec()?.executor())
    }
}
