//! Proof that a plan is right, by other means than those by which it was made.
//!
//! Nothing here calls the compiler's steps: slices become numbered cells instead of maps of ranges, data flow becomes
//! a graph of versions walked from the outputs, and every single memory operation carries the list of what has
//! been ordered behind it through two replays in a row, or four if histories change places. What both share is only the data: declarations, the plan, and
//! the names of stages and accesses.
//!
//! Promises, of a plan that it accepts: each pass runs once or was dropped without loss; conflicting passes keep their
//! declared order; no two transients that are alive in one group share a byte; every conflict between memory
//! operations, within a replay, between two, and with the readers of the outputs, has a chain of barriers with the
//! stages and accesses that Vulkan asks for; every image is in a layout that its users can use, keeps its contents
//! where somebody wants them, and is left as declared; what meets on two queues has a wait in between, and no queue waits
//! for what is submitted after it. It does not judge whether the plan is a good one.

mod cells;
mod flow;
mod lanes;
mod layout;
mod memory;
mod shape;
mod story;
mod visibility;

use std::fmt;

use super::Plan;
use super::scope::{Accesses, Stages};
use crate::graph::resource::ImageState;

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
    /// Make an earlier write visible to accesses, or available to a change of layout.
    Visibility(Accesses),
    /// Make a queue wait for what another one does.
    Wait,
    /// Make stages wait for an earlier read, or a change of layout for operations of them.
    Order(Stages),
}

impl fmt::Display for Missing {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Missing::Wait => write!(f, "between the queues comes before it"),
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
    /// A history that does not consist of two buffers alike.
    #[error("Buffer [{buffer}] belongs to a history whose other half does not fit.")]
    WrongPair { buffer: String },
    /// A conditional pass that runs in any case, or counts on running.
    #[error("Pass [{pass}] runs on a condition, but its group counts are fixed or it promises to overwrite something.")]
    Conditional { pass: String },
    /// Segments that do not make up the plan, or wait for each other in a circle.
    #[error("Segment {segment} of the plan {what}.")]
    Segment { segment: usize, what: &'static str },
    /// An image touched in part.
    #[error("Pass [{pass}] touches a part of image [{image}], which only goes as a whole.")]
    PartOfImage { pass: String, image: String },
    /// A transition of an image that does not exist, or of one that another in the same barrier changes too.
    #[error("The barrier at the {at} of the plan changes the layout of {image}, which {what}.")]
    Transition { at: &'static str, image: String, what: &'static str },
    /// A transition from a state that the image is not in, or that loses what it holds.
    #[error("The barrier at the {at} of the plan takes {image} for {from:?}, but it is {is:?}.")]
    TransitionFrom { at: &'static str, image: String, from: ImageState, is: ImageState },
    /// An image used in a layout that does not allow it.
    #[error("Pass [{pass}] uses image [{image}] in the layout {state:?}, which does not allow it.")]
    Layout { pass: String, image: String, state: ImageState },
    /// An image whose stated home is not the layout that it is in.
    #[error("Image [{image}] is said to be {home:?} while it is {is:?}.")]
    Home { image: String, home: ImageState, is: ImageState },
    /// An image left in another state than declared.
    #[error("Image [{image}] is left {is:?}, but is to be left {exit:?}.")]
    Left { image: String, is: ImageState, exit: ImageState },
    /// A transient image in a slot of another make.
    #[error("Transient image [{image}] is placed in slot {slot}, which does not exist or is of another make.")]
    WrongSlot { image: String, slot: u64 },
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
    /// What others on the queue may not see after the replay, or may change too early.
    #[error("What pass [{pass}] does to [{buffer}] is left to others on the queue, but no barrier {missing}.")]
    LeftOpen { pass: String, buffer: String, missing: Missing },
    /// An output that readers after the replay may not see.
    #[error("What pass [{pass}] writes to output [{buffer}] is not made visible to {access} after the replay.")]
    OutputHidden { pass: String, buffer: String, access: Accesses },
}

/// Checks a plan.
pub fn verify(plan: &Plan) -> Result<(), VerifyError> {
    lanes::check(plan)?;
    let group_of = shape::check(plan)?;
    flow::check_needed(plan, &group_of)?;
    flow::check_order(plan, &group_of)?;
    layout::check(plan)?;
    memory::check(plan, &group_of)?;
    visibility::check(plan)
}

fn pass_name(plan: &Plan, pass: usize) -> String {
    plan.passes[pass].name.clone()
}

fn buffer_name(plan: &Plan, buffer: usize) -> String {
    plan.buffers[buffer].name.clone()
}
