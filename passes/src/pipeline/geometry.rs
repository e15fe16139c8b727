//! One step of geometry training: render a view, compare, go back, update.

use super::Step;
use super::status::{Status, StatusHandles};
use crate::Tuning;
use crate::kernel::stage;
use crate::loss::{
    GeometryLoss, Photometric, geometry_loss, loss_sum, photometric, photometric_bwd, photometric_bwd_in_place,
};
use crate::optim::{AdamUnseen, Rate, adam_unseen};
use crate::scene::{Gaussians, Group, Handles, Layout};
use crate::splat::{
    BackwardKernel, Blended, Channels, FusedAdam, Screen, blend, blend_bwd, blend_debt, intersect, project,
    project_bwd_adam,
};
use sgs_engine::graph::exec::{ExecOptions, Executor};
use sgs_engine::graph::{Buffer, CompileOptions, Graph, GraphError, Plan};
use sgs_engine::{Device, DeviceBuffer, Result, Ticket};
use sgs_shaders::report;
use std::sync::Arc;

/// What a geometry step is made of.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GeometryOptions {
    /// Columns and rows that no view exceeds.
    pub largest: [u32; 2],
    /// Room for tile entries.
    pub entry_capacity: u32,
    /// What is blended; normals and depth only where a loss needs them.
    pub channels: Channels,
    /// Whether densification statistics are gathered.
    pub statistics: bool,
    /// Whether Adam also moves what a step did not see.
    pub dense_adam: bool,
    /// Which backward kernel.
    pub backward: BackwardKernel,
    /// Timestamps around every pass.
    pub timestamps: bool,
    /// Replays in flight.
    pub frames_in_flight: usize,
}

/// A geometry step, ready to be replayed.
pub struct GeometryStep {
    exec: Executor,
    step: Buffer,
    tile: [u32; 2],
    options: GeometryOptions,
}

impl GeometryStep {
    /// Builds the graph and binds everything. `targets`: the photographs, packed; `priors`: normals, packed likewise.
    ///
    /// # Errors
    /// If memory runs out.
    pub fn new(
        device: &Device,
        tuning: &Tuning,
        gaussians: &Gaussians,
        targets: &DeviceBuffer,
        priors: Option<&DeviceBuffer>,
        status: &Status,
        options: GeometryOptions,
    ) -> Result<GeometryStep> {
        let Declared { plan, step, handles, status: status_handles, targets: target_buffer, priors: prior_buffer } =
            declare(tuning, &gaussians.layout(), targets.bytes(), priors.map(DeviceBuffer::bytes), &options)?;
        let exec_options = ExecOptions {
            frames_in_flight: options.frames_in_flight,
            timestamps: options.timestamps,
            ..Default::default()
        };
        let mut exec = Executor::new(device, plan, exec_options)?;
        gaussians.bind(&mut exec, &handles)?;
        status.bind(&mut exec, &status_handles)?;
        exec.bind(target_buffer, targets)?;
        if let (Some(handle), Some(memory)) = (prior_buffer, priors) {
            exec.bind(handle, memory)?;
        }
        Ok(GeometryStep { exec, step, tile: tuning.tile, options })
    }

    /// The plan of a step that does not exist yet, for what it would cost. `targets`, `priors`: bytes of the photographs
    /// and the normals.
    ///
    /// # Errors
    /// If the sizes make no graph.
    pub fn plan(
        tuning: &Tuning,
        gaussians: &Layout,
        targets: u64,
        priors: Option<u64>,
        options: &GeometryOptions,
    ) -> Result<Arc<Plan>> {
        Ok(declare(tuning, gaussians, targets, priors, options)?.plan)
    }

    /// Replays the step with these values.
    ///
    /// # Errors
    /// If the device fails.
    pub fn submit(&mut self, step: &Step) -> Result<Ticket> {
        let mut step = *step;
        let size = step.camera.size;
        step.camera.tiles = [size[0].div_ceil(self.tile[0]), size[1].div_ceil(self.tile[1])];
        self.exec.submit(&[(self.step, bytemuck::bytes_of(&step))])
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
    step: Buffer,
    handles: Handles,
    status: StatusHandles,
    targets: Buffer,
    priors: Option<Buffer>,
}

fn declare(
    tuning: &Tuning,
    gaussians: &Layout,
    targets: u64,
    priors: Option<u64>,
    options: &GeometryOptions,
) -> Result<Declared> {
    let mut g = Graph::new("geometry_step");
    let step = g.uniform("step", size_of::<Step>() as u64);
    let handles = gaussians.declare(&mut g, true);
    let status = Status::declare(&mut g);
    let targets = g.input("targets", targets);
    let priors = priors.map(|bytes| g.input("normal_priors", bytes));
    build(&mut g, tuning, step, &handles, &status, targets, priors, options)?;
    let plan = Arc::new(g.compile(&CompileOptions::default())?);
    Ok(Declared { plan, step, handles, status, targets, priors })
}

/// The learning rate that a group follows.
fn rate(group: Group) -> Rate {
    match group {
        Group::Means => Rate::Means,
        Group::LogScales => Rate::Scales,
        Group::Rotations => Rate::Rotations,
        Group::OpacityLogits => Rate::Opacities,
        Group::Sh0 => Rate::Sh0,
        Group::Sh1 | Group::Sh2 | Group::Sh3 => Rate::ShRest,
        Group::Normals => Rate::Normals,
        Group::Semantics => Rate::Semantics,
    }
}

fn build(
    g: &mut Graph,
    t: &Tuning,
    step: Buffer,
    gaussians: &Handles,
    status: &StatusHandles,
    targets: Buffer,
    priors: Option<Buffer>,
    o: &GeometryOptions,
) -> std::result::Result<(), GraphError> {
    let screen = Screen { step, largest: o.largest, tile: t.tile };
    let channels = o.channels.count();
    let pixels = screen.pixels();
    let visible = project(g, t, &screen, gaussians, o.channels)?;
    let entries = intersect(g, t, &screen, &visible, o.entry_capacity, status.flags)?;
    let blended = Blended {
        image: g.transient("image", 4 * u64::from(channels) * pixels),
        transmittance: g.transient("transmittance", 4 * pixels),
    };
    blend(g, t, &screen, &visible, &entries, &blended)?;
    let loss = Photometric { step, image: blended.image, targets, channels, largest: o.largest };
    let partials = photometric(g, *t, &loss)?;
    let (gradient, geometry) = if o.channels.normals || o.channels.depth {
        let gradient = Blended {
            image: g.transient("grad_image", 4 * u64::from(channels) * pixels),
            transmittance: g.transient("grad_transmittance", 4 * pixels),
        };
        photometric_bwd(g, *t, &loss, &partials, gradient.image)?;
        let loss = GeometryLoss {
            step,
            image: blended.image,
            channels,
            normals: o.channels.normals.then_some(3),
            depth: o.channels.depth.then_some(channels - 2),
            transmittance: blended.transmittance,
            targets,
            priors,
            largest: o.largest,
        };
        let sums = geometry_loss(g, *t, &loss, gradient.image, gradient.transmittance)?;
        (blend_debt(g, t, &screen, channels, &blended, &gradient)?, Some((sums.sums, sums.count)))
    } else {
        (photometric_bwd_in_place(g, *t, &loss, &partials)?, None)
    };
    let stats = g.transient("loss_stats", size_of::<sgs_shaders::structs::LossStats>() as u64);
    loss_sum(g, *t, step, (partials.sums, partials.count), geometry, stats)?;
    let entry_gradients = blend_bwd(g, t, &screen, &visible, &entries, &gradient, o.backward, o.statistics)?;
    let seen = o.dense_adam.then(|| g.transient("seen", 4 * u64::from(gaussians.capacity)));
    if let Some(seen) = seen {
        g.fill("clear_seen", seen, 0)?;
    }
    let adam = FusedAdam { flags: status.flags, skipped: status.skipped, statistics: o.statistics, seen, extra: None };
    project_bwd_adam(g, t, &screen, gaussians, &visible, &entry_gradients, &adam)?;
    if let (Some(seen), Some(moments)) = (seen, gaussians.moments) {
        for group in gaussians.model.groups() {
            let rest = AdamUnseen {
                step,
                live: gaussians.work,
                flags: status.flags,
                seen,
                width: group.width(),
                rate: rate(group),
                parameters: gaussians.group(group),
                moments: moments[group as usize],
                gradients: None,
                sparse: false,
                skipped: status.skipped,
            };
            adam_unseen(g, t, &format!("adam_unseen.{}", group.name()), &rest)?;
        }
    }
    let bindings = report::Bindings {
        params: step.into(),
        gaussians: gaussians.work.into(),
        visible: visible.work.slice,
        wanted: entries.wanted.into(),
        flags: status.flags.into(),
        skipped: status.skipped.into(),
        losses: stats.into(),
        reports: status.reports.into(),
    };
    let specs = report::Specs { ring: super::RING };
    stage(g, "report", &report::KERNEL, bindings.entries(), specs.entries(), &[]).dispatch([1, 1, 1])
}
