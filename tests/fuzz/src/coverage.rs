//! The ways that inputs take through the code, where the program was built with counters at its branches (LLVM's SanitizerCoverage;
//! `tests/fuzz/coverage.toml` says how). Where it was not, no input takes a new way, and what targets say is all there is to go by.
//!
//! As AFL and libFuzzer do, a way is new where a branch is taken that never was, or about twice as many times as ever.

use std::collections::HashSet;
use std::sync::OnceLock;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};

/// The program's counters: a byte for each branch.
static COUNTERS: OnceLock<&'static [AtomicU64]> = OnceLock::new();

/// Takes the program's counters, eight to a number. They come before `main`, and those that come first stay.
pub fn enlist(counters: &'static [AtomicU64]) {
    COUNTERS.get_or_init(|| counters);
}

/// Counters that are looked at together, in numbers of eight.
const BLOCK: usize = 32;

/// The branches that inputs took so far, and how many times.
///
/// Most of a program's counters belong to what a target never reaches, and to go through all of them takes longer than most inputs do.
/// So a look goes through blocks in which something was counted before; [`Coverage::elsewhere`] looks for others.
pub(crate) struct Coverage {
    blocks: Vec<Block>,
    /// How many of them, from the first, are looked at each time.
    near: usize,
}

struct Block {
    /// Which it is among all.
    number: usize,
    counters: &'static [AtomicU64],
    /// For each counter a bit for each of eight classes of numbers.
    seen: [u64; BLOCK],
}

impl Block {
    fn is_still(&self) -> bool {
        self.counters.iter().all(|c| c.load(Relaxed) == 0)
    }
}

impl Coverage {
    /// Of the program's counters.
    pub(crate) fn of_program() -> Coverage {
        Coverage::of(COUNTERS.get().copied().unwrap_or(&[]))
    }

    fn of(counters: &'static [AtomicU64]) -> Coverage {
        let blocks = counters.chunks(BLOCK).enumerate();
        let blocks = blocks.map(|(number, counters)| Block { number, counters, seen: [0; BLOCK] }).collect();
        Coverage { blocks, near: 0 }
    }

    /// Whether the program counts.
    pub(crate) fn counts(&self) -> bool {
        !self.blocks.is_empty()
    }

    /// Forgets what was counted since the last look.
    pub(crate) fn begin(&self) {
        let counters = self.blocks[..self.near].iter().flat_map(|b| b.counters);
        counters.filter(|c| c.load(Relaxed) != 0).for_each(|c| c.store(0, Relaxed));
    }

    /// Whether what was counted since then is new.
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

    /// Whether something was counted where nothing ever was, whenever. From now on looks go there, too.
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

    /// Which branches were counted since [`Coverage::begin`], where something was counted before.
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

    /// How many branches were taken at all.
    pub(crate) fn branches(&self) -> usize {
        let seen = self.blocks[..self.near].iter().flat_map(|b| b.seen);
        seen.map(|s| s.to_ne_bytes().into_iter().filter(|c| *c != 0).count()).sum()
    }
}

/// A bit for a number of times; none for none.
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

    /// Counters, and how to count so many times at one.
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
    fn what_was_never_taken_is_new_and_so_is_twice_as_often() {
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
    fn looks_go_where_something_was_counted() {
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
    fn nothing_is_new_where_nothing_counts() {
        let mut coverage = Coverage::of(&[]);
        coverage.begin();
        assert!(!coverage.counts() && !coverage.is_new() && !coverage.elsewhere() && coverage.branches() == 0);
    }
}
