//! Surroundings that move once in several steps.
//!
//! Steps look up levels that stay ([`KeptEnvironment`]) and gather what they ask of them. When it is due, the sum goes back
//! through the filters, Adam moves the texels by it, and the levels are filtered anew: what a step costs beside shading is
//! paid once for all of them. Promises: the gradient is the mean of those of the steps, at the texels that they saw; the same
//! bits from run to run. Nothing else may be in flight meanwhile.

use super::build::TEXEL_EPSILON;
use super::{IntrinsicInputs, IntrinsicOptions, IntrinsicStatus, Step};
use crate::Tuning;
use crate::kernel::stage;
use crate::optim::Rate;
use crate::scene::{StepWords, Trainable};
use crate::shade::environment::{
    Environment, EnvironmentTables, Kept, environment_clamp, environment_filter_kept, environment_filter_kept_bwd,
    environment_smoothness,
};
use sgs_engine::graph::exec::{ExecOptions, Executor};
use sgs_engine::graph::{Buffer, CompileOptions, Graph, Plan};
use sgs_engine::{Device, DeviceBuffer, Location, Result};
use sgs_shaders::semantic_reduce;
use std::sync::Arc;

/// The levels of an environment in device memory, and what has been asked of them since the texels moved.
#[derive(Debug)]
pub struct KeptEnvironment {
    radiance: DeviceBuffer,
    inverse_sums: DeviceBuffer,
    gathered: DeviceBuffer,
}

impl KeptEnvironment {
    /// Makes it; nothing is filtered yet ([`EnvironmentRefresh::filter`]), nothing gathered.
    ///
    /// # Errors
    /// If memory runs out.
    pub fn new(device: &Device, environment: &Environment) -> Result<KeptEnvironment> {
        let [radiance, inverse_sums, gathered] = Kept::bytes(environment);
        let make = |name: &str, bytes: u64| device.buffer(name, bytes, Location::Device);
        let made = KeptEnvironment {
            radiance: make("environment_radiance", radiance)?,
            inverse_sums: make("environment_inverse_sums", inverse_sums)?,
            gathered: make("environment_gathered", gathered)?,
        };
        device.fill(&made.gathered, 0)?;
        Ok(made)
    }

    /// What it takes.
    pub fn bytes_of(environment: &Environment) -> u64 {
        Kept::bytes(environment).iter().sum()
    }

    /// Of it what a checkpoint holds.
    pub fn kept_bytes_of(environment: &Environment) -> u64 {
        Kept::bytes(environment)[2]
    }

    /// What steps have gathered since the texels moved.
    ///
    /// # Errors
    /// If the device fails.
    pub fn download(&self, device: &Device) -> Result<Vec<f32>> {
        device.download_as(&self.gathered, self.floats())
    }

    /// Puts back what [`KeptEnvironment::download`] gave.
    ///
    /// # Errors
    /// If the device fails.
    pub fn upload(&self, device: &Device, gathered: &[f32]) -> Result<()> {
        device.upload(&self.gathered, 0, bytemuck::cast_slice(gathered))
    }

    /// How many numbers that is.
    pub fn floats(&self) -> usize {
        self.gathered.bytes() as usize / 4
    }

    /// Puts it behind its handles.
    pub(super) fn bind(&self, exec: &mut Executor, handles: &Kept) -> Result<()> {
        exec.bind(handles.radiance, &self.radiance)?;
        exec.bind(handles.inverse_sums, &self.inverse_sums)?;
        exec.bind(handles.gathered, &self.gathered)
    }
}

/// Moves the texels, and filters them.
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
    kept: Kept,
    smoothness: Option<Buffer>,
}

impl EnvironmentRefresh {
    /// Builds the graph. `inputs` must have an environment with its levels.
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
        let (Some((environment, memory)), Some(texels), Some(kept)) =
            (inputs.environment, &inputs.parameters.environment, inputs.kept)
        else {
            return Ok(None);
        };
        let made = declare(tuning, environment, options)?;
        let mut exec = Executor::new(device, made.plan, ExecOptions { frames_in_flight: 1, ..Default::default() })?;
        texels.bind(&mut exec, &made.texels)?;
        memory.bind(&mut exec, environment, &made.tables)?;
        kept.bind(&mut exec, &made.kept)?;
        exec.bind(made.words.flags, &status.flags)?;
        exec.bind(made.words.skipped, &status.skipped)?;
        if let Some(smoothness) = made.smoothness {
            exec.bind(smoothness, &status.smoothness)?;
        }
        Ok(Some(EnvironmentRefresh { exec, step: made.step }))
    }

    /// The plan of one that does not exist yet, for what it would cost.
    ///
    /// # Errors
    /// If the sizes make no graph.
    pub fn plan(tuning: &Tuning, environment: &Environment, options: &IntrinsicOptions) -> Result<Arc<Plan>> {
        Ok(declare(tuning, environment, options)?.plan)
    }

    /// Moves the texels by what was gathered, and waits. `step` has the number of this move, from 1, and its corrections.
    ///
    /// # Errors
    /// If the device fails.
    pub fn run(&mut self, step: &Step) -> Result<()> {
        self.exec.submit(&[(self.step, bytemuck::bytes_of(step))])?;
        self.exec.finish()
    }

    /// Filters the texels as they are, once, and waits: at the start, and where texels come from a file.
    ///
    /// # Errors
    /// If memory runs out or the device fails.
    pub fn filter(device: &Device, tuning: &Tuning, inputs: &IntrinsicInputs<'_>) -> Result<()> {
        let (Some((environment, memory)), Some(texels), Some(kept)) =
            (inputs.environment, &inputs.parameters.environment, inputs.kept)
        else {
            return Ok(());
        };
        let mut g = Graph::new("environment_filter");
        let tables = environment.declare(&mut g);
        let handles = texels.declare(&mut g, false);
        let levels = Kept::declare(&mut g, environment, true);
        environment_filter_kept(&mut g, tuning, environment, &tables, handles.parameters, &levels)?;
        let plan = Arc::new(g.compile(&CompileOptions::default())?);
        let mut exec = Executor::new(device, plan, ExecOptions { frames_in_flight: 1, ..Default::default() })?;
        texels.bind(&mut exec, &handles)?;
        memory.bind(&mut exec, environment, &tables)?;
        kept.bind(&mut exec, &levels)?;
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
    let kept = Kept::declare(&mut g, e, true);
    let smoothness = environment_smoothness(&mut g, t, e, &tables, texels.parameters, o.environment_smooth);
    let gradient = texels.gradient(&mut g);
    environment_filter_kept_bwd(&mut g, t, e, &tables, &kept, smoothness.as_ref(), gradient)?;
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
    // As far in as many steps: moves are rarer, so they are longer.
    let rate = o.rates.environment * o.environment_every.max(1) as f32;
    texels.follow(&mut g, t, &words, gradient, Rate::Constant(rate), TEXEL_EPSILON, true)?;
    environment_clamp(&mut g, t, e, texels.parameters)?;
    environment_filter_kept(&mut g, t, e, &tables, texels.parameters, &kept)?;
    g.fill("clear_gathered", kept.gathered, 0)?;
    let plan = Arc::new(g.compile(&CompileOptions::default())?);
    Ok(Declared { plan, step, words, texels, tables, kept, smoothness })
}
