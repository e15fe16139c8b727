//! Distances between neighboring points.

use rayon::prelude::*;

/// Number of neighbors in the mean, plus the point itself.
const QUERY: usize = 4;

/// Returns the mean squared distance of each point to its three nearest neighbors. With fewer neighbors, the mean is
/// over those; a single point has 0. Duplicates are neighbors at distance 0.
pub(crate) fn mean_square_distances(points: &[[f32; 3]]) -> Vec<f32> {
    if points.len() < 2 {
        return vec![0.0; points.len()];
    }
    // Double precision: with large coordinates, single precision loses the distance.
    let points: Vec<[f64; 3]> = points.iter().map(|p| p.map(f64::from)).collect();
    let mut tree = points.clone();
    let mut axes = vec![0; points.len()];
    arrange(&mut tree, &mut axes);
    // The nearest result is the point itself, or a duplicate at the same distance.
    let neighbors = points.len().min(QUERY) - 1;
    points
        .par_iter()
        .map(|point| {
            let mut nearest = [f64::INFINITY; QUERY];
            search(&tree, &axes, point, &mut nearest);
            (nearest[..=neighbors].iter().sum::<f64>() / neighbors as f64) as f32
        })
        .collect()
}

/// Arranges the points in place as a k-d tree. The middle point splits the others along the longest axis of their
/// bounding box.
fn arrange(points: &mut [[f64; 3]], axes: &mut [u8]) {
    if points.len() < 2 {
        return;
    }
    let extent = |k: usize| {
        let (low, high) =
            points.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), p| (l.min(p[k]), h.max(p[k])));
        high - low
    };
    let axis = (0..3).max_by(|a, b| extent(*a).total_cmp(&extent(*b))).unwrap_or(0);
    let middle = points.len() / 2;
    points.select_nth_unstable_by(middle, |a, b| a[axis].total_cmp(&b[axis]));
    axes[middle] = axis as u8;
    let (low, rest) = points.split_at_mut(middle);
    let (low_axes, rest_axes) = axes.split_at_mut(middle);
    rayon::join(|| arrange(low, low_axes), || arrange(&mut rest[1..], &mut rest_axes[1..]));
}

/// Inserts the smallest squared distances to points of the tree into `nearest`. `nearest` stays in ascending order.
fn search(tree: &[[f64; 3]], axes: &[u8], point: &[f64; 3], nearest: &mut [f64; QUERY]) {
    if tree.is_empty() {
        return;
    }
    let middle = tree.len() / 2;
    let distance: f64 = (0..3).map(|k| (tree[middle][k] - point[k]).powi(2)).sum();
    if distance < nearest[QUERY - 1] {
        nearest[QUERY - 1] = distance;
        nearest.sort_by(f64::total_cmp);
    }
    let axis = axes[middle] as usize;
    let side = point[axis] - tree[middle][axis];
    let (low, high) = ((&tree[..middle], &axes[..middle]), (&tree[middle + 1..], &axes[middle + 1..]));
    let (near, far) = if side < 0.0 { (low, high) } else { (high, low) };
    search(near.0, near.1, point, nearest);
    if side * side < nearest[QUERY - 1] {
        search(far.0, far.1, point, nearest);
    }
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
    fn distances_match_brute_force() {
        let mut random = Pcg::new(3);
        let cloud: Vec<[f32; 3]> = (0..700).map(|_| [(); 3].map(|()| random.next_f32() * 4.0 - 1.0)).collect();
        check(&cloud);
        for n in 1..=6 {
            check(&cloud[..n]);
        }
    }

    #[test]
    fn planar_lattice_and_duplicate_points_match_brute_force() {
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
    fn distances_are_accurate_far_from_the_origin() {
        check(&[[1e6, 0.0, 0.0], [1e6 + 1.0, 0.0, 0.0], [1e6, 2.0, 0.0], [1e6, 0.0, 3.0]]);
        assert!(mean_square_distances(&[[3e38; 3], [-3e38; 3]])[0].is_infinite());
        assert!(mean_square_distances(&[]).is_empty());
    }
}
