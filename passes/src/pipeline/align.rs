//! Aligns a camera and an exposure with a photograph; the Gaussians stay fixed.
//!
//! Measures of novel views compare a render with a photograph. If poses are not exact, the difference shows the pose more than the
//! Gaussians; views are aligned first, as in BARF (Lin et al. 2021).

use super::Step;
use crate::Tuning;
use crate::loss::{Photometric, photometric, photometric_bwd};
use crate::optim::{
    CameraParts, ViewGradients, ViewStatus, camera_bwd, camera_part_bytes, view_gain, view_gain_bwd, view_place,
    view_step,
};
use crate::scene::{Gaussians, Handles, LearnedViews, ViewHandles, ViewKinds};
use crate::splat::{BackwardKernel, Blended, Channels, Screen, blend_bwd, blend_debt, blend_for, intersect, project};
use sgs_engine::exec::{ExecOptions, Executor};
use sgs_engine::graph::{Buffer, CompileOptions, Graph};
use sgs_engine::{Device, DeviceBuffer, Location, Result};
use sgs_shaders::structs::LearnedView;
use std::sync::Arc;

/// Aligns photographs of at most one size.
pub struct Aligner {
    device: Device,
    tuning: Tuning,
    largest: [u32; 2],
    kinds: ViewKinds,
    capacity: u32,
    target: DeviceBuffer,
    views: LearnedViews,
    flags: DeviceBuffer,
    wanted: DeviceBuffer,
    skipped: DeviceBuffer,
    state: State,
}

struct State {
    exec: Executor,
    step: Buffer,
    gaussians: Handles,
}

/// Buffers of the graph besides the Gaussians.
struct Bound {
    step: Buffer,
    target: Buffer,
    views: ViewHandles,
    flags: Buffer,
    wanted: Buffer,
    skipped: Buffer,
}

impl Aligner {
    /// Prepares for photographs of at most `largest` columns and rows.
    ///
    /// # Errors
    /// If memory runs out.
    pub fn new(
        device: &Device,
        tuning: Tuning,
        gaussians: &Gaussians,
        largest: [u32; 2],
        kinds: ViewKinds,
    ) -> Result<Aligner> {
        let pixels = u64::from(largest[0]) * u64::from(largest[1]);
        let buffer = |name: &str, bytes| device.buffer(name, bytes, Location::Device);
        let (target, flags) = (buffer("photograph", 4 * pixels)?, buffer("flags", 4)?);
        let (wanted, skipped) = (buffer("wanted", 4)?, buffer("skipped", 4)?);
        let views = LearnedViews::new(device, 1)?;
        let capacity = gaussians.capacity.saturating_mul(2).clamp(1 << 12, 1 << 24);
        let (bound, exec, handles) = declare(device, &tuning, gaussians, largest, kinds, capacity)?;
        let state = State { exec, step: bound.step, gaussians: handles };
        let mut aligner = Aligner {
            device: device.clone(),
            tuning,
            largest,
            kinds,
            capacity,
            target,
            views,
            flags,
            wanted,
            skipped,
            state,
        };
        aligner.bind(&bound, gaussians)?;
        Ok(aligner)
    }

    fn bind(&mut self, bound: &Bound, gaussians: &Gaussians) -> Result<()> {
        let exec = &mut self.state.exec;
        for (handle, memory) in [
            (bound.target, &self.target),
            (bound.flags, &self.flags),
            (bound.wanted, &self.wanted),
            (bound.skipped, &self.skipped),
        ] {
            exec.bind(handle, memory)?;
        }
        self.views.bind(exec, &bound.views)?;
        gaussians.bind(exec, &self.state.gaussians)
    }

    /// Returns the corrections of a view, after these steps from none.
    ///
    /// `photograph` is packed ([`Photometric`]). Each step has a camera, learning rates of turn, shift and gain, and weights of
    /// the photometric losses; its view is 0.
    ///
    /// # Errors
    /// If memory runs out while growing, or the device fails.
    pub fn align(&mut self, gaussians: &Gaussians, photograph: &[u32], steps: &[Step]) -> Result<LearnedView> {
        self.device.upload(&self.target, 0, bytemuck::cast_slice(photograph))?;
        loop {
            self.views.upload(&self.device, &[LearnedView::default(); 2])?;
            self.device.fill(&self.flags, 0)?;
            for step in steps {
                let mut step = *step;
                let size = step.camera.size;
                step.camera.tiles = [size[0].div_ceil(self.tuning.tile[0]), size[1].div_ceil(self.tuning.tile[1])];
                self.state.exec.submit(&[(self.state.step, bytemuck::bytes_of(&step))])?;
            }
            self.state.exec.finish()?;
            if self.device.download_as::<u32>(&self.flags, 1)?[0] == 0 {
                return Ok(self.views.download(&self.device)?[0]);
            }
            let wanted = self.device.download_as::<u32>(&self.wanted, 1)?[0];
            self.capacity = wanted.max(self.capacity).saturating_add(wanted / 8);
            let (bound, exec, handles) =
                declare(&self.device, &self.tuning, gaussians, self.largest, self.kinds, self.capacity)?;
            self.state = State { exec, step: bound.step, gaussians: handles };
            self.bind(&bound, gaussians)?;
        }
    }
}

fn declare(
    device: &Device,
    t: &Tuning,
    gaussians: &Gaussians,
    largest: [u32; 2],
    kinds: ViewKinds,
    capacity: u32,
) -> Result<(Bound, Executor, Handles)> {
    let mut graph = Graph::new("align");
    let g = &mut graph;
    let uniform = g.uniform("step", size_of::<Step>() as u64);
    let pixels = u64::from(largest[0]) * u64::from(largest[1]);
    let (target, flags) = (g.input("photograph", 4 * pixels), g.external("flags", 4));
    let (wanted, skipped) = (g.external("wanted", 4), g.external("skipped", 4));
    let views = LearnedViews::declare(g, 1, kinds);
    let handles = gaussians.declare(g, false);
    let step = if kinds.cameras { view_place(g, uniform, &views)? } else { uniform };
    let screen = Screen { step, largest, tile: t.tile };
    let channels = Channels::default();
    let visible = project(g, t, &screen, &handles, channels)?;
    let entries = intersect(g, t, &screen, &visible, capacity, flags)?;
    let blended = |g: &mut Graph, name: &str| Blended {
        image: g.transient(name, 12 * pixels),
        transmittance: g.transient(format!("{name}_transmittance"), 4 * pixels),
    };
    let (image, gradient) = (blended(g, "image"), blended(g, "grad_image"));
    let which = BackwardKernel::Pixel;
    let buckets = blend_for(g, t, &screen, &visible, &entries, &image, which)?;
    if kinds.gains {
        view_gain(g, t, &screen, &views, 3, image.image)?;
    }
    let loss = Photometric { step, image: image.image, targets: target, channels: 3, largest };
    let partials = photometric(g, *t, &loss)?;
    photometric_bwd(g, *t, &loss, &partials, gradient.image)?;
    g.fill("clear_grad_transmittance", gradient.transmittance, 0)?;
    let mut owed = blend_debt(g, t, &screen, 3, &image, &gradient)?;
    owed.buckets = buckets;
    let gains = match kinds.gains {
        true => Some(view_gain_bwd(g, t, &screen, &views, 3, image.image, gradient.image)?),
        false => None,
    };
    let cameras = match kinds.cameras {
        true => {
            let sums = blend_bwd(g, t, &screen, &visible, &entries, &owed, which, false)?;
            let parts = g.transient("camera_parts", camera_part_bytes(t, &visible, false));
            camera_bwd(g, t, &screen, &handles, &visible, &sums, CameraParts { parts, lens: false })?;
            Some(parts)
        }
        false => None,
    };
    let gradients = ViewGradients { cameras, gains };
    view_step(g, t, step, visible.work, &views, &gradients, &ViewStatus { flags, skipped })?;
    g.copy("copy_wanted", entries.wanted, wanted)?;
    let plan = Arc::new(graph.compile(&CompileOptions::default())?);
    let exec = Executor::new(device, plan, ExecOptions { frames_in_flight: 2, ..Default::default() })?;
    Ok((Bound { step: uniform, target, views, flags, wanted, skipped }, exec, handles))
}
