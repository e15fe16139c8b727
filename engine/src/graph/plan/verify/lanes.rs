//! Knowledge of each segment about others: which have ended and are visible before it begins.
//!
//! A segment knows about its awaited segments, all earlier segments of their lanes, and everything that those knew. It
//! also inherits the knowledge of the previous segment of its own lane. It does not know that the previous segment has
//! ended: only barriers order the two.

use super::VerifyError;
use crate::graph::plan::{Lane, Plan};

/// By lane: latest segment known to have ended, counted over all replays.
pub(super) type EndedSegments = [Option<usize>; 2];

/// Segments of a plan over several replays.
pub(super) struct Lanes {
    /// By segment, over all replays.
    ended: Vec<EndedSegments>,
    /// By group: its segment.
    segment: Vec<usize>,
    count: usize,
}

/// Returns the position of a lane in [`EndedSegments`].
pub(super) fn index(lane: Lane) -> usize {
    usize::from(lane == Lane::Side)
}

/// Checks that segments contain every group once, in order, and wait only for earlier submissions.
pub(super) fn check(plan: &Plan) -> Result<(), VerifyError> {
    let wrong = |segment: usize, what: &'static str| Err(VerifyError::Segment { segment, what });
    let mut next = 0;
    for (at, segment) in plan.segments.iter().enumerate() {
        if segment.groups.start != next || segment.groups.end < next {
            return wrong(at, "does not begin where the previous segment ends");
        }
        next = segment.groups.end;
        if segment.waits.iter().any(|&wait| wait >= at) {
            return wrong(at, "waits for a later segment");
        }
    }
    if next != plan.groups.len() {
        return wrong(plan.segments.len(), "is missing: some groups are in no segment");
    }
    let last = plan.segments.len().wrapping_sub(1);
    for end in [0, last] {
        if plan.segments.get(end).is_none_or(|segment| segment.lane != Lane::Main) {
            return wrong(end, "is not on the main lane; the first and the last must be");
        }
    }
    if plan.segments.len() > 1 && plan.segments[0].groups.is_empty() {
        return wrong(0, "is empty");
    }
    let lanes = Lanes::new(plan, 1);
    let last_side = plan.segments.iter().rposition(|segment| segment.lane == Lane::Side);
    if lanes.ended[last][1] < last_side {
        return wrong(last, "does not wait for all of the second lane");
    }
    Ok(())
}

impl Lanes {
    /// Computes the knowledge of segments over a number of replays.
    pub(super) fn new(plan: &Plan, replays: usize) -> Lanes {
        let count = plan.segments.len();
        let mut ended: Vec<EndedSegments> = Vec::with_capacity(replays * count);
        let mut before: [Option<usize>; 2] = [None; 2];
        for replay in 0..replays {
            for (at, segment) in plan.segments.iter().enumerate() {
                let mut ended_here = before[index(segment.lane)].map_or([None; 2], |before| ended[before]);
                for wait in segment.waits.iter().map(|wait| replay * count + wait) {
                    for (ended_here, theirs) in ended_here.iter_mut().zip(ended[wait]) {
                        *ended_here = (*ended_here).max(theirs);
                    }
                    let lane = index(plan.segments[wait % count].lane);
                    ended_here[lane] = ended_here[lane].max(Some(wait));
                }
                before[index(segment.lane)] = Some(replay * count + at);
                ended.push(ended_here);
            }
        }
        let mut segment = vec![0; plan.groups.len()];
        for (at, of) in plan.segments.iter().enumerate() {
            segment[of.groups.clone()].fill(at);
        }
        Lanes { ended, segment, count }
    }

    /// Returns the segment of a group in a replay.
    pub(super) fn segment(&self, replay: usize, group: usize) -> usize {
        replay * self.count + self.segment[group]
    }

    /// Returns the first segment of a replay.
    pub(super) fn first(&self, replay: usize) -> usize {
        replay * self.count
    }

    /// Returns the last segment of a replay.
    pub(super) fn last(&self, replay: usize) -> usize {
        (replay + 1) * self.count - 1
    }

    /// Returns whether segment `other` of a lane has ended before `segment` begins.
    pub(super) fn has_ended(&self, segment: usize, lane: Lane, other: usize) -> bool {
        self.ended[segment][index(lane)] >= Some(other)
    }

    /// Returns, by group of one replay, the range of groups during which its memory is in use. For the second lane,
    /// the range of main-lane groups that may run concurrently.
    pub(super) fn together(&self, plan: &Plan) -> Vec<(usize, usize)> {
        let mut spans: Vec<(usize, usize)> = (0..plan.groups.len()).map(|at| (at, at)).collect();
        for (first, a) in plan.segments.iter().enumerate().filter(|(_, a)| !a.groups.is_empty()) {
            for (second, b) in plan.segments.iter().enumerate().skip(first + 1) {
                if a.lane == b.lane || b.groups.is_empty() || self.has_ended(second, a.lane, first) {
                    continue;
                }
                // Extending one of the two suffices to make the ranges overlap.
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
