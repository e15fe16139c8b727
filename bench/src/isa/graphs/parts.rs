//! Graphs of blending with every number of subgroups per tile.
//!
//! Other graphs have views of one size, and thus one number of them. Only benchmarks share splats by
//! ballots and memory.

use super::SIZE;
use sgs_engine::Device;
use sgs_engine::exec::{ExecOptions, Executor};
use sgs_engine::graph::{CompileOptions, Graph};
use sgs_passes::pipeline::Step;
use sgs_passes::scene::{Gaussians, Model};
use sgs_passes::splat::{
    BackwardKernel, Blended, Channels, Screen, blend, blend_bwd, blend_debt, blend_for, intersect, project,
};
use sgs_passes::{Sharing, Tuning};
use std::sync::Arc;

/// Builds the forward passes and the backward pass over buckets.
///
/// Each with colors alone and with all channels.
pub fn build(device: &Device) -> anyhow::Result<()> {
    let all = [1, 2, 4, 8].map(|parts| (parts, Sharing::Shuffles)).into_iter();
    let all = all.chain([Sharing::Ballots, Sharing::Memory].into_iter().flat_map(|s| [(1, s), (4, s)]));
    for (normals, (parts, sharing)) in all.flat_map(|parts| [(false, parts), (true, parts)]) {
        let t = Tuning { tile_parts: Some(parts), sharing, ..Tuning::for_device(device.info()) };
        let model = Model { sh_degree: 3, normals, semantics: false };
        let gaussians = Gaussians::new(device, model, 1000, false)?;
        let channels = Channels { colors: true, normals, depth: normals };
        let mut g = Graph::new("parts");
        let step = g.uniform("step", size_of::<Step>() as u64);
        let screen = Screen { step, largest: SIZE, tile: t.tile };
        let handles = gaussians.declare(&mut g, false);
        let flags = g.external("flags", 4);
        g.fill("clear_flags", flags, 0)?;
        let bytes = 4 * u64::from(channels.count()) * screen.pixels();
        let visible = project(&mut g, &t, &screen, &handles, channels)?;
        let entries = intersect(&mut g, &t, &screen, &visible, 1 << 14, flags)?;
        let mut blended = |name: &str| Blended {
            image: g.external(format!("{name}.image"), bytes),
            transmittance: g.external(format!("{name}.transmittance"), 4 * screen.pixels()),
        };
        let [plain, kept, gradient] = ["plain", "kept", "gradient"].map(&mut blended);
        blend(&mut g, &t, &screen, &visible, &entries, &plain)?;
        let which = BackwardKernel::Bucket;
        let buckets = blend_for(&mut g, &t, &screen, &visible, &entries, &kept, which)?;
        let mut owed = blend_debt(&mut g, &t, &screen, channels.count(), &kept, &gradient)?;
        owed.buckets = buckets;
        let sums = blend_bwd(&mut g, &t, &screen, &visible, &entries, &owed, which, true)?;
        let rows = g.external("rows", 4 * u64::from(7 + channels.count()) * (1 << 14));
        g.copy("keep", sums.gradients, rows)?;
        let plan = Arc::new(g.compile(&CompileOptions::default())?);
        Executor::new(device, plan, ExecOptions::default())?;
    }
    Ok(())
}
