//! Capacity for Gaussians and tile entries.

use sgs_engine::Device;
use sgs_passes::scene::{BLOCK, Group, Model};

/// Exponent of tile entries as a function of the number of Gaussians. Below 1, because densification adds Gaussians
/// that are smaller than the existing ones. Measured on the White Room, fox and a synthetic room, for 2 to 4 times as
/// many Gaussians: 0.58 to 0.62.
const POWER: f64 = 0.6;

/// Capacity for tile entries, relative to the most of the last steps. Entries vary between views and between
/// densifications.
const RESERVE: f64 = 1.25;

/// Returns the most Gaussians for which no buffer exceeds the device's bindings. Columns take whole blocks of Gaussians.
pub(super) fn most_by_binding(device: &Device, model: Model) -> u32 {
    let pairs = if model.semantics { 8 * u64::from(Group::Semantics.width()) } else { 0 };
    let widest = model.column_bytes(BLOCK) / u64::from(BLOCK);
    let most = device.info().largest_binding() / widest.max(pairs);
    u32::try_from(most / u64::from(BLOCK) * u64::from(BLOCK)).unwrap_or(u32::MAX)
}

/// Returns the initial capacity. 1.5 times the count and at least 2^14, so that densification rarely has to grow
/// buffers.
pub(super) fn room_for(count: u32, most: u32) -> u32 {
    let room = (u64::from(count) + u64::from(count) / 2).max(1 << 14);
    (room.min(u64::from(most.max(count)))) as u32
}

/// Returns the capacity for `count` Gaussians. Grows by a quarter at a time until at most three quarters are used. The
/// capacity thus depends on the number alone.
pub(super) fn next_room(count: u32, room: u32, most: u32) -> u32 {
    let mut next = u64::from(room.max(4));
    while u64::from(count) > next / 4 * 3 {
        next += next / 4;
    }
    (next.min(u64::from(most)) as u32).max(room)
}

/// Estimates tile entries of `there` Gaussians from `entries` of `count` Gaussians.
pub(super) fn entries_with(entries: u32, count: u32, there: u32) -> f64 {
    f64::from(entries) * (f64::from(there) / f64::from(count.max(1))).powf(POWER)
}

/// Returns the capacity for these entries.
pub(super) fn entries_of(entries: u32, count: u32, there: u32) -> u32 {
    (RESERVE * entries_with(entries, count, there)).min(f64::from(u32::MAX)) as u32
}

/// Returns the capacity before any measurement. One tile per splat. A low guess costs a rebuild; a high one would cost
/// memory for the whole training.
pub(super) fn first_entry_capacity(wanted: u32, count: u32) -> u32 {
    if wanted > 0 { wanted } else { count.clamp(1 << 14, 1 << 26) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn capacity_depends_on_the_number_alone() {
        let steps = |way: &[u32]| way.iter().fold(16384, |room, count| next_room(*count, room, 1 << 21));
        assert_eq!(steps(&[12288]), 16384);
        assert_eq!(steps(&[12289]), 20480);
        assert_eq!(steps(&[13000, 17000, 40000]), steps(&[40000]));
        assert_eq!((next_room(5000, 16384, 100), next_room(5000, 5000, 6000)), (16384, 6000));
        assert_eq!(next_room(u32::MAX, 1, u32::MAX), u32::MAX);
        assert_eq!((entries_of(1000, 10, 10), entries_of(1000, 0, 0)), (1250, 0));
    }
}
