//! Interpreter of compute kernels in SPIR-V at any subgroup size.
//!
//! It runs the words that the engine gives to a driver, with subgroups of 4 to 64 lanes, and reports what the standard
//! leaves undefined: races, divergent barriers, shuffles from inactive lanes, accesses outside of buffers, reads of
//! shared memory that nobody wrote. Workgroups, subgroups and atomics run in a chosen order.
//!
//! Lanes of a subgroup run in lockstep and meet again at merge blocks. Accesses of two lanes of a subgroup to one word
//! race as well, unless a barrier of the subgroup or of the workgroup lies between them.

mod code;
mod exec;
mod fault;
mod lower;
mod memory;
mod module;
mod plan;
mod random;
mod scalar;

pub use fault::{Fault, Invocation};
pub use memory::{Binding, Store};
pub use plan::{Emulator, Run};

use code::Code;

/// Order of workgroups, of their subgroups, and of the lanes of an atomic.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum Schedule {
    /// Lowest first.
    #[default]
    Ascending,
    /// Highest first.
    Descending,
    /// Pseudorandom, by a seed.
    Shuffled(u64),
}

impl Schedule {
    fn seed(self) -> u64 {
        if let Schedule::Shuffled(seed) = self { seed } else { 0 }
    }
}

/// Limit of steps that no kernel of a test reaches.
pub const LIMIT: u64 = 20_000_000_000;

/// Kernel with its specialization constants.
#[derive(Debug)]
pub struct Kernel {
    code: Code,
}

/// Inputs of a dispatch.
#[derive(Clone, Copy, Debug)]
pub struct Dispatch<'a> {
    /// Lanes of a subgroup: 4, 8, 16, 32 or 64.
    pub lanes: u32,
    /// Workgroups along each axis.
    pub groups: [u32; 3],
    /// Memory of each binding.
    pub bindings: &'a [Binding],
    /// Push constants.
    pub push: &'a [u8],
    /// Order of execution.
    pub schedule: Schedule,
    /// Buffers whose races are no faults, by name. Races on shared memory always are faults.
    pub tolerated: &'a [&'a str],
    /// Steps of all subgroups together after which the kernel counts as endless.
    pub limit: u64,
}

impl Kernel {
    /// Translates a module. `specs` holds constant ids and bits.
    ///
    /// # Errors
    /// If the module is damaged, or uses what the emulator lacks.
    pub fn new(words: &[u32], specs: &[(u32, u32)]) -> Result<Kernel, Fault> {
        Kernel::translate(words, specs, None)
    }

    /// Translates a module for subgroups of a size. Cooperative matrices require it.
    ///
    /// # Errors
    /// If the module is damaged, or uses what the emulator lacks.
    pub fn for_lanes(words: &[u32], specs: &[(u32, u32)], lanes: u32) -> Result<Kernel, Fault> {
        Kernel::translate(words, specs, Some(lanes))
    }

    fn translate(words: &[u32], specs: &[(u32, u32)], lanes: Option<u32>) -> Result<Kernel, Fault> {
        let module = module::Module::decode(words, specs, lanes)?;
        Ok(Kernel { code: lower::lower(&module)? })
    }

    /// Runs the kernel. `stamp` numbers the dispatches on the same memory, from 1.
    ///
    /// # Errors
    /// The first undefined operation.
    pub fn run(&self, stores: &mut [Store], dispatch: &Dispatch<'_>, stamp: u32) -> Result<(), Fault> {
        let mut machine = exec::Machine::new(&self.code, stores, dispatch, stamp)?;
        match dispatch.lanes {
            4 => machine.run::<4>(dispatch.groups),
            8 => machine.run::<8>(dispatch.groups),
            16 => machine.run::<16>(dispatch.groups),
            32 => machine.run::<32>(dispatch.groups),
            64 => machine.run::<64>(dispatch.groups),
            other => Err(Fault::Missing(format!("subgroups of {other} lanes"))),
        }
    }
}
