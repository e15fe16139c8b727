//! Codebooks: 256 numbers that represent many, by k-means in one dimension.

use super::CODES;

/// Most iterations of k-means.
const ITERATIONS: usize = 30;
/// Bins of the histogram that places the first centers.
const BINS: usize = 4096;

/// Numbers of a codebook, in ascending order.
pub(super) struct Codebook(pub(super) Vec<f32>);

impl Codebook {
    /// Finds the codebook of finite values. It has 256 numbers and does not depend on the order of the values.
    pub(super) fn of(values: impl Iterator<Item = f32>) -> Codebook {
        let mut sorted: Vec<f32> = values.collect();
        sorted.sort_unstable_by(f32::total_cmp);
        let mut distinct = sorted.clone();
        distinct.dedup();
        if distinct.len() <= CODES {
            distinct.resize(CODES, distinct.last().copied().unwrap_or(0.0));
            return Codebook(distinct);
        }
        let mut sums = Vec::with_capacity(sorted.len() + 1);
        sums.push(0.0_f64);
        sorted.iter().for_each(|v| sums.push(sums[sums.len() - 1] + f64::from(*v)));
        let mut centers = spread(&sorted);
        for _ in 0..ITERATIONS {
            let mut start = 0;
            let mut moved = false;
            for i in 0..CODES {
                let end = match centers.get(i + 1) {
                    Some(next) => {
                        let border = 0.5 * (centers[i] + next);
                        start + sorted[start..].partition_point(|v| *v < border)
                    }
                    None => sorted.len(),
                };
                if end > start {
                    let mean = ((sums[end] - sums[start]) / (end - start) as f64) as f32;
                    moved |= mean != centers[i];
                    centers[i] = mean;
                }
                start = end;
            }
            centers.sort_unstable_by(f32::total_cmp);
            if !moved {
                break;
            }
        }
        Codebook(centers)
    }

    /// Returns the index of the number closest to a value.
    pub(super) fn index(&self, value: f32) -> u8 {
        let above = self.0.partition_point(|c| *c < value).min(CODES - 1);
        let below = above.saturating_sub(1);
        let closer = (value - self.0[below]).abs() <= (self.0[above] - value).abs();
        if closer { below as u8 } else { above as u8 }
    }
}

/// Places the first centers: their density is the cube root of that of the values, which is best for many centers.
fn spread(sorted: &[f32]) -> Vec<f32> {
    let (low, high) = (f64::from(sorted[0]), f64::from(sorted[sorted.len() - 1]));
    let mut counts = vec![0.0_f64; BINS];
    for v in sorted {
        let at = (f64::from(*v) - low) / (high - low) * BINS as f64;
        counts[(at as usize).min(BINS - 1)] += 1.0;
    }
    let total: f64 = counts.iter().map(|c| c.cbrt()).sum();
    let (mut bin, mut below) = (0, 0.0);
    let mut centers = Vec::with_capacity(CODES);
    for i in 0..CODES {
        let target = (i as f64 + 0.5) / CODES as f64 * total;
        while bin + 1 < BINS && below + counts[bin].cbrt() < target {
            below += counts[bin].cbrt();
            bin += 1;
        }
        let within = ((target - below) / counts[bin].cbrt().max(f64::MIN_POSITIVE)).clamp(0.0, 1.0);
        centers.push((low + (high - low) * (bin as f64 + within) / BINS as f64) as f32);
    }
    centers
}

#[cfg(test)]
mod tests {
    use super::*;

    fn error(book: &Codebook, values: &[f32]) -> f64 {
        let square = |v: &f32| f64::from(book.0[usize::from(book.index(*v))] - v).powi(2);
        (values.iter().map(square).sum::<f64>() / values.len() as f64).sqrt()
    }

    #[test]
    fn few_values_are_exact() {
        let values = [0.5, -2.0, 7.0, 0.5];
        let book = Codebook::of(values.into_iter());
        assert_eq!(book.0.len(), CODES);
        values.iter().for_each(|v| assert_eq!(book.0[usize::from(book.index(*v))], *v));
        assert_eq!(Codebook::of(std::iter::empty()).0, [0.0; CODES]);
    }

    #[test]
    fn codebook_is_better_than_even_steps_and_ignores_order() {
        let values: Vec<f32> = (0..20_000).map(|i| ((i as f32 * 0.7).sin() * 2.0).powi(3)).collect();
        let book = Codebook::of(values.iter().copied());
        let even = Codebook((0..CODES).map(|i| -8.0 + 16.0 * i as f32 / 255.0).collect());
        let [found, steps] = [error(&book, &values), error(&even, &values)];
        // The best codebook has 0.870 of the error of even steps.
        assert!(found < 0.875 * steps, "{found} {steps}");
        let again = Codebook::of(values.iter().rev().copied());
        assert_eq!(book.0, again.0);
    }
}
