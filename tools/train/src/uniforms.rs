//! Sizes of uniforms in device memory.

use sgs_engine::Device;
use sgs_engine::graph::BufferKind;
use sgs_engine::graph::Plan;
use sgs_passes::pipeline::Step;

/// Returns the number of bytes of the uniform of a single-view step.
pub(crate) fn uniform(device: &Device) -> u64 {
    (size_of::<Step>() as u64).next_multiple_of(device.info().uniform_alignment.max(16))
}

/// Returns the number of bytes of the uniforms of all in-flight replays of a plan.
pub(crate) fn uniform_bytes(device: &Device, plan: &Plan, frames: usize) -> u64 {
    let info = device.info();
    let alignment = info.uniform_alignment.max(info.storage_alignment).max(16);
    let uniforms = plan.buffers.iter().filter(|b| b.kind == BufferKind::Uniform);
    frames as u64 * uniforms.map(|b| b.bytes.next_multiple_of(alignment)).sum::<u64>()
}
