//! Graph of a view from its Gaussians to the entries of its tiles.

use super::SIZE;
use sgs_engine::Device;
use sgs_engine::exec::{ExecOptions, Executor};
use sgs_engine::graph::{CompileOptions, Graph};
use sgs_passes::Tuning;
use sgs_passes::pipeline::Step;
use sgs_passes::scene::{Gaussians, Handles, Model};
use sgs_passes::splat::{Channels, Entries, Screen, Visible, intersect, project};
use std::sync::Arc;

/// Largest number of entries.
pub const CAPACITY: u32 = 1 << 14;

/// Unfinished graph of a view.
pub struct EntryGraph {
    pub graph: Graph,
    pub model: Model,
    pub gaussians: Gaussians,
    pub handles: Handles,
    pub screen: Screen,
    pub visible: Visible,
    pub entries: Entries,
    /// Bytes of an image of all channels.
    pub image_bytes: u64,
}

impl EntryGraph {
    /// Projects Gaussians and lists the entries of the tiles.
    pub fn new(device: &Device, name: &str, t: &Tuning, channels: Channels) -> anyhow::Result<EntryGraph> {
        let model = Model { sh_degree: 3, normals: channels.normals, semantics: false, mip: false };
        let gaussians = Gaussians::new(device, model, 1000, false)?;
        let mut graph = Graph::new(name);
        let step = graph.uniform("step", size_of::<Step>() as u64);
        let screen = Screen { step, largest: SIZE, tile: t.tile };
        let handles = gaussians.declare(&mut graph, false);
        let flags = graph.external("flags", 4);
        graph.fill("clear_flags", flags, 0)?;
        let visible = project(&mut graph, t, &screen, &handles, channels)?;
        let entries = intersect(&mut graph, t, &screen, &visible, CAPACITY, flags)?;
        let image_bytes = 4 * u64::from(channels.count()) * screen.pixels();
        Ok(EntryGraph { graph, model, gaussians, handles, screen, visible, entries, image_bytes })
    }

    /// Compiles the kernels of the graph.
    pub fn finish(self, device: &Device) -> anyhow::Result<()> {
        let plan = Arc::new(self.graph.compile(&CompileOptions::default())?);
        Executor::new(device, plan, ExecOptions::default())?;
        Ok(())
    }
}
