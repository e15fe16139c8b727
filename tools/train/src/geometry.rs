//! The geometry stage: steps, densification, growth.
//!
//! Promises: the result depends on the scene, the settings and the seed alone, not on how large buffers were at first,
//! when checkpoints were written, or whether training was interrupted. A step in the steady state waits only for the
//! one two before it; the host looks at reports of steps that are done.

use crate::checkpoint::{self, State};
use crate::convert::{gaussian_data, splats};
use crate::correspondence::Correspondence;
use crate::data::{Packed, TrainingData};
use crate::error::{Result, TrainError};
use crate::head::SemanticHead;
use crate::memory::{Needs, allowed};
use crate::normals::{Prior, initial_normals};
use crate::schedule::Schedule;
use crate::semantics::{SemanticData, SemanticMaps};
use crate::settings::{Backward, Settings};
use sgs_engine::graph::exec::PassTime;
use sgs_engine::{BudgetSource, Device};
use sgs_passes::Tuning;
use sgs_passes::pipeline::{
    DensifyStats, DensifyStep, GeometryOptions, GeometryStep, InputSizes, Inputs, Masks, OpacityReset, PSEUDO_VIEWS,
    Status, Step, StepReport,
};
use sgs_passes::scene::{Decoder, Gaussians, Layout, Model};
use sgs_passes::splat::{BackwardKernel, Channels};
use sgs_scene::{Scene, Splats};
use std::path::Path;

/// Replays in flight.
const IN_FLIGHT: usize = 2;

/// Steps after which the device has seen enough to be timed.
const WARM: u32 = 16;

/// What the caller hears of while training.
#[derive(Clone, Debug)]
pub enum Progress {
    /// A step is done.
    Step(StepReport),
    /// Gaussians were added and removed after a step.
    Densified {
        /// The step.
        step: u32,
        /// What happened.
        stats: DensifyStats,
    },
}

/// The geometry stage of one scene.
pub struct Geometry {
    device: Device,
    tuning: Tuning,
    settings: Settings,
    schedule: Schedule,
    data: TrainingData,
    /// What features should mean, and what gives them a meaning.
    semantics: Option<(SemanticData, Decoder)>,
    /// What is compared between views.
    correspondence: Option<Correspondence>,
    gaussians: Gaussians,
    status: Status,
    /// Absent only while it is rebuilt: the old one's memory goes before the new one's comes.
    exec: Option<GeometryStep>,
    densify: Option<DensifyStep>,
    reset: Option<OpacityReset>,
    options: GeometryOptions,
    /// Densification never goes beyond this many.
    most: u32,
    /// Whether memory is why, and it was not said yet.
    scarce: bool,
    needs: Needs,
    /// Last step that was submitted.
    submitted: u32,
    /// Last step whose report was seen to be clean.
    done: u32,
    /// Last step after which densification and reset had their turn; an overflow may take steps back across it.
    settled: u32,
}

impl Geometry {
    /// Prepares training from the scene's points, or from given splats.
    ///
    /// # Errors
    /// If data cannot be read or memory runs out.
    pub fn new(device: &Device, scene: &Scene, settings: &Settings, start: Option<&Splats>) -> Result<Geometry> {
        settings.check()?;
        let g = &settings.geometry;
        let wants_normals = g.normals && (g.losses.normal > 0.0 || g.losses.normal_smooth > 0.0);
        let budget = settings.memory.budget;
        if budget > 0 {
            device.set_memory_budget(Some(budget));
        }
        let wants_views = g.correspondence && g.losses.correspondence > 0.0 && g.correspondence_from <= g.steps;
        let wants_semantics = g.semantics && (g.losses.semantic > 0.0 || g.losses.semantic_class > 0.0);
        let data = Packed::read(scene, wants_normals)?;
        let maps = if wants_semantics { SemanticMaps::read(scene)? } else { None };
        let inputs = InputSizes {
            targets: data.image_bytes(),
            normals: data.normal_bytes(),
            semantics: maps.as_ref().map(SemanticMaps::sizes),
            ..Default::default()
        };
        let model = Model { sh_degree: g.sh_degree, normals: inputs.normals.is_some(), semantics: maps.is_some() };
        let mut initial;
        let mut start = match start {
            Some(s) => s,
            None => {
                initial = Splats::from_points(&scene.points, g.sh_degree as usize)?;
                &initial
            }
        };
        if let (Some(priors), None) = (data.normals(), &start.normals) {
            let cameras = scene.split.train.iter().map(|&i| &scene.views[i].camera);
            let views: Vec<Prior> = cameras.zip(priors).map(|(camera, prior)| (camera, prior.as_slice())).collect();
            let normals = initial_normals(&start.means, &views);
            initial = Splats { normals: Some(normals), ..start.clone() };
            start = &initial;
        }
        let count = start.len() as u32;
        let most = most_gaussians(device, model, settings, &inputs, data.largest);
        let wanted = most.min(g.densify.max_gaussians);
        let capacity = if g.densify.enabled { room_for(count, wanted) } else { count };
        let tuning = Tuning::for_device(device.info());
        let depth = model.normals && (g.losses.depth_smooth > 0.0 || g.losses.depth_variance > 0.0);
        // Regions are carried to pseudo-views by depth.
        let depth = depth || (wants_views && maps.is_some());
        let options = GeometryOptions {
            largest: data.largest,
            entry_capacity: first_entry_capacity(g.entry_capacity, count),
            channels: Channels { normals: model.normals, depth },
            statistics: g.densify.enabled,
            dense_adam: g.dense_adam,
            backward: if g.backward == Backward::Splat { BackwardKernel::Splat } else { BackwardKernel::Pixel },
            semantic_geometry: g.semantic_geometry,
            pseudo: None,
            timestamps: false,
            frames_in_flight: IN_FLIGHT,
        };
        let layout = Layout { model, capacity: capacity.max(1), training: true, statistics: g.densify.enabled };
        let mut needs = Needs::of(device, &tuning, &layout, &inputs, &options)?;
        needs.check(&allowed(device, settings))?;
        if count > most {
            return Err(TrainError::Memory(format!(
                "The scene starts with {count} Gaussians, but at most {most} fit into the device's memory and bindings; \
                 use fewer points, a lower geometry.sh_degree, or a larger budget."
            )));
        }
        let data = data.upload(device)?;
        let semantics = match maps {
            Some(maps) => Some((maps.upload(device, scene)?, Decoder::new(device, settings.seed as u32, true)?)),
            None => None,
        };
        let correspondence = match &semantics {
            Some((data, _)) if wants_views => Correspondence::load(device, scene, data, settings, options.largest)?,
            _ => None,
        };
        if let Some(c) = &correspondence {
            needs = needs.with_views(&tuning, &layout, &inputs, &options, c)?;
            needs.check(&allowed(device, settings))?;
        }
        let gaussians = Gaussians::with(device, model, capacity, true, g.densify.enabled)?;
        gaussians.upload(device, &gaussian_data(start, model))?;
        let status = Status::new(device)?;
        let schedule = Schedule::new(settings, scene.extent(), data.views.len());
        let scarce = most < g.densify.max_gaussians;
        let mut settings = settings.clone();
        // Processors run lanes one after the other: engine-bench shows the pixel kernel ahead on them by far.
        if settings.geometry.backward == Backward::Auto && device.info().kind == "cpu" {
            settings.geometry.backward = Backward::Pixel;
        }
        let mut training = Geometry {
            device: device.clone(),
            tuning,
            settings,
            schedule,
            data,
            semantics,
            correspondence,
            gaussians,
            status,
            exec: None,
            densify: None,
            reset: None,
            options,
            most: wanted,
            scarce,
            needs,
            submitted: 0,
            done: 0,
            settled: 0,
        };
        training.rebuild()?;
        Ok(training)
    }

    /// Steps that are done.
    pub fn step(&self) -> u32 {
        self.done
    }

    /// The classes, if there are semantic priors.
    pub fn classes(&self) -> Option<&[String]> {
        self.semantics.as_ref().map(|(data, _)| data.text.labels.as_slice())
    }

    /// What says where regions are in pseudo-views, if there will be any.
    pub fn masks(&self) -> Option<Masks> {
        self.correspondence.as_ref().map(Correspondence::masks)
    }

    /// The device.
    pub fn device(&self) -> &Device {
        &self.device
    }

    /// The Gaussians on the device.
    pub fn gaussians(&self) -> &Gaussians {
        &self.gaussians
    }

    /// Trains until `last` steps are done, or `go_on` says no. Always stops with all work done.
    ///
    /// # Errors
    /// If the device fails or training diverges.
    pub fn train(
        &mut self,
        last: u32,
        mut heard: impl FnMut(&Progress),
        mut go_on: impl FnMut() -> bool,
    ) -> Result<()> {
        while self.done < last && go_on() {
            if self.settings.geometry.backward == Backward::Auto && self.done >= WARM && self.drain(&mut heard)? {
                self.choose_backward()?;
            }
            if self.submitted < last {
                self.submit_next()?;
                self.look(self.submitted.saturating_sub(IN_FLIGHT as u32), &mut heard)?;
            }
            let due = self.schedule.densify(self.submitted).is_some() || self.schedule.reset(self.submitted);
            let due = due && self.settled < self.submitted;
            if due || self.submitted == last {
                let clean = self.drain(&mut heard)?;
                if clean && due {
                    self.settled = self.submitted;
                    self.after(self.submitted, &mut heard)?;
                }
            }
        }
        // Steps that an overflow took back are simply not done yet.
        while !self.drain(&mut heard)? {}
        Ok(())
    }

    fn submit_next(&mut self) -> Result<()> {
        let step = self.submitted + 1;
        // Which graph a step runs depends on its number alone, also where it is run again.
        let due = step >= self.settings.geometry.correspondence_from;
        let pseudo = self.correspondence.as_ref().filter(|_| due).map(Correspondence::masks);
        if pseudo != self.options.pseudo {
            self.exec()?.finish()?;
            self.options.pseudo = pseudo;
            self.rebuild()?;
        }
        let mut values = self.values(step);
        if !due || self.correspondence.is_none() {
            self.exec()?.submit(&values)?;
        } else {
            let pseudo = self.pseudo_views(&mut values)?;
            match pseudo {
                Some(pseudo) => self.exec()?.submit_views(&values, &pseudo)?,
                None => {
                    // Nobody says any more where regions are.
                    self.correspondence = None;
                    return self.submit_next();
                }
            };
        }
        self.submitted = step;
        Ok(())
    }

    /// The uniforms of a step's pseudo-views.
    fn pseudo_views(&mut self, values: &mut Step) -> Result<Option<[Step; PSEUDO_VIEWS]>> {
        let (view, seed) = (self.schedule.view(values.step), self.settings.seed);
        let look = (values.sh_degree, self.settings.geometry.background);
        if self.correspondence.as_ref().is_some_and(Correspondence::looks) {
            self.exec()?.finish()?;
        }
        match &mut self.correspondence {
            Some(c) => c.steps(&self.device, &self.gaussians, look, seed, view, values),
            None => Ok(None),
        }
    }

    /// The uniform of a step.
    fn values(&self, step: u32) -> Step {
        let view = self.schedule.view(step);
        let (camera, offset) = self.data.views[view];
        let mut values = self.schedule.step(step, &camera, offset);
        if let Some((data, _)) = &self.semantics {
            data.views[view].fill(&mut values);
        }
        values
    }

    /// Looks at the reports up to a step that is known to be done. False if an overflow took steps back.
    fn look(&mut self, until: u32, heard: &mut impl FnMut(&Progress)) -> Result<bool> {
        while self.done < until {
            let step = self.done + 1;
            let report = self.status.report(step)?;
            if report.step != step {
                return Err(TrainError::Diverged { step, reason: "the device did not report the step".into() });
            }
            if report.flags != 0 {
                self.grow_entries(step)?;
                return Ok(false);
            }
            if !report.losses.total.is_finite() {
                let reason = format!(
                    "the loss is {} with {} Gaussians visible; lower the learning rates",
                    report.losses.total, report.visible
                );
                return Err(TrainError::Diverged { step, reason });
            }
            self.done = step;
            heard(&Progress::Step(report));
        }
        Ok(true)
    }

    /// Waits for everything submitted and looks at it. False if an overflow took steps back.
    fn drain(&mut self, heard: &mut impl FnMut(&Progress)) -> Result<bool> {
        self.exec()?.finish()?;
        self.look(self.submitted, heard)
    }

    /// The entries of a step did not fit. Nothing was changed from that step on: make room and go back to it.
    fn grow_entries(&mut self, step: u32) -> Result<()> {
        self.exec()?.finish()?;
        let mut wanted = 0;
        for s in step..=self.submitted {
            wanted = wanted.max(self.status.report(s)?.entries);
        }
        let room = u64::from(wanted) + u64::from(wanted) / 8;
        self.options.entry_capacity = u32::try_from(room).unwrap_or(u32::MAX);
        tracing::debug!(step, wanted, capacity = self.options.entry_capacity, "tile entries grow");
        self.rebuild()?;
        self.status.clear_flags(&self.device)?;
        self.submitted = step - 1;
        Ok(())
    }

    fn rebuild(&mut self) -> Result<()> {
        self.densify = None;
        self.reset = None;
        self.exec = None;
        let mut inputs = Inputs {
            targets: &self.data.targets,
            normals: self.data.normals.as_ref(),
            semantics: self.semantics.as_ref().map(|(data, decoder)| data.inputs(decoder)),
            regions: None,
            pseudo_regions: None,
        };
        if let (Some(c), Some(_)) = (&self.correspondence, self.options.pseudo) {
            c.bind(&mut inputs);
        }
        let (device, gaussians, status) = (&self.device, &self.gaussians, &self.status);
        self.exec = Some(GeometryStep::new(device, &self.tuning, gaussians, &inputs, status, self.options)?);
        Ok(())
    }

    /// The step, made again if an earlier attempt failed.
    fn exec(&mut self) -> Result<&mut GeometryStep> {
        if self.exec.is_none() {
            self.rebuild()?;
        }
        self.exec.as_mut().ok_or_else(|| TrainError::Setting("The step could not be built.".into()))
    }

    /// What happens between steps.
    fn after(&mut self, step: u32, heard: &mut impl FnMut(&Progress)) -> Result<()> {
        if let Some(mut settings) = self.schedule.densify(step) {
            settings.cap = settings.cap.min(self.most);
            if self.densify.is_none() {
                // Densification may use the step's arena: nothing in it outlives a replay.
                let arena = self.exec()?.executor().arena().cloned();
                self.densify = Some(DensifyStep::new(&self.device, &self.tuning, &self.gaussians, arena)?);
            }
            if let Some(densify) = &mut self.densify {
                let stats = densify.run(&settings)?;
                tracing::info!(step, ?stats, "densified");
                if stats.after > self.gaussians.capacity / 4 * 3 && self.gaussians.capacity < self.most {
                    self.grow(stats.after)?;
                }
                if self.scarce && stats.after >= self.most {
                    self.full();
                }
                heard(&Progress::Densified { step, stats });
            }
        }
        if self.schedule.reset(step) {
            if self.reset.is_none() {
                self.reset = Some(OpacityReset::new(&self.device, &self.tuning, &self.gaussians)?);
            }
            if let Some(reset) = &mut self.reset {
                reset.run()?;
            }
        }
        Ok(())
    }

    /// Makes room for more Gaussians. Where memory refuses, they stay as many as fit now.
    fn grow(&mut self, count: u32) -> Result<()> {
        // What can be made again goes first: for a moment there are two of the rest.
        self.densify = None;
        self.reset = None;
        self.exec = None;
        let old = self.gaussians.capacity;
        match self.gaussians.grown(&self.device, room_for(count, self.most)) {
            Ok(grown) => self.gaussians = grown,
            Err(error) if error.is_out_of_memory() => {
                tracing::debug!(%error, "no room for more Gaussians");
                self.most = old;
                self.scarce = true;
                self.full();
            }
            Err(error) => return Err(error.into()),
        }
        self.rebuild()
    }

    /// Says once that densification has come to the end of memory.
    fn full(&mut self) {
        if std::mem::take(&mut self.scarce) {
            let budget = allowed(&self.device, &self.settings).budget >> 20;
            tracing::warn!("Densification stops at {} Gaussians: no more fit into {budget} MiB.", self.most);
        }
    }

    /// What the first step was reckoned to take of the device's memory.
    pub fn needs(&self) -> &Needs {
        &self.needs
    }

    /// Times both backward kernels on the step as it is, with parameters held, and takes the faster one. The splat
    /// kernel has to win clearly, so that noise does not decide between runs.
    ///
    /// # Errors
    /// If the device fails.
    pub fn choose_backward(&mut self) -> Result<()> {
        self.status.hold(&self.device)?;
        self.options.timestamps = true;
        let pixel = self.time_backward(BackwardKernel::Pixel)?;
        let splat = self.time_backward(BackwardKernel::Splat)?;
        let (kernel, name) = if splat < 0.85 * pixel {
            (BackwardKernel::Splat, Backward::Splat)
        } else {
            (BackwardKernel::Pixel, Backward::Pixel)
        };
        tracing::info!(pixel_ns = pixel, splat_ns = splat, chosen = ?name, "backward kernel");
        self.options.timestamps = false;
        self.options.backward = kernel;
        self.settings.geometry.backward = name;
        self.rebuild()?;
        Ok(self.status.clear_flags(&self.device)?)
    }

    /// Least nanoseconds of a backward kernel over a few views.
    fn time_backward(&mut self, kernel: BackwardKernel) -> Result<f64> {
        self.options.backward = kernel;
        self.rebuild()?;
        for step in 1..=5 {
            let values = self.values(step);
            self.exec()?.submit(&values)?;
        }
        self.exec()?.finish()?;
        let times = self.take_times();
        let backward = times.iter().filter(|t| t.name.starts_with("blend_bwd"));
        Ok(backward.flat_map(|t| t.nanoseconds.iter().copied()).fold(f64::INFINITY, f64::min))
    }

    /// What gives the features their meaning, if there are any.
    ///
    /// # Errors
    /// If the device fails.
    pub fn head(&self) -> Result<Option<SemanticHead>> {
        let Some((data, decoder)) = &self.semantics else { return Ok(None) };
        let temperature = self.settings.geometry.temperature;
        Ok(Some(SemanticHead { decoder: decoder.download(&self.device)?, text: data.text.clone(), temperature }))
    }

    /// The settings, with what was chosen along the way.
    pub fn settings(&self) -> &Settings {
        &self.settings
    }

    /// The Gaussians as they are.
    ///
    /// # Errors
    /// If the device fails.
    pub fn splats(&self) -> Result<Splats> {
        Ok(splats(&self.gaussians.download(&self.device)?, self.gaussians.model))
    }

    /// Writes everything that resuming needs.
    ///
    /// # Errors
    /// If the file cannot be written; an earlier one stays whole.
    pub fn save(&self, path: &Path) -> Result<()> {
        let device = &self.device;
        let (moments, statistics) = self.gaussians.download_optimizer(device)?;
        let decoder = match &self.semantics {
            Some((_, decoder)) => Some([decoder.download(device)?, decoder.download_moments(device)?]),
            None => None,
        };
        let state = State {
            step: self.done,
            capacity: self.gaussians.capacity,
            parameters: self.gaussians.download(device)?,
            moments,
            statistics,
            decoder,
        };
        checkpoint::save(path, &state, self.gaussians.model)
    }

    /// Goes on from what [`Geometry::save`] wrote.
    ///
    /// # Errors
    /// If the file is damaged or belongs to other settings.
    pub fn restore(&mut self, path: &Path) -> Result<()> {
        let state = checkpoint::load(path, self.gaussians.model)?;
        let count = state.parameters.len() as u32;
        // Densification stops where there is no room, so that the room has to be what it was.
        let enabled = self.settings.geometry.densify.enabled;
        let capacity = if enabled { state.capacity.clamp(count, self.most.max(count)) } else { count };
        self.gaussians = Gaussians::with(&self.device, self.gaussians.model, capacity, true, enabled)?;
        self.gaussians.upload(&self.device, &state.parameters)?;
        self.gaussians.upload_optimizer(&self.device, &state.moments, &state.statistics)?;
        if let (Some((_, decoder)), Some([parameters, moments])) = (&self.semantics, &state.decoder) {
            decoder.upload(&self.device, parameters)?;
            decoder.upload_moments(&self.device, moments)?;
        }
        let first = first_entry_capacity(self.settings.geometry.entry_capacity, count);
        self.options.entry_capacity = self.options.entry_capacity.max(first);
        self.rebuild()?;
        self.submitted = state.step;
        self.done = state.step;
        self.settled = state.step;
        Ok(())
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

    /// Times of the passes since the last call.
    pub fn take_times(&mut self) -> Vec<PassTime> {
        self.exec.as_mut().map_or_else(Vec::new, |e| e.executor().take_times())
    }

    /// The step's executor, for its plan.
    ///
    /// # Errors
    /// If it has to be made again and memory runs out.
    pub fn executor(&mut self) -> Result<&mut sgs_engine::graph::exec::Executor> {
        Ok(self.exec()?.executor())
    }
}

/// How many Gaussians memory allows: the budget less the photographs, and no binding beyond the device's range.
fn most_gaussians(device: &Device, model: Model, settings: &Settings, inputs: &InputSizes, largest: [u32; 2]) -> u32 {
    // Parameters and moments; per visible splat and per tile entry of the transients, at three entries a splat.
    let an_entry = 100 + if model.semantics { 160 } else { 0 };
    let a_gaussian = u64::from(model.width()) * 12 + 12 + 4 * u64::from(model.width().min(16)) + 3 * an_entry;
    let pixels = u64::from(largest[0]) * u64::from(largest[1]);
    let semantics = inputs.semantics.map_or(0, |s| s.bytes() + 256 * pixels);
    let fixed = inputs.targets + inputs.normals.unwrap_or(0) + semantics + 160 * pixels;
    let b = allowed(device, settings);
    // What nobody promised is not used up.
    let budget = if b.source == BudgetSource::Heap && b.budget == b.heap { b.heap / 10 * 9 } else { b.budget };
    let by_memory = budget.saturating_sub(fixed) / a_gaussian;
    let widest = model.groups().map(|g| u64::from(g.width()) * 8).max().unwrap_or(8);
    let by_binding = device.info().max_storage_range / widest;
    u32::try_from(by_memory.min(by_binding)).unwrap_or(u32::MAX)
}

/// Half as many again, so that densification rarely has to grow.
fn room_for(count: u32, most: u32) -> u32 {
    let room = (u64::from(count) + u64::from(count) / 2).max(1 << 14);
    (room.min(u64::from(most.max(count)))) as u32
}

/// Before anything is measured: a tile a splat. A wrong guess costs a rebuild; too much room would cost memory for good.
fn first_entry_capacity(wanted: u32, count: u32) -> u32 {
    if wanted > 0 { wanted } else { count.clamp(1 << 14, 1 << 26) }
}
