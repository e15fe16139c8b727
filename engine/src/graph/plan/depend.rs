//! Dependencies between passes: the declared order, reduced to data dependencies.
//!
//! Per byte of each buffer, a read follows the writes before it, a write follows the reads and writes before it, and
//! accumulations commute. Redundant edges are omitted where that is free.

use crate::graph::pass::Pass;
use crate::graph::ranges::RangeMap;
use crate::graph::resource::BufferInfo;
use crate::shader::Access;

/// Accesses of a byte that later passes depend on.
#[derive(Clone, Default)]
struct AccessState {
    /// Passes that every accumulation of the current run follows.
    before: Vec<u32>,
    /// Last write, or the current run of accumulations.
    writers: Vec<u32>,
    /// Readers since then.
    readers: Vec<u32>,
    accumulating: bool,
}

impl AccessState {
    /// Adds the edges of one access of `pass` to `edges`, and the access to the state.
    fn touch(&mut self, pass: u32, access: Access, edges: &mut Vec<u32>) {
        match access {
            Access::Read => {
                edges.extend(&self.writers);
                if self.readers.last() != Some(&pass) {
                    self.readers.push(pass);
                }
            }
            Access::Accumulate if self.accumulating && self.readers.is_empty() => {
                edges.extend(&self.before);
                self.writers.push(pass);
            }
            Access::Accumulate | Access::Write | Access::ReadWrite => {
                // Readers already follow the writers.
                let before =
                    std::mem::take(if self.readers.is_empty() { &mut self.writers } else { &mut self.readers });
                edges.extend(&before);
                let accumulating = access == Access::Accumulate;
                *self = AccessState {
                    before: if accumulating { before } else { Vec::new() },
                    writers: vec![pass],
                    readers: Vec::new(),
                    accumulating,
                };
            }
        }
    }
}

/// Returns, by declared pass, the live passes that it directly follows, ascending. Empty for culled passes.
pub(super) fn depend(buffers: &[BufferInfo], passes: &[Pass], live: &[bool]) -> Vec<Vec<u32>> {
    let mut state: Vec<_> = buffers.iter().map(|info| RangeMap::new(info.bytes, AccessState::default())).collect();
    let mut dependencies = vec![Vec::new(); passes.len()];
    for (index, pass) in passes.iter().enumerate().filter(|&(index, _)| live[index]) {
        let edges = &mut dependencies[index];
        let index = index as u32;
        for (slice, access, _) in &pass.accesses {
            let info = &buffers[slice.buffer.index()];
            if info.writable() {
                state[slice.buffer.index()].update(slice.range(), |byte_state| byte_state.touch(index, *access, edges));
            }
        }
        edges.sort_unstable();
        edges.dedup();
        edges.retain(|&before| before != index);
    }
    dependencies
}
