//! One subgroup: registers, lanes that wait at blocks, and steps that need no other lane.

use super::{BUFFERS, Machine, SHARED, at, offset};
use crate::code::{Atomic, Edge, End, MASKED, NONE, Place, Slot, Space, Step};
use crate::fault::{Fault, Invocation};
use crate::memory::{Actor, Kind, Order};
use crate::scalar::{self, Lanes, Un};

/// Reason why a subgroup stopped.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Stop {
    End,
    Barrier { block: u32, step: u32, semantics: u32 },
}

/// State of a subgroup.
pub(super) struct Subgroup<const N: usize> {
    pub number: u32,
    pub registers: Vec<Lanes<N>>,
    /// Lanes that exist.
    all: u64,
    /// Active lanes.
    pub mask: u64,
    block: u32,
    step: u32,
    /// Blocks with waiting lanes, in descending order.
    waiting: Vec<(u32, u64)>,
    /// First invocation in the dispatch.
    first: u32,
    /// Number in the dispatch.
    global: u32,
    pub shared: Order,
    pub buffers: Order,
    /// Semantics of memory barriers since the last control barrier.
    pub fences: u32,
}

/// Iterates over the lanes of a mask.
pub(super) fn lanes(mask: u64) -> impl Iterator<Item = usize> {
    let mut rest = mask;
    std::iter::from_fn(move || {
        let lane = rest.trailing_zeros();
        rest &= rest.wrapping_sub(1);
        (lane < 64).then_some(lane as usize)
    })
}

impl<const N: usize> Subgroup<N> {
    pub(super) const FULL: u64 = if N == 64 { u64::MAX } else { (1 << N) - 1 };

    pub fn new(number: u32, lanes: u32, registers: Vec<Lanes<N>>) -> Self {
        let all = if lanes == 64 { u64::MAX } else { (1 << lanes) - 1 };
        let (shared, buffers) = (Order::default(), Order::default());
        Subgroup {
            number,
            registers,
            all,
            mask: all,
            block: 0,
            step: 0,
            waiting: Vec::new(),
            first: 0,
            global: 0,
            shared,
            buffers,
            fences: 0,
        }
    }

    /// Starts a workgroup.
    pub fn restart(&mut self, first: u32, global: u32, order: Order) {
        self.waiting.clear();
        (self.mask, self.block, self.step, self.fences) = (self.all, 0, 0, 0);
        (self.first, self.global, self.shared, self.buffers) = (first, global, order, order);
    }

    /// Writes a register: where its flag asks for it, only the lanes of a mask.
    pub fn put(&mut self, slot: Slot, value: Lanes<N>, mask: u64) {
        let register = &mut self.registers[(slot & !MASKED) as usize];
        if slot & MASKED == 0 || mask == Self::FULL {
            *register = value;
        } else {
            for l in 0..N {
                register[l] = if mask >> l & 1 != 0 { value[l] } else { register[l] };
            }
        }
    }

    fn invocation(&self, lane: usize) -> Invocation {
        Invocation(self.first + lane as u32)
    }

    /// Adds lanes to those that wait at the block of an edge.
    fn wait(&mut self, edge: &Edge, mask: u64) {
        if mask == 0 {
            return;
        }
        if let [(to, from)] = edge.copies[..] {
            let value = at(&self.registers, from);
            self.put(to | MASKED, value, mask);
        } else if !edge.copies.is_empty() {
            let values: Vec<Lanes<N>> = edge.copies.iter().map(|(_, from)| at(&self.registers, *from)).collect();
            for ((to, _), value) in edge.copies.iter().zip(values) {
                self.put(to | MASKED, value, mask);
            }
        }
        match self.waiting.binary_search_by(|(block, _)| edge.target.cmp(block)) {
            Ok(k) => self.waiting[k].1 |= mask,
            Err(k) => self.waiting.insert(k, (edge.target, mask)),
        }
    }
}

/// Returns the lanes where a register is not zero.
pub(super) fn truth<const N: usize>(value: &Lanes<N>) -> u64 {
    (0..N).fold(0, |mask, l| mask | u64::from(value[l] != 0) << l)
}

impl Machine<'_> {
    /// Runs a subgroup to its next barrier or its end.
    pub(super) fn advance<const N: usize>(&mut self, s: &mut Subgroup<N>) -> Result<Stop, Fault> {
        let code = self.code;
        loop {
            let block = &code.blocks[s.block as usize];
            self.fuel = self.fuel.checked_sub(1 + block.steps.len() as u64).ok_or(Fault::Endless)?;
            while let Some(step) = block.steps.get(s.step as usize) {
                s.step += 1;
                if let Step::Barrier(scope, semantics) = *step {
                    if s.mask != s.all {
                        let text = format!("lanes {:#x} of {:#x} of subgroup {} reach it", s.mask, s.all, s.number);
                        return Err(Fault::Barrier(text));
                    }
                    // Scopes: 2 is the workgroup, 3 the subgroup.
                    match scope {
                        2 => return Ok(Stop::Barrier { block: s.block, step: s.step, semantics }),
                        3 => self.subgroup_barrier(s, semantics),
                        other => return Err(Fault::missing(format!("barriers of scope {other}"))),
                    }
                    continue;
                }
                self.execute(s, step)?;
            }
            let mask = s.mask;
            match &block.end {
                End::Jump(edge) => s.wait(edge, mask),
                End::Branch(condition, yes, no) => {
                    let yes_lanes = truth(&at(&s.registers, *condition)) & mask;
                    s.wait(yes, yes_lanes);
                    s.wait(no, mask & !yes_lanes);
                }
                End::Switch(selector, cases, other) => {
                    let selector = at(&s.registers, *selector);
                    let mut rest = mask;
                    for (value, edge) in cases {
                        let here = lanes(rest).filter(|l| selector[*l] == *value).fold(0, |m, l| m | 1_u64 << l);
                        rest &= !here;
                        s.wait(edge, here);
                    }
                    s.wait(other, rest);
                }
                End::Exit => {}
                End::Unreachable => return Err(Fault::Unreachable),
            }
            let Some((next, mask)) = s.waiting.pop() else { return Ok(Stop::End) };
            (s.block, s.mask, s.step) = (next, mask, 0);
        }
    }

    fn subgroup_barrier<const N: usize>(&mut self, s: &mut Subgroup<N>, semantics: u32) {
        let semantics = semantics | s.fences;
        s.fences = 0;
        self.clock += 1;
        (s.shared.executed[1], s.buffers.executed[1]) = (self.clock, self.clock);
        if semantics & SHARED != 0 {
            s.shared.subgroup = self.clock;
        }
        if semantics & BUFFERS != 0 {
            s.buffers.subgroup = self.clock;
        }
    }

    fn execute<const N: usize>(&mut self, s: &mut Subgroup<N>, step: &Step) -> Result<(), Fault> {
        let mask = s.mask;
        match *step {
            Step::Un(op, d, a) => {
                let a = at(&s.registers, a);
                if matches!(op, Un::ConvertFToU | Un::ConvertFToS) {
                    check_conversion(op, &a, mask)?;
                }
                s.put(d, scalar::un(op, &a), mask);
            }
            Step::Bin(op, d, a, b) => {
                let (a, b) = (at(&s.registers, a), at(&s.registers, b));
                if op.is_partial()
                    && let Some(l) = lanes(mask).find(|l| scalar::undefined(op, a[*l], b[*l]))
                {
                    return Err(Fault::Arithmetic(format!("{op:?} of {} and {}", a[l], b[l])));
                }
                s.put(d, scalar::bin(op, &a, &b), mask);
            }
            Step::Tri(op, d, a, b, c) => {
                let found = scalar::tri(op, &at(&s.registers, a), &at(&s.registers, b), &at(&s.registers, c));
                s.put(d, found, mask);
            }
            Step::Index(a, length) => {
                let a = at(&s.registers, a);
                if let Some(l) = lanes(mask).find(|l| a[*l] >= length) {
                    return Err(Fault::Index { index: a[l], length });
                }
            }
            Step::Load(d, place) => {
                let found = self.load(s, place)?;
                s.put(d, found, mask);
            }
            Step::Store(place, a) => self.store(s, place, a)?,
            Step::Atomic(op, d, place, a, b) => self.atomic(s, (op, d, place, a, b))?,
            Step::Length(d, binding, offset, stride) => {
                let bytes = self.bindings[binding as usize].bytes.saturating_sub(u64::from(offset));
                s.put(d, [(bytes / u64::from(stride)) as u32; N], mask);
            }
            Step::Texel(d, binding, at, k) => self.texel(s, d, binding, at, k)?,
            Step::SetTexel(binding, at, values) => self.set_texel(s, binding, at, values)?,
            Step::Group(op, d, a, b) => super::group::group(s, op, d, a, b)?,
            Step::Vote(op, d, ballot, lane) => super::group::vote(s, op, d, ballot, lane),
            Step::LoadTile(access) => self.tile(s, &access, Kind::Read)?,
            Step::StoreTile(access) => self.tile(s, &access, Kind::Write)?,
            Step::MulAdd(all) => super::tiles::multiply(s, all)?,
            Step::MemoryBarrier(semantics) => s.fences |= semantics,
            Step::Barrier(..) => {}
        }
        Ok(())
    }

    /// Checks an access and returns its word.
    pub(super) fn word<const N: usize>(
        &mut self,
        s: &Subgroup<N>,
        place: &Place,
        at: u32,
        lane: usize,
        kind: Kind,
    ) -> Result<u32, Fault> {
        let from = place.fixed.wrapping_add(at);
        let actor = |order| Actor { invocation: s.invocation(lane).0 + 1, subgroup: s.global, order };
        let (word, race, first) = match place.space {
            Space::Buffer(binding) => {
                let bound = self.bindings[binding as usize];
                let word = bound.word(from, &self.code.binding_names[binding as usize])?;
                let store = &mut self.stores[bound.store];
                let race = store.access(word, kind, &actor(s.buffers), self.stamp, self.clock);
                (word, race.filter(|_| !self.tolerated[binding as usize]), from / 4)
            }
            Space::Shared => {
                let stamp = self.workgroup_stamp;
                let Some((base, _, name)) = self.code.shared.iter().find(|(f, n, _)| (*f..f + n).contains(&from))
                else {
                    return Err(Fault::OutOfBounds { memory: "shared memory".to_owned(), offset: 4 * from, bytes: 0 });
                };
                if kind != Kind::Write && !self.shared.is_written(from, stamp) {
                    let (memory, word, invocation) = (name.clone(), from - base, s.invocation(lane));
                    return Err(Fault::Uninitialized { memory, word, invocation });
                }
                (from, self.shared.access(from, kind, &actor(s.shared), stamp, self.clock), from - base)
            }
            Space::Push | Space::Registers(..) => return Ok(from),
        };
        if let Some(other) = race {
            let memory = match place.space {
                Space::Buffer(binding) => self.code.binding_names[binding as usize].clone(),
                _ => self
                    .code
                    .shared
                    .iter()
                    .find(|(f, n, _)| (*f..f + n).contains(&from))
                    .map_or_else(String::new, |s| s.2.clone()),
            };
            return Err(Fault::Race { memory, word: first, first: other, second: s.invocation(lane) });
        }
        Ok(word)
    }

    fn load<const N: usize>(&mut self, s: &Subgroup<N>, place: Place) -> Result<Lanes<N>, Fault> {
        let from = offset(&s.registers, place.at);
        let mut found = [0; N];
        for l in lanes(s.mask) {
            found[l] = match place.space {
                Space::Registers(first, count) => {
                    let index = place.fixed.wrapping_add(from[l]);
                    if index >= count {
                        return Err(Fault::Index { index, length: count });
                    }
                    s.registers[(first + index) as usize][l]
                }
                Space::Push => {
                    let byte = place.fixed.wrapping_add(from[l]);
                    let none = || Fault::OutOfBounds {
                        memory: "push constants".to_owned(),
                        offset: byte,
                        bytes: 4 * self.push.len() as u64,
                    };
                    *self.push.get((byte / 4) as usize).ok_or_else(none)?
                }
                Space::Shared => {
                    let word = self.word(s, &place, from[l], l, Kind::Read)?;
                    self.shared.get(word)
                }
                Space::Buffer(binding) => {
                    let word = self.word(s, &place, from[l], l, Kind::Read)?;
                    self.stores[self.bindings[binding as usize].store].get(word)
                }
            };
        }
        Ok(found)
    }

    fn store<const N: usize>(&mut self, s: &mut Subgroup<N>, place: Place, a: Slot) -> Result<(), Fault> {
        let (from, value) = (offset(&s.registers, place.at), at(&s.registers, a));
        for l in lanes(s.mask) {
            match place.space {
                Space::Registers(first, count) => {
                    let index = place.fixed.wrapping_add(from[l]);
                    if index >= count {
                        return Err(Fault::Index { index, length: count });
                    }
                    s.registers[(first + index) as usize][l] = value[l];
                }
                Space::Shared => {
                    let word = self.word(s, &place, from[l], l, Kind::Write)?;
                    self.shared.set(word, value[l]);
                }
                Space::Buffer(binding) => {
                    let word = self.word(s, &place, from[l], l, Kind::Write)?;
                    self.stores[self.bindings[binding as usize].store].set(word, value[l]);
                }
                Space::Push => return Err(Fault::missing("a store to push constants".to_owned())),
            }
        }
        Ok(())
    }

    fn atomic<const N: usize>(
        &mut self,
        s: &mut Subgroup<N>,
        (op, d, place, a, b): (Atomic, Slot, Place, Slot, Slot),
    ) -> Result<(), Fault> {
        let (from, value, comparator) =
            (offset(&s.registers, place.at), offset(&s.registers, a), offset(&s.registers, b));
        let mut found = [0; N];
        for l in self.order(N).into_iter().filter(|l| s.mask >> l & 1 != 0) {
            let word = match op {
                // Stores make shared memory initialized; other atomics read it.
                Atomic::Store if place.space == Space::Shared => self.word(s, &place, from[l], l, Kind::Write)?,
                _ => self.word(s, &place, from[l], l, Kind::Atomic)?,
            };
            let store = match place.space {
                Space::Shared => &mut self.shared,
                Space::Buffer(binding) => &mut self.stores[self.bindings[binding as usize].store],
                _ => return Err(Fault::missing("atomics on variables".to_owned())),
            };
            let before = store.get(word);
            found[l] = before;
            let after = match op {
                Atomic::Load => before,
                Atomic::Store | Atomic::Exchange => value[l],
                Atomic::CompareExchange => {
                    if before == comparator[l] {
                        value[l]
                    } else {
                        before
                    }
                }
                Atomic::Combine(op) => scalar::bin(op, &[before], &[value[l]])[0],
            };
            store.set(word, after);
        }
        if d != NONE {
            s.put(d, found, s.mask);
        }
        Ok(())
    }
}

/// Fails if an active lane converts a float outside the range of the integer.
fn check_conversion<const N: usize>(op: Un, a: &Lanes<N>, mask: u64) -> Result<(), Fault> {
    let (low, high) = if op == Un::ConvertFToU { (-1.0, 4_294_967_296.0) } else { (-2_147_483_904.0, 2_147_483_648.0) };
    for l in lanes(mask) {
        let x = f32::from_bits(a[l]);
        if !(x > low && x < high) {
            return Err(Fault::Conversion(format!("{x:?} by {op:?}")));
        }
    }
    Ok(())
}
