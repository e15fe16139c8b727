//! One step of geometry training: render a view, evaluate the losses, propagate gradients, update.

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
use sgs_engine::exec::{ExecOptions, Executor};
use sgs_engine::graph::{CompileOptions, Graph, Plan};
use sgs_engine::{Device, DeviceBuffer, Result, Ticket};
use std::sync::Arc;

/// Number of pseudo-views of a step.
pub const PSEUDO_VIEWS: usize = 2;

/// Source of the region masks of a step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Masks {
    /// Region ids of the training view; depth carries the mask to the pseudo-views.
    Carried,
    /// Region ids of all views; those of pseudo-views start at their `region_offset`.
    Numbered,
    /// Bit masks of all views, each from the view's `mask_offset`.
    Provided,
}

/// Options of a geometry step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GeometryOptions {
    /// Maximum columns and rows of a view.
    pub largest: [u32; 2],
    /// Capacity of tile entries.
    pub entry_capacity: u32,
    /// Blended channels; normals and depth only if a loss requires them.
    pub channels: Channels,
    /// Losses whose gradients enter the densification statistics, if gathered.
    pub statistics: Option<Statistic>,
    /// Regularizes opacities and scales, and adds noise to means: steps of Markov chain Monte Carlo.
    pub mcmc: bool,
    /// Applies Adam also to Gaussians that the view does not see.
    pub dense_adam: bool,
    /// Backward kernel of blending.
    pub backward: BackwardKernel,
    /// Lets gradients of features also update opacities, positions and shapes.
    pub semantic_geometry: bool,
    /// Source of masks for comparing a region with two pseudo-views; `None` disables that.
    ///
    /// Requires semantics, and depth among the channels for carried masks.
    pub pseudo: Option<Masks>,
    /// Writes timestamps around every pass.
    pub timestamps: bool,
    /// Maximum number of replays in flight.
    pub frames_in_flight: usize,
}

/// Geometry step, replayable.
pub struct GeometryStep {
    exec: Executor,
    steps: Steps,
    inputs: InputHandles,
    tile: [u32; 2],
    options: GeometryOptions,
}

impl GeometryStep {
    /// Builds the graph and binds all buffers.
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
        let (steps, inputs) = (declared.steps, declared.inputs);
        Ok(GeometryStep { exec, steps, inputs, tile: tuning.tile, options })
    }

    /// Binds the photographs of the next steps, if a scene has several buffers of them.
    ///
    /// Buffers that were used before are not recorded again. `normals` and `depths` are the priors of the same views.
    ///
    /// # Errors
    /// If a buffer is smaller than the one that the step was built with.
    pub fn use_photographs(
        &mut self,
        targets: &DeviceBuffer,
        normals: Option<&DeviceBuffer>,
        depths: Option<&DeviceBuffer>,
    ) -> Result<()> {
        self.exec.alternate(self.inputs.targets, targets)?;
        for (handle, priors) in [(self.inputs.normals, normals), (self.inputs.depths.map(|d| d.0), depths)] {
            if let (Some(handle), Some(priors)) = (handle, priors) {
                self.exec.alternate(handle, priors)?;
            }
        }
        Ok(())
    }

    /// Compiles the plan of a step without allocating it, to estimate its cost.
    ///
    /// # Errors
    /// If the graph rejects the sizes.
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
        // The default pseudo-views have zero weights, so they compare nothing.
        let none = Step { camera: step.camera, step: step.step, ..Step::default() };
        self.submit_views(step, &[none; PSEUDO_VIEWS])
    }

    /// Replays the step with these values, and those of its pseudo-views if present.
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

    /// Returns the options of the step.
    pub fn options(&self) -> &GeometryOptions {
        &self.options
    }

    /// Returns the executor, for its plan and its pass times.
    pub fn executor(&mut self) -> &mut Executor {
        &mut self.exec
    }
}

/// Compiled step and the handles to bind.
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
