//! One step of geometry training: render a view, compare, go back, update.

mod build;
mod inputs;
mod pseudo;

pub use inputs::{InputSizes, Inputs, SemanticInputs, SemanticSizes};

use self::build::{Steps, build};
use self::inputs::InputHandles;
use super::Step;
use super::status::{Status, StatusHandles};
use crate::Tuning;
use crate::scene::{Gaussians, Handles, Layout};
use crate::splat::{BackwardKernel, Channels, Statistic};
use sgs_engine::graph::exec::{ExecOptions, Executor};
use sgs_engine::graph::{CompileOptions, Graph, Plan};
use sgs_engine::{Device, Result, Ticket};
use std::sync::Arc;

/// Pseudo-views of a step.
pub const PSEUDO_VIEWS: usize = 2;

/// Where a region is in the pictures of a step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Masks {
    /// In the training view by the ids of its pixels, and carried from there to the pseudo-views by depth.
    Carried,
    /// By the ids of the pixels of all views, those of pseudo-views from their `target_offset`.
    Numbered,
    /// As bits, for each view from its `mask_offset`.
    Given,
}

/// What a geometry step is made of.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GeometryOptions {
    /// Columns and rows that no view exceeds.
    pub largest: [u32; 2],
    /// Room for tile entries.
    pub entry_capacity: u32,
    /// What is blended; normals and depth only where a loss needs them.
    pub channels: Channels,
    /// Which losses' gradients enter the statistics of densification, if these are gathered.
    pub statistics: Option<Statistic>,
    /// Whether Adam also moves what a step did not see.
    pub dense_adam: bool,
    /// Which backward kernel.
    pub backward: BackwardKernel,
    /// Whether what is asked of features also moves opacities, positions and shapes.
    pub semantic_geometry: bool,
    /// Whether a region is compared with two pseudo-views, and what says where it is; needs semantics, and depth among
    /// the channels if masks are carried.
    pub pseudo: Option<Masks>,
    /// Timestamps around every pass.
    pub timestamps: bool,
    /// Replays in flight.
    pub frames_in_flight: usize,
}

/// A geometry step, ready to be replayed.
pub struct GeometryStep {
    exec: Executor,
    steps: Steps,
    tile: [u32; 2],
    options: GeometryOptions,
}

impl GeometryStep {
    /// Builds the graph and binds everything.
    ///
    /// # Errors
    /// If memory runs out.
    pub fn new(
        device: &Device,
        tuning: &Tuning,
        gaussians: &Gaussians,
        inputs: &Inputs<'_>,
        status: &Status,
        options: GeometryOptions,
    ) -> Result<GeometryStep> {
        let declared = declare(tuning, &gaussians.layout(), &inputs.sizes(), &options)?;
        let exec_options = ExecOptions {
            frames_in_flight: options.frames_in_flight,
            timestamps: options.timestamps,
            ..Default::default()
        };
        let mut exec = Executor::new(device, declared.plan, exec_options)?;
        gaussians.bind(&mut exec, &declared.gaussians)?;
        status.bind(&mut exec, &declared.status)?;
        declared.inputs.bind(&mut exec, inputs)?;
        Ok(GeometryStep { exec, steps: declared.steps, tile: tuning.tile, options })
    }

    /// The plan of a step that does not exist yet, for what it would cost.
    ///
    /// # Errors
    /// If the sizes make no graph.
    pub fn plan(
        tuning: &Tuning,
        gaussians: &Layout,
        inputs: &InputSizes,
        options: &GeometryOptions,
    ) -> Result<Arc<Plan>> {
        Ok(declare(tuning, gaussians, inputs, options)?.plan)
    }

    /// Replays the step with these values.
    ///
    /// # Errors
    /// If the device fails.
    pub fn submit(&mut self, step: &Step) -> Result<Ticket> {
        // A step with pseudo-views that has none compares nothing: their weight is zero.
        let none = Step { camera: step.camera, step: step.step, ..Step::default() };
        self.submit_views(step, &[none; PSEUDO_VIEWS])
    }

    /// Replays the step with these values, and those of its pseudo-views if it has some.
    ///
    /// # Errors
    /// If the device fails.
    pub fn submit_views(&mut self, step: &Step, pseudo: &[Step; PSEUDO_VIEWS]) -> Result<Ticket> {
        let tiled = |step: &Step| {
            let mut step = *step;
            let size = step.camera.size;
            step.camera.tiles = [size[0].div_ceil(self.tile[0]), size[1].div_ceil(self.tile[1])];
            step
        };
        let (step, pseudo) = (tiled(step), pseudo.each_ref().map(tiled));
        let first = (self.steps.step, bytemuck::bytes_of(&step));
        match self.steps.pseudo {
            None => self.exec.submit(&[first]),
            Some([a, b]) => {
                let [x, y] = pseudo.each_ref().map(bytemuck::bytes_of);
                self.exec.submit(&[first, (a, x), (b, y)])
            }
        }
    }

    /// Waits for every replay in flight.
    ///
    /// # Errors
    /// If the device fails.
    pub fn finish(&mut self) -> Result<()> {
        self.exec.finish()
    }

    /// What it was made of.
    pub fn options(&self) -> &GeometryOptions {
        &self.options
    }

    /// The executor, for its plan and its times.
    pub fn executor(&mut self) -> &mut Executor {
        &mut self.exec
    }
}

/// A compiled step and what is bound to it.
struct Declared {
    plan: Arc<Plan>,
    steps: Steps,
    gaussians: Handles,
    status: StatusHandles,
    inputs: InputHandles,
}

fn declare(tuning: &Tuning, gaussians: &Layout, inputs: &InputSizes, options: &GeometryOptions) -> Result<Declared> {
    let mut g = Graph::new("geometry_step");
    let mut uniform = |name: &str| g.uniform(name, size_of::<Step>() as u64);
    let steps =
        Steps { step: uniform("step"), pseudo: options.pseudo.map(|_| [uniform("pseudo0"), uniform("pseudo1")]) };
    let gaussians = gaussians.declare(&mut g, true);
    let status = Status::declare(&mut g);
    let inputs = InputHandles::declare(&mut g, inputs);
    build(&mut g, tuning, &steps, &gaussians, &status, &inputs, options)?;
    let plan = Arc::new(g.compile(&CompileOptions::default())?);
    Ok(Declared { plan, steps, gaussians, status, inputs })
}
