//! Environment map that is updated once every several steps.
//!
//! Steps look up fixed mip levels ([`StoredEnvironment`]) and accumulate their gradients. An update propagates the sum
//! back through the filters, moves the texels with Adam, and filters the levels again. All steps between two updates
//! share that cost.
//!
//! Guarantees: the gradient is the mean of those of the steps, at the texels that they used. Results are bitwise equal
//! from run to run. Nothing else may be in flight during an update.

use super::build::TEXEL_EPSILON;
use super::{IntrinsicInputs, IntrinsicOptions, IntrinsicStatus, Step};
use crate::Tuning;
use crate::kernel::stage;
use crate::optim::{AdamRule, Rate, StepWords};
use crate::scene::Trainable;
use crate::shade::environment::{
    Environment, EnvironmentTables, StoredFilter, environment_clamp, environment_filter_stored,
    environment_filter_stored_bwd, environment_smoothness,
};
use sgs_engine::exec::{ExecOptions, Executor};
use sgs_engine::graph::{Buffer, CompileOptions, Graph, Plan};
use sgs_engine::{Device, DeviceBuffer, Location, Result};
use sgs_shaders::semantic_reduce;
use std::sync::Arc;

/// Mip levels of an environment map, and their gradients since the last update.
#[derive(Debug)]
pub struct StoredEnvironment {
    radiance: DeviceBuffer,
    inverse_sums: DeviceBuffer,
    gathered: DeviceBuffer,
}

impl StoredEnvironment {
    /// Allocates the buffers and clears the gradients.
    ///
    /// Levels are undefined until [`EnvironmentRefresh::filter`].
    ///
    /// # Errors
    /// If memory runs out.
    pub fn new(device: &Device, environment: &Environment) -> Result<StoredEnvironment> {
        let [radiance, inverse_sums, gathered] = StoredFilter::bytes(environment);
        let make = |name: &str, bytes: u64| device.buffer(name, bytes, Location::Device);
        let made = StoredEnvironment {
            radiance: make("environment_radiance", radiance)?,
            inverse_sums: make("environment_inverse_sums", inverse_sums)?,
            gathered: make("environment_gathered", gathered)?,
        };
        device.fill(&made.gathered, 0)?;
        Ok(made)
    }

    /// Returns the bytes of all buffers.
    pub fn bytes_of(environment: &Environment) -> u64 {
        StoredFilter::bytes(environment).iter().sum()
    }

    /// Returns the bytes that a checkpoint stores.
    pub fn stored_bytes_of(environment: &Environment) -> u64 {
        StoredFilter::bytes(environment)[2]
    }

    /// Downloads the gradients accumulated since the last update.
    ///
    /// # Errors
    /// If the device fails.
    pub fn download(&self, device: &Device) -> Result<Vec<f32>> {
        device.download_as(&self.gathered, self.floats())
    }

    /// Restores the gradients from [`StoredEnvironment::download`].
    ///
    /// # Errors
    /// If the device fails.
    pub fn upload(&self, device: &Device, gathered: &[f32]) -> Result<()> {
        device.upload(&self.gathered, 0, bytemuck::cast_slice(gathered))
    }

    /// Returns the number of floats of the gradients.
    pub fn floats(&self) -> usize {
        self.gathered.bytes() as usize / 4
    }

    /// Binds the buffers to their handles.
    pub(super) fn bind(&self, exec: &mut Executor, handles: &StoredFilter) -> Result<()> {
        exec.bind(handles.radiance, &self.radiance)?;
        exec.bind(handles.inverse_sums, &self.inverse_sums)?;
        exec.bind(handles.gathered, &self.gathered)
    }
}

/// Update of the texels and their mip levels.
pub struct EnvironmentRefresh {
    exec: Executor,
    step: Buffer,
}

struct Declared {
    plan: Arc<Plan>,
    step: Buffer,
    words: StepWords,
    texels: crate::scene::TrainableHandles,
    tables: EnvironmentTables,
    stored: StoredFilter,
    smoothness: Option<Buffer>,
}

impl EnvironmentRefresh {
    /// Builds the graph. Returns `None` unless `inputs` has an environment map with its levels.
    ///
    /// # Errors
    /// If memory runs out.
    pub fn new(
        device: &Device,
        tuning: &Tuning,
        inputs: &IntrinsicInputs<'_>,
        status: &IntrinsicStatus,
        options: &IntrinsicOptions,
    ) -> Result<Option<EnvironmentRefresh>> {
        let (Some((environment, memory)), Some(texels), Some(stored)) =
            (inputs.environment, &inputs.parameters.environment, inputs.stored)
        else {
            return Ok(None);
        };
        let made = declare(tuning, environment, options)?;
        let mut exec = Executor::new(device, made.plan, ExecOptions { frames_in_flight: 1, ..Default::default() })?;
        texels.bind(&mut exec, &made.texels)?;
        memory.bind(&mut exec, environment, &made.tables)?;
        stored.bind(&mut exec, &made.stored)?;
        exec.bind(made.words.flags, &status.flags)?;
        exec.bind(made.words.skipped, &status.skipped)?;
        if let Some(smoothness) = made.smoothness {
            exec.bind(smoothness, &status.smoothness)?;
        }
        Ok(Some(EnvironmentRefresh { exec, step: made.step }))
    }

    /// Compiles the plan of an update without allocating it, to estimate its cost.
    ///
    /// # Errors
    /// If the graph rejects the sizes.
    pub fn plan(tuning: &Tuning, environment: &Environment, options: &IntrinsicOptions) -> Result<Arc<Plan>> {
        Ok(declare(tuning, environment, options)?.plan)
    }

    /// Updates the texels from the accumulated gradients, without waiting for it.
    ///
    /// Waits for the update before.
    ///
    /// `step` holds the number of this update, from 1, and the bias corrections of Adam.
    ///
    /// # Errors
    /// If the device fails.
    pub fn run(&mut self, step: &Step) -> Result<()> {
        self.exec.submit(&[(self.step, bytemuck::bytes_of(step))])?;
        Ok(())
    }

    /// Waits for the submitted update.
    ///
    /// # Errors
    /// If the device fails.
    pub fn finish(&mut self) -> Result<()> {
        self.exec.finish()
    }

    /// Filters the current texels once (waits for the device).
    ///
    /// Required at the start of training and after loading texels from a file.
    ///
    /// # Errors
    /// If memory runs out or the device fails.
    pub fn filter(device: &Device, tuning: &Tuning, inputs: &IntrinsicInputs<'_>) -> Result<()> {
        let (Some((environment, memory)), Some(texels), Some(stored)) =
            (inputs.environment, &inputs.parameters.environment, inputs.stored)
        else {
            return Ok(());
        };
        let mut g = Graph::new("environment_filter");
        let tables = environment.declare(&mut g);
        let handles = texels.declare(&mut g, false);
        let levels = StoredFilter::declare(&mut g, environment, true);
        environment_filter_stored(&mut g, tuning, environment, &tables, handles.parameters, &levels)?;
        let plan = Arc::new(g.compile(&CompileOptions::default())?);
        let mut exec = Executor::new(device, plan, ExecOptions { frames_in_flight: 1, ..Default::default() })?;
        texels.bind(&mut exec, &handles)?;
        memory.bind(&mut exec, environment, &tables)?;
        stored.bind(&mut exec, &levels)?;
        exec.submit(&[])?;
        exec.finish()
    }
}

fn declare(t: &Tuning, e: &Environment, o: &IntrinsicOptions) -> Result<Declared> {
    let mut g = Graph::new("environment_refresh");
    let step = g.uniform("step", size_of::<Step>() as u64);
    let words = StepWords { step, flags: g.input("flags", 4), skipped: g.external("skipped", 4) };
    let tables = e.declare(&mut g);
    let texels = Trainable::handles(&mut g, "environment", e.floats(), true);
    let stored = StoredFilter::declare(&mut g, e, true);
    let smoothness = environment_smoothness(&mut g, t, e, &tables, texels.parameters, o.environment_smooth);
    let gradient = texels.gradient(&mut g);
    environment_filter_stored_bwd(&mut g, t, e, &tables, &stored, smoothness.as_ref(), gradient)?;
    let smoothness = match smoothness {
        Some(s) if o.environment_smooth > 0.0 => {
            let into = g.external("smoothness", 4);
            let specs = semantic_reduce::Specs { workgroup: t.workgroup, add: false, parts: t.workgroup };
            let push = semantic_reduce::Push { width: 1, groups: s.groups };
            let bytes = bytemuck::bytes_of(&push);
            stage(&mut g, "environment_smoothness_sum", &semantic_reduce::KERNEL, [], specs.entries(), bytes)
                .bind("partials", s.sums)
                .bind_discard("accumulated", into)
                .dispatch([1, 1, 1])?;
            Some(into)
        }
        _ => None,
    };
    // The rate is scaled by the update interval, so that texels move as far in the same number of steps.
    let rate = o.rates.environment * o.environment_every.max(1) as f32;
    let rule = AdamRule { rate: Rate::Constant(rate), epsilon: TEXEL_EPSILON, skip_zero: true };
    texels.follow(&mut g, t, &words, gradient, rule)?;
    environment_clamp(&mut g, t, e, texels.parameters)?;
    environment_filter_stored(&mut g, t, e, &tables, texels.parameters, &stored)?;
    g.fill("clear_gathered", stored.gathered, 0)?;
    let plan = Arc::new(g.compile(&CompileOptions::default())?);
    Ok(Declared { plan, step, words, texels, tables, stored, smoothness })
}
