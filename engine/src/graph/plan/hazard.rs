//! What each group needs of the memory operations before it.
//!
//! Walks the groups in order with the last writes and reads of every byte: of external buffers each by itself, of the
//! arena as one stretch, so that memory passed from one transient to another needs what any memory needs. Points in
//! time are numbers, and only the latest of a kind is kept: whatever orders a later operation after it also orders the
//! earlier ones of that kind.

use super::scope::{Accesses, Stages};
use crate::graph::pass::{Use, writes};
use crate::graph::ranges::RangeMap;
use crate::graph::resource::{BufferInfo, BufferKind, Slice};
use crate::shader::Access;

/// A position in the stream of groups; 0 is before everything.
pub(super) type Time = u32;

/// Kinds of access that write, with the stage that performs them.
pub(super) const WRITES: [(Accesses, Stages); 2] =
    [(Accesses::STORAGE_WRITE, Stages::COMPUTE), (Accesses::TRANSFER_WRITE, Stages::TRANSFER)];

/// Position of the host in [`Stages::EACH`]. Its reads leave no trace: no barrier can wait for them.
const HOST: usize = 3;

/// What must have happened: the latest time of each kind of earlier operation that matters.
#[derive(Clone, Copy, Default, Debug)]
pub(super) struct Need {
    /// By stage of an earlier operation and stage that must wait for it (positions in [`Stages::EACH`]).
    pub(super) execution: [[Time; 4]; 4],
    /// By kind of earlier write (position in [`WRITES`]) and access that must see it (in [`Accesses::EACH`]).
    pub(super) memory: [[Time; 7]; 2],
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
    writes: [Time; 2],
    reads: [Time; 4],
    /// Every write counted here is an accumulation into this buffer.
    accumulates: Option<u32>,
}

/// All memory that a plan touches.
pub(super) struct Memory<'p> {
    buffers: &'p [BufferInfo],
    placements: &'p [Option<u64>],
    arena: RangeMap<Touched>,
    external: Vec<Option<RangeMap<Touched>>>,
}

impl<'p> Memory<'p> {
    /// Memory that nothing has touched.
    pub(super) fn new(buffers: &'p [BufferInfo], placements: &'p [Option<u64>], arena_bytes: u64) -> Self {
        let external = buffers
            .iter()
            .map(|info| {
                // What no pass writes cannot conflict.
                let tracked = info.kind == BufferKind::External && info.writable();
                tracked.then(|| RangeMap::new(info.bytes, Touched::default()))
            })
            .collect();
        Memory { buffers, placements, arena: RangeMap::new(arena_bytes.max(1), Touched::default()), external }
    }

    /// One access at a time: what it needs is added to `need`, and it becomes part of the past.
    pub(super) fn touch(&mut self, now: Time, slice: &Slice, access: Access, used: Use, need: &mut Need) {
        let (stage, accesses) = scope(access, used);
        self.touch_scope(now, slice, stage, accesses, access, need);
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
        let buffer = slice.buffer.index();
        let (map, range) = match self.buffers[buffer].kind {
            BufferKind::Transient => {
                let offset = self.placements[buffer].expect("invariant: a touched transient is placed");
                (&mut self.arena, slice.offset + offset..slice.offset + offset + slice.bytes)
            }
            BufferKind::External | BufferKind::Uniform => match &mut self.external[buffer] {
                Some(map) => (map, slice.range()),
                None => return,
            },
        };
        let stage = stage_index(stage);
        let writes = writes(access);
        let accumulates = (access == Access::Accumulate).then_some(slice.buffer.0);
        let stores = WRITES[0].0 | WRITES[1].0;
        map.update(range, |touched| {
            let commutes = accumulates.is_some() && touched.accumulates == accumulates;
            if !commutes {
                // Who has read a write has seen it; to write after such a reader, waiting for the reader is enough.
                let read = touched.reads.iter().any(|&earlier| earlier > 0);
                let accesses = if read { accesses.without(stores) } else { accesses };
                for (earlier, need) in touched.writes.iter().zip(&mut need.memory) {
                    for (index, need) in need.iter_mut().enumerate() {
                        if accesses.contains(Accesses::EACH[index]) {
                            *need = (*need).max(*earlier);
                        }
                    }
                }
            }
            if writes {
                for (earlier, need) in touched.reads.iter().zip(&mut need.execution) {
                    need[stage] = need[stage].max(*earlier);
                }
                if !commutes {
                    *touched = Touched { accumulates, ..Touched::default() };
                }
                let kind = usize::from(stage == stage_index(Stages::TRANSFER));
                touched.writes[kind] = now;
                touched.reads = [0; 4];
            } else if stage != HOST {
                touched.reads[stage] = now;
            }
        });
    }
}
