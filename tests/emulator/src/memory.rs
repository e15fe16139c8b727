//! Memory of a dispatch: buffers and shared memory, with the accesses since the last barrier.

use crate::fault::{Fault, Invocation};
use sgs_engine::ImageFormat;

/// Several invocations or subgroups.
const MANY: u32 = u32::MAX;

/// Accesses to a word in the current dispatch.
#[derive(Clone, Copy, Default)]
struct Cell {
    /// Dispatch or workgroup of the accesses; others are forgotten.
    stamp: u32,
    atomic: bool,
    written: Access,
    read: Access,
}

/// Last access to a word.
#[derive(Clone, Copy, Default)]
struct Access {
    /// Invocation plus one, [`MANY`], or 0 for none.
    invocation: u32,
    /// Subgroup of the dispatch, or [`MANY`].
    subgroup: u32,
    /// Clock of the access.
    time: u32,
}

/// Invocation that accesses memory, and the barriers that it has passed.
#[derive(Clone, Copy)]
pub(crate) struct Actor {
    /// Invocation of the dispatch, plus one.
    pub invocation: u32,
    /// Subgroup of the dispatch.
    pub subgroup: u32,
    /// Barriers of this kind of memory.
    pub order: Order,
}

/// Clocks that order accesses. A write of the same workgroup before `workgroup` happened before this access, and so did
/// one of the same subgroup before `subgroup`. Reads need only a barrier of execution.
#[derive(Clone, Copy, Default)]
pub(crate) struct Order {
    /// Clock at which the workgroup began.
    pub begin: u32,
    /// Clock after the last barrier of the workgroup with semantics for the memory.
    pub workgroup: u32,
    /// Clock after the last barrier of the subgroup with semantics for the memory.
    pub subgroup: u32,
    /// Clocks after the last barriers of any semantics, of workgroup and subgroup.
    pub executed: [u32; 2],
}

impl Order {
    /// Returns the order against earlier reads.
    fn of_reads(self) -> Order {
        let [workgroup, subgroup] = self.executed;
        Order { workgroup, subgroup, ..self }
    }
}

impl Access {
    /// Returns whether the access happened before one of an actor, or is its own.
    fn before(&self, actor: &Actor) -> bool {
        let Order { begin, workgroup, subgroup, .. } = actor.order;
        self.invocation == 0
            || self.invocation == actor.invocation
            || (self.time >= begin && self.time < workgroup)
            || (self.subgroup == actor.subgroup && self.time >= begin && self.time < subgroup)
    }

    fn by(actor: &Actor, time: u32) -> Access {
        Access { invocation: actor.invocation, subgroup: actor.subgroup, time }
    }

    /// Adds an access that does not come after this one.
    fn join(&mut self, actor: &Actor, time: u32) {
        if self.before(actor) {
            *self = Access::by(actor, time);
        } else {
            let subgroup = if self.subgroup == actor.subgroup { actor.subgroup } else { MANY };
            *self = Access { invocation: MANY, subgroup, time };
        }
    }
}

/// Kind of an access.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum Kind {
    Read,
    Write,
    Atomic,
}

/// Words of memory, and the accesses to them.
#[derive(Default)]
pub struct Store {
    words: Vec<u32>,
    cells: Vec<Cell>,
}

impl Store {
    /// Creates memory with these words.
    pub fn new(words: Vec<u32>) -> Store {
        Store { words, cells: Vec::new() }
    }

    /// Creates memory with these bytes. The last word is filled up with zeros.
    pub fn from_bytes(bytes: &[u8]) -> Store {
        let word = |chunk: &[u8]| {
            let mut four = [0; 4];
            four[..chunk.len()].copy_from_slice(chunk);
            u32::from_le_bytes(four)
        };
        Store::new(bytes.chunks(4).map(word).collect())
    }

    /// Returns the words.
    pub fn words(&self) -> &[u32] {
        &self.words
    }

    /// Returns the words, to change them between dispatches.
    pub fn words_mut(&mut self) -> &mut [u32] {
        &mut self.words
    }

    /// Returns the memory as bytes.
    pub fn bytes(&self) -> Vec<u8> {
        self.words.iter().flat_map(|w| w.to_le_bytes()).collect()
    }

    pub(crate) fn get(&self, word: u32) -> u32 {
        self.words[word as usize]
    }

    pub(crate) fn set(&mut self, word: u32, value: u32) {
        self.words[word as usize] = value;
    }

    /// Returns whether an invocation has written a word since `stamp` began.
    pub(crate) fn is_written(&self, word: u32, stamp: u32) -> bool {
        self.cells.get(word as usize).is_some_and(|c| c.stamp == stamp && c.written.invocation != 0)
    }

    /// Records an access. Returns the conflicting invocation if the access is a race.
    pub(crate) fn access(
        &mut self,
        word: u32,
        kind: Kind,
        actor: &Actor,
        stamp: u32,
        clock: u32,
    ) -> Option<Invocation> {
        if self.cells.len() != self.words.len() {
            self.cells.resize(self.words.len(), Cell::default());
        }
        let cell = &mut self.cells[word as usize];
        if cell.stamp != stamp {
            *cell = Cell { stamp, ..Cell::default() };
        }
        let mut race = None;
        let reader = Actor { order: actor.order.of_reads(), ..*actor };
        let mut against = |access: &Access, actor: &Actor| {
            if !access.before(actor) {
                race = Some(Invocation(if access.invocation == MANY { MANY } else { access.invocation - 1 }));
            }
        };
        match kind {
            Kind::Read => {
                against(&cell.written, actor);
                cell.read.join(&reader, clock);
            }
            Kind::Write => {
                against(&cell.written, actor);
                against(&cell.read, &reader);
                (cell.written, cell.read, cell.atomic) = (Access::by(actor, clock), Access::default(), false);
            }
            Kind::Atomic => {
                against(&cell.read, &reader);
                if cell.atomic {
                    cell.written.join(actor, clock);
                } else {
                    against(&cell.written, actor);
                    cell.written = Access::by(actor, clock);
                }
                (cell.read, cell.atomic) = (Access::default(), true);
            }
        }
        race
    }
}

/// Range of memory that a kernel sees as a binding.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Binding {
    /// Number of the binding.
    pub number: u32,
    /// Index of the memory.
    pub store: usize,
    /// First byte.
    pub offset: u64,
    /// Length in bytes.
    pub bytes: u64,
    /// Size and format, if it is an image. Its texels are packed.
    pub image: Option<([u32; 2], ImageFormat)>,
}

impl Binding {
    /// Returns the word at a byte offset of the binding.
    pub(crate) fn word(&self, offset: u32, name: &str) -> Result<u32, Fault> {
        if !offset.is_multiple_of(4) || u64::from(offset) + 4 > self.bytes {
            return Err(Fault::OutOfBounds { memory: name.to_owned(), offset, bytes: self.bytes });
        }
        Ok(((self.offset + u64::from(offset)) / 4) as u32)
    }
}
