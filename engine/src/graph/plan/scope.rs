//! Scopes of barriers: sets of pipeline stages and of memory accesses.
//!
//! Contains only what compute graphs need, with its own bit values; the executor translates them to Vulkan. Each
//! access belongs to exactly one stage, so a set of accesses implies its stages.

use std::fmt;

/// Set of pipeline stages.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug, Default)]
pub struct Stages(u32);

/// Set of memory access types.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug, Default)]
pub struct Accesses(u32);

impl Stages {
    /// No stage.
    pub const NONE: Stages = Stages(0);
    /// Compute kernels.
    pub const COMPUTE: Stages = Stages(1);
    /// Reads of group counts.
    pub const INDIRECT: Stages = Stages(2);
    /// Fills, clears and copies: every transfer stage.
    pub const TRANSFER: Stages = Stages(4);
    /// Host.
    pub const HOST: Stages = Stages(8);
    /// Commands outside the plan, of any kind.
    pub const OUTSIDE: Stages = Stages(16);
    /// All stages, by ascending bit.
    pub const ALL: [Stages; 5] = [Stages::COMPUTE, Stages::INDIRECT, Stages::TRANSFER, Stages::HOST, Stages::OUTSIDE];

    /// Returns the name of a set with one element.
    fn name(self) -> &'static str {
        match self {
            Stages::COMPUTE => "compute",
            Stages::INDIRECT => "indirect",
            Stages::TRANSFER => "transfer",
            Stages::HOST => "host",
            Stages::OUTSIDE => "outside",
            _ => "?",
        }
    }
}

impl Accesses {
    /// No access.
    pub const NONE: Accesses = Accesses(0);
    /// Loads from storage buffers and storage images.
    pub const STORAGE_READ: Accesses = Accesses(1);
    /// Stores to storage buffers and storage images.
    pub const STORAGE_WRITE: Accesses = Accesses(2);
    /// Loads from uniform buffers.
    pub const UNIFORM_READ: Accesses = Accesses(4);
    /// Reads of group counts.
    pub const INDIRECT_READ: Accesses = Accesses(8);
    /// Reads by copies.
    pub const TRANSFER_READ: Accesses = Accesses(16);
    /// Writes by fills and copies.
    pub const TRANSFER_WRITE: Accesses = Accesses(32);
    /// Loads by the host.
    pub const HOST_READ: Accesses = Accesses(64);
    /// Reads by commands outside the plan.
    pub const OUTSIDE_READ: Accesses = Accesses(128);
    /// Writes by commands outside the plan.
    pub const OUTSIDE_WRITE: Accesses = Accesses(256);
    /// All accesses, by ascending bit.
    pub const ALL: [Accesses; 9] = [
        Accesses::STORAGE_READ,
        Accesses::STORAGE_WRITE,
        Accesses::UNIFORM_READ,
        Accesses::INDIRECT_READ,
        Accesses::TRANSFER_READ,
        Accesses::TRANSFER_WRITE,
        Accesses::HOST_READ,
        Accesses::OUTSIDE_READ,
        Accesses::OUTSIDE_WRITE,
    ];

    /// Returns the stages that perform these accesses.
    pub fn stages(self) -> Stages {
        let mut stages = Stages::NONE;
        for access in Accesses::ALL.into_iter().filter(|&a| self.contains(a)) {
            stages |= match access {
                Accesses::STORAGE_READ | Accesses::STORAGE_WRITE | Accesses::UNIFORM_READ => Stages::COMPUTE,
                Accesses::INDIRECT_READ => Stages::INDIRECT,
                Accesses::TRANSFER_READ | Accesses::TRANSFER_WRITE => Stages::TRANSFER,
                Accesses::OUTSIDE_READ | Accesses::OUTSIDE_WRITE => Stages::OUTSIDE,
                _ => Stages::HOST,
            };
        }
        stages
    }

    /// Returns the name of a set with one element.
    fn name(self) -> &'static str {
        match self {
            Accesses::STORAGE_READ => "storage_read",
            Accesses::STORAGE_WRITE => "storage_write",
            Accesses::UNIFORM_READ => "uniform_read",
            Accesses::INDIRECT_READ => "indirect_read",
            Accesses::TRANSFER_READ => "transfer_read",
            Accesses::TRANSFER_WRITE => "transfer_write",
            Accesses::HOST_READ => "host_read",
            Accesses::OUTSIDE_READ => "outside_read",
            Accesses::OUTSIDE_WRITE => "outside_write",
            _ => "?",
        }
    }
}

macro_rules! set {
    ($set:ident) => {
        impl $set {
            /// Returns the bits, for translation tables and hashes.
            pub fn bits(self) -> u32 {
                self.0
            }

            /// Returns whether the set is empty.
            pub fn is_empty(self) -> bool {
                self.0 == 0
            }

            /// Returns whether the set contains all of `other`.
            pub fn contains(self, other: Self) -> bool {
                self.0 & other.0 == other.0
            }

            /// Returns the intersection of both sets.
            pub fn intersection(self, other: Self) -> Self {
                $set(self.0 & other.0)
            }

            /// Returns this set without the elements of `other`.
            pub fn without(self, other: Self) -> Self {
                $set(self.0 & !other.0)
            }
        }

        impl std::ops::BitOr for $set {
            type Output = Self;

            fn bitor(self, other: Self) -> Self {
                $set(self.0 | other.0)
            }
        }

        impl std::ops::BitOrAssign for $set {
            fn bitor_assign(&mut self, other: Self) {
                self.0 |= other.0;
            }
        }

        impl fmt::Display for $set {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                if self.is_empty() {
                    return f.write_str("none");
                }
                let names = $set::ALL.into_iter().filter(|&one| self.contains(one)).map(|one| one.name());
                f.write_str(&names.collect::<Vec<_>>().join("|"))
            }
        }

        impl serde::Serialize for $set {
            fn serialize<S: serde::Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
                to.collect_seq($set::ALL.into_iter().filter(|&one| self.contains(one)).map(|one| one.name()))
            }
        }
    };
}

set!(Stages);
set!(Accesses);

/// Global memory barrier between earlier and later commands.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug, Default, serde::Serialize)]
pub struct Barrier {
    /// Stages that must finish.
    pub src_stage: Stages,
    /// Writes of those stages that become available.
    pub src_access: Accesses,
    /// Stages that wait.
    pub dst_stage: Stages,
    /// Accesses of those stages that see available writes.
    pub dst_access: Accesses,
}

impl Barrier {
    /// Full barrier: orders all device work. For use between two plans, or between a plan and other commands.
    pub const FULL: Barrier = Barrier {
        src_stage: Stages(7),
        src_access: Accesses(2 | 32),
        dst_stage: Stages(7),
        dst_access: Accesses(1 | 2 | 4 | 8 | 16 | 32),
    };

    /// Returns a barrier that covers at least both.
    pub fn merge(&self, other: &Barrier) -> Barrier {
        Barrier {
            src_stage: self.src_stage | other.src_stage,
            src_access: self.src_access | other.src_access,
            dst_stage: self.dst_stage | other.dst_stage,
            dst_access: self.dst_access | other.dst_access,
        }
    }
}

impl fmt::Display for Barrier {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Barrier { src_stage, src_access, dst_stage, dst_access } = self;
        write!(f, "{src_stage}[{src_access}] -> {dst_stage}[{dst_access}]")
    }
}
