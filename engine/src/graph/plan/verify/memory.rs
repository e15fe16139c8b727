//! Whether every transient that runs has memory of its own for as long as it is alive.

use super::lanes::Lanes;
use super::{VerifyError, buffer_name};
use crate::graph::plan::Plan;
use crate::graph::resource::BufferKind;

struct Stay {
    buffer: usize,
    start: u64,
    end: u64,
    lives: (usize, usize),
}

/// Checks.
pub(super) fn check(plan: &Plan, group_of: &[Option<usize>]) -> Result<(), VerifyError> {
    // What may run together on two queues counts as one.
    let together = Lanes::new(plan, 1).together(plan);
    let mut lives: Vec<Option<(usize, usize)>> = vec![None; plan.buffers.len()];
    for (pass, group) in plan.passes.iter().zip(group_of) {
        let Some(group) = *group else { continue };
        for (slice, ..) in &pass.accesses {
            let (begin, end) = together[group];
            let (first, last) = lives[slice.buffer.index()].unwrap_or((begin, end));
            lives[slice.buffer.index()] = Some((first.min(begin), last.max(end)));
        }
    }
    let mut stays = Vec::new();
    let mut in_slots: Vec<Stay> = Vec::new();
    for (buffer, info) in plan.buffers.iter().enumerate() {
        let (BufferKind::Transient, Some((first, last))) = (info.kind, lives[buffer]) else { continue };
        let Some(start) = plan.placements[buffer] else {
            return Err(VerifyError::Unplaced { buffer: buffer_name(plan, buffer) });
        };
        if info.image.is_some() {
            let last = if info.keep { plan.groups.len() } else { last };
            let stay = Stay { buffer, start, end: start + 1, lives: (first, last) };
            let meets = |other: &&Stay| other.start == start && other.lives.0 <= last && first <= other.lives.1;
            if let Some(other) = in_slots.iter().find(meets) {
                return Err(overlap(plan, other, &stay));
            }
            in_slots.push(stay);
            continue;
        }
        let end = start.saturating_add(info.bytes);
        if end > plan.arena_bytes {
            let buffer = buffer_name(plan, buffer);
            return Err(VerifyError::OutOfArena { buffer, start, end, arena: plan.arena_bytes });
        }
        let last = if info.keep { plan.groups.len() } else { last };
        stays.push(Stay { buffer, start, end, lives: (first, last) });
    }
    stays.sort_by_key(|stay| (stay.start, stay.buffer));
    for (at, first) in stays.iter().enumerate() {
        for second in stays[at + 1..].iter().take_while(|second| second.start < first.end) {
            if first.lives.0 <= second.lives.1 && second.lives.0 <= first.lives.1 {
                return Err(overlap(plan, first, second));
            }
        }
    }
    Ok(())
}

fn overlap(plan: &Plan, first: &Stay, second: &Stay) -> VerifyError {
    VerifyError::Overlap {
        first: buffer_name(plan, first.buffer),
        first_lives: first.lives,
        second: buffer_name(plan, second.buffer),
        second_lives: second.lives,
        byte: second.start,
    }
}
