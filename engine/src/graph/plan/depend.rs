//! Which passes must stay behind which: the declared order, reduced to what the data demands.
//!
//! Per byte of each buffer, a read follows the writes before it, a write follows the reads and writes before it, and
//! accumulations commute among themselves. Edges that others imply are left out where that is free.

use crate::graph::pass::Pass;
use crate::graph::ranges::RangeMap;
use crate::graph::resource::BufferInfo;
use crate::shader::Access;

/// Who touched a byte so far, as far as later passes care.
#[derive(Clone, Default)]
struct Touched {
    /// What every accumulation of the present run follows.
    before: Vec<u32>,
    /// The last write, or the present run of accumulations.
    writers: Vec<u32>,
    /// Who has read since.
    readers: Vec<u32>,
    accumulating: bool,
}

impl Touched {
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
                // Readers have followed the writers already.
                let before =
                    std::mem::take(if self.readers.is_empty() { &mut self.writers } else { &mut self.readers });
                edges.extend(&before);
                let accumulating = access == Access::Accumulate;
                *self = Touched {
                    before: if accumulating { before } else { Vec::new() },
                    writers: vec![pass],
                    readers: Vec::new(),
                    accumulating,
                };
            }
        }
    }
}

/// By declared pass: which living passes it directly follows, ascending. Empty for passes that do not live.
pub(super) fn depend(buffers: &[BufferInfo], passes: &[Pass], lives: &[bool]) -> Vec<Vec<u32>> {
    let mut state: Vec<_> = buffers.iter().map(|info| RangeMap::new(info.bytes, Touched::default())).collect();
    let mut follows = vec![Vec::new(); passes.len()];
    for (index, pass) in passes.iter().enumerate().filter(|&(index, _)| lives[index]) {
        let edges = &mut follows[index];
        let index = index as u32;
        for (slice, access, _) in &pass.accesses {
            let info = &buffers[slice.buffer.index()];
            if info.writable() {
                state[slice.buffer.index()].update(slice.range(), |touched| touched.touch(index, *access, edges));
            }
        }
        edges.sort_unstable();
        edges.dedup();
        edges.retain(|&before| before != index);
    }
    follows
}
