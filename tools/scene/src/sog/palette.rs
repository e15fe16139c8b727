//! Palette of harmonics: rows of numbers that represent many rows.
//!
//! Every row is its own entry where the palette holds them all. Otherwise a tree splits the cluster of the largest
//! squared error at the mean of its most varied number, until the palette is full.

use std::cmp::Ordering;
use std::collections::BinaryHeap;

/// Largest palette: labels have two bytes.
const MOST: usize = 65_536;

/// Entries and the entry of each row.
pub(super) struct Palette {
    /// Entries, one after another.
    pub(super) entries: Vec<f32>,
    /// Index of the entry of each row.
    pub(super) labels: Vec<u16>,
}

/// Cluster that can be split, and its error along the axis of the split.
struct Cluster {
    error: f64,
    axis: usize,
    middle: f32,
    /// Range of the row indices.
    rows: std::ops::Range<usize>,
}

impl Ord for Cluster {
    fn cmp(&self, other: &Cluster) -> Ordering {
        // The start decides between equal errors, so that the result is always the same.
        self.error.total_cmp(&other.error).then(other.rows.start.cmp(&self.rows.start))
    }
}

impl PartialOrd for Cluster {
    fn partial_cmp(&self, other: &Cluster) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl PartialEq for Cluster {
    fn eq(&self, other: &Cluster) -> bool {
        self.cmp(other) == Ordering::Equal
    }
}

impl Eq for Cluster {}

impl Palette {
    /// Finds the palette of rows of `wide` numbers.
    pub(super) fn of(rows: &[f32], wide: usize) -> Palette {
        Palette::with_size(rows, wide, MOST)
    }

    fn with_size(rows: &[f32], wide: usize, most: usize) -> Palette {
        let count = rows.len() / wide;
        if count <= most {
            return Palette { entries: rows.to_vec(), labels: (0..count).map(|i| i as u16).collect() };
        }
        let row = |i: u32| &rows[i as usize * wide..(i as usize + 1) * wide];
        let mut order: Vec<u32> = (0..count as u32).collect();
        let mut open = BinaryHeap::from([cluster(&order, 0..count, wide, &row)]);
        let mut closed = Vec::new();
        while open.len() + closed.len() < most
            && let Some(Cluster { error, axis, middle, rows }) = open.pop()
        {
            if error <= 0.0 {
                closed.push(rows);
                break;
            }
            let (start, end) = (rows.start, rows.end);
            let (low, high): (Vec<u32>, Vec<u32>) = order[rows].iter().partition(|i| row(**i)[axis] < middle);
            let border = start + low.len();
            order[start..border].copy_from_slice(&low);
            order[border..end].copy_from_slice(&high);
            for part in [start..border, border..end].into_iter().filter(|part| !part.is_empty()) {
                open.push(cluster(&order, part, wide, &row));
            }
        }
        closed.extend(open.into_iter().map(|cluster| cluster.rows));
        closed.sort_unstable_by_key(|rows| rows.start);
        let mut palette = Palette { entries: Vec::with_capacity(closed.len() * wide), labels: vec![0; count] };
        for (label, range) in closed.into_iter().enumerate() {
            let mut mean = vec![0.0_f64; wide];
            let members = &order[range];
            for i in members {
                palette.labels[*i as usize] = label as u16;
                mean.iter_mut().zip(row(*i)).for_each(|(sum, v)| *sum += f64::from(*v));
            }
            palette.entries.extend(mean.iter().map(|sum| (sum / members.len() as f64) as f32));
        }
        palette
    }
}

/// Measures a cluster: the axis with the largest squared error, and its mean.
fn cluster<'a>(order: &[u32], rows: std::ops::Range<usize>, wide: usize, row: &impl Fn(u32) -> &'a [f32]) -> Cluster {
    let mut sums = vec![[0.0_f64; 2]; wide];
    for i in &order[rows.clone()] {
        sums.iter_mut().zip(row(*i)).for_each(|(sum, v)| {
            let v = f64::from(*v);
            *sum = [sum[0] + v, sum[1] + v * v];
        });
    }
    let count = rows.len() as f64;
    let error = |[sum, squares]: [f64; 2]| squares - sum * sum / count;
    let axis = (1..wide).fold(0, |best, k| if error(sums[k]) > error(sums[best]) { k } else { best });
    let middle = (sums[axis][0] / count) as f32;
    // Rounding must not leave all rows on one side.
    let splits = {
        let mut sides = order[rows.clone()].iter().map(|i| row(*i)[axis] < middle);
        let first = sides.next();
        sides.any(|side| Some(side) != first)
    };
    Cluster { error: if splits { error(sums[axis]) } else { 0.0 }, axis, middle, rows }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_of_few_kinds_are_exact() {
        let kinds = [[0.0, 1.0, 2.0], [5.0, -1.0, 0.5], [0.1, 1.0, 2.0]];
        let rows: Vec<f32> = (0..900).flat_map(|i| kinds[i % 3]).collect();
        let palette = Palette::with_size(&rows, 3, 8);
        assert_eq!(palette.entries.len(), 9);
        for (row, label) in rows.as_chunks::<3>().0.iter().zip(&palette.labels) {
            let entry = &palette.entries[usize::from(*label) * 3..][..3];
            assert!(row.iter().zip(entry).all(|(a, b)| (a - b).abs() < 1e-6), "{row:?} {entry:?}");
        }
    }

    #[test]
    fn error_falls_with_the_size() {
        let rows: Vec<f32> = (0..3000).map(|i| (i as f32 * 0.37).sin() * ((i % 3) as f32 + 0.2)).collect();
        let error = |size: usize| {
            let palette = Palette::with_size(&rows, 3, size);
            assert!(palette.entries.len() <= 3 * size && palette.labels.len() == 1000);
            let entry = |i: usize| palette.entries[usize::from(palette.labels[i / 3]) * 3 + i % 3];
            rows.iter().enumerate().map(|(i, v)| f64::from(v - entry(i)).powi(2)).sum::<f64>()
        };
        let errors = [1, 4, 16, 64, 256].map(error);
        assert!(errors.windows(2).all(|pair| pair[1] < 0.6 * pair[0]), "{errors:?}");
        assert_eq!(Palette::with_size(&rows, 3, 1000).entries, rows);
    }
}
