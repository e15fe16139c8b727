//! A value for every byte of a stretch of memory, stored as maximal known pieces.
//!
//! Builder and compiler phases keep their per-byte state in it. The verifier does not: it has cells of its own.

use std::collections::BTreeMap;
use std::ops::Range;

/// A total map from `0..end` to `T`.
#[derive(Clone, Debug)]
pub(crate) struct RangeMap<T> {
    /// By first byte; a piece reaches to the next key.
    pieces: BTreeMap<u64, T>,
    end: u64,
}

impl<T: Clone> RangeMap<T> {
    /// Every byte has the same value.
    pub(crate) fn new(end: u64, value: T) -> Self {
        RangeMap { pieces: BTreeMap::from([(0, value)]), end }
    }

    /// Makes `at` the first byte of a piece.
    fn split(&mut self, at: u64) {
        if at >= self.end {
            return;
        }
        let (&start, value) = self.pieces.range(..=at).next_back().expect("invariant: byte 0 starts a piece");
        if start != at {
            let value = value.clone();
            self.pieces.insert(at, value);
        }
    }

    /// Changes the values of a range, piece by piece.
    pub(crate) fn update(&mut self, range: Range<u64>, mut change: impl FnMut(&mut T)) {
        if range.is_empty() {
            return;
        }
        self.split(range.start);
        self.split(range.end);
        self.pieces.range_mut(range).for_each(|(_, value)| change(value));
    }

    /// Gives a range one value, in one piece.
    pub(crate) fn set(&mut self, range: Range<u64>, value: T) {
        if range.is_empty() {
            return;
        }
        self.split(range.start);
        self.split(range.end);
        let inner: Vec<u64> = self.pieces.range(range.start + 1..range.end).map(|(&start, _)| start).collect();
        for start in inner {
            self.pieces.remove(&start);
        }
        self.pieces.insert(range.start, value);
    }

    /// Whether some byte of a range has a value such as this.
    pub(crate) fn any(&self, range: Range<u64>, mut like: impl FnMut(&T) -> bool) -> bool {
        if range.is_empty() {
            return false;
        }
        let first = self.pieces.range(..=range.start).next_back().expect("invariant: byte 0 starts a piece");
        like(first.1) || self.pieces.range(range.start + 1..range.end).any(|(_, value)| like(value))
    }
}

#[cfg(test)]
mod tests {
    use super::RangeMap;

    #[test]
    fn update_splits_only_where_the_range_ends() {
        let mut map = RangeMap::new(100, 0);
        map.update(10..20, |v| *v += 1);
        map.update(15..100, |v| *v += 2);
        let pieces: Vec<_> = map.pieces.iter().map(|(&k, &v)| (k, v)).collect();
        assert_eq!(pieces, [(0, 0), (10, 1), (15, 3), (20, 2)]);
    }

    #[test]
    fn any_sees_the_piece_that_the_range_begins_in() {
        let mut map = RangeMap::new(100, false);
        map.set(10..20, true);
        assert!(map.any(19..30, |&v| v));
        assert!(!map.any(20..30, |&v| v));
        assert!(!map.any(0..10, |&v| v));
        assert!(map.any(0..11, |&v| v));
        assert!(!map.any(15..15, |&v| v));
    }

    #[test]
    fn set_leaves_one_piece() {
        let mut map = RangeMap::new(100, 0);
        map.update(10..20, |v| *v = 5);
        map.set(5..50, 7);
        let pieces: Vec<_> = map.pieces.iter().map(|(&k, &v)| (k, v)).collect();
        assert_eq!(pieces, [(0, 0), (5, 7), (50, 0)]);
    }
}
