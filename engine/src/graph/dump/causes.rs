//! Reasons of a plan's barriers: the conflicting accesses that each one separates.
//!
//! For explanation, not verification. Tracks accesses per byte over two replays, and assigns each conflict to the
//! first barrier that covers it alone. Layout transitions and external users are not included. The verifier
//! ([`crate::graph::verify`]) checks that all conflicts are covered.

use std::collections::BTreeSet;

use crate::graph::pass::Use;
use crate::graph::plan::verify::Hazard;
use crate::graph::plan::{Accesses, Barrier, Plan};
use crate::graph::ranges::RangeMap;
use crate::graph::resource::{BufferKind, Slice};
use crate::shader::Access;

/// Two conflicting accesses that a barrier separates.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Cause {
    /// Type of the hazard.
    pub(super) hazard: Hazard,
    /// Earlier pass and its buffer. `None` as pass: readers of outputs between two replays.
    pub(super) first: (Option<usize>, usize),
    /// Later pass and its buffer, which differs from the first after aliasing.
    pub(super) second: (Option<usize>, usize),
    /// Whether the earlier access belongs to the previous replay.
    pub(super) across: bool,
    /// Whether only several barriers together cover it, this one included.
    pub(super) chained: bool,
}

/// Access to a byte.
#[derive(Clone, Copy)]
struct Event {
    pass: Option<usize>,
    buffer: usize,
    access: Access,
    accesses: Accesses,
    /// Position in the sequence of groups over all replays. Each replay's readers of outputs count as a group.
    at: usize,
}

/// Returns the hazards at each group's barrier, and last at the final barrier.
pub(super) fn causes(plan: &Plan) -> Vec<Vec<Cause>> {
    let mut walk = Walk::new(plan);
    let groups = plan.groups.len();
    for replay in 0..2 {
        for (at, group) in plan.groups.iter().enumerate() {
            for &pass in &group.passes {
                for (slice, access, used) in &plan.passes[pass].accesses {
                    let (buffer, accesses) = (slice.buffer.index(), device_accesses(*access, *used));
                    let at = replay * (groups + 1) + at;
                    walk.touch(slice, Event { pass: Some(pass), buffer, access: *access, accesses, at });
                }
            }
        }
        let at = replay * (groups + 1) + groups;
        for (buffer, info) in plan.buffers().filter(|(_, info)| info.keep) {
            let slice = buffer.slice(0, info.bytes);
            let (accesses, buffer) = (Accesses::TRANSFER_READ, buffer.index());
            walk.touch(&slice, Event { pass: None, buffer, access: Access::Read, accesses, at });
        }
    }
    walk.finish()
}

struct Walk<'p> {
    plan: &'p Plan,
    /// One map per external buffer or image, then the arena, then one per image slot.
    memory: Vec<RangeMap<Vec<Event>>>,
    seen: BTreeSet<[usize; 6]>,
    found: Vec<Vec<Cause>>,
    /// Conflicts that no single barrier covers, with both accesses.
    chained: Vec<(Cause, Event, Event)>,
}

impl<'p> Walk<'p> {
    fn new(plan: &'p Plan) -> Self {
        let slots = plan.image_slots.iter().map(|slot| slot.bytes());
        let sizes = plan.buffers.iter().map(|info| info.bytes).chain([plan.arena_bytes.max(1)]).chain(slots);
        Walk {
            plan,
            memory: sizes.map(|bytes| RangeMap::new(bytes, Vec::new())).collect(),
            seen: BTreeSet::new(),
            found: vec![Vec::new(); plan.groups.len() + 1],
            chained: Vec::new(),
        }
    }

    fn touch(&mut self, slice: &Slice, event: Event) {
        let info = &self.plan.buffers[event.buffer];
        let (space, offset) = match (info.kind, self.plan.placements[event.buffer]) {
            (BufferKind::Transient, Some(slot)) if info.image.is_some() => {
                (self.plan.buffers.len() + 1 + slot as usize, 0)
            }
            (BufferKind::Transient, Some(offset)) => (self.plan.buffers.len(), offset),
            (BufferKind::Transient, None) => return,
            _ => (event.buffer, 0),
        };
        let range = slice.range();
        let mut conflicts = Vec::new();
        self.memory[space].update(range.start + offset..range.end + offset, |recent| {
            let mut read_since = false;
            for earlier in recent.iter().rev() {
                // A reader between two writes already orders them.
                let redundant = earlier.access != Access::Read && event.access == Access::Write && read_since;
                if let (Some(hazard), false) = (conflict(earlier, &event), redundant) {
                    let seen = if read_since { stores() } else { Accesses::NONE };
                    conflicts.push((hazard, *earlier, event.accesses.without(seen)));
                }
                read_since |= earlier.access == Access::Read;
            }
            if matches!(event.access, Access::Write | Access::ReadWrite) {
                recent.clear();
            }
            recent.push(event);
        });
        for (hazard, earlier, visible) in conflicts {
            self.add(hazard, &earlier, &event, visible);
        }
    }

    /// Adds a conflict. `visible`: accesses of the second side that must see the first side's write.
    fn add(&mut self, hazard: Hazard, first: &Event, second: &Event, visible: Accesses) {
        let length = self.plan.groups.len() + 1;
        let number = |pass: Option<usize>| pass.map_or(0, |pass| pass + 1);
        let across = first.at / length != second.at / length;
        let key =
            [number(first.pass), first.buffer, number(second.pass), second.buffer, hazard as usize, across.into()];
        // Conflicts within the second replay repeat those within the first.
        if first.at == second.at || first.at >= length || !self.seen.insert(key) {
            return;
        }
        let (one, other) = ((first.pass, first.buffer), (second.pass, second.buffer));
        let cause = Cause { hazard, first: one, second: other, across, chained: false };
        let covered = |at: &usize| self.barrier(*at).is_some_and(|b| covers(&b, first, second, visible));
        match (first.at + 1..=second.at).find(covered) {
            Some(at) => self.found[at % length].push(cause),
            None => self.chained.push((Cause { chained: true, ..cause }, *first, *second)),
        }
    }

    /// Returns the barrier before a position of the sequence.
    fn barrier(&self, at: usize) -> Option<Barrier> {
        let at = at % (self.plan.groups.len() + 1);
        self.plan.groups.get(at).map_or(self.plan.final_barrier, |group| group.barrier)
    }

    /// Assigns each chain to the barriers at its ends. Also assigns it to barriers that have no other reason.
    fn finish(mut self) -> Vec<Vec<Cause>> {
        let length = self.plan.groups.len() + 1;
        for (cause, first, second) in std::mem::take(&mut self.chained) {
            for at in first.at + 1..=second.at {
                let Some(barrier) = self.barrier(at) else { continue };
                let ends = barrier.src_stage.contains(first.accesses.stages())
                    || barrier.dst_stage.contains(second.accesses.stages());
                let found = &mut self.found[at % length];
                if (ends || found.is_empty()) && !found.contains(&cause) {
                    found.push(cause);
                }
            }
        }
        self.found
    }
}

/// Returns the device accesses of an access.
fn device_accesses(access: Access, used: Use) -> Accesses {
    match (used, access) {
        (Use::Indirect, _) => Accesses::INDIRECT_READ,
        (Use::Uniform, _) => Accesses::UNIFORM_READ,
        (Use::Transfer, Access::Read) => Accesses::TRANSFER_READ,
        (Use::Transfer, _) => Accesses::TRANSFER_WRITE,
        (Use::Compute, Access::Read) => Accesses::STORAGE_READ,
        (Use::Compute, Access::Write) => Accesses::STORAGE_WRITE,
        (Use::Compute, _) => Accesses::STORAGE_READ | Accesses::STORAGE_WRITE,
    }
}

/// Returns the hazard between two accesses, if they conflict.
fn conflict(first: &Event, second: &Event) -> Option<Hazard> {
    match (first.access, second.access) {
        (Access::Read, Access::Read) => None,
        (Access::Accumulate, Access::Accumulate) if first.buffer == second.buffer => None,
        (Access::Read, _) => Some(Hazard::WriteAfterRead),
        (_, Access::Read) => Some(Hazard::ReadAfterWrite),
        (_, Access::ReadWrite | Access::Accumulate) if first.buffer == second.buffer => Some(Hazard::ReadAfterWrite),
        _ => Some(Hazard::WriteAfterWrite),
    }
}

/// Returns whether one barrier alone separates the two.
fn covers(barrier: &Barrier, first: &Event, second: &Event, visible: Accesses) -> bool {
    let written = first.accesses.intersection(stores());
    barrier.src_stage.contains(first.accesses.stages())
        && barrier.dst_stage.contains(second.accesses.stages())
        && (written.is_empty() || barrier.src_access.contains(written) && barrier.dst_access.contains(visible))
}

/// Returns all write accesses.
fn stores() -> Accesses {
    Accesses::STORAGE_WRITE | Accesses::TRANSFER_WRITE
}
