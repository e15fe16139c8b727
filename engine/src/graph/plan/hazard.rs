//! What each group needs of the memory operations before it.
//!
//! Walks the groups in order with the last writes and reads of every byte: of external buffers each by itself, of the
//! arena as one stretch, so that memory passed from one transient to another needs what any memory needs. Points in
//! time are numbers, and only the latest of a kind is kept: whatever orders a later operation after it also orders the
//! earlier ones of that kind.

use std::ops::Range;

use super::alias::Layout;
use super::clock::Transitions;
use super::image::ImageMemory;
use super::scope::{Accesses, Stages};
use crate::graph::pass::{Use, writes};
use crate::graph::ranges::RangeMap;
use crate::graph::resource::{BufferInfo, BufferKind, BufferState, Slice};
use crate::shader::Access;

/// A position in the stream of groups; 0 is before everything.
pub(super) type Time = u32;

/// Kinds of access that write, with the stage that performs them.
pub(super) const WRITES: [(Accesses, Stages); 3] = [
    (Accesses::STORAGE_WRITE, Stages::COMPUTE),
    (Accesses::TRANSFER_WRITE, Stages::TRANSFER),
    (Accesses::OUTSIDE_WRITE, Stages::OUTSIDE),
];

/// Rows of executions: the stages, and the layout transitions at the beginning and at the end of a replay.
pub(super) const ROWS: usize = Stages::EACH.len() + 2;
/// Rows of memory: the kinds of write, and the same transitions.
pub(super) const MEMORY_ROWS: usize = WRITES.len() + 2;
/// Column of executions that a transition inside the barrier itself waits for.
pub(super) const INSIDE: usize = Stages::EACH.len();
/// Column of writes that a transition inside the barrier itself must find available.
pub(super) const TRANSITION_ACCESS: usize = Accesses::EACH.len();

/// Position of the host in [`Stages::EACH`]. Its reads leave no trace: no barrier can wait for them.
const HOST: usize = 3;

/// What must have happened: the latest time of each kind of earlier operation that matters.
#[derive(Clone, Copy, Default, Debug)]
pub(super) struct Need {
    /// By stage of an earlier operation and stage that must wait for it (positions in [`Stages::EACH`]).
    pub(super) execution: [[Time; INSIDE + 1]; ROWS],
    /// By kind of earlier write (position in [`WRITES`]) and access that must see it (in [`Accesses::EACH`]).
    pub(super) memory: [[Time; TRANSITION_ACCESS + 1]; MEMORY_ROWS],
}

/// The stage of an access and what it does there.
pub(super) fn scope(access: Access, used: Use) -> (Stages, Accesses) {
    match used {
        Use::Compute => {
            let accesses = match access {
                Access::Read => Accesses::STORAGE_READ,
                Access::Write => Accesses::STORAGE_WRITE,
                Access::ReadWrite | Access::Accumulate => Accesses::STORAGE_READ | Accesses::STORAGE_WRITE,
            };
            (Stages::COMPUTE, accesses)
        }
        Use::Uniform => (Stages::COMPUTE, Accesses::UNIFORM_READ),
        Use::Indirect => (Stages::INDIRECT, Accesses::INDIRECT_READ),
        Use::Transfer if writes(access) => (Stages::TRANSFER, Accesses::TRANSFER_WRITE),
        Use::Transfer => (Stages::TRANSFER, Accesses::TRANSFER_READ),
    }
}

/// Position of a single stage in [`Stages::EACH`].
pub(super) fn stage_index(stage: Stages) -> usize {
    stage.bits().trailing_zeros() as usize
}

/// The operations on a byte that later ones may conflict with: latest time of each kind since the last write.
#[derive(Clone, Copy, Default)]
struct Touched {
    writes: [Time; MEMORY_ROWS],
    reads: [Time; Stages::EACH.len()],
    /// Every write counted here is an accumulation into this buffer.
    accumulates: Option<u32>,
}

/// All memory that a plan touches.
pub(super) struct Memory<'p> {
    buffers: &'p [BufferInfo],
    placements: &'p [Option<u64>],
    arena: RangeMap<Touched>,
    /// By slot of the transient images.
    slots: Vec<RangeMap<Touched>>,
    /// Whether the buffers of each history have changed places.
    pub(super) swapped: bool,
    external: Vec<Option<RangeMap<Touched>>>,
}

impl<'p> Memory<'p> {
    /// Memory that nothing has touched.
    pub(super) fn new(buffers: &'p [BufferInfo], layout: &'p Layout) -> Self {
        let external = buffers
            .iter()
            .map(|info| {
                // What no pass writes cannot conflict.
                let shared = info.entry == BufferState::Queue || info.exit == BufferState::Queue;
                let changes = info.writable() || shared;
                let tracked = match info.kind {
                    BufferKind::External => changes,
                    BufferKind::History => true,
                    BufferKind::Transient | BufferKind::Uniform => false,
                };
                tracked.then(|| RangeMap::new(info.bytes, Touched::default()))
            })
            .collect();
        let arena = RangeMap::new(layout.bytes.max(1), Touched::default());
        let slots = layout.slots.iter().map(|slot| RangeMap::new(slot.bytes(), Touched::default())).collect();
        Memory { buffers, placements: &layout.placements, arena, slots, swapped: false, external }
    }

    /// One access at a time: what it needs is added to `need`, and it becomes part of the past.
    pub(super) fn touch(&mut self, now: Time, slice: &Slice, access: Access, used: Use, need: &mut Need) {
        let (stage, accesses) = scope(access, used);
        self.touch_scope(now, slice, stage, accesses, access, need);
    }

    /// Commands outside that may read and write a buffer, without anything to wait for.
    pub(super) fn outside(&mut self, now: Time, slice: &Slice) {
        let accesses = Accesses::OUTSIDE_READ | Accesses::OUTSIDE_WRITE;
        self.touch_scope(now, slice, Stages::OUTSIDE, accesses, Access::ReadWrite, &mut Need::default());
    }

    /// What commands outside need that may read and write a buffer, whatever they leave.
    pub(super) fn leave(&mut self, slice: &Slice, need: &mut Need) {
        let accesses = Accesses::OUTSIDE_READ | Accesses::OUTSIDE_WRITE;
        let Some((map, range)) = self.find(slice) else { return };
        map.update(range, |touched| {
            // What others did before is their own affair.
            let mut ours = *touched;
            ours.writes[2] = 0;
            ours.needs(stage_index(Stages::OUTSIDE), accesses, true, need);
        });
    }

    /// A layout transition of all of an image's memory inside the barrier of `need`.
    pub(super) fn transition(&mut self, now: Time, image: ImageMemory, which: Transitions, need: &mut Need) {
        let Some((_, row)) = which.rows() else { return };
        let map = match image {
            ImageMemory::Slot(slot) => Some(&mut self.slots[slot as usize]),
            ImageMemory::External(image) => self.external[image.index()].as_mut(),
        };
        let Some(map) = map else { return };
        map.update(0..u64::MAX, |touched| {
            let read = touched.reads.iter().any(|&earlier| earlier > 0);
            for (earlier, need) in touched.reads.iter().zip(&mut need.execution) {
                need[INSIDE] = need[INSIDE].max(*earlier);
            }
            if !read {
                for (earlier, need) in touched.writes.iter().zip(&mut need.memory) {
                    need[TRANSITION_ACCESS] = need[TRANSITION_ACCESS].max(*earlier);
                }
            }
            *touched = Touched::default();
            touched.writes[row] = now;
        });
    }

    /// A read of a kind that no pass makes.
    pub(super) fn read(&mut self, now: Time, slice: &Slice, accesses: Accesses, need: &mut Need) {
        self.touch_scope(now, slice, accesses.stages(), accesses, Access::Read, need);
    }

    fn touch_scope(
        &mut self,
        now: Time,
        slice: &Slice,
        stage: Stages,
        accesses: Accesses,
        access: Access,
        need: &mut Need,
    ) {
        let Some((map, range)) = self.find(slice) else { return };
        let stage = stage_index(stage);
        let writes = writes(access);
        let accumulates = (access == Access::Accumulate).then_some(slice.buffer.0);
        map.update(range, |touched| {
            let commutes = accumulates.is_some() && touched.accumulates == accumulates;
            touched.needs(stage, if commutes { Accesses::NONE } else { accesses }, writes, need);
            if writes {
                if !commutes {
                    *touched = Touched { accumulates, ..Touched::default() };
                }
                let kind = WRITES.iter().position(|&(_, writer)| stage_index(writer) == stage);
                touched.writes[kind.expect("invariant: a stage that writes")] = now;
                touched.reads = Default::default();
            } else if stage != HOST {
                touched.reads[stage] = now;
            }
        });
    }

    /// The memory of a slice and the bytes there; nothing where nothing can conflict.
    fn find(&mut self, slice: &Slice) -> Option<(&mut RangeMap<Touched>, Range<u64>)> {
        let buffer = slice.buffer.index();
        let info = &self.buffers[buffer];
        if info.kind != BufferKind::Transient {
            let partner = info.pair.filter(|_| self.swapped).map(|pair| pair.partner.index());
            return self.external[partner.unwrap_or(buffer)].as_mut().map(|map| (map, slice.range()));
        }
        let place = self.placements[buffer].expect("invariant: a touched transient is placed");
        match info.image {
            Some(_) => Some((&mut self.slots[place as usize], slice.range())),
            None => Some((&mut self.arena, place + slice.offset..place + slice.offset + slice.bytes)),
        }
    }
}

impl Touched {
    /// Adds what an operation of a stage needs of the ones before it.
    fn needs(&self, stage: usize, accesses: Accesses, writes: bool, need: &mut Need) {
        // Who has read a write has seen it; to write after such a reader, waiting for the reader is enough.
        let read = self.reads.iter().any(|&earlier| earlier > 0);
        let stores = WRITES.iter().fold(Accesses::NONE, |all, &(access, _)| all | access);
        let accesses = if read { accesses.without(stores) } else { accesses };
        for (earlier, need) in self.writes.iter().zip(&mut need.memory) {
            for (need, access) in need.iter_mut().zip(Accesses::EACH) {
                if accesses.contains(access) {
                    *need = (*need).max(*earlier);
                }
            }
        }
        if writes {
            for (earlier, need) in self.reads.iter().zip(&mut need.execution) {
                need[stage] = need[stage].max(*earlier);
            }
        }
    }
}
