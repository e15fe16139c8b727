//! Branches that inputs take, from LLVM's SanitizerCoverage counters.
//!
//! `tests/fuzz/coverage.toml` builds a program with such counters. Without counters, no input takes a new branch, and
//! only the results of targets guide the fuzzer. As in AFL and libFuzzer, an input is new in two cases: if it takes a
//! branch for the first time, or about twice as many times as before.

use std::collections::HashSet;
use std::sync::OnceLock;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};

/// Counters of the program, one byte per branch.
static COUNTERS: OnceLock<&'static [AtomicU64]> = OnceLock::new();

/// Registers the program's counters, eight per word.
///
/// The call comes before `main`. Only the first call has an effect.
pub fn enlist(counters: &'static [AtomicU64]) {
    COUNTERS.get_or_init(|| counters);
}

/// Size of a block of counters, in words of eight counters.
const BLOCK: usize = 32;

/// Branches that inputs have taken, with classes of their counts.
///
/// Most counters of a program belong to code that a target never reaches. A scan of all counters takes longer than most
/// inputs do. A regular scan therefore covers only blocks that had counts before; [`Coverage::elsewhere`] finds new
/// blocks.
pub(crate) struct Coverage {
    blocks: Vec<Block>,
    /// Number of active blocks, at the front; each scan covers these.
    near: usize,
}

struct Block {
    /// Index of the block in the program.
    number: usize,
    counters: &'static [AtomicU64],
    /// One bit for each of eight classes of counts, for each counter.
    seen: [u64; BLOCK],
}

impl Block {
    fn is_still(&self) -> bool {
        self.counters.iter().all(|c| c.load(Relaxed) == 0)
    }
}

impl Coverage {
    /// Creates the coverage of the program's counters.
    pub(crate) fn of_program() -> Coverage {
        Coverage::of(COUNTERS.get().copied().unwrap_or(&[]))
    }

    fn of(counters: &'static [AtomicU64]) -> Coverage {
        let blocks = counters.chunks(BLOCK).enumerate();
        let blocks = blocks.map(|(number, counters)| Block { number, counters, seen: [0; BLOCK] }).collect();
        Coverage { blocks, near: 0 }
    }

    /// Returns true if the program has counters.
    pub(crate) fn counts(&self) -> bool {
        !self.blocks.is_empty()
    }

    /// Resets the counters of active blocks.
    pub(crate) fn begin(&self) {
        let counters = self.blocks[..self.near].iter().flat_map(|b| b.counters);
        counters.filter(|c| c.load(Relaxed) != 0).for_each(|c| c.store(0, Relaxed));
    }

    /// Records the counts since [`Coverage::begin`]; returns true if any is new.
    pub(crate) fn is_new(&mut self) -> bool {
        let mut new = false;
        for block in &mut self.blocks[..self.near] {
            for (counter, seen) in block.counters.iter().zip(&mut block.seen) {
                let counts = counter.load(Relaxed);
                if counts != 0 {
                    let classes = u64::from_ne_bytes(counts.to_ne_bytes().map(class));
                    new |= classes & !*seen != 0;
                    *seen |= classes;
                }
            }
        }
        new
    }

    /// Activates blocks with counts; returns true if any block is new.
    ///
    /// The counts of inactive blocks accumulate over all inputs.
    pub(crate) fn elsewhere(&mut self) -> bool {
        let before = self.near;
        for at in before..self.blocks.len() {
            if !self.blocks[at].is_still() {
                self.blocks.swap(self.near, at);
                self.near += 1;
            }
        }
        self.near > before
    }

    /// Returns the branches taken since [`Coverage::begin`] in active blocks.
    pub(crate) fn taken(&self) -> HashSet<u32> {
        let numbers = self.blocks[..self.near].iter().flat_map(|block| {
            let counters = block.counters.iter().enumerate().filter(|(_, c)| c.load(Relaxed) != 0);
            counters.flat_map(move |(at, c)| {
                let bytes = c.load(Relaxed).to_ne_bytes().into_iter().enumerate().filter(|(_, count)| *count != 0);
                bytes.map(move |(byte, _)| ((block.number * BLOCK + at) * 8 + byte) as u32)
            })
        });
        numbers.collect()
    }

    /// Returns the number of branches that any input took.
    pub(crate) fn branches(&self) -> usize {
        let seen = self.blocks[..self.near].iter().flat_map(|b| b.seen);
        seen.map(|s| s.to_ne_bytes().into_iter().filter(|c| *c != 0).count()).sum()
    }
}

/// Returns the bit of a count's class; no bit for a count of zero.
fn class(count: u8) -> u8 {
    match count {
        0 => 0,
        1..=3 => 1 << (count - 1),
        4..=7 => 1 << 3,
        8..=15 => 1 << 4,
        16..=31 => 1 << 5,
        32..=127 => 1 << 6,
        128.. => 1 << 7,
    }
}

#[cfg(test)]
mod tests {
    use super::{BLOCK, Coverage};
    use std::sync::atomic::{AtomicU64, Ordering::Relaxed};

    /// Creates counters, and a function that sets the count of a branch.
    fn counters(blocks: usize) -> (&'static [AtomicU64], impl Fn(usize, u8)) {
        let numbers = (0..blocks * BLOCK).map(|_| AtomicU64::new(0)).collect::<Vec<_>>();
        let counters: &'static [AtomicU64] = numbers.leak();
        let count = |branch: usize, times: u8| {
            let mut bytes = counters[branch / 8].load(Relaxed).to_ne_bytes();
            bytes[branch % 8] = times;
            counters[branch / 8].store(u64::from_ne_bytes(bytes), Relaxed);
        };
        (counters, count)
    }

    #[test]
    fn new_branches_and_doubled_counts_are_new() {
        let (counters, count) = counters(1);
        let mut coverage = Coverage::of(counters);
        assert!(coverage.counts() && coverage.branches() == 0);
        count(3, 1);
        assert!(coverage.elsewhere() && !coverage.elsewhere());
        coverage.begin();
        assert!(!coverage.is_new(), "what was before is forgotten");
        let mut taken = |branch: usize, times: u8| {
            coverage.begin();
            count(branch, times);
            (coverage.is_new(), coverage.branches())
        };
        assert_eq!(taken(5, 1), (true, 1));
        assert_eq!(taken(5, 1), (false, 1));
        assert_eq!(taken(12, 9), (true, 2));
        assert_eq!(taken(12, 14), (false, 2), "a few times more is nothing new");
        assert_eq!(taken(12, 31), (true, 2));
        assert_eq!(taken(12, 255), (true, 2));
        assert_eq!(taken(12, 200), (false, 2));
        assert_eq!(taken(5, 2), (true, 2));
        assert_eq!(taken(4, 0), (false, 2));
    }

    #[test]
    fn blocks_become_active_once_they_have_counts() {
        let (counters, count) = counters(5);
        let mut coverage = Coverage::of(counters);
        let (far, farther) = (8 * BLOCK * 3 + 100, 8 * BLOCK * 4 + 7);
        count(far, 1);
        coverage.begin();
        assert!(!coverage.is_new(), "nobody has looked there yet");
        assert!(coverage.elsewhere() && coverage.is_new() && coverage.branches() == 1);
        coverage.begin();
        count(far, 1);
        count(farther, 9);
        assert!(!coverage.is_new() && coverage.elsewhere() && coverage.is_new() && coverage.branches() == 2);
        assert_eq!(coverage.taken(), [far as u32, farther as u32].into());
        coverage.begin();
        assert!(counters.iter().all(|c| c.load(Relaxed) == 0) && coverage.taken().is_empty());
        count(far, 2);
        assert!(coverage.is_new() && !coverage.elsewhere() && coverage.branches() == 2);
    }

    #[test]
    fn nothing_is_new_without_counters() {
        let mut coverage = Coverage::of(&[]);
        coverage.begin();
        assert!(!coverage.counts() && !coverage.is_new() && !coverage.elsewhere() && coverage.branches() == 0);
    }
}
