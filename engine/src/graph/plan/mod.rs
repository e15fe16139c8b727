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
mod queue;
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
    /// Whether passes may go to a second queue.
    pub queues: Queues,
}

impl Default for CompileOptions {
    /// Returns options with an alignment that suits every device, all steps enabled, one queue.
    fn default() -> Self {
        CompileOptions { alignment: 256, alias: true, reorder: true, verify: true, queues: Queues::One }
    }
}

/// Number of queues of a plan.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub enum Queues {
    /// One queue.
    #[default]
    One,
    /// A second queue where that shortens a replay, by the costs of [`Graph::set_costs`] or an estimate from bytes.
    Two {
        /// Minimum gain in percent of a replay's time.
        gain_percent: u32,
        /// Cost of a wait between queues in nanoseconds.
        wait_nanoseconds: u32,
    },
    /// A second queue wherever possible, for tests.
    Forced,
}

/// Command sequence of a plan.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Hash, serde::Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Lane {
    /// Device's main queue; runs the beginning and end of every replay.
    Main,
    /// Second queue.
    Side,
}

/// Groups that one lane runs without waiting in between.
///
/// A segment begins after the segments in `waits` have ended and earlier segments of its lane have begun: on its own
/// lane, only barriers order memory. A wait for a segment covers all work of its lane up to its end and makes it
/// visible.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Segment {
    /// Lane of the segment.
    pub lane: Lane,
    /// Range of [`Plan::groups`].
    pub groups: std::ops::Range<usize>,
    /// Indices of earlier segments in [`Plan::segments`].
    pub waits: Vec<usize>,
    /// Barrier after its last group; on the second lane, makes results visible to the host.
    pub last: Option<Barrier>,
}

/// Final barrier of a segment of the second lane.
const RESULTS: Barrier = Barrier {
    src_stage: Stages::COMPUTE.and(Stages::TRANSFER),
    src_access: Accesses::STORAGE_WRITE.and(Accesses::TRANSFER_WRITE),
    dst_stage: Stages::HOST,
    dst_access: Accesses::HOST_READ,
};

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
    /// Segments of both lanes in submission order. The first and last belong to the main lane; the last one ends
    /// after all others.
    pub segments: Vec<Segment>,
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

/// Passes without hazards between them, which may run concurrently and in any order.
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
        let spans = queue::spans(self.groups.len(), &self.segments);
        alias::lifetimes(&self.buffers, &self.passes, &self.groups, &spans)
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
    let Graph { name, buffers, passes, costs, .. } = graph;
    let key = key(&name, &buffers, &passes, &costs, options);
    let live = cull::cull(&buffers, &passes);
    let dependencies = depend::depend(&buffers, &passes, &live);
    let order = order::order(&buffers, &passes, &live, &dependencies, options.reorder);
    let (mut groups, mut segments) = queue::lanes(&buffers, &passes, &dependencies, order, &costs, options);
    let spans = queue::spans(groups.len(), &segments);
    let lifetimes = alias::lifetimes(&buffers, &passes, &groups, &spans);
    let homes = image::homes(&buffers, &passes, &live);
    let layout = alias::alias(&buffers, &lifetimes, &homes, options.alignment.max(16), options.alias);
    let (entry, exit) = image::transitions(&buffers, &homes, &layout);
    image::at_least_one_group(&entry, &mut groups, &mut segments);
    let inputs =
        barrier::BarrierInputs { buffers: &buffers, passes: &passes, layout: &layout, entry: &entry, exit: &exit };
    let final_barrier = barrier::place_lanes(&inputs, &mut groups, &segments);
    Plan {
        name,
        groups,
        segments,
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
