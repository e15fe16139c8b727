//! Passes that run only if a word on the device is not zero.
//!
//! A kernel of one invocation, the *gate*, turns the word and the group counts into indirect dispatch arguments, zero
//! if the pass must not run. This works on every device, and with group counts computed on the device. Conditional
//! rendering would be an optional extension with its own access type and covers neither fills nor copies. The engine
//! has no kernels: the caller provides the gate.

use std::sync::Arc;

use super::builder::{Condition, Graph};
use super::error::GraphError;
use super::pass::{Dispatch, INDIRECT_BYTES, Pass, PassKind, Use};
use super::resource::{Buffer, BufferKind, Slice, Switch};
use crate::shader::{Access, BindingKind, Shader};

/// Size of a gate's push constants in bytes.
const PUSH_BYTES: u32 = 24;

/// Slice offset alignment that every device supports.
const ALIGNMENT: u64 = 256;

/// Group counts of a conditional pass.
pub(super) enum Counts {
    /// Constant counts.
    Fixed([u32; 3]),
    /// Counts in a buffer.
    Indirect(Slice),
}

impl Graph {
    /// Sets the gate kernel, which conditional passes require.
    ///
    /// The gate has three storage bindings and six words of push constants: `[x, y, z, found, word, counts]`. One
    /// invocation writes three words to `arguments`:
    /// * zeros if word `word` of the binding `word` is zero;
    /// * else x, y, z if `found` is zero;
    /// * else the three words of the binding `counts` from word `counts` on.
    pub fn set_gate(&mut self, gate: &Arc<Shader>) {
        let binding =
            |name, access| gate.binding(name).is_some_and(|b| b.kind == BindingKind::Storage && b.access == access);
        let reads = binding("word", Access::Read) && binding("counts", Access::Read);
        if gate.bindings.len() == 3 && reads && binding("arguments", Access::Write) && gate.push_bytes == PUSH_BYTES {
            self.gate = Some(Arc::clone(gate));
        } else {
            self.errors.push(GraphError::BadGate { graph: self.name.clone(), shader: gate.name.to_string() });
        }
    }

    /// Declares a switch that the host sets between replays; initially on. Used by
    /// [`PassBuilder::when`](super::PassBuilder::when).
    pub fn switch(&mut self, name: impl Into<String>) -> Switch {
        let buffer = self.declare(name.into(), 4, BufferKind::Uniform, false);
        self.buffers[buffer.index()].switch = true;
        Switch(buffer)
    }

    /// Returns the condition of a word at this point of the declaration.
    pub(super) fn condition(&self, word: Slice) -> Condition {
        (word, self.versions[word.buffer.index()])
    }

    /// Checks that a slice is one aligned 32-bit word.
    pub(super) fn resolve_word(&self, pass: &str, word: Slice) -> Result<Slice, GraphError> {
        let word = self.resolve(pass, word)?;
        if word.bytes != 4 || !word.offset.is_multiple_of(4) {
            let (pass, buffer) = (pass.to_owned(), self.buffers[word.buffer.index()].name.clone());
            return Err(GraphError::ConditionWord { pass, buffer, offset: word.offset, bytes: word.bytes });
        }
        self.check_written(pass, &word, None)?;
        Ok(word)
    }

    /// Declares the gate of a pass; returns the buffer of its group counts.
    pub(super) fn add_gate(&mut self, pass: &str, word: Slice, counts: Counts) -> Result<Buffer, GraphError> {
        let gate = self.gate.clone().ok_or_else(|| GraphError::NoGate { pass: pass.to_owned() })?;
        let (groups, found, counts) = match counts {
            Counts::Fixed(groups) => (groups, 0, word),
            Counts::Indirect(slice) => {
                self.check_not_uniform(pass, slice.buffer, "its group counts")?;
                self.check_written(pass, &slice, None)?;
                ([0; 3], 1, slice)
            }
        };
        let arguments = self.transient(format!("{pass}.groups"), INDIRECT_BYTES.next_multiple_of(16));
        // Slices begin at an alignment that every device supports; the kernel receives the word offset.
        let bound = |slice: Slice| {
            let first = slice.offset / ALIGNMENT * ALIGNMENT;
            (slice.buffer.slice(first, slice.offset + slice.bytes - first), ((slice.offset - first) / 4) as u32)
        };
        let ((word, word_at), (counts, counts_at)) = (bound(word), bound(counts));
        let push = [groups[0], groups[1], groups[2], found, word_at, counts_at];
        let slice = |name: &str| match name {
            "word" => word,
            "counts" => counts,
            _ => arguments.slice(0, INDIRECT_BYTES),
        };
        let bindings: Vec<(u32, Slice)> = gate.bindings.iter().map(|b| (b.number, slice(&b.name))).collect();
        let accesses = gate.bindings.iter().map(|b| (slice(&b.name), b.access, Use::Compute)).collect();
        self.finish(Pass {
            name: format!("{pass}.when"),
            condition: None,
            accesses,
            discards: vec![arguments.slice(0, INDIRECT_BYTES)],
            kind: PassKind::Compute {
                shader: gate,
                specs: Vec::new(),
                push: push.iter().flat_map(|word| word.to_ne_bytes()).collect(),
                bindings,
                subgroup_size: None,
                dispatch: Dispatch::Groups([1; 3]),
            },
        })?;
        Ok(arguments)
    }
}
