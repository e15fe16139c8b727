//! Operations on the shared disk: what each action of a worker costs.
//!
//! An operation is a system call that names a file or moves bytes: open, read, write, list (a page of names), stat,
//! link, rename, remove, flush, make a folder. Empty reads, the end of a listing, `fstat` and `close` do not count.
//! `bench/batch_operations` compares these numbers with `strace` of real workers.

use serde::Serialize;
use std::ops::{Add, AddAssign, Mul};

/// Version of the queue's use of the disk.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, clap::ValueEnum)]
#[serde(rename_all = "lowercase")]
pub enum Protocol {
    /// That of the first version, which asks for each run.
    First,
    /// That of this version, which lists leases and results.
    Current,
}

/// Operations by the place of their files.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Ops {
    /// In `leases`.
    pub leases: f64,
    /// In `results`.
    pub results: f64,
    /// On `summary.*`.
    pub summary: f64,
    /// In `runs`, by the queue. Those of training are not counted.
    pub runs: f64,
    /// On scenes, when a worker starts.
    pub scenes: f64,
}

impl Ops {
    /// No operations.
    pub const NONE: Ops = Ops { leases: 0.0, results: 0.0, summary: 0.0, runs: 0.0, scenes: 0.0 };

    /// Returns the number of all operations.
    pub fn total(&self) -> f64 {
        self.leases + self.results + self.summary + self.runs + self.scenes
    }

    fn leases(count: f64) -> Ops {
        Ops { leases: count, ..Ops::NONE }
    }

    fn results(count: f64) -> Ops {
        Ops { results: count, ..Ops::NONE }
    }
}

impl Add for Ops {
    type Output = Ops;
    fn add(self, o: Ops) -> Ops {
        Ops {
            leases: self.leases + o.leases,
            results: self.results + o.results,
            summary: self.summary + o.summary,
            runs: self.runs + o.runs,
            scenes: self.scenes + o.scenes,
        }
    }
}

impl AddAssign for Ops {
    fn add_assign(&mut self, other: Ops) {
        *self = *self + other;
    }
}

impl Mul<f64> for Ops {
    type Output = Ops;
    fn mul(self, n: f64) -> Ops {
        Ops {
            leases: n * self.leases,
            results: n * self.results,
            summary: n * self.summary,
            runs: n * self.runs,
            scenes: n * self.scenes,
        }
    }
}

/// Bytes of a directory entry with a usual key, as `getdents64` writes it.
const ENTRY: f64 = 48.0;

/// Bytes of a page of a listing.
const PAGE: f64 = 32_768.0;

/// An attempt to open an absent file.
const ABSENT: f64 = 1.0;

/// Opening and reading a small file.
const READ: f64 = 2.0;

/// Atomic write with both flushes: create, write, flush, rename, open the folder, flush it.
const ATOMIC: f64 = 6.0;

/// Writing a lease: create, write.
const WRITE: f64 = 2.0;

/// Opening and listing a folder with `names` entries.
fn list(names: usize) -> f64 {
    1.0 + ((names as f64 + 2.0) * ENTRY / PAGE).ceil().max(1.0)
}

/// Costs of a protocol.
#[derive(Clone, Copy, Debug)]
pub struct Costs(pub Protocol);

impl Costs {
    /// A renewal of a lease. `held`: leases of all workers.
    pub fn renewal(self, held: usize) -> Ops {
        let valid = match self.0 {
            Protocol::First => READ + list(held),
            Protocol::Current => READ + ABSENT,
        };
        Ops::leases(valid + WRITE + 1.0)
    }

    /// The start of a pass over the runs.
    pub fn pass(self, held: usize) -> Ops {
        match self.0 {
            Protocol::First => Ops::NONE,
            Protocol::Current => Ops::leases(list(held)),
        }
    }

    /// A look at the lease of another worker.
    pub fn look(self, held: usize) -> Ops {
        match self.0 {
            Protocol::First => Ops::results(ABSENT) + Ops::leases(list(held) + READ),
            Protocol::Current => Ops::leases(READ),
        }
    }

    /// Reading the result of another worker.
    pub fn result(self) -> Ops {
        Ops::results(READ)
    }

    /// A claim that another worker won. It may list the leases again.
    pub fn lost_race(self, held: usize) -> Ops {
        let again = self.pass(held);
        Ops::results(ABSENT) + Ops::leases(list(held) + WRITE + 2.0 + READ) + again
    }

    /// A claim that succeeds. `taken_over`: whether the run had a lease.
    pub fn claim(self, held: usize, taken_over: bool) -> Ops {
        let old = if taken_over { READ } else { 0.0 };
        Ops::results(2.0 * ABSENT) + Ops::leases(list(held) + old + WRITE + 2.0)
    }

    /// The start of an attempt without evaluation: record, folders, log.
    pub fn attempt(self) -> Ops {
        Ops { runs: 16.0, ..Ops::NONE }
    }

    /// The end of a run: its result is written, its lease removed.
    pub fn finish(self, held: usize) -> Ops {
        let valid = match self.0 {
            Protocol::First => READ + list(held),
            Protocol::Current => READ + ABSENT,
        };
        let write = Ops { results: ATOMIC + 2.0, runs: READ, ..Ops::NONE };
        write + Ops::leases(valid + list(held) + 1.0)
    }

    /// The start of a worker. `ended`: results that exist.
    pub fn start(self, rooms: usize, held: usize, ended: usize) -> Ops {
        let folders = Ops { leases: 2.0 + list(held), results: 2.0, runs: 2.0, ..Ops::NONE };
        let results = match self.0 {
            Protocol::First => READ * ended as f64 + ABSENT * (rooms - ended) as f64,
            Protocol::Current => list(ended) + READ * ended as f64,
        };
        folders + Ops::results(results)
    }

    /// Reading all results for the summary. `unread`: results that this worker has not read.
    pub fn results(self, rooms: usize, ended: usize, unread: usize) -> Ops {
        Ops::results(match self.0 {
            Protocol::First => READ * ended as f64 + ABSENT * (rooms - ended) as f64,
            Protocol::Current => list(ended) + READ * unread as f64,
        })
    }

    /// Comparing the files of the summary with new texts, and writing them.
    pub fn files(self, differ: bool) -> Ops {
        Ops { summary: 3.0 * (READ + if differ { ATOMIC + 2.0 } else { 0.0 }), ..Ops::NONE }
    }

    /// The look at the age of the summary after a run.
    pub fn age(self) -> Ops {
        match self.0 {
            Protocol::First => Ops::NONE,
            Protocol::Current => Ops { summary: 1.0, results: 1.0, ..Ops::NONE },
        }
    }
}
