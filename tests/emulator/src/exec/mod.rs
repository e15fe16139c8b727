//! Execution: workgroups one after the other, their subgroups from barrier to barrier.

mod group;
mod image;
mod subgroup;
mod tiles;

pub(crate) use image::encode;

use crate::code::{BuiltIn, Code, MASKED, NONE};
use crate::fault::Fault;
use crate::memory::{Binding, Order, Store};
use crate::random::Random;
use crate::scalar::Lanes;
use crate::{Dispatch, Schedule};
use subgroup::{Stop, Subgroup};

/// Semantics of barriers that order buffers: `UniformMemory`.
const BUFFERS: u32 = 0x40;
/// Semantics of barriers that order shared memory: `WorkgroupMemory`.
const SHARED: u32 = 0x100;

/// Dispatch that runs.
pub(super) struct Machine<'a> {
    pub code: &'a Code,
    pub stores: &'a mut [Store],
    /// Binding of each buffer of the code.
    pub bindings: Vec<Binding>,
    pub push: Vec<u32>,
    pub shared: Store,
    /// Number of the workgroup that owns shared memory.
    pub workgroup_stamp: u32,
    /// Number of the dispatch.
    pub stamp: u32,
    /// Counts barriers and workgroups.
    pub clock: u32,
    pub fuel: u64,
    pub schedule: Schedule,
    pub random: Random,
    /// By binding: whether its races are no faults.
    pub tolerated: Vec<bool>,
}

impl<'a> Machine<'a> {
    pub fn new(code: &'a Code, stores: &'a mut [Store], dispatch: &Dispatch<'_>, stamp: u32) -> Result<Self, Fault> {
        let mut bindings = Vec::new();
        for (number, name) in code.bindings.iter().zip(&code.binding_names) {
            let found = dispatch.bindings.iter().find(|b| b.number == *number);
            let none = Fault::OutOfBounds { memory: name.clone(), offset: 0, bytes: 0 };
            let found = *found.ok_or(none)?;
            assert!(found.offset % 4 == 0, "binding {number} lies at byte {}", found.offset);
            bindings.push(found);
        }
        let push = Store::from_bytes(dispatch.push).words().to_vec();
        Ok(Machine {
            code,
            stores,
            bindings,
            push,
            shared: Store::new(vec![u32::MAX; code.shared_words() as usize]),
            workgroup_stamp: 0,
            stamp,
            clock: 1,
            fuel: dispatch.limit,
            schedule: dispatch.schedule,
            random: Random::new(dispatch.schedule.seed()),
            tolerated: code.binding_names.iter().map(|name| dispatch.tolerated.contains(&name.as_str())).collect(),
        })
    }

    /// Runs all workgroups with subgroups of `N` lanes.
    pub fn run<const N: usize>(&mut self, groups: [u32; 3]) -> Result<(), Fault> {
        let count = groups.iter().map(|n| u64::from(*n)).product::<u64>();
        let order = self.order(count as usize);
        let mut subgroups = self.subgroups::<N>(groups);
        for (which, index) in order.into_iter().enumerate() {
            let index = index as u32;
            let id = [index % groups[0], index / groups[0] % groups[1], index / groups[0] / groups[1]];
            self.clock += 1;
            self.workgroup_stamp = which as u32 + 1;
            self.begin(&mut subgroups, index, id);
            self.workgroup(&mut subgroups)?;
        }
        Ok(())
    }

    /// Returns the numbers below `count` in the order of the schedule.
    pub fn order(&mut self, count: usize) -> Vec<usize> {
        let mut order: Vec<usize> = (0..count).collect();
        match self.schedule {
            Schedule::Ascending => {}
            Schedule::Descending => order.reverse(),
            Schedule::Shuffled(_) => self.random.shuffle(&mut order),
        }
        order
    }

    /// Creates the subgroups of a workgroup with what all workgroups share.
    fn subgroups<const N: usize>(&self, groups: [u32; 3]) -> Vec<Subgroup<N>> {
        let size = self.code.local_size;
        let invocations = size.iter().product::<u32>();
        let count = invocations.div_ceil(N as u32);
        let mut registers = vec![[u32::MAX; N]; self.code.slots as usize];
        for (slot, bits) in &self.code.constants {
            registers[*slot as usize] = [*bits; N];
        }
        (0..count)
            .map(|number| {
                let mut registers = registers.clone();
                let local = |l: usize| number * N as u32 + l as u32;
                let axis = |l: usize, k: usize| match k {
                    0 => local(l) % size[0],
                    1 => local(l) / size[0] % size[1],
                    _ => local(l) / size[0] / size[1],
                };
                for (built_in, first) in &self.code.inputs {
                    let mut fill = |k: usize, value: &dyn Fn(usize) -> u32| {
                        registers[*first as usize + k] = std::array::from_fn(value);
                    };
                    match built_in {
                        BuiltIn::NumWorkgroups => (0..3).for_each(|k| fill(k, &|_| groups[k])),
                        BuiltIn::WorkgroupSize => (0..3).for_each(|k| fill(k, &|_| size[k])),
                        BuiltIn::LocalId => (0..3).for_each(|k| fill(k, &|l| axis(l, k))),
                        BuiltIn::LocalIndex => fill(0, &local),
                        BuiltIn::SubgroupSize => fill(0, &|_| N as u32),
                        BuiltIn::NumSubgroups => fill(0, &|_| count),
                        BuiltIn::SubgroupId => fill(0, &|_| number),
                        BuiltIn::Lane => fill(0, &|l| l as u32),
                        BuiltIn::WorkgroupId | BuiltIn::GlobalId => {}
                    }
                }
                let lanes = (invocations - number * N as u32).min(N as u32);
                Subgroup::new(number, lanes, registers)
            })
            .collect()
    }

    /// Sets subgroups to the beginning of a workgroup.
    fn begin<const N: usize>(&self, subgroups: &mut [Subgroup<N>], index: u32, id: [u32; 3]) {
        let size = self.code.local_size;
        let total = subgroups.len() as u32;
        for s in subgroups {
            for (built_in, first) in &self.code.inputs {
                for k in 0..3 {
                    let slot = *first as usize + k;
                    match built_in {
                        BuiltIn::WorkgroupId => s.registers[slot] = [id[k]; N],
                        BuiltIn::GlobalId => {
                            let local = |l: usize| s.number * N as u32 + l as u32;
                            let axis = |l: usize| match k {
                                0 => local(l) % size[0],
                                1 => local(l) / size[0] % size[1],
                                _ => local(l) / size[0] / size[1],
                            };
                            s.registers[slot] = std::array::from_fn(|l| id[k] * size[k] + axis(l));
                        }
                        _ => {}
                    }
                }
            }
            for &(first, count) in &self.code.variables {
                s.registers[first as usize..(first + count) as usize].fill([u32::MAX; N]);
            }
            let first = index * size.iter().product::<u32>() + s.number * N as u32;
            let order = Order { begin: self.clock, ..Order::default() };
            s.restart(first, index * total + s.number, order);
        }
    }

    /// Runs the subgroups of a workgroup from barrier to barrier.
    fn workgroup<const N: usize>(&mut self, subgroups: &mut [Subgroup<N>]) -> Result<(), Fault> {
        loop {
            let mut stops = vec![Stop::End; subgroups.len()];
            for k in self.order(subgroups.len()) {
                stops[k] = self.advance(&mut subgroups[k])?;
            }
            let first = stops[0];
            if let Some(other) = stops.iter().position(|s| *s != first) {
                let place = |stop: Stop| match stop {
                    Stop::End => "ends".to_owned(),
                    Stop::Barrier { block, step, .. } => format!("waits at step {step} of block {block}"),
                };
                let text = format!("subgroup 0 {}, subgroup {other} {}", place(first), place(stops[other]));
                return Err(Fault::Barrier(text));
            }
            let Stop::Barrier { semantics, .. } = first else { return Ok(()) };
            self.clock += 1;
            for s in subgroups.iter_mut() {
                let semantics = semantics | s.fences;
                s.fences = 0;
                (s.shared.executed[0], s.buffers.executed[0]) = (self.clock, self.clock);
                if semantics & SHARED != 0 {
                    s.shared.workgroup = self.clock;
                }
                if semantics & BUFFERS != 0 {
                    s.buffers.workgroup = self.clock;
                }
            }
        }
    }
}

/// Returns the register of a slot.
pub(super) fn at<const N: usize>(registers: &[Lanes<N>], slot: u32) -> Lanes<N> {
    registers[(slot & !MASKED) as usize]
}

/// Returns the register of an offset; zeros for none.
pub(super) fn offset<const N: usize>(registers: &[Lanes<N>], slot: u32) -> Lanes<N> {
    if slot == NONE { [0; N] } else { at(registers, slot) }
}
