//! k-d tree of points in six dimensions, for nearest neighbors.

/// Point in six dimensions.
pub(super) type Key = [f32; 6];

/// Neighbor of a point that has fewer.
pub const NO_NEIGHBOR: u32 = u32::MAX;
/// Points of a leaf.
const LEAF: usize = 8;

/// k-d tree: points in the order of an implicit, balanced tree.
pub(super) struct Tree {
    keys: Vec<Key>,
    /// Numbers of the points in the caller's order.
    numbers: Vec<u32>,
    /// Axis and position of the split of each inner node, by the middle of its range.
    splits: Vec<(u8, f32)>,
}

impl Tree {
    /// Builds the tree of all finite points.
    pub fn new(points: Vec<Key>) -> Tree {
        let finite = |k: &Key| k.iter().all(|x| x.is_finite());
        let mut order: Vec<u32> = (0..points.len() as u32).filter(|&i| finite(&points[i as usize])).collect();
        let mut splits = vec![(0, 0.0); order.len()];
        split(&points, &mut order, &mut splits);
        Tree { keys: order.iter().map(|&i| points[i as usize]).collect(), numbers: order, splits }
    }

    /// Returns the nearest points: squares of distances and numbers.
    ///
    /// The nearest is first. Of points at equal distance, those with the lowest numbers count. Missing ones are infinitely far.
    pub fn nearest<const N: usize>(&self, key: &Key) -> [(f32, u32); N] {
        let mut best = [(f32::INFINITY, NO_NEIGHBOR); N];
        if key.iter().all(|x| x.is_finite()) {
            self.visit(key, 0, self.keys.len(), &mut best);
        }
        best
    }

    fn visit<const N: usize>(&self, key: &Key, begin: usize, end: usize, best: &mut [(f32, u32); N]) {
        if end - begin <= LEAF {
            for at in begin..end {
                let square = self.keys[at].iter().zip(key).map(|(a, b)| (a - b) * (a - b)).sum::<f32>();
                let mut found = (square, self.numbers[at]);
                for slot in best.iter_mut().filter(|slot| slot.0 >= square) {
                    if found.0 < slot.0 || found.0 == slot.0 && found.1 < slot.1 {
                        std::mem::swap(slot, &mut found);
                    }
                }
            }
            return;
        }
        let middle = (begin + end) / 2;
        let (axis, at) = self.splits[middle];
        let apart = key[usize::from(axis)] - at;
        let sides = [(begin, middle), (middle, end)];
        let near = usize::from(apart >= 0.0);
        self.visit(key, sides[near].0, sides[near].1, best);
        // A point behind the split may be as near as the farthest one found, with a lower number.
        if apart * apart <= best[N - 1].0 {
            self.visit(key, sides[1 - near].0, sides[1 - near].1, best);
        }
    }
}

/// Orders points around the median of their widest axis, and both halves in turn.
fn split(points: &[Key], order: &mut [u32], splits: &mut [(u8, f32)]) {
    if order.len() <= LEAF {
        return;
    }
    let value = |i: u32, axis: usize| points[i as usize][axis];
    let width = |axis: usize| {
        let (mut low, mut high) = (f32::INFINITY, f32::NEG_INFINITY);
        for &i in order.iter() {
            (low, high) = (low.min(value(i, axis)), high.max(value(i, axis)));
        }
        high - low
    };
    let axis = (0..6).max_by(|&a, &b| width(a).total_cmp(&width(b))).unwrap_or(0);
    let middle = order.len() / 2;
    order.select_nth_unstable_by(middle, |&a, &b| value(a, axis).total_cmp(&value(b, axis)).then(a.cmp(&b)));
    splits[middle] = (axis as u8, value(order[middle], axis));
    let ((low, high), (low_splits, high_splits)) = (order.split_at_mut(middle), splits.split_at_mut(middle));
    split(points, low, low_splits);
    // The first of the upper half keeps this split: an upper half that is split again has its middle after it.
    split(points, high, high_splits);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::Pcg;

    #[test]
    fn nearest_points_match_a_search_of_all() {
        let mut rng = Pcg::new(3);
        // A coarse lattice has many points at equal distance.
        for (count, scale) in [(0, 1.0), (1, 1.0), (7, 1.0), (9, 1.0), (500, 3.0), (500, 1e6)] {
            let mut draw = || -> Key { [0; 6].map(|_| (rng.range(-scale, scale)).round() as f32) };
            let points: Vec<Key> = (0..count).map(|_| draw()).collect();
            let queries: Vec<Key> = (0..40).map(|_| draw()).collect();
            let tree = Tree::new(points.clone());
            for q in &queries {
                let mut all: Vec<(f32, u32)> = (0..count as u32)
                    .map(|i| (points[i as usize].iter().zip(q).map(|(a, b)| (a - b) * (a - b)).sum(), i))
                    .collect();
                all.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
                all.resize(all.len().max(8), (f32::INFINITY, NO_NEIGHBOR));
                assert_eq!(tree.nearest::<8>(q)[..], all[..8]);
            }
        }
    }

    #[test]
    fn points_that_are_not_finite_are_no_neighbors() {
        let tree = Tree::new(vec![[f32::NAN; 6], [0.0; 6], [f32::INFINITY; 6]]);
        assert_eq!(tree.nearest::<2>(&[1.0; 6]), [(6.0, 1), (f32::INFINITY, NO_NEIGHBOR)]);
        assert_eq!(tree.nearest::<1>(&[f32::NAN; 6]), [(f32::INFINITY, NO_NEIGHBOR)]);
    }
}
