//! State of a sequence of barriers: the operations that they have ordered.
//!
//! For each kind of operation, holds the time up to which all operations of that kind are ordered before a stage,
//! available, or visible to an access. A barrier covers everything before it in its source stages. The times
//! therefore only grow, and one number per pair is exact. Execution dependencies chain.
//!
//! Layout transitions happen inside a barrier: after its source stages, and visible to its destination accesses.
//! Those at the beginning of a replay are one kind of operation, those at its end another. Each kind happens at one
//! point of a replay, to the same images every time, so that one number is exact for them too.

use super::hazard::{INSIDE, MEMORY_ROWS, Need, ROWS, TRANSITION_ACCESS, Time, WRITES};
use super::scope::{Accesses, Barrier, Stages};

/// Position of layout transitions in a replay.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Transitions {
    /// No transitions at this barrier.
    None,
    /// Transitions in the barrier before the first group.
    Entry,
    /// Transitions in the barrier after the last group.
    Exit,
}

impl Transitions {
    /// Returns the row in a need's executions and the row in its memory.
    pub(super) fn rows(self) -> Option<(usize, usize)> {
        match self {
            Transitions::None => None,
            Transitions::Entry => Some((Stages::ALL.len(), WRITES.len())),
            Transitions::Exit => Some((Stages::ALL.len() + 1, WRITES.len() + 1)),
        }
    }
}

/// State after some barriers.
#[derive(Clone, Copy, Default)]
pub(super) struct Clock {
    /// By stage of an operation and stage that has waited for it; last, the latest barrier. The last rows are kinds of
    /// transitions.
    ordered: [[Time; INSIDE + 1]; ROWS],
    /// By kind of write and stage that has waited until it was available.
    available: [[Time; Stages::ALL.len()]; WRITES.len()],
    /// By kind of write (or transition) and access; last, the latest barrier.
    visible: [[Time; TRANSITION_ACCESS + 1]; MEMORY_ROWS],
}

impl Clock {
    /// Applies a barrier; everything up to `before` was recorded before it. Its transitions happen at the next time.
    pub(super) fn pass(&mut self, barrier: &Barrier, before: Time, transitions: Transitions) {
        // Time up to which each stage's operations are in the barrier's first scope.
        let mut covered = [0; ROWS];
        for (stage, covered) in covered.iter_mut().enumerate() {
            for (source, &bit) in Stages::ALL.iter().enumerate() {
                if barrier.src_stage.contains(bit) {
                    *covered = (*covered).max(if source == stage { before } else { self.ordered[stage][source] });
                }
            }
        }
        let mut reach = covered;
        if let Some((row, _)) = transitions.rows() {
            reach[row] = before + 1;
        }
        for ((ordered, covered), reach) in self.ordered.iter_mut().zip(covered).zip(reach) {
            for (target, &bit) in Stages::ALL.iter().enumerate() {
                if barrier.dst_stage.contains(bit) {
                    ordered[target] = ordered[target].max(reach);
                }
            }
            ordered[INSIDE] = covered;
        }
        for kind in 0..MEMORY_ROWS {
            let (reaches, inside) = match WRITES.get(kind) {
                Some(&(access, stage)) => {
                    // A barrier makes earlier available writes visible only if it waits for a stage that waited for
                    // their availability.
                    let named = barrier.src_access.contains(access) && barrier.src_stage.contains(stage);
                    let available = &mut self.available[kind];
                    let waited =
                        Stages::ALL.iter().zip(*available).filter(|(bit, _)| barrier.src_stage.contains(**bit));
                    let reaches = waited.map(|(_, time)| time).max().unwrap_or(0).max(if named { before } else { 0 });
                    for (&bit, available) in Stages::ALL.iter().zip(available) {
                        if barrier.dst_stage.contains(bit) {
                            *available = (*available).max(reaches);
                        }
                    }
                    (reaches, reaches)
                }
                // A transition makes its write available.
                None => {
                    (reach[kind - WRITES.len() + Stages::ALL.len()], covered[kind - WRITES.len() + Stages::ALL.len()])
                }
            };
            for (target, &bit) in Accesses::ALL.iter().enumerate() {
                if barrier.dst_access.contains(bit) && barrier.dst_stage.contains(bit.stages()) {
                    self.visible[kind][target] = self.visible[kind][target].max(reaches);
                }
            }
            self.visible[kind][TRANSITION_ACCESS] = inside;
        }
    }

    /// Returns whether all needs are met.
    pub(super) fn covers(&self, need: &Need) -> bool {
        let covers = |have: &[Time], need: &[Time]| have.iter().zip(need).all(|(have, need)| have >= need);
        self.ordered.iter().zip(&need.execution).all(|(have, need)| covers(have, need))
            && self.visible.iter().zip(&need.memory).all(|(have, need)| covers(have, need))
    }

    /// Returns a barrier that covers, alone and now, all unmet needs. Needed transitions are assumed to happen in
    /// this barrier.
    pub(super) fn missing_barrier(&self, need: &Need) -> Barrier {
        let mut barrier = Barrier::default();
        for (source, row) in need.execution.iter().enumerate() {
            let src = Stages::ALL.get(source).copied().unwrap_or_default();
            for (target, &dst) in Stages::ALL.iter().enumerate() {
                if self.ordered[source][target] < row[target] {
                    barrier.src_stage |= src;
                    barrier.dst_stage |= dst;
                }
            }
            if row[INSIDE] > 0 {
                barrier.src_stage |= src;
            }
        }
        for (kind, row) in need.memory.iter().enumerate() {
            let (access, stage) = WRITES.get(kind).copied().unwrap_or_default();
            for (target, &dst) in Accesses::ALL.iter().enumerate() {
                if self.visible[kind][target] < row[target] {
                    barrier.src_stage |= stage;
                    barrier.src_access |= access;
                    barrier.dst_stage |= dst.stages();
                    barrier.dst_access |= dst;
                }
            }
            if row[TRANSITION_ACCESS] > 0 {
                barrier.src_stage |= stage;
                barrier.src_access |= access;
            }
        }
        barrier
    }
}
