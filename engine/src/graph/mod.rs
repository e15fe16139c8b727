//! The frame graph: declare once, compile once, replay often.
//!
//! A [`Graph`] is a list of passes over named buffers. The order in which passes are declared says how the data flows:
//! a pass sees what the passes before it wrote. A pass names a kernel, what is bound to each of the kernel's bindings,
//! and how many groups run, a number or a place in a buffer where the device will find it. What the kernel does to each
//! binding is read off its code ([`crate::shader`]), never typed by hand.
//!
//! [`Graph::compile`] turns this into a [`Plan`]. Passes that no output needs are dropped. The rest is put into
//! *groups*: within a group nothing conflicts, so its passes may run at once. Between groups stands at most one
//! *barrier*, a global one, that covers all the conflicts that meet there and nothing else. *Transient* buffers get
//! offsets in one *arena* and share its memory when their lifetimes, counted in groups, do not meet. The plan is data:
//! no device is needed to make, print, compare or prove it, and [`plan::verify`] does prove it.
//!
//! Terms:
//!
//! * An **external** buffer belongs to the caller, is bound at replay, and keeps its contents; writing it is what a
//!   graph is for. An **input** is one that no pass may write. A **uniform** is a small input with a slot for each
//!   frame in flight.
//! * A **history** is two buffers that change places from replay to replay: what one replay writes to the current one,
//!   the next finds in the previous one.
//! * An access is **read**, **write**, **read and write**, or **accumulate**: atomic additions whose results the kernel
//!   does not look at. Accumulations into one buffer commute, so passes that only accumulate may share a group.
//! * A pass may run on a **condition**, a word that earlier passes or the host write; it then promises nothing about what
//!   it overwrites.
//! * A write is taken to leave some bytes as they were, so what was there before stays needed, unless the pass
//!   **discards**: promises that it overwrites whatever anyone will read. Fills and copies always do.
//! * An **image** is touched as a whole. It has one layout within a replay; an external one states the layouts in which
//!   it is found and left, and others on the queue may use it before and after.
//! * A **hazard** is two accesses to one byte, at least one a write, that do not commute. A transient that takes over
//!   another's memory makes hazards like anything else.
//!
//! * A **lane** is one of two sequences of commands. Plans for two queues send passes that the main lane can do without
//!   for a while to a second one, in *segments* that wait for segments of the other ([`Queues`]).
//!
//! Promises, and their limits:
//!
//! * Replays of one plan may follow each other on one queue without waiting, several in flight, with one arena and the
//!   same externals. The first barrier of a replay covers what the replay before left open.
//! * After a replay the host and copies on the same queue may read the outputs, and the next replay waits for those
//!   copies. The host has to wait for the device itself before it reads, and before it lets an output be overwritten.
//! * An external buffer that is shared with the queue ([`Graph::shared`]) is ordered against whatever else the queue
//!   does, before and after.
//! * Anything else at the seam (another plan, an upload) needs [`Barrier::FULL`] between the two.
//! * Different externals must not share memory: the graph takes buffers for what they are declared as.
//! * Equal declarations give equal plans, byte for byte.

pub mod builder;
pub mod condition;
pub mod dump;
pub mod error;
pub mod exec;
pub mod image;
pub mod pass;
pub mod pass_builder;
pub mod plan;
pub(crate) mod ranges;
pub mod resource;
#[cfg(test)]
mod tests;

pub use builder::Graph;
pub use error::GraphError;
pub use pass::{Dispatch, Pass, PassKind, Use};
pub use pass_builder::PassBuilder;
pub use plan::verify::{VerifyError, verify};
pub use plan::{
    Accesses, Barrier, CompileOptions, Group, ImageMemory, ImageSlot, Lane, Plan, Queues, Segment, Stages, Transition,
};
pub use resource::{
    Buffer, BufferInfo, BufferKind, BufferState, History, Image, ImageInfo, ImageState, Pair, Slice, Switch,
};
