//! Graph resources: buffers and images, their kinds, and byte ranges.
//!
//! A [`Buffer`] or [`Image`] is a handle valid only in its own graph. It owns nothing: external buffers are bound at
//! replay, and transients are offsets into an arena that the plan lays out.

use std::ops::Range;

use crate::format::ImageFormat;

/// Buffer handle of one graph and its plan.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug, PartialOrd, Ord, serde::Serialize)]
pub struct Buffer(pub(crate) u32);

impl Buffer {
    /// Returns the index in [`Plan::buffers`](super::Plan::buffers).
    pub fn index(self) -> usize {
        self.0 as usize
    }

    /// Returns a byte range of the buffer.
    pub fn slice(self, offset: u64, bytes: u64) -> Slice {
        Slice { buffer: self, offset, bytes }
    }
}

/// Image handle of one graph. Its byte range is always the whole range of its packed texels.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug, PartialOrd, Ord, serde::Serialize)]
pub struct Image(pub(crate) Buffer);

impl Image {
    /// Returns the index in [`Plan::buffers`](super::Plan::buffers).
    pub fn index(self) -> usize {
        self.0.index()
    }
}

/// Layout of an image at the beginning or end of a replay.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum ImageState {
    /// Contents are discarded. Valid only on entry.
    Undefined,
    /// General layout, for any use.
    General,
    /// Source of copies.
    TransferSource,
    /// Target of copies.
    TransferTarget,
    /// Sampled by shaders.
    ShaderRead,
    /// Color attachment of a render pass.
    ColorAttachment,
    /// Presented in a window.
    Present,
}

/// Size, format, entry and exit state of an image.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub struct ImageInfo {
    /// Width and height.
    pub size: [u32; 2],
    /// Texel format.
    pub format: ImageFormat,
    /// State on entry; [`ImageState::Undefined`] for transients.
    pub entry: ImageState,
    /// State on exit; unused for transients.
    pub exit: ImageState,
}

/// Other users of an external buffer between replays. They do not wait for the device.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug, Default, serde::Serialize)]
#[serde(rename_all = "lowercase")]
pub enum BufferState {
    /// Replays of this plan, and copies from the buffer after them.
    #[default]
    Ready,
    /// Also the host: it writes before the submission, which makes its writes visible, or reads after it has waited.
    Host,
    /// Also any other command on the same queue.
    Queue,
}

/// Owner of a buffer's memory.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug, serde::Serialize)]
#[serde(rename_all = "lowercase")]
pub enum BufferKind {
    /// Bound at replay; contents persist between replays.
    External,
    /// In the plan's arena, from first to last use within a replay.
    Transient,
    /// Small, bound at replay, written by the host, with one slot per frame in flight. Only kernels read it.
    Uniform,
}

/// Declaration of a buffer.
#[derive(Clone, PartialEq, Eq, Hash, Debug)]
pub struct BufferInfo {
    /// Name in dumps and errors; need not be unique.
    pub name: String,
    /// Size in bytes.
    pub bytes: u64,
    /// Owner of the memory.
    pub kind: BufferKind,
    /// Whether the contents are needed after a replay: writes to it are outputs.
    pub keep: bool,
    /// Users before a replay.
    pub entry: BufferState,
    /// Users after a replay.
    pub exit: BufferState,
    /// Image declaration, if it is an image.
    pub image: Option<ImageInfo>,
}

impl BufferInfo {
    /// Returns whether a pass may write it.
    pub fn writable(&self) -> bool {
        match self.kind {
            BufferKind::External => self.keep,
            BufferKind::Transient => true,
            BufferKind::Uniform => false,
        }
    }
}

/// Byte range of a buffer.
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
    /// Length that means "to the end of the buffer". Never occurs in a plan.
    pub const WHOLE: u64 = u64::MAX;

    /// Returns the byte range.
    pub fn range(&self) -> Range<u64> {
        self.offset..self.offset + self.bytes
    }

    /// Returns whether the two ranges overlap.
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
