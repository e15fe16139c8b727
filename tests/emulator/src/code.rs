//! Code that subgroups run: scalar operations on registers, in blocks.
//!
//! Functions are inlined, so that each pointer names one variable. Blocks keep the order of the module. Lanes wait at
//! the block that they reach; the lowest block with waiting lanes runs next. With the order that structured control
//! flow gives, lanes that diverge at a header therefore meet again at its merge block.

use crate::module::Tile;
use crate::scalar::{Bin, Tri, Un};

/// Index of a register of all lanes.
///
/// A destination has [`MASKED`] where only active lanes may be written.
pub(crate) type Slot = u32;

/// Flag of a destination that other blocks use: inactive lanes keep their value.
pub(crate) const MASKED: Slot = 1 << 31;

/// Slot that stands for none.
pub(crate) const NONE: Slot = MASKED - 1;

/// Memory of an access.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Space {
    /// Registers of a variable from a slot on, with their number.
    Registers(Slot, u32),
    /// Shared memory of the workgroup.
    Shared,
    /// Binding by its place in [`Code::bindings`].
    Buffer(u32),
    /// Push constants.
    Push,
}

/// Word in memory: a constant offset plus a register. Words for registers and shared memory, bytes for buffers.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Place {
    pub space: Space,
    pub fixed: u32,
    pub at: Slot,
}

/// Operation of subgroups that combines lanes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Combine {
    Reduce,
    Inclusive,
    Exclusive,
    /// Number of lanes of a cluster.
    Clustered(u32),
}

/// Operation of subgroups.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Group {
    Elect,
    All,
    Any,
    AllEqual,
    /// Ballot of the lanes from 32 times this number on.
    Ballot(u32),
    Broadcast,
    BroadcastFirst,
    Shuffle,
    ShuffleXor,
    ShuffleUp,
    ShuffleDown,
    Arithmetic(Bin, Combine, u32),
}

/// Question to a ballot.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Vote {
    Bit,
    Count(Combine),
    Lowest,
    Highest,
}

/// Atomic operation.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Atomic {
    Load,
    Store,
    Exchange,
    CompareExchange,
    Combine(Bin),
}

/// Access to a cooperative matrix in memory.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Access {
    /// First register.
    pub first: Slot,
    pub tile: Tile,
    pub place: Place,
    /// Distance of rows, or of columns.
    pub stride: Slot,
    /// Whether a column is contiguous.
    pub by_columns: bool,
}

/// Operation.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Step {
    Un(Un, Slot, Slot),
    Bin(Bin, Slot, Slot, Slot),
    Tri(Tri, Slot, Slot, Slot, Slot),
    /// Checks an index against the length of an array.
    Index(Slot, u32),
    Load(Slot, Place),
    Store(Place, Slot),
    /// Result, place, value and comparator.
    Atomic(Atomic, Slot, Place, Slot, Slot),
    /// Component of a texel: result, binding, coordinates and number of the component.
    Texel(Slot, u32, [Slot; 2], u32),
    /// Writes a texel: binding, coordinates and components.
    SetTexel(u32, [Slot; 2], [Slot; 4]),
    /// Number of elements: binding, offset and stride.
    Length(Slot, u32, u32, u32),
    Group(Group, Slot, Slot, Slot),
    /// Result, the four words of the ballot, and a lane.
    Vote(Vote, Slot, [Slot; 4], Slot),
    LoadTile(Access),
    StoreTile(Access),
    /// First registers and sizes of result, operands and addend.
    MulAdd([(Slot, Tile); 4]),
    /// Scope of execution and memory semantics.
    Barrier(u32, u32),
    /// Memory semantics.
    MemoryBarrier(u32),
}

/// Way to a block, with the copies into its phis.
#[derive(Clone, Debug, Default)]
pub(crate) struct Edge {
    /// Label while the code grows, block index afterwards.
    pub target: u32,
    pub copies: Vec<(Slot, Slot)>,
}

/// End of a block.
#[derive(Clone, Debug)]
pub(crate) enum End {
    Jump(Edge),
    Branch(Slot, Edge, Edge),
    Switch(Slot, Vec<(u32, Edge)>, Edge),
    Exit,
    Unreachable,
}

/// Basic block.
#[derive(Clone, Debug)]
pub(crate) struct Block {
    pub steps: Vec<Step>,
    pub end: End,
}

/// Built-in variables that a subgroup starts with.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum BuiltIn {
    NumWorkgroups,
    WorkgroupSize,
    WorkgroupId,
    LocalId,
    GlobalId,
    LocalIndex,
    SubgroupSize,
    NumSubgroups,
    SubgroupId,
    Lane,
}

/// Code of a kernel at one specialization.
#[derive(Debug, Default)]
pub(crate) struct Code {
    pub blocks: Vec<Block>,
    /// Number of registers.
    pub slots: u32,
    /// Registers of constants and their bits.
    pub constants: Vec<(Slot, u32)>,
    /// Registers of variables: first and number. They start undefined.
    pub variables: Vec<(Slot, u32)>,
    /// Built-in variables and the register of the first component.
    pub inputs: Vec<(BuiltIn, Slot)>,
    /// Number of each binding.
    pub bindings: Vec<u32>,
    /// Name of each binding.
    pub binding_names: Vec<String>,
    /// First word, number of words and name of each shared variable.
    pub shared: Vec<(u32, u32, String)>,
    pub local_size: [u32; 3],
}

impl Code {
    /// Returns the number of words of shared memory.
    pub fn shared_words(&self) -> u32 {
        self.shared.last().map_or(0, |(first, words, _)| first + words)
    }

    /// Sets [`MASKED`] on destinations that outlive their block.
    ///
    /// These are written in several blocks or read in another one.
    pub fn mask(&mut self) {
        let mut home = vec![u32::MAX; self.slots as usize];
        let mut escapes = vec![false; self.slots as usize];
        for &(first, count) in &self.variables {
            (first..first + count).for_each(|s| escapes[s as usize] = true);
        }
        for (index, block) in self.blocks.iter_mut().enumerate() {
            for step in &mut block.steps {
                if let Some(d) = step.destination() {
                    let slot = *d as usize;
                    escapes[slot] |= home[slot] != u32::MAX && home[slot] != index as u32;
                    home[slot] = index as u32;
                }
            }
        }
        for (index, block) in self.blocks.iter().enumerate() {
            let mut read = |slot: Slot| {
                if slot < NONE && home[slot as usize] != index as u32 {
                    escapes[slot as usize] = true;
                }
            };
            block.steps.iter().for_each(|s| s.reads().into_iter().for_each(&mut read));
            block.end.reads().into_iter().for_each(&mut read);
        }
        for block in &mut self.blocks {
            for step in &mut block.steps {
                if let Some(d) = step.destination() {
                    *d |= if escapes[*d as usize] { MASKED } else { 0 };
                }
            }
        }
    }
}

impl Step {
    fn destination(&mut self) -> Option<&mut Slot> {
        match self {
            Step::Un(_, d, _)
            | Step::Bin(_, d, ..)
            | Step::Tri(_, d, ..)
            | Step::Load(d, _)
            | Step::Atomic(_, d, ..)
            | Step::Length(d, ..)
            | Step::Texel(d, ..)
            | Step::Group(_, d, ..)
            | Step::Vote(_, d, ..) => Some(d).filter(|d| **d != NONE),
            Step::Index(..)
            | Step::Store(..)
            | Step::SetTexel(..)
            // All lanes are active, so that no lane keeps its value.
            | Step::LoadTile(_)
            | Step::StoreTile(_)
            | Step::MulAdd(_)
            | Step::Barrier(..)
            | Step::MemoryBarrier(_) => None,
        }
    }

    fn reads(&self) -> Vec<Slot> {
        match *self {
            Step::Un(_, _, a) | Step::Index(a, _) => vec![a],
            Step::Bin(_, _, a, b) | Step::Group(_, _, a, b) => vec![a, b],
            Step::Tri(_, _, a, b, c) => vec![a, b, c],
            Step::Load(_, p) => vec![p.at],
            Step::Store(p, a) => vec![p.at, a],
            Step::Atomic(_, _, p, a, b) => vec![p.at, a, b],
            Step::Texel(_, _, [x, y], _) => vec![x, y],
            Step::SetTexel(_, [x, y], [a, b, c, d]) => vec![x, y, a, b, c, d],
            Step::Vote(_, _, [a, b, c, d], e) => vec![a, b, c, d, e],
            Step::LoadTile(a) => vec![a.place.at, a.stride],
            Step::StoreTile(a) => [vec![a.place.at, a.stride], (a.first..a.first + a.tile.share).collect()].concat(),
            Step::MulAdd([_, operands @ ..]) => {
                operands.iter().flat_map(|(first, tile)| *first..first + tile.share).collect()
            }
            Step::Length(..) | Step::Barrier(..) | Step::MemoryBarrier(_) => Vec::new(),
        }
    }
}

impl End {
    fn reads(&self) -> Vec<Slot> {
        let sources = |e: &Edge| e.copies.iter().map(|(_, from)| *from).collect::<Vec<_>>();
        match self {
            End::Jump(e) => sources(e),
            End::Branch(c, yes, no) => [vec![*c], sources(yes), sources(no)].concat(),
            End::Switch(c, cases, other) => {
                let cases = cases.iter().flat_map(|(_, e)| sources(e)).collect();
                [vec![*c], cases, sources(other)].concat()
            }
            End::Exit | End::Unreachable => Vec::new(),
        }
    }
}
