//! Graph of a render with the gradients of its parameters and of the pose.
//!
//! The Python package builds the same.

use super::entries::EntryGraph;
use sgs_engine::Device;
use sgs_passes::Tuning;
use sgs_passes::splat::{BackwardKernel, Blended, Channels, Gradients, blend, blend_bwd, blend_debt, project_bwd};

/// Builds it with and without normals.
pub fn build(device: &Device) -> anyhow::Result<()> {
    let t = Tuning::for_device(device.info());
    for normals in [false, true] {
        let channels = Channels { colors: true, normals, depth: true };
        let mut v = EntryGraph::new(device, "render_gradients", &t, channels)?;
        let (g, screen, capacity) = (&mut v.graph, &v.screen, u64::from(v.gaussians.capacity));
        let blended = Blended {
            image: g.transient("image", v.image_bytes),
            transmittance: g.transient("transmittance", 4 * screen.pixels()),
        };
        blend(g, &t, screen, &v.visible, &v.entries, &blended)?;
        let gradient = Blended {
            image: g.input("grad_image", v.image_bytes),
            transmittance: g.input("grad_transmittance", 4 * screen.pixels()),
        };
        let owed = blend_debt(g, &t, screen, channels.count(), &blended, &gradient)?;
        let sums = blend_bwd(g, &t, screen, &v.visible, &v.entries, &owed, BackwardKernel::Pixel, false)?;
        let parameters = g.external("grad_parameters", v.model.column_bytes(v.gaussians.capacity));
        let means2d = g.external("means2d", 8 * capacity);
        let into = Gradients { parameters, means2d, pose: Some(g.external("pose", 48)) };
        project_bwd(g, &t, screen, &v.handles, &v.visible, &sums, &into)?;
        v.finish(device)?;
    }
    Ok(())
}
