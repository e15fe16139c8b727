//! Culling of passes that no output needs.
//!
//! One walk from the last declared pass to the first tracks the bytes whose contents are still needed. A pass is live
//! if it writes one of them. A write does not end the need for earlier contents, because it may preserve bytes,
//! unless the pass discards them.

use crate::graph::pass::{Pass, writes};
use crate::graph::ranges::RangeMap;
use crate::graph::resource::BufferInfo;
use crate::shader::Access;

/// Returns, by declared pass, whether it must run.
pub(super) fn cull(buffers: &[BufferInfo], passes: &[Pass]) -> Vec<bool> {
    let mut needed: Vec<_> = buffers.iter().map(|info| RangeMap::new(info.bytes, info.keep)).collect();
    let mut live = vec![false; passes.len()];
    for (pass, live) in passes.iter().zip(&mut live).rev() {
        *live = pass.accesses.iter().any(|(slice, access, _)| {
            writes(*access) && needed[slice.buffer.index()].any(slice.range(), |&needed| needed)
        });
        if !*live {
            continue;
        }
        for slice in &pass.discards {
            needed[slice.buffer.index()].set(slice.range(), false);
        }
        for (slice, access, _) in &pass.accesses {
            // Accumulation needs earlier contents only if something reads the sum.
            let reads = matches!(access, Access::Read | Access::ReadWrite);
            if reads && !pass.discards(slice) {
                needed[slice.buffer.index()].set(slice.range(), true);
            }
        }
    }
    live
}
