//! Needs of each group: earlier memory operations that must be ordered or visible before it.
//!
//! Walks the groups in order and tracks the last writes and reads of every byte: external buffers each by itself, the
//! arena as one range, so that reused memory has ordinary hazards. Times are numbers. Only the latest operation of
//! each kind is stored: whatever orders a later operation after it also orders the earlier ones of that kind.

use std::ops::Range;

use super::alias::Layout;
use super::clock::Transitions;
use super::image::ImageMemory;
use super::scope::{Accesses, Stages};
use crate::graph::pass::{Use, writes};
use crate::graph::ranges::RangeMap;
use crate::graph::resource::{BufferInfo, BufferKind, BufferState, Slice};
use crate::shader::Access;

/// Position in the sequence of groups; 0 is before everything.
pub(super) type Time = u32;

/// Kinds of write access, with the stage that performs them.
pub(super) const WRITES: [(Accesses, Stages); 3] = [
    (Accesses::STORAGE_WRITE, Stages::COMPUTE),
    (Accesses::TRANSFER_WRITE, Stages::TRANSFER),
    (Accesses::OUTSIDE_WRITE, Stages::OUTSIDE),
];

/// Rows of executions: the stages, then the layout transitions at the beginning and end of a replay.
pub(super) const ROWS: usize = Stages::ALL.len() + 2;
/// Rows of memory: the kinds of write, then the same transitions.
pub(super) const MEMORY_ROWS: usize = WRITES.len() + 2;
/// Column of executions for a transition inside the barrier itself.
pub(super) const INSIDE: usize = Stages::ALL.len();
/// Column of writes that must be available to a transition. The transition is inside the barrier itself.
pub(super) const TRANSITION_ACCESS: usize = Accesses::ALL.len();

/// Position of the host in [`Stages::ALL`]. Host reads are not tracked: no barrier can wait for them.
const HOST: usize = 3;

/// Requirements on earlier operations: the latest time of each relevant kind.
#[derive(Clone, Copy, Default, Debug)]
pub(super) struct Need {
    /// By stage of an earlier operation and stage that must wait for it. Indices are positions in [`Stages::ALL`].
    pub(super) execution: [[Time; INSIDE + 1]; ROWS],
    /// By kind of earlier write and access that must see it. Indices are positions in [`WRITES`] and [`Accesses::ALL`].
    pub(super) memory: [[Time; TRANSITION_ACCESS + 1]; MEMORY_ROWS],
}

/// Returns the stage and access flags of an access.
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

/// Returns the position of a single stage in [`Stages::ALL`].
pub(super) fn stage_index(stage: Stages) -> usize {
    stage.bits().trailing_zeros() as usize
}

/// Accesses of a byte that later ones may conflict with: latest time of each kind since the last write.
#[derive(Clone, Copy, Default)]
struct AccessTimes {
    writes: [Time; MEMORY_ROWS],
    reads: [Time; Stages::ALL.len()],
    /// Buffer into which all tracked writes accumulate, if they do.
    accumulates: Option<u32>,
}

/// All memory that a plan accesses.
pub(super) struct Memory<'p> {
    buffers: &'p [BufferInfo],
    placements: &'p [Option<u64>],
    arena: RangeMap<AccessTimes>,
    /// By image slot.
    slots: Vec<RangeMap<AccessTimes>>,
    external: Vec<Option<RangeMap<AccessTimes>>>,
}

impl<'p> Memory<'p> {
    /// Creates memory without accesses.
    pub(super) fn new(buffers: &'p [BufferInfo], layout: &'p Layout) -> Self {
        let external = buffers
            .iter()
            .map(|info| {
                // Buffers that no pass writes cannot conflict.
                let shared = info.entry == BufferState::Queue || info.exit == BufferState::Queue;
                let changes = info.writable() || shared;
                let tracked = match info.kind {
                    BufferKind::External => changes,
                    BufferKind::Transient | BufferKind::Uniform => false,
                };
                tracked.then(|| RangeMap::new(info.bytes, AccessTimes::default()))
            })
            .collect();
        let arena = RangeMap::new(layout.bytes.max(1), AccessTimes::default());
        let slots = layout.slots.iter().map(|slot| RangeMap::new(slot.bytes(), AccessTimes::default())).collect();
        Memory { buffers, placements: &layout.placements, arena, slots, external }
    }

    /// Adds the needs of one access to `need` and records the access.
    pub(super) fn touch(&mut self, now: Time, slice: &Slice, access: Access, used: Use, need: &mut Need) {
        let (stage, accesses) = scope(access, used);
        self.touch_scope(now, slice, stage, accesses, access, need);
    }

    /// Records external commands that may read and write a buffer, without needs.
    pub(super) fn external_before(&mut self, now: Time, slice: &Slice) {
        let accesses = Accesses::OUTSIDE_READ | Accesses::OUTSIDE_WRITE;
        self.touch_scope(now, slice, Stages::OUTSIDE, accesses, Access::ReadWrite, &mut Need::default());
    }

    /// Adds the needs of external commands after the replay. They may read and write the buffer.
    pub(super) fn external_after(&mut self, slice: &Slice, need: &mut Need) {
        let accesses = Accesses::OUTSIDE_READ | Accesses::OUTSIDE_WRITE;
        let Some((map, range)) = self.find(slice) else { return };
        map.update(range, |times| {
            // Earlier external commands are not ordered by the plan.
            let mut ours = *times;
            ours.writes[2] = 0;
            ours.needs(stage_index(Stages::OUTSIDE), accesses, true, need);
        });
    }

    /// Records a layout transition of a whole image inside the barrier of `need`.
    pub(super) fn transition(&mut self, now: Time, image: ImageMemory, which: Transitions, need: &mut Need) {
        let Some((_, row)) = which.rows() else { return };
        let map = match image {
            ImageMemory::Slot(slot) => Some(&mut self.slots[slot as usize]),
            ImageMemory::External(image) => self.external[image.index()].as_mut(),
        };
        let Some(map) = map else { return };
        map.update(0..u64::MAX, |times| {
            let read = times.reads.iter().any(|&earlier| earlier > 0);
            for (earlier, need) in times.reads.iter().zip(&mut need.execution) {
                need[INSIDE] = need[INSIDE].max(*earlier);
            }
            if !read {
                for (earlier, need) in times.writes.iter().zip(&mut need.memory) {
                    need[TRANSITION_ACCESS] = need[TRANSITION_ACCESS].max(*earlier);
                }
            }
            *times = AccessTimes::default();
            times.writes[row] = now;
        });
    }

    /// Records a read of a kind that no pass makes.
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
        map.update(range, |times| {
            let commutes = accumulates.is_some() && times.accumulates == accumulates;
            times.needs(stage, if commutes { Accesses::NONE } else { accesses }, writes, need);
            if writes {
                if !commutes {
                    *times = AccessTimes { accumulates, ..AccessTimes::default() };
                }
                let kind = WRITES.iter().position(|&(_, writer)| stage_index(writer) == stage);
                times.writes[kind.expect("invariant: a stage that writes")] = now;
                times.reads = Default::default();
            } else if stage != HOST {
                times.reads[stage] = now;
            }
        });
    }

    /// Returns the map of a slice's memory and its range; `None` if it cannot conflict.
    fn find(&mut self, slice: &Slice) -> Option<(&mut RangeMap<AccessTimes>, Range<u64>)> {
        let buffer = slice.buffer.index();
        let info = &self.buffers[buffer];
        if info.kind != BufferKind::Transient {
            return self.external[buffer].as_mut().map(|map| (map, slice.range()));
        }
        let place = self.placements[buffer].expect("invariant: a touched transient is placed");
        match info.image {
            Some(_) => Some((&mut self.slots[place as usize], slice.range())),
            None => Some((&mut self.arena, place + slice.offset..place + slice.offset + slice.bytes)),
        }
    }
}

impl AccessTimes {
    /// Adds the needs of an operation of a stage on earlier accesses.
    fn needs(&self, stage: usize, accesses: Accesses, writes: bool, need: &mut Need) {
        // A reader has seen the write before it. To write after a reader, waiting for the reader suffices.
        let read = self.reads.iter().any(|&earlier| earlier > 0);
        let stores = WRITES.iter().fold(Accesses::NONE, |all, &(access, _)| all | access);
        let accesses = if read { accesses.without(stores) } else { accesses };
        for (earlier, need) in self.writes.iter().zip(&mut need.memory) {
            for (need, access) in need.iter_mut().zip(Accesses::ALL) {
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
