//! Counter-based random numbers, a function of a key and a counter alone.
//!
//! Every consumer derives its key from the run's seed and from its work item (a view, a pixel, a piece of furniture).
//! Results therefore do not depend on the order of threads.

use glam::Vec3;

/// Scrambles 64 bits so that neighboring inputs give unrelated outputs.
pub(crate) fn mix64(mut x: u64) -> u64 {
    x ^= x >> 31;
    x = x.wrapping_mul(0x9fb2_1c65_1e98_df25);
    x ^= x >> 29;
    x = x.wrapping_mul(0xd6e8_feb8_6659_fd93);
    x ^ (x >> 32)
}

/// Scrambles 32 bits like [`mix64`].
pub(crate) fn mix32(mut x: u32) -> u32 {
    x ^= x >> 16;
    x = x.wrapping_mul(0x7feb_352d);
    x ^= x >> 15;
    x = x.wrapping_mul(0x846c_a68b);
    x ^ (x >> 16)
}

/// Hashes words into one key.
pub(crate) fn key(words: &[u64]) -> u64 {
    words.iter().fold(0x243f_6a88_85a3_08d3, |acc, word| {
        mix64(acc.rotate_left(23).wrapping_add(mix64(word.wrapping_add(0x1319_8a2e_0370_7344))))
    })
}

/// Hashes a text into a number that is the same on every machine.
pub(crate) fn text_key(text: &str) -> u64 {
    text.bytes().fold(0x9ae1_6a3b_2f90_404f, |acc, b| mix64(acc ^ u64::from(b)))
}

/// Stream of random numbers. The n-th number is a function of the key and n.
#[derive(Debug, Clone)]
pub(crate) struct Rng {
    key: u64,
    counter: u64,
}

impl Rng {
    /// Creates a stream keyed by the given words.
    pub(crate) fn new(words: &[u64]) -> Self {
        Self { key: key(words), counter: 0 }
    }

    /// Returns the next 32 bits.
    pub(crate) fn next_u32(&mut self) -> u32 {
        self.counter += 1;
        (mix64(self.key.wrapping_add(self.counter.wrapping_mul(0x9e37_79b9_7f4a_7c15))) >> 32) as u32
    }

    /// Returns a uniform number in [0, 1).
    pub(crate) fn uniform(&mut self) -> f32 {
        unit(self.next_u32())
    }

    /// Returns a uniform number in [low, high).
    pub(crate) fn range(&mut self, low: f32, high: f32) -> f32 {
        low + (high - low) * self.uniform()
    }

    /// Returns a uniform index below `count`, which must not be zero.
    pub(crate) fn index(&mut self, count: usize) -> usize {
        ((u64::from(self.next_u32()) * count as u64) >> 32) as usize
    }

    /// Returns true with the given probability.
    pub(crate) fn chance(&mut self, probability: f32) -> bool {
        self.uniform() < probability
    }

    /// Returns a random item of a slice, which must not be empty.
    pub(crate) fn pick<'a, T>(&mut self, items: &'a [T]) -> &'a T {
        &items[self.index(items.len())]
    }

    /// Returns a standard normal number.
    pub(crate) fn normal(&mut self) -> f32 {
        let radius = (-2.0 * (1.0 - self.uniform()).ln()).sqrt();
        radius * (std::f32::consts::TAU * self.uniform()).cos()
    }

    /// Returns three independent standard normal numbers.
    pub(crate) fn normal3(&mut self) -> Vec3 {
        Vec3::new(self.normal(), self.normal(), self.normal())
    }
}

/// Maps 32 bits onto [0, 1); never returns 1.
pub(crate) fn unit(bits: u32) -> f32 {
    (bits >> 8) as f32 * (1.0 / 16_777_216.0)
}
