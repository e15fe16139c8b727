//! Layouts of images, and their transitions.
//!
//! An image has one layout, its *home*, from the first group to the last: the general layout, or a transfer layout if
//! only copies in one direction use it. Layouts change only in the barrier before the first group and in the one
//! after the last. No other barrier waits for a transition (docs/adr/0010).

use super::Group;
use super::alias::Layout;
use crate::format::ImageFormat;
use crate::graph::pass::{Pass, Use};
use crate::graph::resource::Buffer;
use crate::graph::resource::{BufferInfo, BufferKind, BufferState, Image, ImageInfo, ImageState};
use crate::shader::Access;

/// Image shared by transient images, one after the other. They have equal size, format and layout.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug, serde::Serialize)]
pub struct ImageSlot {
    /// Width and height.
    pub size: [u32; 2],
    /// Texel format.
    pub format: ImageFormat,
    /// Layout while in use.
    pub home: ImageState,
}

impl ImageSlot {
    /// Returns the size of its packed texels in bytes.
    pub fn bytes(&self) -> u64 {
        self.format.packed_bytes(self.size)
    }
}

/// Physical image of a plan.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug, serde::Serialize)]
#[serde(rename_all = "lowercase")]
pub enum ImageMemory {
    /// Bound external image.
    External(Image),
    /// Image of [`Plan::image_slots`](super::Plan::image_slots).
    Slot(u32),
}

/// Layout transition of an image inside a barrier.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug, serde::Serialize)]
pub struct Transition {
    /// Image.
    pub image: ImageMemory,
    /// Old layout.
    pub from: ImageState,
    /// New layout.
    pub to: ImageState,
}

/// Returns, by buffer, the home layout of an image that a live pass uses.
pub(super) fn homes(buffers: &[BufferInfo], passes: &[Pass], live: &[bool]) -> Vec<Option<ImageState>> {
    let mut homes = vec![None; buffers.len()];
    if buffers.iter().all(|info| info.image.is_none()) {
        return homes;
    }
    for pass in passes.iter().zip(live).filter(|(_, live)| **live).map(|(pass, _)| pass) {
        for (slice, access, used) in &pass.accesses {
            let Some(info) = &buffers[slice.buffer.index()].image else { continue };
            let required = match (used, access) {
                _ if info.entry == ImageState::General || info.exit == ImageState::General => ImageState::General,
                (Use::Transfer, Access::Read) => ImageState::TransferSource,
                (Use::Transfer, _) => ImageState::TransferTarget,
                _ => ImageState::General,
            };
            let home = &mut homes[slice.buffer.index()];
            *home = Some(home.filter(|home| *home != required).map_or(required, |_| ImageState::General));
        }
    }
    homes
}

/// Returns the transitions before the first group and after the last.
pub(super) fn transitions(
    buffers: &[BufferInfo],
    homes: &[Option<ImageState>],
    layout: &Layout,
) -> (Vec<Transition>, Vec<Transition>) {
    let (mut entry, mut exit) = (Vec::new(), Vec::new());
    for (index, info) in buffers.iter().enumerate().filter(|(_, info)| info.kind == BufferKind::External) {
        let Some(ImageInfo { entry: from, exit: to, .. }) = info.image else { continue };
        let image = ImageMemory::External(Image(Buffer(index as u32)));
        let home = homes[index].unwrap_or(to);
        if from != home {
            entry.push(Transition { image, from, to: home });
        }
        if home != to {
            exit.push(Transition { image, from: home, to });
        }
    }
    for (slot, made) in layout.slots.iter().enumerate() {
        let image = ImageMemory::Slot(slot as u32);
        entry.push(Transition { image, from: ImageState::Undefined, to: made.home });
    }
    (entry, exit)
}

/// Adds an empty group to an empty plan that needs entry transitions.
pub(super) fn at_least_one_group(entry: &[Transition], groups: &mut Vec<Group>) {
    if groups.is_empty() && !entry.is_empty() {
        groups.push(Group::default());
    }
}

/// Returns whether other commands on the queue use a buffer before a replay.
pub(super) fn enters(info: &BufferInfo) -> bool {
    info.kind == BufferKind::External && info.entry == BufferState::Queue
}

/// Returns whether other commands on the queue use a buffer after a replay.
pub(super) fn leaves(info: &BufferInfo) -> bool {
    info.kind == BufferKind::External && info.exit == BufferState::Queue
}
