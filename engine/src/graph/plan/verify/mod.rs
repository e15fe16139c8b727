//! Proof that a plan is right, by other means than those by which it was made.
//!
//! Nothing here calls the compiler's steps: slices become numbered cells instead of maps of ranges, data flow becomes
//! a graph of versions walked from the outputs, and every single memory operation carries the list of what has
//! been ordered behind it through two replays in a row. What both share is only the data: declarations, the plan, and
//! the names of stages and accesses.
//!
//! Promises, of a plan that it accepts: each pass runs once or was dropped without loss; conflicting passes keep their
//! declared order; no two transients that are alive in one group share a byte; every conflict between memory
//! operations, within a replay, between two, and with the readers of the outputs, has a chain of barriers with the
//! stages and accesses that Vulkan asks for. It does not judge whether the plan is a good one.

mod cells;
mod flow;
mod memory;
mod shape;
mod story;
mod visibility;

use std::fmt;

use super::Plan;
use super::scope::{Accesses, Stages};

/// Two operations that must not be left to chance.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Hazard {
    /// A read of what was written before.
    ReadAfterWrite,
    /// A write over what was read before.
    WriteAfterRead,
    /// A write over what was written before.
    WriteAfterWrite,
}

impl fmt::Display for Hazard {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Hazard::ReadAfterWrite => "read after write",
            Hazard::WriteAfterRead => "write after read",
            Hazard::WriteAfterWrite => "write after write",
        })
    }
}

/// What no barrier does for two conflicting operations.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Missing {
    /// Make an earlier write visible to accesses.
    Visibility(Accesses),
    /// Make stages wait for an earlier read.
    Order(Stages),
}

impl fmt::Display for Missing {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Missing::Visibility(accesses) => write!(f, "makes the write visible to {accesses}"),
            Missing::Order(stages) => write!(f, "makes {stages} wait for the read"),
        }
    }
}

/// What is wrong with a plan.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // The fields are what the messages say of them.
pub enum VerifyError {
    /// A list that does not belong to the plan's buffers or passes.
    #[error("The plan has {found} {what} where {expected} are expected.")]
    Count { what: &'static str, found: usize, expected: usize },
    /// A pass that does not run exactly once.
    #[error("Pass [{pass}] is scheduled or dropped {times} times instead of once.")]
    NotOnce { pass: String, times: usize },
    /// A slice outside its buffer.
    #[error("Pass [{pass}] touches bytes {start}..{end} of buffer [{buffer}], which has {bytes}.")]
    OutOfBuffer { pass: String, buffer: String, start: u64, end: u64, bytes: u64 },
    /// An access that the kind of the pass implies and its list of accesses lacks, or the other way round.
    #[error("Pass [{pass}] {what} without saying so in its accesses, or says so without doing it.")]
    Undeclared { pass: String, what: String },
    /// A write to a read-only buffer.
    #[error("Pass [{pass}] writes buffer [{buffer}], which is read-only.")]
    WriteToReadOnly { pass: String, buffer: String },
    /// A barrier with an access that none of its stages performs.
    #[error("The barrier before group {group} names access {access} without the stage {stage} that performs it.")]
    AccessWithoutStage { group: usize, access: Accesses, stage: Stages },
    /// A pass that was dropped although somebody wants what it writes.
    #[error("Pass [{pass}] was dropped, but {by} needs what it writes to buffer [{buffer}].")]
    NeededPassCulled { pass: String, buffer: String, by: String },
    /// Passes in an order that changes the data.
    #[error(
        "Pass [{second}] in group {second_group} must come after pass [{first}] in group {first_group}: {hazard} of \
         buffer [{buffer}]."
    )]
    Order { hazard: Hazard, buffer: String, first: String, first_group: usize, second: String, second_group: usize },
    /// A used transient without memory.
    #[error("Transient [{buffer}] is used but has no place in the arena.")]
    Unplaced { buffer: String },
    /// A transient that does not fit.
    #[error("Transient [{buffer}] occupies bytes {start}..{end} of an arena of {arena} bytes.")]
    OutOfArena { buffer: String, start: u64, end: u64, arena: u64 },
    /// Two transients in one place at one time.
    #[error(
        "Transients [{first}] (groups {first_lives:?}) and [{second}] (groups {second_lives:?}) share byte {byte} of \
         the arena while both are alive."
    )]
    Overlap { first: String, first_lives: (usize, usize), second: String, second_lives: (usize, usize), byte: u64 },
    /// Two conflicting memory operations without the barriers that they need.
    #[error(
        "Pass [{second}] on buffer [{second_buffer}] has a {hazard} with pass [{first}] on buffer [{first_buffer}] at \
         byte {byte} within {replays} replay(s), but no barrier {missing}."
    )]
    Hazard {
        hazard: Hazard,
        first: String,
        first_buffer: String,
        second: String,
        second_buffer: String,
        /// Of the external buffer, or of the arena.
        byte: u64,
        /// 1 if both are in the same replay, 2 if the second is in the next.
        replays: usize,
        missing: Missing,
    },
    /// An output that readers after the replay may not see.
    #[error("What pass [{pass}] writes to output [{buffer}] is not made visible to {access} after the replay.")]
    OutputHidden { pass: String, buffer: String, access: Accesses },
}

/// Checks a plan.
pub fn verify(plan: &Plan) -> Result<(), VerifyError> {
    let group_of = shape::check(plan)?;
    flow::check_needed(plan, &group_of)?;
    flow::check_order(plan, &group_of)?;
    memory::check(plan, &group_of)?;
    visibility::check(plan)
}

fn pass_name(plan: &Plan, pass: usize) -> String {
    plan.passes[pass].name.clone()
}

fn buffer_name(plan: &Plan, buffer: usize) -> String {
    plan.buffers[buffer].name.clone()
}
