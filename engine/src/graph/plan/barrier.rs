//! The barrier before each group, the one before the first of a replay, and the one after the last.
//!
//! Each is the merger of what the group's hazards lack, and then loses every bit without which they are still covered.
//! Between groups only hazards within a replay count. What the end of one replay leaves open towards the next is the
//! first barrier's: it gets what the barriers of the next replay, as they stand, do not cover in time.

use super::Group;
use super::clock::Clock;
use super::hazard::{Memory, Need, Time};
use super::scope::{Accesses, Barrier, Stages};
use crate::graph::pass::Pass;
use crate::graph::resource::{Buffer, BufferInfo, Slice};

/// Puts barriers into the groups; returns the one after the last group.
pub(super) fn place(
    buffers: &[BufferInfo],
    passes: &[Pass],
    placements: &[Option<u64>],
    arena_bytes: u64,
    groups: &mut [Group],
) -> Option<Barrier> {
    let mut memory = Memory::new(buffers, placements, arena_bytes);
    let outputs = outputs(buffers, passes, groups);
    let mut clock = Clock::default();

    let needs = replay(&mut memory, passes, groups, &outputs, 0);
    let mut barriers = Vec::with_capacity(groups.len() + 1);
    for (at, need) in needs.iter().enumerate() {
        let barrier = minimal(clock.lacks(need), |barrier| {
            let mut clock = clock;
            clock.pass(barrier, at as Time);
            clock.covers(need)
        });
        clock.pass(&barrier, at as Time);
        barriers.push(barrier);
    }

    // A second replay, with the same barriers.
    let start = length(groups);
    let needs = replay(&mut memory, passes, groups, &outputs, start);
    let mut first = Barrier::default();
    let mut later = clock;
    for (at, (need, barrier)) in needs.iter().zip(&barriers).enumerate() {
        later.pass(barrier, start + at as Time);
        first = first.merge(&later.lacks(need));
    }
    barriers[0] = minimal(first, |barrier| {
        let mut clock = clock;
        clock.pass(barrier, start);
        let rest = barriers.iter().enumerate().skip(1);
        needs.first().is_none_or(|need| clock.covers(need))
            && rest.zip(&needs[1..]).all(|((at, barrier), need)| {
                clock.pass(barrier, start + at as Time);
                clock.covers(need)
            })
    });

    let mut barriers = barriers.into_iter().map(|barrier| (barrier != Barrier::default()).then_some(barrier));
    for (group, barrier) in groups.iter_mut().zip(&mut barriers) {
        group.barrier = barrier;
    }
    if groups.is_empty() { None } else { barriers.next().flatten() }
}

/// Points in time of one replay: its groups, and whoever reads the outputs afterwards.
fn length(groups: &[Group]) -> Time {
    groups.len() as Time + 1
}

/// What is written and wanted after a replay.
fn outputs(buffers: &[BufferInfo], passes: &[Pass], groups: &[Group]) -> Vec<Slice> {
    let mut written = vec![false; buffers.len()];
    for &pass in groups.iter().flat_map(|group| &group.passes) {
        for (slice, access, _) in &passes[pass].accesses {
            written[slice.buffer.index()] |= crate::graph::pass::writes(*access);
        }
    }
    let kept = buffers.iter().zip(written).enumerate().filter(|(_, (info, written))| info.keep && *written);
    kept.map(|(index, (info, _))| Buffer(index as u32).slice(0, info.bytes)).collect()
}

/// The need of each group of a replay that begins after time `start`, and, last, that of the readers afterwards.
fn replay(memory: &mut Memory<'_>, passes: &[Pass], groups: &[Group], outputs: &[Slice], start: Time) -> Vec<Need> {
    let mut needs = vec![Need::default(); groups.len() + 1];
    for (at, (group, need)) in groups.iter().zip(&mut needs).enumerate() {
        for &pass in &group.passes {
            for (slice, access, used) in &passes[pass].accesses {
                memory.touch(start + at as Time + 1, slice, *access, *used, need);
            }
        }
    }
    // The host and copies may read the outputs between replays; the next replay waits for the copies.
    let after = start + length(groups);
    for slice in outputs {
        memory.read(after, slice, Accesses::TRANSFER_READ, &mut needs[groups.len()]);
        memory.read(after, slice, Accesses::HOST_READ, &mut needs[groups.len()]);
    }
    needs
}

/// Takes bits away, one at a time and always in the same sequence, as long as the barrier is enough.
fn minimal(mut barrier: Barrier, mut enough: impl FnMut(&Barrier) -> bool) -> Barrier {
    let mut attempt = |barrier: &mut Barrier, less: Barrier| {
        if less != *barrier && enough(&less) {
            *barrier = less;
        }
    };
    for access in Accesses::EACH {
        let less = Barrier { src_access: barrier.src_access.without(access), ..barrier };
        attempt(&mut barrier, less);
        let less = Barrier { dst_access: barrier.dst_access.without(access), ..barrier };
        attempt(&mut barrier, less);
    }
    for stage in Stages::EACH {
        let less = Barrier { src_stage: barrier.src_stage.without(stage), ..barrier };
        attempt(&mut barrier, less);
        let less = Barrier { dst_stage: barrier.dst_stage.without(stage), ..barrier };
        attempt(&mut barrier, less);
    }
    barrier
}
