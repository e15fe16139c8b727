//! Partition of memory at all slice boundaries: no operation accesses part of a cell.

use std::ops::Range;

/// Cells of separate memory spaces.
pub(super) struct Cells {
    /// By space: cell boundaries, ascending.
    cuts: Vec<Vec<u64>>,
}

impl Cells {
    /// Creates cells with boundaries at both ends of each range.
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

    /// Creates a table with one value per cell, by space.
    pub(super) fn table<T: Clone + Default>(&self) -> Vec<Vec<T>> {
        self.cuts.iter().map(|cuts| vec![T::default(); cuts.len()]).collect()
    }

    /// Returns the cells of a range that was passed to [`Cells::new`].
    pub(super) fn of(&self, space: usize, range: &Range<u64>) -> Range<usize> {
        let find = |byte| self.cuts[space].partition_point(|&cut| cut < byte);
        find(range.start)..find(range.end)
    }

    /// Returns the first byte of a cell.
    pub(super) fn byte(&self, space: usize, cell: usize) -> u64 {
        self.cuts[space][cell]
    }
}
