//! What has happened since a memory operation: Vulkan's happens-before, one operation at a time.
//!
//! A barrier concerns an operation if it waits for the operation's stage or for a stage that an earlier barrier
//! already held back behind it. It makes a write available if it names the write's own stage and access, and visible to
//! the accesses it names what it makes available itself or what was made available before something that it waits for.
//! Stages count only as named: that a pipeline runs some before others is
//! not made use of.
//!
//! Operations between the same two barriers that are alike in stage and access have the same story, which is told
//! once and only as far as somebody asks.

use super::Missing;
use super::shape::performs;
use crate::graph::plan::scope::{Accesses, Barrier, Stages};

/// One operation's story so far.
#[derive(Clone, Copy)]
struct Story {
    stage: Stages,
    /// The write, or none if the operation reads.
    writes: Accesses,
    /// Stages whose later operations come after it.
    ordered: Stages,
    /// Stages whose later operations come after it was made available.
    available: Stages,
    /// Accesses that see it.
    visible: Accesses,
    /// How many barriers of the stream have been counted.
    told: usize,
}

impl Story {
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

/// Which story an operation belongs to.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) struct Operation(usize);

/// All stories along a stream of barriers.
pub(super) struct Stories {
    barriers: Vec<Barrier>,
    /// By how many barriers came before, times [`KINDS`], plus the kind.
    stories: Vec<Option<Story>>,
}

/// Kinds of operation: a read in each stage, a write in each, and a change of layout inside a barrier.
const KINDS: usize = 11;
/// The last of them: layout transitions.
const TRANSITION: usize = KINDS - 1;

impl Stories {
    /// Stories along these barriers.
    pub(super) fn new(barriers: Vec<Barrier>) -> Self {
        let stories = vec![None; (barriers.len() + 1) * KINDS];
        Stories { barriers, stories }
    }

    /// An operation after the first `barriers` barriers. All of `accesses` happens in one stage; it is a write if any
    /// of them is.
    pub(super) fn operation(&mut self, barriers: usize, accesses: Accesses) -> Operation {
        let writes =
            accesses.intersection(Accesses::STORAGE_WRITE | Accesses::TRANSFER_WRITE | Accesses::OUTSIDE_WRITE);
        let one = Accesses::EACH.into_iter().find(|&one| accesses.contains(one));
        let stage = performs(one.expect("invariant: an operation has an access"));
        let kind = stage.bits().trailing_zeros() as usize * 2 + usize::from(!writes.is_empty());
        let at = barriers * KINDS + kind;
        self.stories[at].get_or_insert(Story {
            stage,
            writes,
            ordered: Stages::NONE,
            available: Stages::NONE,
            visible: Accesses::NONE,
            told: barriers,
        });
        Operation(at)
    }

    /// A change of layout inside a barrier, the last of the first `barriers`: it is done before anything that the
    /// barrier holds back, and visible to what the barrier names.
    pub(super) fn transition(&mut self, barriers: usize, barrier: &Barrier) -> Operation {
        let at = barriers * KINDS + TRANSITION;
        self.stories[at] = Some(Story {
            stage: Stages::NONE,
            writes: Accesses::NONE,
            ordered: barrier.dst_stage,
            available: barrier.dst_stage,
            visible: barrier.dst_access,
            told: barriers,
        });
        Operation(at)
    }

    /// What keeps a change of layout inside `barrier`, which follows the first `barriers`, from coming after an
    /// operation, if anything.
    pub(super) fn outside(&mut self, operation: Operation, barriers: usize, barrier: &Barrier) -> Option<Missing> {
        let story = self.tell(operation, barriers);
        if (story.stage | story.ordered).intersection(barrier.src_stage).is_empty() {
            return Some(Missing::Order(story.stage));
        }
        let names = barrier.src_stage.contains(story.stage) && barrier.src_access.contains(story.writes);
        let seen = names || !story.available.intersection(barrier.src_stage).is_empty();
        (!seen && !story.writes.is_empty()).then_some(Missing::Visibility(story.writes))
    }

    fn tell(&mut self, operation: Operation, barriers: usize) -> Story {
        let story = self.stories[operation.0].as_mut().expect("invariant: operations have stories");
        while story.told < barriers {
            let barrier = self.barriers[story.told];
            story.pass(&barrier);
            story.told += 1;
        }
        *story
    }

    /// The stages of `stages` that do not wait for the operation, as of `barriers` barriers.
    pub(super) fn unordered(&mut self, operation: Operation, barriers: usize, stages: Stages) -> Stages {
        stages.without(self.tell(operation, barriers).ordered)
    }

    /// The accesses of `accesses` that do not see the write, as of `barriers` barriers.
    pub(super) fn hidden(&mut self, operation: Operation, barriers: usize, accesses: Accesses) -> Accesses {
        accesses.without(self.tell(operation, barriers).visible)
    }
}
