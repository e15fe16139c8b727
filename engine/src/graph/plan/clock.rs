//! What a stream of barriers has ordered so far.
//!
//! For each kind of operation, the time up to which all operations of that kind are ordered before a stage, available,
//! or visible to an access. A barrier covers everything before it in its source stages, so these times only grow and
//! one number a pair is exact. Chains count: what waited for an operation passes the wait on.

use super::hazard::{Need, Time, WRITES, stage_index};
use super::scope::{Accesses, Barrier, Stages};

/// The state after some barriers.
#[derive(Clone, Copy, Default)]
pub(super) struct Clock {
    /// By stage of an operation and stage that has waited for it.
    ordered: [[Time; 4]; 4],
    /// By kind of write.
    available: [Time; 2],
    /// By kind of write and access.
    visible: [[Time; 7]; 2],
}

impl Clock {
    /// Passes a barrier; everything up to `before` was recorded before it.
    pub(super) fn pass(&mut self, barrier: &Barrier, before: Time) {
        // Up to when each stage's operations are in the barrier's first scope.
        let mut covered = [0; 4];
        for (stage, covered) in covered.iter_mut().enumerate() {
            for (source, &bit) in Stages::EACH.iter().enumerate() {
                if barrier.src_stage.contains(bit) {
                    *covered = (*covered).max(if source == stage { before } else { self.ordered[stage][source] });
                }
            }
        }
        for (ordered, covered) in self.ordered.iter_mut().zip(covered) {
            for (target, &bit) in Stages::EACH.iter().enumerate() {
                if barrier.dst_stage.contains(bit) {
                    ordered[target] = ordered[target].max(covered);
                }
            }
        }
        for (kind, (access, stage)) in WRITES.into_iter().enumerate() {
            if barrier.src_access.contains(access) && barrier.src_stage.contains(stage) {
                self.available[kind] = before;
            }
            let reaches = covered[stage_index(stage)].min(self.available[kind]);
            for (target, &bit) in Accesses::EACH.iter().enumerate() {
                if barrier.dst_access.contains(bit) && barrier.dst_stage.contains(bit.stages()) {
                    self.visible[kind][target] = self.visible[kind][target].max(reaches);
                }
            }
        }
    }

    /// Whether everything needed has happened.
    pub(super) fn covers(&self, need: &Need) -> bool {
        let covers = |have: &[Time], need: &[Time]| have.iter().zip(need).all(|(have, need)| have >= need);
        self.ordered.iter().zip(&need.execution).all(|(have, need)| covers(have, need))
            && self.visible.iter().zip(&need.memory).all(|(have, need)| covers(have, need))
    }

    /// A barrier that covers, by itself and right now, whatever of the need is not yet covered.
    pub(super) fn lacks(&self, need: &Need) -> Barrier {
        let mut barrier = Barrier::default();
        for (source, &src) in Stages::EACH.iter().enumerate() {
            for (target, &dst) in Stages::EACH.iter().enumerate() {
                if self.ordered[source][target] < need.execution[source][target] {
                    barrier.src_stage |= src;
                    barrier.dst_stage |= dst;
                }
            }
        }
        for (kind, (access, stage)) in WRITES.into_iter().enumerate() {
            for (target, &dst) in Accesses::EACH.iter().enumerate() {
                if self.visible[kind][target] < need.memory[kind][target] {
                    barrier.src_stage |= stage;
                    barrier.src_access |= access;
                    barrier.dst_stage |= dst.stages();
                    barrier.dst_access |= dst;
                }
            }
        }
        barrier
    }
}
