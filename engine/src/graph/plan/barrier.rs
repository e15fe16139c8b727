//! Placement of barriers: before each group, before the first group of a replay, and after the last group.
//!
//! Each barrier starts as the union of what the group's hazards require. It then loses every bit without which all
//! hazards stay covered. Barriers between groups cover only hazards within a replay. The first barrier covers the
//! hazards with the previous replay and with external commands, as far as later barriers do not cover them in time.

use super::Group;
use super::alias::Layout;
use super::clock::{Clock, Transitions};
use super::hazard::{Memory, Need, Time};
use super::image::{Transition, enters, leaves};
use super::scope::{Accesses, Barrier, Stages};
use crate::graph::pass::Pass;
use crate::graph::resource::{Buffer, BufferInfo, Slice};

/// Inputs of barrier placement.
pub(super) struct BarrierInputs<'p> {
    pub(super) buffers: &'p [BufferInfo],
    pub(super) passes: &'p [Pass],
    pub(super) layout: &'p Layout,
    pub(super) entry: &'p [Transition],
    pub(super) exit: &'p [Transition],
}

/// Places barriers before the groups; returns the barrier after the last group.
pub(super) fn place(inputs: &BarrierInputs<'_>, groups: &mut [Group]) -> Option<Barrier> {
    if groups.is_empty() {
        return None;
    }
    let outputs = &inputs.outputs(groups);
    let mut memory = Memory::new(inputs.buffers, inputs.layout);
    let last = groups.len();
    let mut clock = Clock::default();

    let needs = inputs.replay(&mut memory, groups, outputs, 0, false);
    let mut barriers = Vec::with_capacity(groups.len() + 1);
    for (at, need) in needs.iter().enumerate() {
        // The first barrier's transitions are handled below, with its other needs.
        let transitions = if at == last { Transitions::Exit } else { Transitions::None };
        let before = at as Time + 1;
        let barrier = minimal(clock.missing_barrier(need), |barrier| {
            let mut clock = clock;
            clock.pass(barrier, before, transitions);
            clock.covers(need)
        });
        clock.pass(&barrier, before, transitions);
        barriers.push(barrier);
    }

    // The next replay, with the same barriers.
    let transitions = |at: usize| match at {
        0 => Transitions::Entry,
        at if at == last => Transitions::Exit,
        _ => Transitions::None,
    };
    let start = length(groups);
    let needs = inputs.replay(&mut memory, groups, outputs, start, true);
    let mut first = Barrier::default();
    let mut later = clock;
    for (at, (need, barrier)) in needs.iter().zip(&barriers).enumerate() {
        // Only the first barrier handles the needs of its own transitions here.
        if at > 0 {
            later.pass(barrier, start + at as Time + 1, transitions(at));
        }
        first = first.merge(&later.missing_barrier(need));
    }
    barriers[0] = minimal(first, |barrier| {
        let mut clock = clock;
        needs.iter().enumerate().all(|(at, need)| {
            let barrier = if at == 0 { barrier } else { &barriers[at] };
            clock.pass(barrier, start + at as Time + 1, transitions(at));
            clock.covers(need)
        })
    });

    let mut barriers = barriers.into_iter().map(|barrier| (barrier != Barrier::default()).then_some(barrier));
    for (group, barrier) in groups.iter_mut().zip(&mut barriers) {
        group.barrier = barrier;
    }
    barriers.next().flatten()
}

/// Returns the time steps of one replay: earlier users, its groups, and later readers of the outputs.
fn length(groups: &[Group]) -> Time {
    groups.len() as Time + 2
}

impl BarrierInputs<'_> {
    /// Returns the written buffers that copies and the host read after a replay. Buffers left to the queue are
    /// excluded; they have stricter needs.
    fn outputs(&self, groups: &[Group]) -> Vec<Slice> {
        let mut written = vec![false; self.buffers.len()];
        for &pass in groups.iter().flat_map(|group| &group.passes) {
            for (slice, access, _) in &self.passes[pass].accesses {
                written[slice.buffer.index()] |= crate::graph::pass::writes(*access);
            }
        }
        let retained = self.buffers.iter().zip(written).enumerate();
        retained
            .filter(|(_, (info, written))| info.keep && *written && !leaves(info))
            .map(|(index, (info, _))| Buffer(index as u32).slice(0, info.bytes))
            .collect()
    }

    /// Returns the need of each group of a replay, and last that of later users. The replay begins after time `start`.
    /// The beginning of the replay counts only if `entered`.
    fn replay(
        &self,
        memory: &mut Memory<'_>,
        groups: &[Group],
        outputs: &[Slice],
        start: Time,
        entered: bool,
    ) -> Vec<Need> {
        let mut needs = vec![Need::default(); groups.len() + 1];
        let whole = |index: usize, info: &BufferInfo| Buffer(index as u32).slice(0, info.bytes);
        if entered {
            for (index, info) in self.buffers.iter().enumerate().filter(|(_, info)| enters(info)) {
                memory.external_before(start + 1, &whole(index, info));
            }
            for transition in self.entry {
                memory.transition(start + 2, transition.image, Transitions::Entry, &mut needs[0]);
            }
        }
        for (at, (group, need)) in groups.iter().zip(&mut needs).enumerate() {
            for &pass in &group.passes {
                for (slice, access, used) in &self.passes[pass].accesses {
                    memory.touch(start + at as Time + 2, slice, *access, *used, need);
                }
            }
        }
        let (after, need) = (start + length(groups), &mut needs[groups.len()]);
        for transition in self.exit {
            memory.transition(after, transition.image, Transitions::Exit, need);
        }
        // The host and copies may read outputs between replays; the next replay waits for the copies.
        for slice in outputs {
            memory.read(after, slice, Accesses::TRANSFER_READ, need);
            memory.read(after, slice, Accesses::HOST_READ, need);
        }
        for (index, info) in self.buffers.iter().enumerate().filter(|(_, info)| leaves(info)) {
            memory.external_after(&whole(index, info), need);
        }
        needs
    }
}

/// Removes barrier bits while the barrier stays sufficient. Tries them one at a time in a fixed order.
fn minimal(mut barrier: Barrier, mut enough: impl FnMut(&Barrier) -> bool) -> Barrier {
    let mut attempt = |barrier: &mut Barrier, less: Barrier| {
        if less != *barrier && enough(&less) {
            *barrier = less;
        }
    };
    for access in Accesses::ALL {
        let less = Barrier { src_access: barrier.src_access.without(access), ..barrier };
        attempt(&mut barrier, less);
        let less = Barrier { dst_access: barrier.dst_access.without(access), ..barrier };
        attempt(&mut barrier, less);
    }
    for stage in Stages::ALL {
        let less = Barrier { src_stage: barrier.src_stage.without(stage), ..barrier };
        attempt(&mut barrier, less);
        let less = Barrier { dst_stage: barrier.dst_stage.without(stage), ..barrier };
        attempt(&mut barrier, less);
    }
    barrier
}
