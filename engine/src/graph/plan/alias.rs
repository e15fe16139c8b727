//! Placement of transients in the arena.
//!
//! Transients that are alive in a common group never overlap; others may. Larger transients are placed first,
//! longer-lived ones first among equals, each at the lowest free offset of its lifetime. Reuse of a byte by another
//! transient is an ordinary hazard, which the barriers cover.
//!
//! Images are not placed by bytes, because only a device knows their size. Transient images of equal format, size and
//! layout share a whole image if their lifetimes do not overlap.

use super::Group;
use super::image::ImageSlot;
use crate::graph::pass::Pass;
use crate::graph::resource::{BufferInfo, BufferKind, ImageState};

/// Returns first and last group of each used transient; a kept one lives past the last group.
pub(super) fn lifetimes(buffers: &[BufferInfo], passes: &[Pass], groups: &[Group]) -> Vec<Option<(usize, usize)>> {
    let mut lifetimes = vec![None; buffers.len()];
    for (at, group) in groups.iter().enumerate() {
        for &pass in &group.passes {
            for (slice, ..) in &passes[pass].accesses {
                let buffer = slice.buffer.index();
                let info = &buffers[buffer];
                if info.kind == BufferKind::Transient {
                    let end = if info.keep { groups.len() } else { at };
                    let (first, last) = lifetimes[buffer].unwrap_or((at, end));
                    lifetimes[buffer] = Some((first.min(at), last.max(end)));
                }
            }
        }
    }
    lifetimes
}

/// Arena layout.
pub(super) struct Layout {
    /// By buffer: offset of a used transient; for an image, its slot.
    pub(super) placements: Vec<Option<u64>>,
    /// Images shared by transient images.
    pub(super) slots: Vec<ImageSlot>,
    /// Size of the arena in bytes.
    pub(super) bytes: u64,
    /// Size without aliasing in bytes.
    pub(super) unaliased_bytes: u64,
}

/// Places the transients.
pub(super) fn alias(
    buffers: &[BufferInfo],
    lifetimes: &[Option<(usize, usize)>],
    homes: &[Option<ImageState>],
    alignment: u64,
    share: bool,
) -> Layout {
    struct Placement {
        offset: u64,
        end: u64,
        first: usize,
        last: usize,
    }

    let size = |index: usize| buffers[index].bytes.next_multiple_of(alignment);
    let mut todo: Vec<(usize, usize, usize)> = lifetimes
        .iter()
        .enumerate()
        .filter(|(index, _)| buffers[*index].image.is_none())
        .filter_map(|(index, life)| life.map(|(first, last)| (index, first, last)))
        .collect();
    let unaliased_bytes = todo.iter().map(|&(index, ..)| size(index)).sum();
    if share {
        todo.sort_by_key(|&(index, first, last)| (std::cmp::Reverse((size(index), last - first)), index));
    }
    let mut placements = vec![None; buffers.len()];
    // Sorted by offset, so that one pass finds the lowest gap.
    let mut placed: Vec<Placement> = Vec::with_capacity(todo.len());
    for (index, first, last) in todo {
        let bytes = size(index);
        let mut offset = 0;
        for other in &placed {
            if other.offset >= offset + bytes {
                break;
            }
            if !share || (other.first <= last && first <= other.last) {
                offset = offset.max(other.end);
            }
        }
        placements[index] = Some(offset);
        let at = placed.partition_point(|other| other.offset <= offset);
        placed.insert(at, Placement { offset, end: offset + bytes, first, last });
    }
    let slots = place_images(buffers, lifetimes, homes, share, &mut placements);
    Layout { placements, slots, bytes: placed.iter().map(|p| p.end).max().unwrap_or(0), unaliased_bytes }
}

/// Assigns each transient image to a slot. Takes the first equal slot that is free from the image's first group on.
fn place_images(
    buffers: &[BufferInfo],
    lifetimes: &[Option<(usize, usize)>],
    homes: &[Option<ImageState>],
    share: bool,
    placements: &mut [Option<u64>],
) -> Vec<ImageSlot> {
    let mut todo: Vec<(usize, usize, usize, ImageSlot)> = Vec::new();
    for (index, info) in buffers.iter().enumerate() {
        let (Some(image), Some((first, last)), Some(home)) = (&info.image, lifetimes[index], homes[index]) else {
            continue;
        };
        todo.push((first, index, last, ImageSlot { size: image.size, format: image.format, home }));
    }
    todo.sort_by_key(|&(first, index, ..)| (first, index));
    let mut slots: Vec<(ImageSlot, usize)> = Vec::new();
    for (first, index, last, make) in todo {
        let free = slots.iter().position(|&(slot, busy)| share && slot == make && busy < first);
        let slot = free.unwrap_or(slots.len());
        match slots.get_mut(slot) {
            Some((_, busy)) => *busy = last,
            None => slots.push((make, last)),
        }
        placements[index] = Some(slot as u64);
    }
    slots.into_iter().map(|(slot, _)| slot).collect()
}
