//! Compiled graph: live passes in groups, the barriers between them, and the placement of transients.
//!
//! A plan is pure data. It references no device object, can be printed, compared and verified without a device, and
//! replayed any number of times. Replays of one plan may follow each other on a queue without waiting: the barrier of
//! the first group covers the hazards with the previous replay. Between *different* plans, and between a plan and
//! other commands, the caller inserts [`Barrier::FULL`]. Only copies from outputs after a replay need none.
//!
//! Compilation runs small steps, one per file: `cull` unneeded passes, `depend` and `order` the others into groups,
//! `alias` the transients in an arena, and place each `barrier` by the `hazard`s it must cover, which `clock`s
//! measure. `verify` checks the result with independent code and an independent model.

mod alias;
mod barrier;
mod clock;
mod cull;
mod depend;
mod hazard;
mod image;
mod key;
mod order;
pub mod scope;
pub mod verify;

pub use image::{ImageMemory, ImageSlot, Transition};
pub(in crate::graph) use key::key;
pub use scope::{Accesses, Barrier, Stages};

use super::builder::Graph;
use super::pass::Pass;
use super::resource::{Buffer, BufferInfo, ImageState};

/// Options of graph compilation.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct CompileOptions {
    /// Alignment of the offsets of bound slices and transients in bytes; a power of two.
    pub alignment: u64,
    /// Whether transients alias memory.
    pub alias: bool,
    /// Whether passes may leave their declared order.
    pub reorder: bool,
    /// Whether the plan is verified before it is returned.
    pub verify: bool,
}

impl Default for CompileOptions {
    /// Returns options with all steps enabled. The alignment suits every device.
    fn default() -> Self {
        CompileOptions { alignment: 256, alias: true, reorder: true, verify: true }
    }
}

/// Compiled graph.
#[derive(Clone, Debug)]
pub struct Plan {
    /// Name of the graph.
    pub name: String,
    /// Every declared buffer, by [`Buffer::index`].
    pub buffers: Vec<BufferInfo>,
    /// Every declared pass in declared order, including culled ones.
    pub passes: Vec<Pass>,
    /// Groups in submission order.
    pub groups: Vec<Group>,
    /// Size of the arena in bytes.
    pub arena_bytes: u64,
    /// Size of the arena without aliasing in bytes.
    pub arena_unaliased_bytes: u64,
    /// By buffer: arena offset of a used transient; for an image, its slot.
    pub placements: Vec<Option<u64>>,
    /// Images shared by transient images.
    pub image_slots: Vec<ImageSlot>,
    /// By buffer: layout of a used image from the first group to the last.
    pub homes: Vec<Option<ImageState>>,
    /// Layout transitions inside the barrier before the first group.
    pub entry: Vec<Transition>,
    /// Layout transitions inside the barrier after the last group.
    pub exit: Vec<Transition>,
    /// Passes that no output needs, ascending.
    pub culled: Vec<usize>,
    /// Barrier after the last group: makes outputs visible to the host and to copies. It is part of the replay: the
    /// next replay's first barrier relies on it.
    pub final_barrier: Option<Barrier>,
    /// Hash of the declaration and of the options that affect the plan.
    pub key: u64,
}

/// Passes without hazards between them. They may run concurrently and in any order.
#[derive(Clone, PartialEq, Eq, Debug, Default)]
pub struct Group {
    /// Barrier before the group, if any.
    pub barrier: Option<Barrier>,
    /// Indices into [`Plan::passes`].
    pub passes: Vec<usize>,
}

impl Plan {
    /// Returns the handle of a buffer by its index in [`Plan::buffers`].
    pub fn buffer(&self, index: usize) -> Buffer {
        Buffer(index as u32)
    }

    /// Returns, by buffer, first and last group of a used transient; a kept one lives past the last group.
    pub fn lifetimes(&self) -> Vec<Option<(usize, usize)>> {
        alias::lifetimes(&self.buffers, &self.passes, &self.groups)
    }

    /// Returns, by pass, the passes that it depends on, ascending. Redundant edges are omitted where that is free;
    /// empty for culled passes.
    pub fn dependencies(&self) -> Vec<Vec<u32>> {
        let mut live = vec![true; self.passes.len()];
        self.culled.iter().for_each(|&pass| live[pass] = false);
        depend::depend(&self.buffers, &self.passes, &live)
    }

    /// Iterates over the declared buffers with their handles.
    pub fn buffers(&self) -> impl Iterator<Item = (Buffer, &BufferInfo)> {
        self.buffers.iter().enumerate().map(|(index, info)| (Buffer(index as u32), info))
    }
}

/// Compiles a valid declaration.
pub(super) fn compile(graph: Graph, options: &CompileOptions) -> Plan {
    let Graph { name, buffers, passes, .. } = graph;
    let key = key(&name, &buffers, &passes, options);
    let live = cull::cull(&buffers, &passes);
    let dependencies = depend::depend(&buffers, &passes, &live);
    let order = order::order(&buffers, &passes, &live, &dependencies, options.reorder);
    let filled = order.into_iter().filter(|passes| !passes.is_empty());
    let mut groups: Vec<Group> = filled.map(|passes| Group { barrier: None, passes }).collect();
    let lifetimes = alias::lifetimes(&buffers, &passes, &groups);
    let homes = image::homes(&buffers, &passes, &live);
    let layout = alias::alias(&buffers, &lifetimes, &homes, options.alignment.max(16), options.alias);
    let (entry, exit) = image::transitions(&buffers, &homes, &layout);
    image::at_least_one_group(&entry, &mut groups);
    let inputs =
        barrier::BarrierInputs { buffers: &buffers, passes: &passes, layout: &layout, entry: &entry, exit: &exit };
    let final_barrier = barrier::place(&inputs, &mut groups);
    Plan {
        name,
        groups,
        arena_bytes: layout.bytes,
        arena_unaliased_bytes: layout.unaliased_bytes,
        placements: layout.placements,
        image_slots: layout.slots,
        homes,
        entry,
        exit,
        culled: (0..passes.len()).filter(|&index| !live[index]).collect(),
        final_barrier,
        key,
        buffers,
        passes,
    }
}
