//! Random graphs of integer kernels: drawing, declaration and reference results.
//!
//! Guarantees: a seed gives one recipe. The builder accepts every recipe. Every word of the result is defined, since no
//! pass reads a word that no pass wrote. Does not run the graphs; the test does.

mod draw;
mod machine;

pub use draw::draw;
pub use machine::Machine;

use crate::kernels::kernel;
use sgs_engine::graph::{Buffer, CompileOptions, Graph, GraphError, Slice};

/// Ownership and lifetime of a buffer of a recipe.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Memory of the caller that passes read and write.
    External,
    /// Memory of the caller that passes only read.
    Input,
    /// Memory that lives within a replay.
    Transient,
    /// Memory that lives within a replay and stays readable after the replay.
    Retained,
    /// Four words that change with every replay.
    Uniform,
}

impl Kind {
    /// Returns true if passes may write the buffer.
    pub fn writable(self) -> bool {
        matches!(self, Kind::External | Kind::Transient | Kind::Retained)
    }

    /// Returns true if the contents are undefined at the start of a replay.
    pub fn transient(self) -> bool {
        matches!(self, Kind::Transient | Kind::Retained)
    }
}

/// Range of words of a buffer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Span {
    /// Index of the buffer.
    pub buffer: usize,
    /// First word.
    pub start: usize,
    /// Number of words.
    pub words: usize,
}

impl Span {
    /// Returns the range of its words in the buffer.
    pub fn range(&self) -> std::ops::Range<usize> {
        self.start..self.start + self.words
    }

    /// Returns true if two spans share a word.
    pub fn overlaps(&self, other: &Span) -> bool {
        self.buffer == other.buffer && self.start < other.start + other.words && other.start < self.start + self.words
    }
}

/// Number of workgroups of a dispatch.
#[derive(Clone, Copy, Debug)]
pub enum Groups {
    /// Constant number.
    Fixed(u32),
    /// Number that an indirect dispatch reads from a buffer and a word in it.
    At(usize, usize),
}

/// One pass.
#[derive(Clone, Debug)]
pub enum Op {
    /// Fills a span with one word.
    Fill(Span, u32),
    /// Copies the first span to the second.
    Copy(Span, Span),
    /// Runs a kernel.
    Run {
        /// Name of the kernel.
        kernel: &'static str,
        /// Name of each binding, its span, and whether the previous contents are discarded.
        bound: Vec<(&'static str, Span, bool)>,
        /// Push constant.
        seed: u32,
        /// Number of workgroups.
        groups: Groups,
    },
}

/// Random graph and how to run it.
#[derive(Clone, Debug)]
pub struct Recipe {
    /// Seed that the recipe was drawn from.
    pub seed: u32,
    /// Kind and number of words of each buffer.
    pub buffers: Vec<(Kind, usize)>,
    /// Passes in declared order.
    pub ops: Vec<Op>,
    /// Compile options of the graph.
    pub options: CompileOptions,
    /// Number of replays.
    pub replays: u32,
    /// Number of replays in flight.
    pub frames: usize,
    /// Whether the arena is filled with ones before each replay.
    pub poison: bool,
}

impl Recipe {
    /// Returns a recipe with only the first passes.
    pub fn prefix(&self, passes: usize) -> Recipe {
        Recipe { ops: self.ops[..passes].to_vec(), ..self.clone() }
    }

    /// Declares the graph and its buffers, in order.
    ///
    /// # Errors
    /// Never fails for a recipe from [`draw()`].
    pub fn declare(&self) -> Result<(Graph, Vec<Buffer>), GraphError> {
        let mut graph = Graph::new(format!("random {}", self.seed));
        let mut buffers = Vec::new();
        for (index, &(kind, words)) in self.buffers.iter().enumerate() {
            let (name, bytes) = (format!("{kind:?}{index}").to_lowercase(), 4 * words as u64);
            buffers.push(match kind {
                Kind::External => graph.external(name, bytes),
                Kind::Input => graph.input(name, bytes),
                Kind::Uniform => graph.uniform(name, bytes),
                Kind::Transient | Kind::Retained => graph.transient(name, bytes),
            });
            if kind == Kind::Retained {
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
