//! What a graph calls its memory: buffers and images, their kinds, and byte ranges of them.
//!
//! A [`Buffer`] or an [`Image`] is a number that only its own graph understands. It owns nothing: external buffers are bound when a
//! plan is replayed, transient ones are offsets into an arena that the plan lays out.

use std::ops::Range;

use crate::format::ImageFormat;

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

/// An image of one graph. Wherever ranges of bytes are spoken of, it is the range of its packed texels, as a whole.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug, PartialOrd, Ord, serde::Serialize)]
pub struct Image(pub(crate) Buffer);

impl Image {
    /// Position in [`Plan::buffers`](super::Plan::buffers).
    pub fn index(self) -> usize {
        self.0.index()
    }
}

/// What others leave an image in, or want to find it in: its layout, and that its texels count.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum ImageState {
    /// Nobody wants what it holds. On entry alone.
    Undefined,
    /// The layout for everything.
    General,
    /// To be copied from.
    TransferSource,
    /// To be copied to.
    TransferTarget,
    /// To be sampled by shaders.
    ShaderRead,
    /// To be drawn into.
    ColorAttachment,
    /// To be shown in a window.
    Present,
}

/// What an image is made of, and what state it is handed over in.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub struct ImageInfo {
    /// Width and height.
    pub size: [u32; 2],
    /// What a texel is.
    pub format: ImageFormat,
    /// The state in which a replay finds it; [`ImageState::Undefined`] for transients.
    pub entry: ImageState,
    /// The state in which a replay leaves it; of no meaning for transients.
    pub exit: ImageState,
}

/// Who else uses an external buffer, between replays, without waiting for the device.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug, Default, serde::Serialize)]
#[serde(rename_all = "lowercase")]
pub enum BufferState {
    /// Replays of this plan, and copies from it afterwards.
    #[default]
    Ready,
    /// The host as well: it writes before the replay is submitted, which makes its writes visible by itself, or reads
    /// after it has waited.
    Host,
    /// Any command on the same queue that no plan knows of.
    Queue,
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
    /// One of two that change places from replay to replay; see [`History`].
    History,
}

/// Something that the host turns on and off from replay to replay, without recording anything again.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub struct Switch(pub(crate) Buffer);

impl From<Switch> for Slice {
    fn from(switch: Switch) -> Self {
        switch.0.into()
    }
}

/// Two buffers that change places: what a replay writes to `current`, the next one finds in `previous`.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub struct History {
    /// What the replay before wrote; no pass may write it.
    pub previous: Buffer,
    /// What this replay writes. It holds what the replay before the last wrote until it is written.
    pub current: Buffer,
}

/// What a buffer of a history knows of it.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub struct Pair {
    /// The other one.
    pub partner: Buffer,
    /// The word that both are filled with before the first replay.
    pub value: u32,
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
    /// Who may have used it before a replay.
    pub entry: BufferState,
    /// Who may use it after a replay.
    pub exit: BufferState,
    /// What it is made of, if it is an image.
    pub image: Option<ImageInfo>,
    /// Whom it changes places with, if it belongs to a history.
    pub pair: Option<Pair>,
    /// Whether it is a switch: one word that the executor keeps.
    pub switch: bool,
}

impl BufferInfo {
    /// Whether a pass may write it.
    pub fn writable(&self) -> bool {
        match self.kind {
            BufferKind::External | BufferKind::History => self.keep,
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
