//! Counter-based random numbers of `random.glsl`. Integers match bit for bit. Tests use the generator, too.

/// Applies one round of PCG's 32-bit generator with its output permutation. O'Neill 2014; as a hash, Jarzynski and
/// Olano 2020.
pub fn pcg(x: u32) -> u32 {
    let state = x.wrapping_mul(747_796_405).wrapping_add(2_891_336_453);
    let word = ((state >> ((state >> 28) + 4)) ^ state).wrapping_mul(277_803_737);
    (word >> 22) ^ word
}

/// Returns 32 random bits for a seed and two counters.
pub fn random_bits(seed: u32, a: u32, b: u32) -> u32 {
    pcg(pcg(pcg(seed).wrapping_add(a)).wrapping_add(b))
}

/// Returns a uniform number in (0, 1), never 0 or 1.
pub fn uniform_from(bits: u32) -> f64 {
    (f64::from(bits >> 9) + 0.5) / 8_388_608.0
}

/// Returns two independent standard normal numbers (Box and Muller 1958).
pub fn normal_from(bits_a: u32, bits_b: u32) -> [f64; 2] {
    let radius = (-2.0 * uniform_from(bits_a).ln()).sqrt();
    let (sin, cos) = (std::f64::consts::TAU * uniform_from(bits_b)).sin_cos();
    [radius * cos, radius * sin]
}

/// Stream of random numbers.
#[derive(Clone, Debug)]
pub struct Pcg {
    seed: u32,
    count: u32,
}

impl Pcg {
    /// Creates the stream of a seed.
    pub fn new(seed: u32) -> Self {
        Pcg { seed, count: 0 }
    }

    /// Returns the next 32 bits.
    pub fn next_u32(&mut self) -> u32 {
        self.count = self.count.wrapping_add(1);
        random_bits(self.seed, self.count, 0)
    }

    /// Returns the next number in (0, 1).
    pub fn uniform(&mut self) -> f64 {
        uniform_from(self.next_u32())
    }

    /// Returns the next number between `low` and `high`.
    pub fn range(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.uniform()
    }

    /// Returns the next standard normal number.
    pub fn normal(&mut self) -> f64 {
        normal_from(self.next_u32(), self.next_u32())[0]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn moments_match_the_distributions() {
        let mut rng = Pcg::new(3);
        let n = 20_000;
        let uniform: Vec<f64> = (0..n).map(|_| rng.uniform()).collect();
        let normal: Vec<f64> = (0..n).map(|_| rng.normal()).collect();
        let mean = |v: &[f64]| v.iter().sum::<f64>() / f64::from(n);
        let square = |v: &[f64]| v.iter().map(|x| x * x).sum::<f64>() / f64::from(n);
        assert!((mean(&uniform) - 0.5).abs() < 0.01 && (square(&uniform) - 1.0 / 3.0).abs() < 0.01);
        assert!(mean(&normal).abs() < 0.03 && (square(&normal) - 1.0).abs() < 0.05);
        assert!(uniform.iter().all(|&u| u > 0.0 && u < 1.0));
    }
}
