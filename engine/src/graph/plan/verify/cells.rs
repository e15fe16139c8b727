//! Memory cut wherever any slice begins or ends: no operation touches part of a cell.

use std::ops::Range;

/// The cells of some spaces, each a stretch of memory of its own.
pub(super) struct Cells {
    /// By space: the cuts, ascending.
    cuts: Vec<Vec<u64>>,
}

impl Cells {
    /// Cuts at both ends of each range.
    pub(super) fn new(spaces: usize, ranges: impl Iterator<Item = (usize, Range<u64>)>) -> Self {
        let mut cuts = vec![Vec::new(); spaces];
        for (space, range) in ranges {
            cuts[space].extend([range.start, range.end]);
        }
        for cuts in &mut cuts {
            cuts.sort_unstable();
            cuts.dedup();
        }
        Cells { cuts }
    }

    /// One value for each cell, by space.
    pub(super) fn table<T: Clone + Default>(&self) -> Vec<Vec<T>> {
        self.cuts.iter().map(|cuts| vec![T::default(); cuts.len()]).collect()
    }

    /// The cells of one of the ranges that made the cuts.
    pub(super) fn of(&self, space: usize, range: &Range<u64>) -> Range<usize> {
        let find = |byte| self.cuts[space].partition_point(|&cut| cut < byte);
        find(range.start)..find(range.end)
    }

    /// First byte of a cell.
    pub(super) fn byte(&self, space: usize, cell: usize) -> u64 {
        self.cuts[space][cell]
    }
}
