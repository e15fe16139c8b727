//! How much room there is, and how much is made at first.

use crate::memory::allowed;
use crate::settings::Settings;
use sgs_engine::{BudgetSource, Device};
use sgs_passes::pipeline::InputSizes;
use sgs_passes::scene::Model;

/// How many Gaussians memory allows: the budget less the photographs, and no binding beyond the device's range.
pub(super) fn most_gaussians(
    device: &Device,
    model: Model,
    settings: &Settings,
    inputs: &InputSizes,
    largest: [u32; 2],
) -> u32 {
    // Parameters and moments; per visible splat and per tile entry of the transients, at three entries a splat.
    let an_entry = 100 + if model.semantics { 160 } else { 0 };
    let a_gaussian = u64::from(model.width()) * 12 + 12 + 4 * u64::from(model.width().min(16)) + 3 * an_entry;
    let pixels = u64::from(largest[0]) * u64::from(largest[1]);
    let semantics = inputs.semantics.map_or(0, |s| s.bytes() + 256 * pixels);
    let fixed = inputs.targets + inputs.normals.unwrap_or(0) + semantics + 160 * pixels;
    let b = allowed(device, settings);
    // What nobody promised is not used up.
    let budget = if b.source == BudgetSource::Heap && b.budget == b.heap { b.heap / 10 * 9 } else { b.budget };
    let by_memory = budget.saturating_sub(fixed) / a_gaussian;
    let widest = model.groups().map(|g| u64::from(g.width()) * 8).max().unwrap_or(8);
    let by_binding = device.info().max_storage_range / widest;
    u32::try_from(by_memory.min(by_binding)).unwrap_or(u32::MAX)
}

/// Half as many again, so that densification rarely has to grow.
pub(super) fn room_for(count: u32, most: u32) -> u32 {
    let room = (u64::from(count) + u64::from(count) / 2).max(1 << 14);
    (room.min(u64::from(most.max(count)))) as u32
}

/// Before anything is measured: a tile a splat. A wrong guess costs a rebuild; too much room would cost memory for good.
pub(super) fn first_entry_capacity(wanted: u32, count: u32) -> u32 {
    if wanted > 0 { wanted } else { count.clamp(1 << 14, 1 << 26) }
}
