//! Where in the arena each transient lives.
//!
//! Two transients that are alive in a common group never overlap; others may. The largest are placed first, the
//! longest-lived among equals, each at the lowest offset that is free for its lifetime. That a byte passes from one
//! transient to the next is a hazard like any other, and left to the barriers.
//!
//! Images are not placed by bytes, since only a device knows how large they are: transients of equal make and layout
//! share a whole image when their lifetimes do not meet.

use super::Group;
use super::image::ImageSlot;
use crate::graph::pass::Pass;
use crate::graph::resource::{BufferInfo, BufferKind, ImageState};

/// First and last group of each transient that is used; a kept one lives past the last group.
pub(super) fn lifetimes(
    buffers: &[BufferInfo],
    passes: &[Pass],
    groups: &[Group],
    spans: &[(usize, usize)],
) -> Vec<Option<(usize, usize)>> {
    let mut lives = vec![None; buffers.len()];
    for (group, &(begin, end)) in groups.iter().zip(spans) {
        for &pass in &group.passes {
            for (slice, ..) in &passes[pass].accesses {
                let buffer = slice.buffer.index();
                let info = &buffers[buffer];
                if info.kind == BufferKind::Transient {
                    let end = if info.keep { groups.len() } else { end };
                    let (first, last) = lives[buffer].unwrap_or((begin, end));
                    lives[buffer] = Some((first.min(begin), last.max(end)));
                }
            }
        }
    }
    lives
}

/// An arena.
pub(super) struct Layout {
    /// By buffer: its offset, if it is a transient that is used; its slot, if it is an image.
    pub(super) placements: Vec<Option<u64>>,
    /// The images that transient images share.
    pub(super) slots: Vec<ImageSlot>,
    /// Size of the arena.
    pub(super) bytes: u64,
    /// Size that it would have without sharing.
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
    struct Placed {
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
    // By offset, so that one walk finds the lowest gap.
    let mut placed: Vec<Placed> = Vec::with_capacity(todo.len());
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
        placed.insert(at, Placed { offset, end: offset + bytes, first, last });
    }
    let slots = place_images(buffers, lifetimes, homes, share, &mut placements);
    Layout { placements, slots, bytes: placed.iter().map(|p| p.end).max().unwrap_or(0), unaliased_bytes }
}

/// Gives each transient image the first slot of its make that is free from its first group on.
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
