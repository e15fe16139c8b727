//! What each segment knows of the others: which of them have ended, for certain and in sight, before it begins.
//!
//! A segment knows what the segments that it waits for knew, those segments and all before them on their lane, and what
//! the segment before it on its own lane knew. That this one has ended it does not know: only barriers say that.

use super::VerifyError;
use crate::graph::plan::{Lane, Plan};

/// By lane: the latest segment that has ended, counted through all replays.
pub(super) type Known = [Option<usize>; 2];

/// The segments of a plan through several replays.
pub(super) struct Lanes {
    /// By segment of all replays in a row.
    known: Vec<Known>,
    /// By group: its segment.
    segment: Vec<usize>,
    count: usize,
}

/// Position of a lane in [`Known`].
pub(super) fn index(lane: Lane) -> usize {
    usize::from(lane == Lane::Side)
}

/// Checks that the segments hold every group once, in order, and wait only for what is submitted before them.
pub(super) fn check(plan: &Plan) -> Result<(), VerifyError> {
    let wrong = |segment: usize, what: &'static str| Err(VerifyError::Segment { segment, what });
    let mut next = 0;
    for (at, segment) in plan.segments.iter().enumerate() {
        if segment.groups.start != next || segment.groups.end < next {
            return wrong(at, "does not begin where the one before it ends");
        }
        next = segment.groups.end;
        if segment.waits.iter().any(|&wait| wait >= at) {
            return wrong(at, "waits for one that is submitted after it");
        }
    }
    if next != plan.groups.len() {
        return wrong(plan.segments.len(), "is missing: some groups are in none");
    }
    let last = plan.segments.len().wrapping_sub(1);
    for end in [0, last] {
        if plan.segments.get(end).is_none_or(|segment| segment.lane != Lane::Main) {
            return wrong(end, "is not the main lane's, as the first and the last have to be");
        }
    }
    if plan.segments.len() > 1 && plan.segments[0].groups.is_empty() {
        return wrong(0, "is empty");
    }
    let lanes = Lanes::new(plan, 1);
    let last_side = plan.segments.iter().rposition(|segment| segment.lane == Lane::Side);
    if lanes.known[last][1] < last_side {
        return wrong(last, "does not wait for all of the second lane");
    }
    Ok(())
}

impl Lanes {
    /// Takes the segments through so many replays.
    pub(super) fn new(plan: &Plan, replays: usize) -> Lanes {
        let count = plan.segments.len();
        let mut known: Vec<Known> = Vec::with_capacity(replays * count);
        let mut before: [Option<usize>; 2] = [None; 2];
        for replay in 0..replays {
            for (at, segment) in plan.segments.iter().enumerate() {
                let mut knows = before[index(segment.lane)].map_or([None; 2], |before| known[before]);
                for wait in segment.waits.iter().map(|wait| replay * count + wait) {
                    for (knows, theirs) in knows.iter_mut().zip(known[wait]) {
                        *knows = (*knows).max(theirs);
                    }
                    let lane = index(plan.segments[wait % count].lane);
                    knows[lane] = knows[lane].max(Some(wait));
                }
                before[index(segment.lane)] = Some(replay * count + at);
                known.push(knows);
            }
        }
        let mut segment = vec![0; plan.groups.len()];
        for (at, of) in plan.segments.iter().enumerate() {
            segment[of.groups.clone()].fill(at);
        }
        Lanes { known, segment, count }
    }

    /// The segment of a group of a replay.
    pub(super) fn segment(&self, replay: usize, group: usize) -> usize {
        replay * self.count + self.segment[group]
    }

    /// The first segment of a replay.
    pub(super) fn first(&self, replay: usize) -> usize {
        replay * self.count
    }

    /// The last segment of a replay.
    pub(super) fn last(&self, replay: usize) -> usize {
        (replay + 1) * self.count - 1
    }

    /// Whether something in a segment on a lane has ended before another segment begins.
    pub(super) fn knows(&self, segment: usize, lane: Lane, other: usize) -> bool {
        self.known[segment][index(lane)] >= Some(other)
    }

    /// By group of one replay: from which group to which its memory is in use. For groups of the second lane, from the
    /// first to the last group of the main lane that may run together with them.
    pub(super) fn together(&self, plan: &Plan) -> Vec<(usize, usize)> {
        let mut spans: Vec<(usize, usize)> = (0..plan.groups.len()).map(|at| (at, at)).collect();
        for (first, a) in plan.segments.iter().enumerate().filter(|(_, a)| !a.groups.is_empty()) {
            for (second, b) in plan.segments.iter().enumerate().skip(first + 1) {
                if a.lane == b.lane || b.groups.is_empty() || self.knows(second, a.lane, first) {
                    continue;
                }
                // One of the two is enough: then the stretches of both meet.
                if a.lane == Lane::Side {
                    spans[a.groups.clone()].iter_mut().for_each(|span| span.1 = span.1.max(b.groups.end - 1));
                } else {
                    spans[b.groups.clone()].iter_mut().for_each(|span| span.0 = span.0.min(a.groups.start));
                }
            }
        }
        spans
    }
}
