//! Map from every byte of a range to a value, stored as maximal segments.
//!
//! The builder and the compiler use it for per-byte state. The verifier uses its own cells instead.

use std::collections::BTreeMap;
use std::ops::Range;

/// Total map from `0..end` to `T`.
#[derive(Clone, Debug)]
pub(crate) struct RangeMap<T> {
    /// By first byte; a segment reaches to the next key.
    segments: BTreeMap<u64, T>,
    end: u64,
}

impl<T: Clone> RangeMap<T> {
    /// Creates a map with the same value for every byte.
    pub(crate) fn new(end: u64, value: T) -> Self {
        RangeMap { segments: BTreeMap::from([(0, value)]), end }
    }

    /// Splits the segment that contains `at`, so that one begins there.
    fn split(&mut self, at: u64) {
        if at >= self.end {
            return;
        }
        let (&start, value) = self.segments.range(..=at).next_back().expect("invariant: byte 0 starts a piece");
        if start != at {
            let value = value.clone();
            self.segments.insert(at, value);
        }
    }

    /// Changes the values of a range, segment by segment.
    pub(crate) fn update(&mut self, range: Range<u64>, mut change: impl FnMut(&mut T)) {
        if range.is_empty() {
            return;
        }
        self.split(range.start);
        self.split(range.end);
        self.segments.range_mut(range).for_each(|(_, value)| change(value));
    }

    /// Sets a range to one value, as one segment.
    pub(crate) fn set(&mut self, range: Range<u64>, value: T) {
        if range.is_empty() {
            return;
        }
        self.split(range.start);
        self.split(range.end);
        let inner: Vec<u64> = self.segments.range(range.start + 1..range.end).map(|(&start, _)| start).collect();
        for start in inner {
            self.segments.remove(&start);
        }
        self.segments.insert(range.start, value);
    }

    /// Returns whether any byte of a range has a value that satisfies `predicate`.
    pub(crate) fn any(&self, range: Range<u64>, mut predicate: impl FnMut(&T) -> bool) -> bool {
        if range.is_empty() {
            return false;
        }
        let first = self.segments.range(..=range.start).next_back().expect("invariant: byte 0 starts a piece");
        predicate(first.1) || self.segments.range(range.start + 1..range.end).any(|(_, value)| predicate(value))
    }
}

#[cfg(test)]
mod tests {
    use super::RangeMap;

    #[test]
    fn update_splits_only_at_range_ends() {
        let mut map = RangeMap::new(100, 0);
        map.update(10..20, |v| *v += 1);
        map.update(15..100, |v| *v += 2);
        let segments: Vec<_> = map.segments.iter().map(|(&k, &v)| (k, v)).collect();
        assert_eq!(segments, [(0, 0), (10, 1), (15, 3), (20, 2)]);
    }

    #[test]
    fn any_includes_segment_at_range_start() {
        let mut map = RangeMap::new(100, false);
        map.set(10..20, true);
        assert!(map.any(19..30, |&v| v));
        assert!(!map.any(20..30, |&v| v));
        assert!(!map.any(0..10, |&v| v));
        assert!(map.any(0..11, |&v| v));
        assert!(!map.any(15..15, |&v| v));
    }

    #[test]
    fn set_leaves_one_segment() {
        let mut map = RangeMap::new(100, 0);
        map.update(10..20, |v| *v = 5);
        map.set(5..50, 7);
        let segments: Vec<_> = map.segments.iter().map(|(&k, &v)| (k, v)).collect();
        assert_eq!(segments, [(0, 0), (5, 7), (50, 0)]);
    }
}
