//! Assignment of passes to groups.
//!
//! Groups are the levels of the dependency graph: as few as the longest chain allows, each as wide as possible. A
//! pass with slack then moves to where its transients live shortest: a fill moves directly before its first user, a
//! last reader stays near the writer. Equal inputs give equal orders; no search is involved.

use crate::graph::pass::Pass;
use crate::graph::resource::{BufferInfo, BufferKind};

/// Returns the live passes in groups. Passes of one group do not depend on each other.
pub(super) fn order(
    buffers: &[BufferInfo],
    passes: &[Pass],
    live: &[bool],
    dependencies: &[Vec<u32>],
    reorder: bool,
) -> Vec<Vec<usize>> {
    let live_passes: Vec<usize> = (0..passes.len()).filter(|&index| live[index]).collect();
    if !reorder {
        return declared(&live_passes, dependencies);
    }
    let mut level = vec![0; passes.len()];
    for &index in &live_passes {
        level[index] = dependencies[index].iter().map(|&before| level[before as usize] + 1).max().unwrap_or(0);
    }
    let depth = live_passes.iter().map(|&index| level[index] + 1).max().unwrap_or(0);
    sink(buffers, passes, &live_passes, dependencies, depth, &mut level);

    let mut groups = vec![Vec::new(); depth];
    for &index in &live_passes {
        groups[level[index]].push(index);
    }
    for group in &mut groups {
        // Separates transfers from kernels: the device switches between them once per group.
        group.sort_by_key(|&index| (!passes[index].is_transfer(), index));
    }
    groups
}

/// Splits the declared order into groups. A split precedes each pass that depends on a pass since the last split.
fn declared(live_passes: &[usize], dependencies: &[Vec<u32>]) -> Vec<Vec<usize>> {
    let mut groups: Vec<Vec<usize>> = Vec::new();
    for &index in live_passes {
        match groups.last_mut() {
            Some(group) if !dependencies[index].iter().any(|&before| before as usize >= group[0]) => group.push(index),
            _ => groups.push(vec![index]),
        }
    }
    groups
}

/// Moves passes to later groups where that shortens transient lifetimes. Their dependents limit the move.
fn sink(
    buffers: &[BufferInfo],
    passes: &[Pass],
    live_passes: &[usize],
    dependencies: &[Vec<u32>],
    depth: usize,
    level: &mut [usize],
) {
    let mut latest = vec![depth.saturating_sub(1); passes.len()];
    for &index in live_passes.iter().rev() {
        let at = latest[index];
        limit_latest(&mut latest, &dependencies[index], at);
    }
    let users = transient_users(buffers, passes, live_passes);
    // From last to first, so that dependents have their final place.
    for &index in live_passes.iter().rev() {
        let slack = (level[index], latest[index]);
        if slack.0 < slack.1 {
            let schedule = Schedule { buffers, users: &users, level: &*level, latest: &latest, depth };
            let transient_uses = transient_uses(&schedule, &dependencies[index], index, &passes[index]);
            level[index] = best(&transient_uses, slack);
        }
        limit_latest(&mut latest, &dependencies[index], level[index]);
    }
}

/// Limits the latest level of a pass's dependencies to before the pass.
fn limit_latest(latest: &mut [usize], dependencies: &[u32], at: usize) {
    for &before in dependencies {
        let latest = &mut latest[before as usize];
        *latest = (*latest).min(at - 1);
    }
}

/// Returns, by buffer, the live passes that access it, if it is transient.
fn transient_users(buffers: &[BufferInfo], passes: &[Pass], live_passes: &[usize]) -> Vec<Vec<usize>> {
    let mut users = vec![Vec::new(); buffers.len()];
    for &index in live_passes {
        for (slice, ..) in &passes[index].accesses {
            let buffer = slice.buffer.index();
            if buffers[buffer].kind == BufferKind::Transient && users[buffer].last() != Some(&index) {
                users[buffer].push(index);
            }
        }
    }
    users
}

/// Partial schedule: levels of the passes placed so far, and bounds of the others.
struct Schedule<'a> {
    buffers: &'a [BufferInfo],
    /// By buffer: the live passes that access it, if it is transient.
    users: &'a [Vec<usize>],
    /// By pass: its level, final or earliest.
    level: &'a [usize],
    /// By pass: its latest level.
    latest: &'a [usize],
    /// Number of levels.
    depth: usize,
}

/// Lifetime of a transient, as a function of the level of one pass.
struct TransientUse {
    bytes: u64,
    /// First and last level without the pass.
    others: Option<(usize, usize)>,
    /// Latest level of the passes that write it for this one. They are not placed yet and can move along.
    producers: Option<usize>,
}

impl TransientUse {
    /// Returns the number of levels that the transient spans, minus one. The pass is at level `at`.
    fn length(&self, at: usize) -> usize {
        let (mut first, last) = self.others.map_or((at, at), |(first, last)| (first.min(at), last.max(at)));
        if let Some(producers) = self.producers {
            first = first.min(producers).min(at.saturating_sub(1));
        }
        last - first
    }
}

/// Returns the transients that a pass accesses. Passes declared later are already placed. Earlier ones are assumed as
/// late as possible where they begin a lifetime, and as early as possible where they end one.
fn transient_uses(schedule: &Schedule<'_>, dependencies: &[u32], index: usize, pass: &Pass) -> Vec<TransientUse> {
    let Schedule { buffers, users, level, latest, depth } = *schedule;
    let mut transient_uses: Vec<usize> = pass.accesses.iter().map(|(slice, ..)| slice.buffer.index()).collect();
    transient_uses.retain(|&buffer| buffers[buffer].kind == BufferKind::Transient);
    transient_uses.sort_unstable();
    transient_uses.dedup();
    let transient_use = |buffer: usize| {
        // The reader of a kept buffer after the replay is one more user.
        let mut others = buffers[buffer].keep.then_some((depth, depth));
        let mut producers: Option<usize> = None;
        for &user in users[buffer].iter().filter(|&&user| user != index) {
            if dependencies.binary_search(&(user as u32)).is_ok() {
                producers = Some(producers.map_or(latest[user], |producers| producers.min(latest[user])));
            } else {
                let begin = if user > index { level[user] } else { latest[user] };
                let (first, last) = others.unwrap_or((begin, level[user]));
                others = Some((first.min(begin), last.max(level[user])));
            }
        }
        TransientUse { bytes: buffers[buffer].bytes, others, producers }
    };
    transient_uses.into_iter().map(transient_use).collect()
}

/// Returns the level with the smallest size-weighted lifetimes of transients; the earliest among equals.
fn best(transient_uses: &[TransientUse], (first, last): (usize, usize)) -> usize {
    let cost = |at: usize| -> u128 {
        transient_uses.iter().map(|life| u128::from(life.bytes) * life.length(at) as u128).sum()
    };
    // The cost is linear between these levels.
    let ends = transient_uses.iter().filter_map(|life| life.others).flat_map(|(first, last)| [first, last]);
    let producers = transient_uses.iter().filter_map(|life| life.producers).map(|producers| producers + 1);
    let candidates = [first, last].into_iter().chain(ends).chain(producers).filter(|at| (first..=last).contains(at));
    candidates.min_by_key(|&at| (cost(at), at)).unwrap_or(first)
}
