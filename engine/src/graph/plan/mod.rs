//! A compiled graph: which passes run, in which groups, behind which barriers, and where the transients live.
//!
//! A plan is data. It names no device object, can be printed, compared and verified without a device, and is replayed
//! as often as wanted. Replays of one plan may follow each other on a queue without waiting: the barrier of the first
//! group covers what the replay before left open. Between *different* plans, and between a plan and commands that the
//! graph does not know of, the caller puts [`Barrier::FULL`]; only copies from outputs need none after a replay.
//!
//! Compilation is a pipeline of small steps, each in its file: `cull` what no output needs, `depend` and `order` the
//! rest into groups, `alias` the transients into an arena, and place each `barrier` by the `hazard`s it must cover,
//! which `clock`s measure. `verify` checks the result with code and a model of its own.

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

/// How a graph is compiled.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct CompileOptions {
    /// What the offsets of bound slices and of transients are multiples of; a power of two.
    pub alignment: u64,
    /// Whether transients share memory.
    pub alias: bool,
    /// Whether passes may leave their declared order.
    pub reorder: bool,
    /// Whether the plan is verified before it is returned.
    pub verify: bool,
    /// Whether passes may go to a second queue.
    pub queues: Queues,
}

impl Default for CompileOptions {
    /// An alignment that suits every device, everything on.
    fn default() -> Self {
        CompileOptions { alignment: 256, alias: true, reorder: true, verify: true, queues: Queues::One }
    }
}

/// How many queues a plan is for.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub enum Queues {
    /// One.
    #[default]
    One,
    /// A second one where that shortens a replay, by the costs of [`Graph::set_costs`] or a guess from bytes.
    Two {
        /// Percent of a replay's time below which it is not worth it.
        gain_percent: u32,
        /// What one queue's waiting for the other costs.
        wait_nanoseconds: u32,
    },
    /// A second one wherever that is possible: for tests.
    Forced,
}

/// One of the two sequences of commands of a plan.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Hash, serde::Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Lane {
    /// The device's queue, which sees every replay from beginning to end.
    Main,
    /// The second queue.
    Side,
}

/// Groups that one lane runs without waiting in between. A segment begins when the segments that it waits for, and those
/// before it on its lane, have begun: on its own lane only barriers order memory. Waiting for a segment waits for all
/// that its lane did up to its end, and sees all of it.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Segment {
    /// Where it runs.
    pub lane: Lane,
    /// Positions in [`Plan::groups`].
    pub groups: std::ops::Range<usize>,
    /// Positions of earlier segments in [`Plan::segments`].
    pub waits: Vec<usize>,
    /// After its last group: on the second lane, makes results visible to the host.
    pub last: Option<Barrier>,
}

/// What a segment of the second lane ends with.
const RESULTS: Barrier = Barrier {
    src_stage: Stages::COMPUTE.and(Stages::TRANSFER),
    src_access: Accesses::STORAGE_WRITE.and(Accesses::TRANSFER_WRITE),
    dst_stage: Stages::HOST,
    dst_access: Accesses::HOST_READ,
};

/// A compiled graph.
#[derive(Clone, Debug)]
pub struct Plan {
    /// The graph's name.
    pub name: String,
    /// Every declared buffer, by [`Buffer::index`].
    pub buffers: Vec<BufferInfo>,
    /// Every declared pass in declared order, those that do not run included.
    pub passes: Vec<Pass>,
    /// What runs, in the order in which it is submitted.
    pub groups: Vec<Group>,
    /// Which groups run on which lane, and who waits for whom. The first and the last are the main lane's; the last one
    /// ends when everything has.
    pub segments: Vec<Segment>,
    /// Size of the arena.
    pub arena_bytes: u64,
    /// Size that the arena would have if no memory were shared.
    pub arena_unaliased_bytes: u64,
    /// By buffer: its offset in the arena, if it is a transient that is used; for an image the number of its slot.
    pub placements: Vec<Option<u64>>,
    /// The images that transient images live in, one after the other.
    pub image_slots: Vec<ImageSlot>,
    /// By buffer: the layout that an image is in from the first group to the last, if anything uses it.
    pub homes: Vec<Option<ImageState>>,
    /// Layouts that change inside the barrier before the first group.
    pub entry: Vec<Transition>,
    /// Layouts that change inside the barrier after the last group.
    pub exit: Vec<Transition>,
    /// The passes that no output needs, ascending.
    pub culled: Vec<usize>,
    /// After the last group: makes outputs visible to the host and to copies. As much a part of the replay as the
    /// others: the next replay's first barrier counts on it.
    pub final_barrier: Option<Barrier>,
    /// The identity of the declaration and of the options that shaped the plan.
    pub key: u64,
}

/// Passes without hazards among them, which may run at once and in any order.
#[derive(Clone, PartialEq, Eq, Debug, Default)]
pub struct Group {
    /// What is recorded before the group, if anything.
    pub barrier: Option<Barrier>,
    /// Positions in [`Plan::passes`].
    pub passes: Vec<usize>,
}

impl Plan {
    /// The handle of the buffer at a position of [`Plan::buffers`].
    pub fn buffer(&self, index: usize) -> Buffer {
        Buffer(index as u32)
    }

    /// By buffer: the first and the last group in which a transient is alive; a kept one lives past the last group.
    pub fn lifetimes(&self) -> Vec<Option<(usize, usize)>> {
        let spans = queue::spans(self.groups.len(), &self.segments);
        alias::lifetimes(&self.buffers, &self.passes, &self.groups, &spans)
    }

    /// By pass: which passes it must stay behind, ascending, without those that others imply where that is free. Empty
    /// for passes that do not run.
    pub fn dependencies(&self) -> Vec<Vec<u32>> {
        let mut lives = vec![true; self.passes.len()];
        self.culled.iter().for_each(|&pass| lives[pass] = false);
        depend::depend(&self.buffers, &self.passes, &lives)
    }

    /// The declared buffers, with their handles.
    pub fn buffers(&self) -> impl Iterator<Item = (Buffer, &BufferInfo)> {
        self.buffers.iter().enumerate().map(|(index, info)| (Buffer(index as u32), info))
    }
}

/// Compiles a declaration that the builder has found meaningful.
pub(super) fn compile(graph: Graph, options: &CompileOptions) -> Plan {
    let Graph { name, buffers, passes, costs, .. } = graph;
    let key = key(&name, &buffers, &passes, &costs, options);
    let lives = cull::cull(&buffers, &passes);
    let follows = depend::depend(&buffers, &passes, &lives);
    let order = order::order(&buffers, &passes, &lives, &follows, options.reorder);
    let (mut groups, mut segments) = queue::lanes(&buffers, &passes, &follows, order, &costs, options);
    let spans = queue::spans(groups.len(), &segments);
    let lifetimes = alias::lifetimes(&buffers, &passes, &groups, &spans);
    let homes = image::homes(&buffers, &passes, &lives);
    let layout = alias::alias(&buffers, &lifetimes, &homes, options.alignment.max(16), options.alias);
    let (entry, exit) = image::transitions(&buffers, &homes, &layout);
    image::at_least_one_group(&entry, &mut groups, &mut segments);
    let scene = barrier::Scene { buffers: &buffers, passes: &passes, layout: &layout, entry: &entry, exit: &exit };
    let final_barrier = barrier::place_lanes(&scene, &mut groups, &segments);
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
        culled: (0..passes.len()).filter(|&index| !lives[index]).collect(),
        final_barrier,
        key,
        buffers,
        passes,
    }
}
