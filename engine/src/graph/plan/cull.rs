//! Which passes any output needs.
//!
//! One walk from the last declared pass to the first with the set of bytes whose contents somebody still wants. A
//! pass lives if it writes one of them. A write does not end the want for what was there before, since it may leave
//! bytes as they are, unless the pass promised to overwrite them.

use crate::graph::pass::{Pass, writes};
use crate::graph::ranges::RangeMap;
use crate::graph::resource::BufferInfo;
use crate::shader::Access;

/// By declared pass: whether it must run.
pub(super) fn cull(buffers: &[BufferInfo], passes: &[Pass]) -> Vec<bool> {
    let mut wanted: Vec<_> = buffers.iter().map(|info| RangeMap::new(info.bytes, info.keep)).collect();
    let mut lives = vec![false; passes.len()];
    for (pass, lives) in passes.iter().zip(&mut lives).rev() {
        *lives = pass.accesses.iter().any(|(slice, access, _)| {
            writes(*access) && wanted[slice.buffer.index()].any(slice.range(), |&wanted| wanted)
        });
        if !*lives {
            continue;
        }
        for slice in &pass.discards {
            wanted[slice.buffer.index()].set(slice.range(), false);
        }
        for (slice, access, _) in &pass.accesses {
            // What is accumulated into matters only to those who read the sum.
            let reads = matches!(access, Access::Read | Access::ReadWrite);
            if reads && !pass.discards(slice) {
                wanted[slice.buffer.index()].set(slice.range(), true);
            }
        }
    }
    lives
}
