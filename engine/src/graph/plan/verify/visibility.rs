//! Visibility verification: barriers separate conflicting memory operations, through two consecutive replays.
//!
//! Two replays suffice because each does the same to the same bytes: the third meets the same state as the second.

use super::cells::Cells;
use super::ordering::{Operation, OrderingStates};
use super::shape::performs;
use super::{Hazard, Missing, VerifyError, buffer_name, pass_name};
use crate::graph::pass::Use;
use crate::graph::plan::scope::{Accesses, Barrier, Stages};
use crate::graph::plan::{ImageMemory, ImageSlot, Plan, Transition};
use crate::graph::resource::{BufferInfo, BufferKind, BufferState, Slice};
use crate::shader::Access;

/// Access of a cell.
#[derive(Clone, Copy)]
struct Event {
    operation: Operation,
    pass: usize,
    buffer: usize,
    replay: usize,
    access: Access,
}

/// Accesses of a cell in group order, starting with its last non-commuting write.
type RecentAccesses = Vec<Event>;

/// Checks the visibility of all conflicting operations.
pub(super) fn check(plan: &Plan) -> Result<(), VerifyError> {
    let mut walk = Walk::new(plan);
    let points = plan.groups.len() + 1;
    for replay in 0..REPLAYS {
        walk.replay = replay;
        walk.external_before();
        for (at, group) in plan.groups.iter().enumerate() {
            walk.time.now = walk.before[replay * points + at];
            if at == 0 {
                walk.transitions(&plan.entry, group.barrier)?;
            }
            for &pass in &group.passes {
                for (slice, access, used) in &plan.passes[pass].accesses {
                    walk.touch(replay, pass, slice, *access, *used)?;
                }
            }
        }
        walk.time.now = walk.before[replay * points + plan.groups.len()];
        walk.transitions(&plan.exit, plan.final_barrier)?;
        walk.read_outputs()?;
        walk.external_after()?;
    }
    Ok(())
}

/// Pass number of the copies that read outputs between replays.
const OUTSIDE: usize = usize::MAX;
/// Pass number of other commands on the queue.
const OTHERS: usize = usize::MAX - 1;
/// Pass number of layout transitions.
const TRANSITION: usize = usize::MAX - 2;

/// Returns the device accesses of an access.
fn device_accesses(access: Access, used: Use) -> Accesses {
    match (used, access) {
        (Use::Compute, Access::Read) => Accesses::STORAGE_READ,
        (Use::Compute, Access::Write) => Accesses::STORAGE_WRITE,
        (Use::Compute, Access::ReadWrite | Access::Accumulate) => Accesses::STORAGE_READ | Accesses::STORAGE_WRITE,
        (Use::Transfer, Access::Read) => Accesses::TRANSFER_READ,
        (Use::Transfer, Access::Write | Access::ReadWrite | Access::Accumulate) => Accesses::TRANSFER_WRITE,
        (Use::Indirect, _) => Accesses::INDIRECT_READ,
        (Use::Uniform, _) => Accesses::UNIFORM_READ,
    }
}

/// Position in the barrier sequence, with the knowledge of the past there.
struct Time {
    states: OrderingStates,
    /// Number of earlier barriers.
    now: usize,
}

impl Time {
    /// Returns an operation at the current position.
    fn operation(&mut self, accesses: Accesses) -> Operation {
        self.states.operation(self.now, accesses)
    }

    /// Returns why stages are not ordered after an event; `None` if they are.
    fn unordered(&mut self, event: &Event, stages: Stages) -> Option<Missing> {
        let unordered = self.states.unordered(event.operation, self.now, stages);
        (!unordered.is_empty()).then_some(Missing::Order(unordered))
    }

    /// Returns why accesses do not see a write; `None` if they do.
    fn hidden(&mut self, event: &Event, accesses: Accesses) -> Option<Missing> {
        let hidden = self.states.hidden(event.operation, self.now, accesses);
        (!hidden.is_empty()).then_some(Missing::Visibility(hidden))
    }
}

/// Number of consecutive replays to check.
const REPLAYS: usize = 2;

struct Walk<'p> {
    plan: &'p Plan,
    time: Time,
    /// By group, and for the end, of each replay: number of earlier barriers.
    before: Vec<usize>,
    replay: usize,
    /// Memory spaces: one per external buffer, the arena, and one per image slot.
    cells: Cells,
    recent: Vec<Vec<RecentAccesses>>,
    /// By buffer: whether a live pass writes it.
    written: Vec<bool>,
}

impl<'p> Walk<'p> {
    fn new(plan: &'p Plan) -> Self {
        let (mut barriers, mut before) = (Vec::new(), Vec::new());
        for _ in 0..REPLAYS {
            for group in &plan.groups {
                barriers.extend(group.barrier);
                before.push(barriers.len());
            }
            barriers.extend(plan.final_barrier);
            before.push(barriers.len());
        }
        let mut written = vec![false; plan.buffers.len()];
        let running =
            || plan.groups.iter().flat_map(|group| &group.passes).flat_map(|&pass| &plan.passes[pass].accesses);
        for (slice, access, _) in running() {
            written[slice.buffer.index()] |= *access != Access::Read;
        }
        let outputs = outputs(plan);
        let shared = shared(plan);
        let slices = running().map(|(slice, ..)| slice).chain(&outputs).chain(&shared);
        let whole = |(slot, make): (usize, &ImageSlot)| (plan.buffers.len() + 1 + slot, 0..make.bytes());
        let ranges =
            slices.filter_map(|slice| place(plan, slice)).chain(plan.image_slots.iter().enumerate().map(whole));
        let cells = Cells::new(plan.buffers.len() + 1 + plan.image_slots.len(), ranges);
        let recent = cells.table();
        let time = Time { states: OrderingStates::new(barriers), now: 0 };
        Walk { plan, time, before, replay: 0, cells, recent, written }
    }

    /// Creates an event at the current position.
    fn event(&self, operation: Operation, pass: usize, buffer: usize, access: Access) -> Event {
        Event { operation, pass, buffer, replay: self.replay, access }
    }

    fn touch(
        &mut self,
        replay: usize,
        pass: usize,
        slice: &Slice,
        access: Access,
        used: Use,
    ) -> Result<(), VerifyError> {
        let buffer = slice.buffer.index();
        let info = &self.plan.buffers[buffer];
        let shared = info.entry == BufferState::Queue || info.exit == BufferState::Queue;
        let changes = self.written[buffer] || shared;
        if !changes && matches!(info.kind, BufferKind::External | BufferKind::Uniform) {
            return Ok(()); // Nothing to conflict with.
        }
        let Some((space, range)) = place(self.plan, slice) else { return Ok(()) };
        let accesses = device_accesses(access, used);
        let operation = self.time.operation(accesses);
        let event = self.event(operation, pass, buffer, access);
        let stores = accesses.intersection(Accesses::STORAGE_WRITE | Accesses::TRANSFER_WRITE);
        let stage = Accesses::ALL.into_iter().find(|&one| accesses.contains(one)).map(performs).unwrap_or_default();
        for cell in self.cells.of(space, &range) {
            let byte = self.cells.byte(space, cell);
            let recent = &mut self.recent[space][cell];
            let mut read_since = false;
            for earlier in recent.iter().rev() {
                if earlier.access == Access::Read {
                    read_since = true;
                    if access != Access::Read
                        && let Some(missing) = self.time.unordered(earlier, stage)
                    {
                        return Err(hazard_error(self.plan, Hazard::WriteAfterRead, earlier, &event, byte, missing));
                    }
                } else if !(access == Access::Accumulate
                    && earlier.access == Access::Accumulate
                    && earlier.buffer == buffer)
                {
                    // An intermediate reader has seen the write, and this write waits for the reader. Only a load
                    // needs visibility of the earlier write.
                    let needed = if read_since { accesses.without(stores) } else { accesses };
                    if let Some(missing) = self.time.hidden(earlier, needed) {
                        let reads = access == Access::Read;
                        let hazard = if reads { Hazard::ReadAfterWrite } else { Hazard::WriteAfterWrite };
                        return Err(hazard_error(self.plan, hazard, earlier, &event, byte, missing));
                    }
                }
            }
            // Accumulations keep the access they started from: each must be ordered after it.
            if matches!(access, Access::Write | Access::ReadWrite) {
                recent.clear();
            }
            let alike = |last: &Event| {
                let same = (last.operation, last.replay, last.access) == (operation, replay, access);
                same && last.buffer == buffer
            };
            if !recent.last().is_some_and(alike) {
                recent.push(event);
            }
        }
        Ok(())
    }

    /// Records other commands on the queue before a replay, on shared resources. They follow the end of the last
    /// replay, as far as declared.
    fn external_before(&mut self) {
        let operation = self.time.operation(Accesses::OUTSIDE_READ | Accesses::OUTSIDE_WRITE);
        for slice in shared(self.plan) {
            let buffer = slice.buffer.index();
            let Some((space, range)) = place(self.plan, &slice) else { continue };
            if self.plan.buffers[buffer].entry == BufferState::Queue {
                for cell in self.cells.of(space, &range) {
                    let event = self.event(operation, OTHERS, buffer, Access::ReadWrite);
                    self.recent[space][cell] = vec![event];
                }
            }
        }
    }

    /// Records layout transitions inside the barrier that was just counted, if any.
    fn transitions(&mut self, transitions: &[Transition], barrier: Option<Barrier>) -> Result<(), VerifyError> {
        let before = self.time.now - usize::from(barrier.is_some());
        let barrier = barrier.unwrap_or_default();
        for transition in transitions {
            let (space, bytes, buffer) = match transition.image {
                ImageMemory::External(image) => (image.index(), self.plan.buffers[image.index()].bytes, image.index()),
                ImageMemory::Slot(slot) => {
                    let placed = |(buffer, place): (usize, &Option<u64>)| {
                        self.plan.buffers[buffer].image.is_some() && *place == Some(u64::from(slot))
                    };
                    let user = self.plan.placements.iter().enumerate().position(placed);
                    let bytes = self.plan.image_slots[slot as usize].bytes();
                    (self.plan.buffers.len() + 1 + slot as usize, bytes, user.unwrap_or_default())
                }
            };
            let now = self.time.now;
            let operation = self.time.states.transition(now, &barrier);
            let event = self.event(operation, TRANSITION, buffer, Access::Write);
            for cell in self.cells.of(space, &(0..bytes)) {
                let byte = self.cells.byte(space, cell);
                let recent = std::mem::replace(&mut self.recent[space][cell], vec![event]);
                let mut read_since = false;
                for earlier in recent.iter().rev() {
                    let reads = earlier.access == Access::Read;
                    if (reads || !read_since)
                        && let Some(missing) =
                            self.time.states.unordered_transition(earlier.operation, before, &barrier)
                    {
                        let hazard = if reads { Hazard::WriteAfterRead } else { Hazard::WriteAfterWrite };
                        return Err(hazard_error(self.plan, hazard, earlier, &event, byte, missing));
                    }
                    read_since |= reads;
                }
            }
        }
        Ok(())
    }

    /// Checks accesses to shared resources after a replay. Other commands on the queue must be able to access them.
    fn external_after(&mut self) -> Result<(), VerifyError> {
        for slice in shared(self.plan) {
            let buffer = slice.buffer.index();
            let Some((space, range)) = place(self.plan, &slice) else { continue };
            if self.plan.buffers[buffer].exit != BufferState::Queue {
                continue;
            }
            for cell in self.cells.of(space, &range) {
                let mut accesses = Accesses::OUTSIDE_READ | Accesses::OUTSIDE_WRITE;
                for event in self.recent[space][cell].iter().rev() {
                    let missing = if event.access == Access::Read {
                        accesses = Accesses::OUTSIDE_READ;
                        self.time.unordered(event, Stages::OUTSIDE)
                    } else if event.pass == OTHERS {
                        None
                    } else {
                        self.time.hidden(event, accesses)
                    };
                    if let Some(missing) = missing {
                        let (pass, buffer) = (pass_label(self.plan, event.pass), buffer_name(self.plan, buffer));
                        return Err(VerifyError::LeftOpen { pass, buffer, missing });
                    }
                }
            }
        }
        Ok(())
    }

    /// Checks that the host and copies see the outputs after a replay.
    fn read_outputs(&mut self) -> Result<(), VerifyError> {
        let reader_accesses = Accesses::TRANSFER_READ | Accesses::HOST_READ;
        let operation = self.time.operation(Accesses::TRANSFER_READ);
        for slice in outputs(self.plan) {
            let buffer = slice.buffer.index();
            let Some((space, range)) = place(self.plan, &slice).filter(|_| self.written[buffer]) else {
                continue;
            };
            let event = self.event(operation, OUTSIDE, buffer, Access::Read);
            for cell in self.cells.of(space, &range) {
                let recent = &mut self.recent[space][cell];
                for write in recent.iter().filter(|event| event.access != Access::Read) {
                    let access = self.time.states.hidden(write.operation, self.time.now, reader_accesses);
                    if !access.is_empty() {
                        let (pass, buffer) = (pass_name(self.plan, write.pass), buffer_name(self.plan, buffer));
                        return Err(VerifyError::OutputHidden { pass, buffer, access });
                    }
                }
                recent.push(event);
            }
        }
        Ok(())
    }
}

/// Returns the name of the user of a buffer.
fn pass_label(plan: &Plan, pass: usize) -> String {
    match pass {
        OUTSIDE => "copies from outputs".to_owned(),
        OTHERS => "other commands on the queue".to_owned(),
        TRANSITION => "layout transition".to_owned(),
        pass => pass_name(plan, pass),
    }
}

/// Returns the buffers that other commands on the queue use, as whole slices. They use them before or after a replay.
fn shared(plan: &Plan) -> Vec<Slice> {
    let queue = |info: &BufferInfo| info.entry == BufferState::Queue || info.exit == BufferState::Queue;
    let external = plan.buffers().filter(|(_, info)| info.kind == BufferKind::External && queue(info));
    external.map(|(buffer, info)| buffer.slice(0, info.bytes)).collect()
}

/// Returns the output buffers as whole slices. The host and copies read them after a replay. Buffers left to the queue
/// are excluded: their barrier covers copies too.
fn outputs(plan: &Plan) -> Vec<Slice> {
    let left = |info: &BufferInfo| info.kind == BufferKind::External && info.exit == BufferState::Queue;
    plan.buffers()
        .filter(|(_, info)| info.keep && !left(info))
        .map(|(buffer, info)| buffer.slice(0, info.bytes))
        .collect()
}

/// Returns the memory space and range of a slice; `None` for an unplaced transient.
fn place(plan: &Plan, slice: &Slice) -> Option<(usize, std::ops::Range<u64>)> {
    let buffer = slice.buffer.index();
    match plan.buffers[buffer].kind {
        BufferKind::Transient => {
            let place = plan.placements[buffer]?;
            if plan.buffers[buffer].image.is_some() {
                return Some((plan.buffers.len() + 1 + place as usize, slice.range()));
            }
            let offset = place + slice.offset;
            Some((plan.buffers.len(), offset..offset + slice.bytes))
        }
        BufferKind::External | BufferKind::Uniform => Some((buffer, slice.range())),
    }
}

fn hazard_error(
    plan: &Plan,
    hazard: Hazard,
    first: &Event,
    second: &Event,
    byte: u64,
    missing: Missing,
) -> VerifyError {
    VerifyError::Hazard {
        hazard,
        first: pass_label(plan, first.pass),
        first_buffer: buffer_name(plan, first.buffer),
        second: pass_label(plan, second.pass),
        second_buffer: buffer_name(plan, second.buffer),
        byte,
        replays: 1 + second.replay - first.replay,
        missing,
    }
}
