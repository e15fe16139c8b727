//! The frame graph: declared once, compiled once, replayed many times.
//!
//! A [`Graph`] is a list of passes over named buffers. Declaration order defines data flow: a pass sees the writes of
//! all earlier passes. A pass names a kernel, the resources of the kernel's bindings, and the number of groups: a
//! constant, or a location in a buffer for indirect dispatch. The kernel's access to each binding is reflected from
//! its code ([`crate::shader`]), never declared by hand.
//!
//! [`Graph::compile`] turns a graph into a [`Plan`]. It drops passes that no output needs and sorts the others into
//! *groups*. Passes of a group have no conflicts and may run concurrently. At most one global *barrier* separates two
//! groups; it covers exactly the conflicts between them. *Transient* buffers are placed in one *arena* and share
//! memory if their lifetimes, counted in groups, do not overlap. A plan is pure data: creating, printing, comparing
//! and verifying it needs no device. [`plan::verify`] verifies it.
//!
//! Terms:
//!
//! * An **external** buffer belongs to the caller, is bound at replay, and persists; writes to it are the outputs of
//!   a graph. An **input** is an external buffer that no pass may write. A **uniform** is a small input with one slot
//!   per frame in flight.
//! * An access is **read**, **write**, **read and write**, or **accumulate**: atomic additions whose results the
//!   kernel does not use. Accumulations into one buffer commute, so passes that only accumulate may share a group.
//! * A write is assumed to preserve some bytes, so earlier contents stay needed unless the pass **discards**:
//!   promises to overwrite everything that is read later. Fills and copies always discard.
//! * An **image** is accessed as a whole. It has one layout within a replay. An external image declares its entry and
//!   exit layouts; other commands on the queue may use it before and after.
//! * A **hazard** is a pair of accesses to one byte, at least one a write, that do not commute. A transient that
//!   reuses another's memory creates hazards like any other access.
//!
//! Guarantees and limits:
//!
//! * Replays of one plan may follow each other on one queue without waiting, several in flight, with one arena and
//!   the same externals. The first barrier of a replay covers the hazards with the previous replay.
//! * After a replay the host and copies on the same queue may read the outputs; the next replay waits for those
//!   copies. The host must wait for the device before it reads an output or allows it to be overwritten.
//! * An external buffer shared with the queue ([`Graph::shared`]) is ordered against all other commands on the queue,
//!   before and after.
//! * Any other use between replays (another plan, an upload) needs [`Barrier::FULL`] before and after it.
//! * Different externals must not share memory: the graph assumes that they are distinct.
//! * Equal declarations give equal plans, byte for byte.

pub mod builder;
pub mod dump;
pub mod error;
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
pub use plan::{Accesses, Barrier, CompileOptions, Group, ImageMemory, ImageSlot, Plan, Stages, Transition};
pub use resource::{Buffer, BufferInfo, BufferKind, BufferState, Image, ImageInfo, ImageState, Slice};
