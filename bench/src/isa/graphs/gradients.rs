//! Graph of a render with the gradients of its parameters and of the pose.
//!
//! The Python package builds the same.

use super::SIZE;
use sgs_engine::Device;
use sgs_engine::exec::{ExecOptions, Executor};
use sgs_engine::graph::{CompileOptions, Graph};
use sgs_passes::Tuning;
use sgs_passes::pipeline::Step;
use sgs_passes::scene::{Gaussians, Model};
use sgs_passes::splat::{
    BackwardKernel, Blended, Channels, Gradients, Screen, blend, blend_bwd, blend_debt, intersect, project, project_bwd,
};
use std::sync::Arc;

/// Builds it with and without normals.
pub fn build(device: &Device) -> anyhow::Result<()> {
    let t = Tuning::for_device(device.info());
    for normals in [false, true] {
        let model = Model { sh_degree: 3, normals, semantics: false };
        let gaussians = Gaussians::new(device, model, 1000, false)?;
        let channels = Channels { colors: true, normals, depth: true };
        let mut g = Graph::new("render_gradients");
        let step = g.uniform("step", size_of::<Step>() as u64);
        let screen = Screen { step, largest: SIZE, tile: t.tile };
        let handles = gaussians.declare(&mut g, false);
        let flags = g.external("flags", 4);
        g.fill("clear_flags", flags, 0)?;
        let bytes = 4 * u64::from(channels.count()) * screen.pixels();
        let visible = project(&mut g, &t, &screen, &handles, channels)?;
        let entries = intersect(&mut g, &t, &screen, &visible, 1 << 14, flags)?;
        let blended = Blended {
            image: g.transient("image", bytes),
            transmittance: g.transient("transmittance", 4 * screen.pixels()),
        };
        blend(&mut g, &t, &screen, &visible, &entries, &blended)?;
        let gradient = Blended {
            image: g.input("grad_image", bytes),
            transmittance: g.input("grad_transmittance", 4 * screen.pixels()),
        };
        let owed = blend_debt(&mut g, &t, &screen, channels.count(), &blended, &gradient)?;
        let sums = blend_bwd(&mut g, &t, &screen, &visible, &entries, &owed, BackwardKernel::Pixel, false)?;
        let parameters = g.external("grad_parameters", model.column_bytes(gaussians.capacity));
        let means2d = g.external("means2d", 8 * u64::from(gaussians.capacity));
        let into = Gradients { parameters, means2d, pose: Some(g.external("pose", 48)) };
        project_bwd(&mut g, &t, &screen, &handles, &visible, &sums, &into)?;
        let plan = Arc::new(g.compile(&CompileOptions::default())?);
        Executor::new(device, plan, ExecOptions::default())?;
    }
    Ok(())
}
