//! Memory verification: every used transient has exclusive memory during its lifetime.

use super::{VerifyError, buffer_name};
use crate::graph::plan::Plan;
use crate::graph::resource::BufferKind;

struct Occupancy {
    buffer: usize,
    start: u64,
    end: u64,
    lifetime: (usize, usize),
}

/// Checks the placement of all transients.
pub(super) fn check(plan: &Plan, group_of: &[Option<usize>]) -> Result<(), VerifyError> {
    let mut lifetime: Vec<Option<(usize, usize)>> = vec![None; plan.buffers.len()];
    for (pass, group) in plan.passes.iter().zip(group_of) {
        let Some(group) = *group else { continue };
        for (slice, ..) in &pass.accesses {
            let (first, last) = lifetime[slice.buffer.index()].unwrap_or((group, group));
            lifetime[slice.buffer.index()] = Some((first.min(group), last.max(group)));
        }
    }
    let mut occupancies = Vec::new();
    let mut in_slots: Vec<Occupancy> = Vec::new();
    for (buffer, info) in plan.buffers.iter().enumerate() {
        let (BufferKind::Transient, Some((first, last))) = (info.kind, lifetime[buffer]) else { continue };
        let Some(start) = plan.placements[buffer] else {
            return Err(VerifyError::Unplaced { buffer: buffer_name(plan, buffer) });
        };
        if info.image.is_some() {
            let last = if info.keep { plan.groups.len() } else { last };
            let occupancy = Occupancy { buffer, start, end: start + 1, lifetime: (first, last) };
            let meets =
                |other: &&Occupancy| other.start == start && other.lifetime.0 <= last && first <= other.lifetime.1;
            if let Some(other) = in_slots.iter().find(meets) {
                return Err(overlap(plan, other, &occupancy));
            }
            in_slots.push(occupancy);
            continue;
        }
        let end = start.saturating_add(info.bytes);
        if end > plan.arena_bytes {
            let buffer = buffer_name(plan, buffer);
            return Err(VerifyError::OutOfArena { buffer, start, end, arena: plan.arena_bytes });
        }
        let last = if info.keep { plan.groups.len() } else { last };
        occupancies.push(Occupancy { buffer, start, end, lifetime: (first, last) });
    }
    occupancies.sort_by_key(|occupancy| (occupancy.start, occupancy.buffer));
    for (at, first) in occupancies.iter().enumerate() {
        for second in occupancies[at + 1..].iter().take_while(|second| second.start < first.end) {
            if first.lifetime.0 <= second.lifetime.1 && second.lifetime.0 <= first.lifetime.1 {
                return Err(overlap(plan, first, second));
            }
        }
    }
    Ok(())
}

fn overlap(plan: &Plan, first: &Occupancy, second: &Occupancy) -> VerifyError {
    VerifyError::Overlap {
        first: buffer_name(plan, first.buffer),
        first_lives: first.lifetime,
        second: buffer_name(plan, second.buffer),
        second_lives: second.lifetime,
        byte: second.start,
    }
}
