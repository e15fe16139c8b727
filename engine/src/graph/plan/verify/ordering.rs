//! Ordering state of memory operations: Vulkan's happens-before, per operation.
//!
//! A barrier affects an operation if it waits for the operation's stage, or for a stage that an earlier barrier
//! already ordered after it. It makes a write available if it names the write's stage and access. It makes visible,
//! to the accesses it names, writes that it makes available itself or that were made available before a stage it
//! waits for. Stages count only as named: implicit pipeline order is not used.
//!
//! Operations of equal stage and access between the same two barriers share one state. It is advanced lazily.

use super::Missing;
use super::shape::performs;
use crate::graph::plan::scope::{Accesses, Barrier, Stages};

/// Ordering state of one operation.
#[derive(Clone, Copy)]
struct OrderingState {
    stage: Stages,
    /// Write access, or none if the operation reads.
    writes: Accesses,
    /// Stages whose later operations are ordered after it.
    ordered: Stages,
    /// Stages whose later operations are ordered after its availability.
    available: Stages,
    /// Accesses that see it.
    visible: Accesses,
    /// Number of barriers applied.
    applied: usize,
}

impl OrderingState {
    fn pass(&mut self, barrier: &Barrier) {
        let concerned = self.stage | self.ordered;
        if concerned.intersection(barrier.src_stage).is_empty() {
            return;
        }
        self.ordered |= barrier.dst_stage;
        let names = barrier.src_stage.contains(self.stage) && barrier.src_access.contains(self.writes);
        if names || !self.available.intersection(barrier.src_stage).is_empty() {
            self.available |= barrier.dst_stage;
            self.visible |= barrier.dst_access;
        }
    }
}

/// Index of an operation's state.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) struct Operation(usize);

/// States of all operations along a sequence of barriers.
pub(super) struct OrderingStates {
    barriers: Vec<Barrier>,
    /// Index: number of earlier barriers, times [`KINDS`], plus the kind.
    states: Vec<Option<OrderingState>>,
}

/// Kinds of operation: a read and a write per stage, and a layout transition inside a barrier.
const KINDS: usize = 11;
/// Kind of layout transitions.
const TRANSITION: usize = KINDS - 1;

impl OrderingStates {
    /// Creates states along these barriers.
    pub(super) fn new(barriers: Vec<Barrier>) -> Self {
        let states = vec![None; (barriers.len() + 1) * KINDS];
        OrderingStates { barriers, states }
    }

    /// Returns an operation after the first `barriers` barriers.
    ///
    /// All of `accesses` happens in one stage. It is a write if any of them is.
    pub(super) fn operation(&mut self, barriers: usize, accesses: Accesses) -> Operation {
        let writes =
            accesses.intersection(Accesses::STORAGE_WRITE | Accesses::TRANSFER_WRITE | Accesses::OUTSIDE_WRITE);
        let one = Accesses::ALL.into_iter().find(|&one| accesses.contains(one));
        let stage = performs(one.expect("invariant: an operation has an access"));
        let kind = stage.bits().trailing_zeros() as usize * 2 + usize::from(!writes.is_empty());
        let at = barriers * KINDS + kind;
        self.states[at].get_or_insert(OrderingState {
            stage,
            writes,
            ordered: Stages::NONE,
            available: Stages::NONE,
            visible: Accesses::NONE,
            applied: barriers,
        });
        Operation(at)
    }

    /// Returns a layout transition inside a barrier, the last of the first `barriers`. It precedes everything ordered
    /// after the barrier, and is visible to the accesses that the barrier names.
    pub(super) fn transition(&mut self, barriers: usize, barrier: &Barrier) -> Operation {
        let at = barriers * KINDS + TRANSITION;
        self.states[at] = Some(OrderingState {
            stage: Stages::NONE,
            writes: Accesses::NONE,
            ordered: barrier.dst_stage,
            available: barrier.dst_stage,
            visible: barrier.dst_access,
            applied: barriers,
        });
        Operation(at)
    }

    /// Returns why a layout transition is not ordered after an operation; `None` if it is. The transition is inside
    /// `barrier`, which follows the first `barriers`.
    pub(super) fn unordered_transition(
        &mut self,
        operation: Operation,
        barriers: usize,
        barrier: &Barrier,
    ) -> Option<Missing> {
        let state = self.advance(operation, barriers);
        if (state.stage | state.ordered).intersection(barrier.src_stage).is_empty() {
            return Some(Missing::Order(state.stage));
        }
        let names = barrier.src_stage.contains(state.stage) && barrier.src_access.contains(state.writes);
        let seen = names || !state.available.intersection(barrier.src_stage).is_empty();
        (!seen && !state.writes.is_empty()).then_some(Missing::Visibility(state.writes))
    }

    fn advance(&mut self, operation: Operation, barriers: usize) -> OrderingState {
        let state = self.states[operation.0].as_mut().expect("invariant: operations have stories");
        while state.applied < barriers {
            let barrier = self.barriers[state.applied];
            state.pass(&barrier);
            state.applied += 1;
        }
        *state
    }

    /// Returns the stages of `stages` that are not ordered after the operation. Applies the first `barriers` barriers.
    pub(super) fn unordered(&mut self, operation: Operation, barriers: usize, stages: Stages) -> Stages {
        stages.without(self.advance(operation, barriers).ordered)
    }

    /// Returns the accesses of `accesses` that do not see the write. Applies the first `barriers` barriers.
    pub(super) fn hidden(&mut self, operation: Operation, barriers: usize, accesses: Accesses) -> Accesses {
        accesses.without(self.advance(operation, barriers).visible)
    }
}
