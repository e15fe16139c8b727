//! Random graphs of integer kernels: how they are drawn and declared, and what they must compute.
//!
//! Promises: a seed gives one recipe; every recipe is a declaration that the builder accepts and whose result is defined,
//! word for word: nothing reads what nobody wrote. Leaves running them to the test.

mod draw;
mod machine;

pub use draw::draw;
pub use machine::Machine;

use crate::kernels::kernel;
use sgs_engine::graph::{Buffer, CompileOptions, Graph, GraphError, Slice};

/// Whose memory a buffer of a recipe is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Kept by the caller, and written.
    External,
    /// Given by the caller, only read.
    Input,
    /// Inside a replay.
    Transient,
    /// Inside a replay, and wanted afterwards.
    Kept,
    /// Four words that change with every replay.
    Uniform,
}

impl Kind {
    /// Whether passes may write it.
    pub fn writable(self) -> bool {
        matches!(self, Kind::External | Kind::Transient | Kind::Kept)
    }

    /// Whether it holds nothing when a replay begins.
    pub fn transient(self) -> bool {
        matches!(self, Kind::Transient | Kind::Kept)
    }
}

/// Words of a buffer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Span {
    /// Which buffer.
    pub buffer: usize,
    /// First word.
    pub start: usize,
    /// How many.
    pub words: usize,
}

impl Span {
    /// Its words in their buffer.
    pub fn range(&self) -> std::ops::Range<usize> {
        self.start..self.start + self.words
    }

    /// Whether two have a word in common.
    pub fn overlaps(&self, other: &Span) -> bool {
        self.buffer == other.buffer && self.start < other.start + other.words && other.start < self.start + self.words
    }
}

/// How many groups run.
#[derive(Clone, Copy, Debug)]
pub enum Groups {
    /// So many.
    Fixed(u32),
    /// As many as are found in a buffer at a word.
    At(usize, usize),
}

/// One pass.
#[derive(Clone, Debug)]
pub enum Op {
    /// Writes one word everywhere.
    Fill(Span, u32),
    /// Copies.
    Copy(Span, Span),
    /// Runs a kernel.
    Run {
        /// Which.
        kernel: &'static str,
        /// What is bound to each name, and whether its contents are discarded.
        bound: Vec<(&'static str, Span, bool)>,
        /// Its push constant.
        seed: u32,
        /// How much of it.
        groups: Groups,
    },
}

/// A graph to be, and how it is run.
#[derive(Clone, Debug)]
pub struct Recipe {
    /// What it was drawn from.
    pub seed: u32,
    /// Kinds and words.
    pub buffers: Vec<(Kind, usize)>,
    /// Passes in declared order.
    pub ops: Vec<Op>,
    /// How the graph is compiled.
    pub options: CompileOptions,
    /// How often it is replayed.
    pub replays: u32,
    /// How many replays are in flight.
    pub frames: usize,
    /// Whether the arena is filled with ones before each replay.
    pub poison: bool,
}

impl Recipe {
    /// The first passes of the recipe.
    pub fn prefix(&self, passes: usize) -> Recipe {
        Recipe { ops: self.ops[..passes].to_vec(), ..self.clone() }
    }

    /// The declaration, with its buffers in order.
    ///
    /// # Errors
    /// None, if the recipe was drawn as promised.
    pub fn declare(&self) -> Result<(Graph, Vec<Buffer>), GraphError> {
        let mut graph = Graph::new(format!("random {}", self.seed));
        let mut buffers = Vec::new();
        for (index, &(kind, words)) in self.buffers.iter().enumerate() {
            let (name, bytes) = (format!("{kind:?}{index}").to_lowercase(), 4 * words as u64);
            buffers.push(match kind {
                Kind::External => graph.external(name, bytes),
                Kind::Input => graph.input(name, bytes),
                Kind::Uniform => graph.uniform(name, bytes),
                Kind::Transient | Kind::Kept => graph.transient(name, bytes),
            });
            if kind == Kind::Kept {
                graph.keep(buffers[index]);
            }
        }
        let slice = |span: &Span| -> Slice { buffers[span.buffer].slice(4 * span.start as u64, 4 * span.words as u64) };
        for (index, op) in self.ops.iter().enumerate() {
            match op {
                Op::Fill(target, value) => graph.fill(format!("{index} fill"), slice(target), *value)?,
                Op::Copy(source, target) => graph.copy(format!("{index} copy"), slice(source), slice(target))?,
                Op::Run { kernel: name, bound, seed, groups } => {
                    let mut pass = graph.pass(format!("{index} {name}"), &kernel(name)).push(&seed.to_ne_bytes());
                    for (name, span, discard) in bound {
                        let slice = slice(span);
                        pass = if *discard { pass.bind_discard(name, slice) } else { pass.bind(name, slice) };
                    }
                    match *groups {
                        Groups::Fixed(count) => pass.dispatch([count, 1, 1])?,
                        Groups::At(buffer, word) => pass.dispatch_indirect(buffers[buffer], 4 * word as u64)?,
                    }
                }
            }
        }
        Ok((graph, buffers))
    }
}
