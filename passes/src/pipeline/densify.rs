//! Densification and opacity reset: separate plans that run between training steps.

use crate::Tuning;
use crate::optim::densify::{Densify, densify};
use crate::optim::opacity_reset::opacity_reset;
use crate::optim::relocate::{Relocate, relocate};
use crate::scene::{Gaussians, Handles, Layout};
use sgs_engine::exec::{ExecOptions, Executor};
use sgs_engine::graph::{Buffer, CompileOptions, Graph, Plan};
use sgs_engine::{Device, DeviceBuffer, Error, Location, Result};
use sgs_shaders::structs::{Densify as Settings, DensifyStats};
use std::sync::Arc;

/// Rule by which Gaussians are added and removed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DensifyRule {
    /// Gradients select Gaussians to clone and split. Requires statistics.
    Gradient,
    /// Markov chain Monte Carlo. Dead Gaussians move onto others, and the number grows by a twentieth.
    Relocation,
}

/// Densification plan, replayable.
pub struct DensifyStep {
    exec: Executor,
    settings: Buffer,
    stats: DeviceBuffer,
}

impl DensifyStep {
    /// Builds the plan for Gaussians in training.
    ///
    /// `arena`: memory that may be shared, since no content outlives a replay.
    ///
    /// # Errors
    /// If memory runs out, or the Gaussians have no optimizer.
    pub fn new(
        device: &Device,
        tuning: &Tuning,
        gaussians: &Gaussians,
        rule: DensifyRule,
        arena: Option<DeviceBuffer>,
    ) -> Result<Self> {
        let (plan, settings, handles, out) = DensifyStep::declare(tuning, &gaussians.layout(), rule)?;
        let options = ExecOptions { frames_in_flight: 1, arena, ..Default::default() };
        let mut exec = Executor::new(device, plan, options)?;
        gaussians.bind(&mut exec, &handles)?;
        let stats = device.buffer("densify_stats", size_of::<DensifyStats>() as u64, Location::Readback)?;
        exec.bind(out, &stats)?;
        Ok(DensifyStep { exec, settings, stats })
    }

    fn declare(tuning: &Tuning, gaussians: &Layout, rule: DensifyRule) -> Result<(Arc<Plan>, Buffer, Handles, Buffer)> {
        let mut g = Graph::new("densify");
        let settings = g.uniform("densify_settings", size_of::<Settings>() as u64);
        let handles = gaussians.declare(&mut g, true);
        let out = g.external("densify_stats", size_of::<DensifyStats>() as u64);
        match rule {
            DensifyRule::Gradient => {
                let what = Densify::of(&handles, settings, out).ok_or_else(not_training)?;
                densify(&mut g, *tuning, &what)?;
            }
            DensifyRule::Relocation => {
                let what = Relocate::of(&handles, settings, out).ok_or_else(not_training)?;
                relocate(&mut g, *tuning, &what)?;
            }
        }
        Ok((Arc::new(g.compile(&CompileOptions::default())?), settings, handles, out))
    }

    /// Compiles the plan for a layout without allocating it, to estimate its cost.
    ///
    /// # Errors
    /// If the layout has no optimizer.
    pub fn plan(tuning: &Tuning, gaussians: &Layout, rule: DensifyRule) -> Result<Arc<Plan>> {
        Ok(DensifyStep::declare(tuning, gaussians, rule)?.0)
    }

    /// Densifies once and waits for the result.
    ///
    /// # Errors
    /// If the device fails.
    pub fn run(&mut self, settings: &Settings) -> Result<DensifyStats> {
        self.exec.submit(&[(self.settings, bytemuck::bytes_of(settings))])?;
        self.exec.finish()?;
        let mut stats = DensifyStats::default();
        self.stats.read(0, bytemuck::bytes_of_mut(&mut stats))?;
        Ok(stats)
    }
}

/// Opacity reset plan, replayable.
pub struct OpacityReset {
    exec: Executor,
}

impl OpacityReset {
    /// Builds the plan.
    ///
    /// # Errors
    /// If memory runs out, or the Gaussians have no optimizer.
    pub fn new(device: &Device, tuning: &Tuning, gaussians: &Gaussians) -> Result<Self> {
        let mut g = Graph::new("opacity_reset");
        let handles = gaussians.declare(&mut g, true);
        let moments = handles.moments.ok_or_else(not_training)?;
        opacity_reset(&mut g, *tuning, &handles, &moments)?;
        let plan = Arc::new(g.compile(&CompileOptions::default())?);
        let mut exec = Executor::new(device, plan, ExecOptions { frames_in_flight: 1, ..Default::default() })?;
        gaussians.bind(&mut exec, &handles)?;
        Ok(OpacityReset { exec })
    }

    /// Submits one reset; work submitted later runs after it.
    ///
    /// # Errors
    /// If the device fails.
    pub fn run(&mut self) -> Result<()> {
        self.exec.submit(&[]).map(|_| ())
    }
}

fn not_training() -> Error {
    Error::Unbound { buffer: "moments".into(), plan: "densify".into() }
}
