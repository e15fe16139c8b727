//! What a graph calls its memory: buffers, their kinds, and byte ranges of them.
//!
//! A [`Buffer`] is a number that only its own graph understands. It owns nothing: external buffers are bound when a
//! plan is replayed, transient ones are offsets into an arena that the plan lays out.

use std::ops::Range;

/// A buffer of one graph (and of the plan compiled from it).
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug, PartialOrd, Ord, serde::Serialize)]
pub struct Buffer(pub(crate) u32);

impl Buffer {
    /// Position in [`Plan::buffers`](super::Plan::buffers).
    pub fn index(self) -> usize {
        self.0 as usize
    }

    /// A byte range of the buffer.
    pub fn slice(self, offset: u64, bytes: u64) -> Slice {
        Slice { buffer: self, offset, bytes }
    }
}

/// Whose memory a buffer is.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug, serde::Serialize)]
#[serde(rename_all = "lowercase")]
pub enum BufferKind {
    /// Bound at replay; its contents persist from replay to replay.
    External,
    /// Lives in the plan's arena from its first use in a replay to its last.
    Transient,
    /// Bound at replay, small, written by the host: a ring slot per frame in flight. Kernels only read it.
    Uniform,
}

/// The declaration of a buffer.
#[derive(Clone, PartialEq, Eq, Hash, Debug)]
pub struct BufferInfo {
    /// What dumps and errors call it; need not be unique.
    pub name: String,
    /// Its size.
    pub bytes: u64,
    /// Whose memory it is.
    pub kind: BufferKind,
    /// Whether its contents are wanted after a replay: writes to it are outputs.
    pub keep: bool,
}

impl BufferInfo {
    /// Whether a pass may write it.
    pub fn writable(&self) -> bool {
        match self.kind {
            BufferKind::External => self.keep,
            BufferKind::Transient => true,
            BufferKind::Uniform => false,
        }
    }
}

/// A byte range of a buffer.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub struct Slice {
    /// The buffer.
    pub buffer: Buffer,
    /// First byte.
    pub offset: u64,
    /// Length; [`Slice::WHOLE`] until the builder has replaced it.
    pub bytes: u64,
}

impl Slice {
    /// As a length: up to the end of the buffer. Never occurs in a plan.
    pub const WHOLE: u64 = u64::MAX;

    /// The bytes of the buffer that it covers.
    pub fn range(&self) -> Range<u64> {
        self.offset..self.offset + self.bytes
    }

    /// Whether the two have a byte in common.
    pub fn overlaps(&self, other: &Slice) -> bool {
        self.buffer == other.buffer
            && self.offset < other.offset + other.bytes
            && other.offset < self.offset + self.bytes
    }
}

impl From<Buffer> for Slice {
    fn from(buffer: Buffer) -> Self {
        Slice { buffer, offset: 0, bytes: Slice::WHOLE }
    }
}
