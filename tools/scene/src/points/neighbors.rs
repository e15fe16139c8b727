//! How far apart points are.

use std::num::NonZero;

use kiddo::{ImmutableKdTree, SquaredEuclidean};
use rayon::prelude::*;

/// Neighbors that the mean is taken over, and the point itself.
const QUERY: NonZero<usize> = NonZero::new(4).unwrap();

/// For each point the mean squared distance to its three nearest neighbors; to fewer where there are fewer, and 0 for a
/// single point. Duplicates are neighbors at distance 0.
pub(crate) fn mean_square_distances(points: &[[f32; 3]]) -> Vec<f32> {
    if points.len() < 2 {
        return vec![0.0; points.len()];
    }
    // In double precision, because the squares of far coordinates leave nothing of the distance in single precision.
    let points: Vec<[f64; 3]> = points.iter().map(|p| p.map(f64::from)).collect();
    let tree: ImmutableKdTree<f64, 3> = ImmutableKdTree::new_from_slice(&points);
    points
        .par_iter()
        .map(|point| {
            let nearest = tree.nearest_n::<SquaredEuclidean>(point, QUERY);
            // One of them is the point itself, or a duplicate of it that is as far away.
            let neighbors = nearest.len().saturating_sub(1).max(1);
            let sum: f64 = nearest.iter().map(|n| n.distance).sum();
            (sum / neighbors as f64) as f32
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::points::Pcg;

    fn brute_force(points: &[[f32; 3]]) -> Vec<f32> {
        let square =
            |a: &[f32; 3], b: &[f32; 3]| -> f64 { (0..3).map(|k| (f64::from(a[k]) - f64::from(b[k])).powi(2)).sum() };
        let mean = |i: usize| {
            let others = points.iter().enumerate().filter(|(j, _)| *j != i);
            let mut distances: Vec<f64> = others.map(|(_, p)| square(p, &points[i])).collect();
            distances.sort_by(f64::total_cmp);
            distances.truncate(3);
            (distances.iter().sum::<f64>() / distances.len().max(1) as f64) as f32
        };
        (0..points.len()).map(mean).collect()
    }

    fn check(points: &[[f32; 3]]) {
        for (found, expected) in mean_square_distances(points).iter().zip(brute_force(points)) {
            assert!((found - expected).abs() <= 1e-6 * expected, "{found} {expected}");
        }
    }

    #[test]
    fn agrees_with_brute_force() {
        let mut random = Pcg::new(3);
        let cloud: Vec<[f32; 3]> = (0..700).map(|_| [(); 3].map(|()| random.next_f32() * 4.0 - 1.0)).collect();
        check(&cloud);
        for n in 1..=6 {
            check(&cloud[..n]);
        }
    }

    #[test]
    fn walls_lattices_and_duplicates_are_handled() {
        let mut random = Pcg::new(4);
        check(&(0..600).map(|_| [1.0, random.next_f32(), 2.0]).collect::<Vec<_>>());
        check(&(0..900).map(|i| [(i % 10) as f32, (i / 10 % 9) as f32, (i / 90) as f32]).collect::<Vec<_>>());
        check(&[[0.5; 3]; 500]);
        let mut mostly = vec![[0.25, -0.5, 1.0]; 400];
        mostly.extend((0..100).map(|_| [(); 3].map(|()| random.next_f32())));
        check(&mostly);
        assert_eq!(mean_square_distances(&vec![[7.0; 3]; 5000]), vec![0.0; 5000]);
    }

    #[test]
    fn far_from_the_origin() {
        check(&[[1e6, 0.0, 0.0], [1e6 + 1.0, 0.0, 0.0], [1e6, 2.0, 0.0], [1e6, 0.0, 3.0]]);
        assert!(mean_square_distances(&[[3e38; 3], [-3e38; 3]])[0].is_infinite());
        assert!(mean_square_distances(&[]).is_empty());
    }
}
