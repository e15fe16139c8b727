//! Verification of a plan, independent of the compiler.
//!
//! Uses none of the compiler's steps. Slices become numbered cells instead of range maps, and data flow becomes a
//! graph of versions walked from the outputs. Each memory operation tracks what is ordered after it, through two
//! consecutive replays. Compiler and verifier share only data: declarations, the plan, and
//! the names of stages and accesses.
//!
//! Guarantees for an accepted plan:
//! * Each pass runs once or was culled without loss; conflicting passes keep their declared order.
//! * No two transients that are alive in one group share a byte.
//! * Every conflict between memory operations has a chain of barriers with the stages and accesses that Vulkan
//!   requires. This covers conflicts within a replay, between two replays, and with readers of outputs.
//! * Every image is in a layout that its users allow, keeps needed contents, and ends in its declared state.
//!
//! The verifier does not judge performance.

mod cells;
mod flow;
mod layout;
mod memory;
mod ordering;
mod shape;
mod visibility;

use std::fmt;

use super::Plan;
use super::scope::{Accesses, Stages};
use crate::graph::resource::ImageState;

/// Type of conflict between two operations.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Hazard {
    /// Read after an earlier write.
    ReadAfterWrite,
    /// Write after an earlier read.
    WriteAfterRead,
    /// Write after an earlier write.
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

/// Missing effect of barriers between two conflicting operations.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Missing {
    /// Makes an earlier write visible to accesses, or available to a layout transition.
    Visibility(Accesses),
    /// Makes stages wait for an earlier read. Or makes a layout transition wait for their operations.
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

/// Error of a plan.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // The fields are what the messages say of them.
pub enum VerifyError {
    /// The length of a list does not match the plan's buffers or passes.
    #[error("The plan has {found} {what} where {expected} are expected.")]
    Count { what: &'static str, found: usize, expected: usize },
    /// A pass does not run exactly once.
    #[error("Pass [{pass}] is scheduled or dropped {times} times instead of once.")]
    NotOnce { pass: String, times: usize },
    /// A slice exceeds its buffer.
    #[error("Pass [{pass}] touches bytes {start}..{end} of buffer [{buffer}], which has {bytes}.")]
    OutOfBuffer { pass: String, buffer: String, start: u64, end: u64, bytes: u64 },
    /// The accesses of a pass do not match its kind.
    #[error("The declared accesses of pass [{pass}] do not match its kind: it {what}.")]
    Undeclared { pass: String, what: String },
    /// A pass accesses part of an image.
    #[error("Pass [{pass}] accesses part of image [{image}]; images are accessed as a whole.")]
    PartOfImage { pass: String, image: String },
    /// A transition has no image, or the same barrier changes its image twice.
    #[error("The barrier at the {at} of the plan changes the layout of {image}, which {what}.")]
    Transition { at: &'static str, image: String, what: &'static str },
    /// A transition starts from the wrong state, or discards needed contents.
    #[error("The barrier at the {at} of the plan changes {image} from {from:?}, but its layout is {is:?}.")]
    TransitionFrom { at: &'static str, image: String, from: ImageState, is: ImageState },
    /// A pass uses an image in a layout that does not allow it.
    #[error("Pass [{pass}] uses image [{image}] in the layout {state:?}, which does not allow it.")]
    Layout { pass: String, image: String, state: ImageState },
    /// The home of an image differs from its actual layout.
    #[error("Image [{image}] has home layout {home:?}, but is in {is:?}.")]
    Home { image: String, home: ImageState, is: ImageState },
    /// An image ends in another state than declared.
    #[error("Image [{image}] is left {is:?}, but its exit state is {exit:?}.")]
    Left { image: String, is: ImageState, exit: ImageState },
    /// A transient image is placed in an incompatible slot.
    #[error("Transient image [{image}] is placed in slot {slot}, which does not exist or has another size or format.")]
    WrongSlot { image: String, slot: u64 },
    /// A pass writes a read-only buffer.
    #[error("Pass [{pass}] writes buffer [{buffer}], which is read-only.")]
    WriteToReadOnly { pass: String, buffer: String },
    /// A barrier has an access that none of its stages performs.
    #[error("The barrier before group {group} names access {access} without the stage {stage} that performs it.")]
    AccessWithoutStage { group: usize, access: Accesses, stage: Stages },
    /// A needed pass was culled.
    #[error("Pass [{pass}] was dropped, but {by} needs its write to buffer [{buffer}].")]
    NeededPassCulled { pass: String, buffer: String, by: String },
    /// Dependent passes are out of order.
    #[error(
        "Pass [{second}] in group {second_group} must come after pass [{first}] in group {first_group}: {hazard} of \
         buffer [{buffer}]."
    )]
    Order { hazard: Hazard, buffer: String, first: String, first_group: usize, second: String, second_group: usize },
    /// A used transient has no memory.
    #[error("Transient [{buffer}] is used but has no place in the arena.")]
    Unplaced { buffer: String },
    /// A transient exceeds the arena.
    #[error("Transient [{buffer}] occupies bytes {start}..{end} of an arena of {arena} bytes.")]
    OutOfArena { buffer: String, start: u64, end: u64, arena: u64 },
    /// Two transients overlap in memory and lifetime.
    #[error(
        "Transients [{first}] (groups {first_lives:?}) and [{second}] (groups {second_lives:?}) share byte {byte} of \
         the arena while both are alive."
    )]
    Overlap { first: String, first_lives: (usize, usize), second: String, second_lives: (usize, usize), byte: u64 },
    /// Two conflicting memory operations lack barriers.
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
        /// Byte of the external buffer or of the arena.
        byte: u64,
        /// 1 if both are in the same replay, 2 if the second is in the next.
        replays: usize,
        missing: Missing,
    },
    /// Other commands on the queue may not see a write, or may overwrite too early.
    #[error("Pass [{pass}] accesses [{buffer}], which other commands use after the replay, but no barrier {missing}.")]
    LeftOpen { pass: String, buffer: String, missing: Missing },
    /// Readers after the replay may not see an output.
    #[error("The write of pass [{pass}] to output [{buffer}] is not visible to {access} after the replay.")]
    OutputHidden { pass: String, buffer: String, access: Accesses },
}

/// Verifies a plan.
pub fn verify(plan: &Plan) -> Result<(), VerifyError> {
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
