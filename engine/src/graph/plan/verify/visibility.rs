//! Whether conflicting memory operations are kept apart by barriers, through two replays in a row.
//!
//! Two suffice where each replay does the same to the same bytes: what the third meets is what the second met. The
//! buffers of a history change places each time, so a plan with histories is taken through four.

use super::cells::Cells;
use super::lanes::{self, Lanes};
use super::shape::performs;
use super::story::{Operation, Stories};
use super::{Hazard, Missing, VerifyError, buffer_name, pass_name};
use crate::graph::pass::Use;
use crate::graph::plan::scope::{Accesses, Barrier, Stages};
use crate::graph::plan::{ImageMemory, ImageSlot, Lane, Plan, Transition};
use crate::graph::resource::{BufferInfo, BufferKind, BufferState, Slice};
use crate::shader::Access;

/// Something that touched a cell.
#[derive(Clone, Copy)]
struct Event {
    operation: Operation,
    pass: usize,
    buffer: usize,
    replay: usize,
    access: Access,
    lane: Lane,
    /// Counted through all replays.
    segment: usize,
}

/// What touched a cell, beginning with its last write that commutes with nothing, in the order of the groups.
type Since = Vec<Event>;

/// Checks.
pub(super) fn check(plan: &Plan) -> Result<(), VerifyError> {
    let mut walk = Walk::new(plan);
    let points = plan.groups.len() + 1;
    for replay in 0..replays(plan) {
        walk.replay = replay;
        walk.time.segment = walk.time.lanes.first(replay);
        walk.enter();
        for (at, group) in plan.groups.iter().enumerate() {
            let segment = walk.time.lanes.segment(replay, at);
            walk.go(plan.segments[segment % plan.segments.len()].lane, segment, replay * points + at);
            if at == 0 {
                walk.transitions(&plan.entry, group.barrier)?;
            }
            for &pass in &group.passes {
                for (slice, access, used) in &plan.passes[pass].accesses {
                    walk.touch(replay, pass, slice, *access, *used)?;
                }
            }
        }
        walk.go(Lane::Main, walk.time.lanes.last(replay), replay * points + plan.groups.len());
        walk.transitions(&plan.exit, plan.final_barrier)?;
        walk.read_outputs(replay)?;
        walk.leave()?;
    }
    Ok(())
}

/// A pass number for the copies that read outputs between replays.
const OUTSIDE: usize = usize::MAX;
/// For commands on the queue that no plan knows of.
const OTHERS: usize = usize::MAX - 1;
/// For changes of layout.
const TRANSITION: usize = usize::MAX - 2;

/// Which accesses of the device an access is.
fn performed(access: Access, used: Use) -> Accesses {
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

/// Where in the two streams of barriers something happens, and what is known of the past there.
struct Time {
    /// By lane.
    stories: [Stories; 2],
    lanes: Lanes,
    lane: Lane,
    segment: usize,
    /// How many barriers of the lane came so far.
    now: usize,
}

impl Time {
    /// An operation that happens now.
    fn operation(&mut self, accesses: Accesses) -> Operation {
        self.stories[lanes::index(self.lane)].operation(self.now, accesses)
    }

    /// Whether something ended before this segment began, or else what orders it on this lane.
    fn past(&mut self, event: &Event) -> Result<Option<&mut Stories>, Missing> {
        if self.lanes.knows(self.segment, event.lane, event.segment) {
            return Ok(None);
        }
        if event.lane != self.lane {
            return Err(Missing::Wait);
        }
        Ok(Some(&mut self.stories[lanes::index(self.lane)]))
    }

    /// Why stages do not wait for something, if they do not.
    fn unordered(&mut self, event: &Event, stages: Stages) -> Option<Missing> {
        let now = self.now;
        match self.past(event) {
            Ok(None) => None,
            Ok(Some(stories)) => {
                let unordered = stories.unordered(event.operation, now, stages);
                (!unordered.is_empty()).then_some(Missing::Order(unordered))
            }
            Err(missing) => Some(missing),
        }
    }

    /// Why accesses do not see a write, if they do not.
    fn hidden(&mut self, event: &Event, accesses: Accesses) -> Option<Missing> {
        let now = self.now;
        match self.past(event) {
            Ok(None) => None,
            Ok(Some(stories)) => {
                let hidden = stories.hidden(event.operation, now, accesses);
                (!hidden.is_empty()).then_some(Missing::Visibility(hidden))
            }
            Err(missing) => Some(missing),
        }
    }

    /// Why a change of layout inside a barrier does not come after something, if it does not.
    fn outside(&mut self, event: &Event, before: usize, barrier: &Barrier) -> Option<Missing> {
        match self.past(event) {
            Ok(None) => None,
            Ok(Some(stories)) => stories.outside(event.operation, before, barrier),
            Err(missing) => Some(missing),
        }
    }
}

struct Walk<'p> {
    plan: &'p Plan,
    time: Time,
    /// How many barriers of its lane come before each group, and of the main lane before the end, of each replay.
    before: Vec<usize>,
    /// By replay: how many barriers of the second lane come before its end.
    side_ends: Vec<usize>,
    replay: usize,
    /// Memory spaces: one an external buffer, the arena, and one a slot of the transient images.
    cells: Cells,
    since: Vec<Vec<Since>>,
    /// By buffer: whether anything that runs writes it.
    written: Vec<bool>,
}

impl<'p> Walk<'p> {
    fn new(plan: &'p Plan) -> Self {
        let mut barriers: [Vec<Barrier>; 2] = Default::default();
        let (mut before, mut side_ends) = (Vec::new(), Vec::new());
        for _ in 0..replays(plan) {
            for segment in &plan.segments {
                let lane = &mut barriers[lanes::index(segment.lane)];
                for group in &plan.groups[segment.groups.clone()] {
                    lane.extend(group.barrier);
                    before.push(lane.len());
                }
                lane.extend(segment.last);
            }
            barriers[0].extend(plan.final_barrier);
            before.push(barriers[0].len());
            side_ends.push(barriers[1].len());
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
        // Both halves of a history are cut where either is touched.
        let both = |slice| [place(plan, slice, 0), place(plan, slice, 1)];
        let ranges = slices.flat_map(both).flatten().chain(plan.image_slots.iter().enumerate().map(whole));
        let cells = Cells::new(plan.buffers.len() + 1 + plan.image_slots.len(), ranges);
        let since = cells.table();
        let lanes = Lanes::new(plan, replays(plan));
        let time = Time { stories: barriers.map(Stories::new), lanes, lane: Lane::Main, segment: 0, now: 0 };
        Walk { plan, time, before, side_ends, replay: 0, cells, since, written }
    }

    /// Goes on to a point of some lane.
    fn go(&mut self, lane: Lane, segment: usize, point: usize) {
        (self.time.lane, self.time.segment, self.time.now) = (lane, segment, self.before[point]);
    }

    /// Something that happens now.
    fn event(&self, operation: Operation, pass: usize, buffer: usize, access: Access) -> Event {
        let (lane, segment) = (self.time.lane, self.time.segment);
        Event { operation, pass, buffer, replay: self.replay, access, lane, segment }
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
        let Some((space, range)) = place(self.plan, slice, self.replay) else { return Ok(()) };
        let accesses = performed(access, used);
        let operation = self.time.operation(accesses);
        let event = self.event(operation, pass, buffer, access);
        let stores = accesses.intersection(Accesses::STORAGE_WRITE | Accesses::TRANSFER_WRITE);
        let stage = Accesses::EACH.into_iter().find(|&one| accesses.contains(one)).map(performs).unwrap_or_default();
        for cell in self.cells.of(space, &range) {
            let byte = self.cells.byte(space, cell);
            let since = &mut self.since[space][cell];
            let mut read_since = false;
            for earlier in since.iter().rev() {
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
                    // Whoever read in between has the write behind it, and the write before us waits for the reader:
                    // only to load what was written we have to see it.
                    let needed = if read_since { accesses.without(stores) } else { accesses };
                    if let Some(missing) = self.time.hidden(earlier, needed) {
                        let reads = access == Access::Read;
                        let hazard = if reads { Hazard::ReadAfterWrite } else { Hazard::WriteAfterWrite };
                        return Err(hazard_error(self.plan, hazard, earlier, &event, byte, missing));
                    }
                }
            }
            // A run of accumulations keeps what it began on: each of its members has to follow that.
            if matches!(access, Access::Write | Access::ReadWrite) {
                since.clear();
            }
            let alike = |last: &Event| {
                let when = (last.operation, last.replay, last.segment, last.lane);
                when == (operation, replay, event.segment, event.lane) && last.buffer == buffer && last.access == access
            };
            if !since.last().is_some_and(alike) {
                since.push(event);
            }
        }
        Ok(())
    }

    /// Commands of others, before a replay, on whatever is shared with them. They come after the last replay's end, as
    /// far as that is declared, and leave something to wait for.
    fn enter(&mut self) {
        let operation = self.time.operation(Accesses::OUTSIDE_READ | Accesses::OUTSIDE_WRITE);
        for slice in shared(self.plan) {
            let buffer = slice.buffer.index();
            let Some((space, range)) = place(self.plan, &slice, self.replay) else { continue };
            if self.plan.buffers[buffer].entry == BufferState::Queue {
                for cell in self.cells.of(space, &range) {
                    let event = self.event(operation, OTHERS, buffer, Access::ReadWrite);
                    self.since[space][cell] = vec![event];
                }
            }
        }
    }

    /// Changes of layout inside a barrier that has just been counted, if it exists.
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
            let operation = self.time.stories[0].transition(now, &barrier);
            let event = self.event(operation, TRANSITION, buffer, Access::Write);
            for cell in self.cells.of(space, &(0..bytes)) {
                let byte = self.cells.byte(space, cell);
                let since = std::mem::replace(&mut self.since[space][cell], vec![event]);
                let mut read_since = false;
                for earlier in since.iter().rev() {
                    let reads = earlier.access == Access::Read;
                    if (reads || !read_since)
                        && let Some(missing) = self.time.outside(earlier, before, &barrier)
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

    /// Commands of others, after a replay: they may do anything to what is left to them.
    fn leave(&mut self) -> Result<(), VerifyError> {
        for slice in shared(self.plan) {
            let buffer = slice.buffer.index();
            let Some((space, range)) = place(self.plan, &slice, self.replay) else { continue };
            if self.plan.buffers[buffer].exit != BufferState::Queue {
                continue;
            }
            for cell in self.cells.of(space, &range) {
                let mut accesses = Accesses::OUTSIDE_READ | Accesses::OUTSIDE_WRITE;
                for event in self.since[space][cell].iter().rev() {
                    let missing = if event.access == Access::Read {
                        accesses = Accesses::OUTSIDE_READ;
                        self.time.unordered(event, Stages::OUTSIDE)
                    } else if event.pass == OTHERS {
                        None
                    } else {
                        self.time.hidden(event, accesses)
                    };
                    if let Some(missing) = missing {
                        let (pass, buffer) = (who(self.plan, event.pass), buffer_name(self.plan, buffer));
                        return Err(VerifyError::LeftOpen { pass, buffer, missing });
                    }
                }
            }
        }
        Ok(())
    }

    /// The host and copies, after a replay.
    fn read_outputs(&mut self, replay: usize) -> Result<(), VerifyError> {
        let wanted = Accesses::TRANSFER_READ | Accesses::HOST_READ;
        let operation = self.time.operation(Accesses::TRANSFER_READ);
        for slice in outputs(self.plan) {
            let buffer = slice.buffer.index();
            let Some((space, range)) = place(self.plan, &slice, self.replay).filter(|_| self.written[buffer]) else {
                continue;
            };
            let event = self.event(operation, OUTSIDE, buffer, Access::Read);
            for cell in self.cells.of(space, &range) {
                let since = &mut self.since[space][cell];
                for write in since.iter().filter(|event| event.access != Access::Read) {
                    let [main, side] = &mut self.time.stories;
                    let access = match write.lane {
                        Lane::Main => main.hidden(write.operation, self.time.now, wanted),
                        // That the main lane has waited is enough for copies, but not for the host.
                        Lane::Side => side.hidden(write.operation, self.side_ends[replay], Accesses::HOST_READ),
                    };
                    if !access.is_empty() {
                        let (pass, buffer) = (pass_name(self.plan, write.pass), buffer_name(self.plan, buffer));
                        return Err(VerifyError::OutputHidden { pass, buffer, access });
                    }
                }
                since.push(event);
            }
        }
        Ok(())
    }
}

/// Who touched a buffer.
fn who(plan: &Plan, pass: usize) -> String {
    match pass {
        OUTSIDE => "whoever copies from the outputs".to_owned(),
        OTHERS => "others on the queue".to_owned(),
        TRANSITION => "change of layout".to_owned(),
        pass => pass_name(plan, pass),
    }
}

/// Buffers that others on the queue use before or after a replay, as a whole.
fn shared(plan: &Plan) -> Vec<Slice> {
    let queue = |info: &BufferInfo| info.entry == BufferState::Queue || info.exit == BufferState::Queue;
    let external = plan.buffers().filter(|(_, info)| info.kind == BufferKind::External && queue(info));
    external.map(|(buffer, info)| buffer.slice(0, info.bytes)).collect()
}

/// Buffers whose contents the host and copies want after a replay, as a whole. Who leaves them to all commands of the
/// queue leaves them to copies too.
fn outputs(plan: &Plan) -> Vec<Slice> {
    let left = |info: &BufferInfo| info.kind == BufferKind::External && info.exit == BufferState::Queue;
    plan.buffers()
        .filter(|(_, info)| info.keep && !left(info))
        .map(|(buffer, info)| buffer.slice(0, info.bytes))
        .collect()
}

/// How many replays in a row show everything.
fn replays(plan: &Plan) -> usize {
    if plan.buffers.iter().any(|info| info.kind == BufferKind::History) { 4 } else { 2 }
}

/// The memory of a slice in a replay: its space and the bytes there. Nothing for a transient without a place.
fn place(plan: &Plan, slice: &Slice, replay: usize) -> Option<(usize, std::ops::Range<u64>)> {
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
        BufferKind::History => {
            let partner = plan.buffers[buffer].pair?.partner.index();
            Some((if replay.is_multiple_of(2) { buffer } else { partner }, slice.range()))
        }
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
        first: who(plan, first.pass),
        first_buffer: buffer_name(plan, first.buffer),
        second: who(plan, second.pass),
        second_buffer: buffer_name(plan, second.buffer),
        byte,
        replays: 1 + second.replay - first.replay,
        missing,
    }
}
