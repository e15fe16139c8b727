//! Sobol pairs, scrambled and shuffled by hashes of pixel and dimension.
//!
//! Each two-dimensional decision of a path gets its own pair. Over a pixel's samples, every pair covers the unit square
//! evenly. The points are a function of (key, sample, dimension) alone.

use glam::Vec2;

use crate::rng::{mix32, unit};

/// Number of decisions with Sobol points.
///
/// Later decisions gain little from even coverage and get cheaper independent points.
const WELL_DISTRIBUTED: u32 = 10;

/// Points of one sample of one pixel.
#[derive(Debug, Clone)]
pub(crate) struct Sampler {
    key: u32,
    index: u32,
    dimension: u32,
}

impl Sampler {
    /// Creates the points of sample `index` under a pixel's key.
    pub(crate) fn new(key: u64, index: u32) -> Self {
        Self { key: (key ^ (key >> 32)) as u32, index, dimension: 0 }
    }

    /// Returns the next point of the unit square.
    pub(crate) fn pair(&mut self) -> Vec2 {
        self.dimension += 1;
        let seed = mix32(self.key ^ self.dimension.wrapping_mul(0x9e37_79b9));
        if self.dimension > WELL_DISTRIBUTED {
            let x = mix32(seed ^ self.index.wrapping_mul(0x85eb_ca6b));
            return Vec2::new(unit(x), unit(mix32(x ^ 0x27d4_eb2f)));
        }
        // Only the low bits of the shuffled index matter: the high bits are equal for all samples of a pixel.
        let index = scramble(self.index.reverse_bits(), seed).reverse_bits() & 0x3_ffff;
        let x = scramble(index, mix32(seed ^ 0x68bc_21eb));
        let y = scramble(second(index), mix32(seed ^ 0x02e5_be93));
        Vec2::new(unit(x.reverse_bits()), unit(y.reverse_bits()))
    }

    /// Returns the next number in [0, 1).
    pub(crate) fn single(&mut self) -> f32 {
        self.pair().x
    }
}

/// Returns the second Sobol dimension of an index, bit-reversed like the index.
///
/// The reversed index itself is the first dimension.
fn second(mut index: u32) -> u32 {
    let mut column = 1u32;
    let mut result = 0;
    while index != 0 {
        if index & 1 == 1 {
            result ^= column;
        }
        index >>= 1;
        // Columns are rows of Pascal's triangle modulo two; in reversed bits the step is a carryless multiplication by
        // three.
        column ^= column << 1;
    }
    result
}

/// Applies a nested uniform scramble to a bit-reversed fraction.
///
/// Each bit is flipped depending on the bits below it. Every step carries information only from lower to higher bits,
/// which preserves the distribution of the points.
fn scramble(mut x: u32, seed: u32) -> u32 {
    x = x.wrapping_add(seed);
    x ^= x.wrapping_mul(0x5a7b_e3d4);
    x = x.wrapping_mul(mix32(seed) | 1);
    x ^= x.wrapping_mul(0x91c6_f2ea);
    x = x.wrapping_add(seed >> 13);
    x ^= x.wrapping_mul(0x2f4d_8b96);
    x
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pairs_are_stratified_in_every_dimension() {
        for key in [3u64, 0x1234_5678_9abc] {
            for dimension in 0..6 {
                let points: Vec<Vec2> = (0..64)
                    .map(|i| {
                        let mut sampler = Sampler::new(key, i);
                        (0..dimension).for_each(|_| {
                            sampler.pair();
                        });
                        sampler.pair()
                    })
                    .collect();
                // 64 points: every elementary interval of area 1/64 holds exactly one.
                for bits in 0..=6 {
                    let (nx, ny) = (1u32 << bits, 64u32 >> bits);
                    let mut seen = vec![0; 64];
                    for p in &points {
                        let (x, y) = ((p.x * nx as f32) as u32, (p.y * ny as f32) as u32);
                        seen[(y * nx + x) as usize] += 1;
                    }
                    assert!(seen.iter().all(|c| *c == 1), "dimension {dimension}, {nx}×{ny}");
                }
            }
        }
    }

    #[test]
    fn dimensions_are_uncorrelated() {
        let mut sum = 0.0;
        for i in 0..1024 {
            let mut sampler = Sampler::new(99, i);
            let (a, b) = (sampler.pair(), sampler.pair());
            sum += (a.x - 0.5) * (b.x - 0.5);
        }
        assert!((sum / 1024.0).abs() < 0.01, "{}", sum / 1024.0);
    }
}
