//! Into which hazard group each pass goes.
//!
//! The groups are the levels of the dependency graph, so there are as few as the longest chain allows and each is as
//! wide as it can be. A pass with room to move is then put where its transients live shortest: a fill goes right
//! before its first user, a last reader stays near the writer. Equal inputs give equal orders; there is no search.

use crate::graph::pass::Pass;
use crate::graph::resource::{BufferInfo, BufferKind};

/// The living passes in groups. No two passes of one group depend on each other.
pub(super) fn order(
    buffers: &[BufferInfo],
    passes: &[Pass],
    lives: &[bool],
    follows: &[Vec<u32>],
    reorder: bool,
) -> Vec<Vec<usize>> {
    let living: Vec<usize> = (0..passes.len()).filter(|&index| lives[index]).collect();
    if !reorder {
        return declared(&living, follows);
    }
    let mut level = vec![0; passes.len()];
    for &index in &living {
        level[index] = follows[index].iter().map(|&before| level[before as usize] + 1).max().unwrap_or(0);
    }
    let depth = living.iter().map(|&index| level[index] + 1).max().unwrap_or(0);
    sink(buffers, passes, &living, follows, depth, &mut level);

    let mut groups = vec![Vec::new(); depth];
    for &index in &living {
        groups[level[index]].push(index);
    }
    for group in &mut groups {
        // Kernels and transfers apart: the device switches between them once a group.
        group.sort_by_key(|&index| (!passes[index].is_transfer(), index));
    }
    groups
}

/// The declared order, cut before each pass that depends on one since the last cut.
fn declared(living: &[usize], follows: &[Vec<u32>]) -> Vec<Vec<usize>> {
    let mut groups: Vec<Vec<usize>> = Vec::new();
    for &index in living {
        match groups.last_mut() {
            Some(group) if !follows[index].iter().any(|&before| before as usize >= group[0]) => group.push(index),
            _ => groups.push(vec![index]),
        }
    }
    groups
}

/// Moves passes to later groups, within what their followers allow, where that shortens transient lifetimes.
fn sink(
    buffers: &[BufferInfo],
    passes: &[Pass],
    living: &[usize],
    follows: &[Vec<u32>],
    depth: usize,
    level: &mut [usize],
) {
    let mut latest = vec![depth.saturating_sub(1); passes.len()];
    for &index in living.iter().rev() {
        let at = latest[index];
        bound(&mut latest, &follows[index], at);
    }
    let users = transient_users(buffers, passes, living);
    // From the last pass to the first, so that followers have their final place.
    for &index in living.iter().rev() {
        let room = (level[index], latest[index]);
        if room.0 < room.1 {
            let touched = touched(buffers, &users, level, &latest, &follows[index], index, &passes[index], depth);
            level[index] = best(&touched, room);
        }
        bound(&mut latest, &follows[index], level[index]);
    }
}

/// Keeps what a pass follows in front of it.
fn bound(latest: &mut [usize], follows: &[u32], at: usize) {
    for &before in follows {
        let latest = &mut latest[before as usize];
        *latest = (*latest).min(at - 1);
    }
}

/// By buffer: the living passes that touch it, if it is transient.
fn transient_users(buffers: &[BufferInfo], passes: &[Pass], living: &[usize]) -> Vec<Vec<usize>> {
    let mut users = vec![Vec::new(); buffers.len()];
    for &index in living {
        for (slice, ..) in &passes[index].accesses {
            let buffer = slice.buffer.index();
            if buffers[buffer].kind == BufferKind::Transient && users[buffer].last() != Some(&index) {
                users[buffer].push(index);
            }
        }
    }
    users
}

/// A transient as the pass to be placed sees it.
struct Touched {
    bytes: u64,
    /// Where it begins and ends without the pass.
    others: Option<(usize, usize)>,
    /// Where the passes that make it for this one end up at the latest. They have no place yet and can come along.
    makers: Option<usize>,
}

impl Touched {
    /// How many groups it lives through, but one, if the pass is there.
    fn length(&self, at: usize) -> usize {
        let (mut first, last) = self.others.map_or((at, at), |(first, last)| (first.min(at), last.max(at)));
        if let Some(makers) = self.makers {
            first = first.min(makers).min(at.saturating_sub(1));
        }
        last - first
    }
}

/// The transients that a pass touches. Passes declared after it have their place; those before it are expected as
/// late as they may be where they begin a lifetime, and as early where they end one.
fn touched(
    buffers: &[BufferInfo],
    users: &[Vec<usize>],
    level: &[usize],
    latest: &[usize],
    follows: &[u32],
    index: usize,
    pass: &Pass,
    depth: usize,
) -> Vec<Touched> {
    let mut touched: Vec<usize> = pass.accesses.iter().map(|(slice, ..)| slice.buffer.index()).collect();
    touched.retain(|&buffer| buffers[buffer].kind == BufferKind::Transient);
    touched.sort_unstable();
    touched.dedup();
    let look = |buffer: usize| {
        // Who wants a kept buffer after the replay is one more user.
        let mut others = buffers[buffer].keep.then_some((depth, depth));
        let mut makers: Option<usize> = None;
        for &user in users[buffer].iter().filter(|&&user| user != index) {
            if follows.binary_search(&(user as u32)).is_ok() {
                makers = Some(makers.map_or(latest[user], |makers| makers.min(latest[user])));
            } else {
                let begin = if user > index { level[user] } else { latest[user] };
                let (first, last) = others.unwrap_or((begin, level[user]));
                others = Some((first.min(begin), last.max(level[user])));
            }
        }
        Touched { bytes: buffers[buffer].bytes, others, makers }
    };
    touched.into_iter().map(look).collect()
}

/// The place within the room at which the transients live shortest, weighted by size; the earliest of equals.
fn best(touched: &[Touched], (first, last): (usize, usize)) -> usize {
    let cost =
        |at: usize| -> u128 { touched.iter().map(|life| u128::from(life.bytes) * life.length(at) as u128).sum() };
    // The cost is linear between these.
    let ends = touched.iter().filter_map(|life| life.others).flat_map(|(first, last)| [first, last]);
    let makers = touched.iter().filter_map(|life| life.makers).map(|makers| makers + 1);
    let candidates = [first, last].into_iter().chain(ends).chain(makers).filter(|at| (first..=last).contains(at));
    candidates.min_by_key(|&at| (cost(at), at)).unwrap_or(first)
}
