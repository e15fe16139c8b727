//! In which layout each image is used, and where layouts change.
//!
//! An image has one layout, its *home*, from the first group to the last: the general one, or a transfer layout if
//! nothing but copies in one direction touches it. Layouts change in two places only, in the barrier before the first
//! group and in the one after the last, so that nothing in between waits for a transition (docs/adr/0010).

use super::alias::Layout;
use super::{Group, Segment};
use crate::format::ImageFormat;
use crate::graph::pass::{Pass, Use};
use crate::graph::resource::Buffer;
use crate::graph::resource::{BufferInfo, BufferKind, BufferState, Image, ImageInfo, ImageState};
use crate::shader::Access;

/// An image that transients of equal make share, one after the other.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug, serde::Serialize)]
pub struct ImageSlot {
    /// Width and height.
    pub size: [u32; 2],
    /// What a texel is.
    pub format: ImageFormat,
    /// The layout that it is used in.
    pub home: ImageState,
}

impl ImageSlot {
    /// Bytes of its packed texels.
    pub fn bytes(&self) -> u64 {
        self.format.packed_bytes(self.size)
    }
}

/// An image that really exists when a plan runs.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug, serde::Serialize)]
#[serde(rename_all = "lowercase")]
pub enum ImageMemory {
    /// One that is bound.
    External(Image),
    /// One of [`Plan::image_slots`](super::Plan::image_slots).
    Slot(u32),
}

/// A change of an image's layout, inside a barrier.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug, serde::Serialize)]
pub struct Transition {
    /// Whose.
    pub image: ImageMemory,
    /// From.
    pub from: ImageState,
    /// To.
    pub to: ImageState,
}

/// By buffer: the layout in which an image is used, if it is one and anything that runs uses it.
pub(super) fn homes(buffers: &[BufferInfo], passes: &[Pass], lives: &[bool]) -> Vec<Option<ImageState>> {
    let mut homes = vec![None; buffers.len()];
    if buffers.iter().all(|info| info.image.is_none()) {
        return homes;
    }
    for pass in passes.iter().zip(lives).filter(|(_, lives)| **lives).map(|(pass, _)| pass) {
        for (slice, access, used) in &pass.accesses {
            let Some(info) = &buffers[slice.buffer.index()].image else { continue };
            let wish = match (used, access) {
                _ if info.entry == ImageState::General || info.exit == ImageState::General => ImageState::General,
                (Use::Transfer, Access::Read) => ImageState::TransferSource,
                (Use::Transfer, _) => ImageState::TransferTarget,
                _ => ImageState::General,
            };
            let home = &mut homes[slice.buffer.index()];
            *home = Some(home.filter(|home| *home != wish).map_or(wish, |_| ImageState::General));
        }
    }
    homes
}

/// The transitions before the first group and those after the last.
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

/// Gives a plan that runs nothing a group if something has to happen at its beginning all the same.
pub(super) fn at_least_one_group(entry: &[Transition], groups: &mut Vec<Group>, segments: &mut [Segment]) {
    if groups.is_empty() && !entry.is_empty() {
        groups.push(Group::default());
        segments.iter_mut().for_each(|segment| segment.groups = 0..1);
    }
}

/// Whether others use a buffer on the queue before a replay.
pub(super) fn enters(info: &BufferInfo) -> bool {
    info.kind == BufferKind::External && info.entry == BufferState::Queue
}

/// Whether others use a buffer on the queue after a replay.
pub(super) fn leaves(info: &BufferInfo) -> bool {
    info.kind == BufferKind::External && info.exit == BufferState::Queue
}
