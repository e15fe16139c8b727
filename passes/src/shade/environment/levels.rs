//! Prefiltered levels of an environment map: roughness, resolution and lobe reach.
//!
//! Roughness goes from 0.08 to 0.5 in even steps and then to 1, as in the published method. There are five levels (six
//! for 512 texels a side). In the published method the number of levels depends on the resolution. Here small cubes
//! have as many levels, so that the steps between them stay small.
//!
//! Resolution: a level is as fine as its lobe requires, with 1.25 texels to the angle where the lobe has fallen to
//! half, and never finer than the cube. A level is filtered from the cube's mip of the same resolution. The published
//! method halves the resolution from level to level. This gives the lobe of roughness 0.22 four times the texels along
//! a side, and 256 times the products.
//!
//! Reach: the cone holds 99 % of the lobe's light. The published rule, 99 % of the sum of D over evenly spaced angles,
//! cuts off a quarter of the light of the sharpest lobe. Where 99 % would exceed the limit on products, the cone
//! shrinks to that limit, but never below five texels. [`Level::share`] is the share that the cone then holds. The lobe
//! fades out over the last quarter of its squared reach, so that rounding does not decide whether a texel counts.
//!
//! The last level is a lobe of roughness 1, which is the cosine. It is therefore also the diffuse irradiance over pi.

use std::f64::consts::FRAC_PI_2;

/// Default limit on the products of a level.
pub const PRODUCTS: u64 = 1 << 23;
/// Share of a lobe's light that its cone holds, if affordable.
const SHARE: f64 = 0.99;
/// Minimum reach of a cone in texels.
const LEAST: f64 = 5.0;

/// One prefiltered level.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Level {
    /// Texels along a side.
    pub size: u32,
    /// Index of the level's first texel in the buffer of all levels.
    pub first: u32,
    /// Roughness that the level is filtered for.
    pub roughness: f64,
    /// Squared distance between unit vectors up to which texels count.
    pub cutoff: f64,
    /// Share of the lobe's light within the cutoff.
    pub share: f64,
}

impl Level {
    /// Returns GGX's alpha, the square of the roughness.
    pub fn alpha(&self) -> f64 {
        self.roughness * self.roughness
    }

    /// Returns the weight of a texel at squared distance `e`. The weight is n.l D(h) for a view along the normal, over
    /// its value at 0, faded out towards the cutoff.
    pub fn weight(&self, e: f64) -> f64 {
        let q = 1.0 + self.steep() * e;
        (1.0 - 0.5 * e) * ((self.cutoff - e) * self.fade()).clamp(0.0, 1.0) / (q * q)
    }

    /// Returns the steepness of the lobe. The lobe is `(1 - e/2) / (1 + steep e)^2`: alpha^2 (h.n)^2 + |h x n|^2, over
    /// alpha^2, with h the half vector.
    pub fn steep(&self) -> f64 {
        let square = self.alpha() * self.alpha();
        (1.0 - square) / (4.0 * square)
    }

    /// Returns the slope of the fade; a hemisphere needs no fade.
    pub fn fade(&self) -> f64 {
        if self.cutoff >= 2.0 { 1e6 } else { 4.0 / self.cutoff }
    }

    /// Returns the angle of the cutoff in radians.
    pub fn reach(&self) -> f64 {
        2.0 * (0.5 * self.cutoff.sqrt()).asin()
    }

    /// Returns the number of texels of the level.
    pub fn texels(&self) -> u32 {
        6 * self.size * self.size
    }
}

/// Returns the levels of a cube of `size` texels a side.
pub fn levels(size: u32, products: u64) -> Vec<Level> {
    let count: u32 = if size > 256 { 6 } else { 5 };
    let mut first = 0;
    let mut made = Vec::new();
    for i in 0..count {
        let roughness = if i + 1 == count { 1.0 } else { 0.08 + 0.42 * f64::from(i) / f64::from(count - 2) };
        let level = level(size, first, roughness, products);
        first += level.texels();
        made.push(level);
    }
    made
}

fn level(cube: u32, first: u32, roughness: f64, products: u64) -> Level {
    let alpha = roughness * roughness;
    // (alpha^2 + h^2)^2 is twice alpha^4 at h = 0.6436 alpha; the lobe's own angle is twice that.
    let half = 2.0 * 0.6436 * alpha;
    let needed = (1.25 * FRAC_PI_2 / half).ceil() as u32;
    let size = needed.next_power_of_two().max(16).min(cube);
    let texels = f64::from(6 * size * size);
    // The cap with cutoff e covers e / 4 of the sphere.
    let affordable = 4.0 * products as f64 / (texels * texels);
    let least = (LEAST * FRAC_PI_2 / f64::from(size)).powi(2);
    let wanted = if roughness >= 1.0 { 2.0 } else { reaching(alpha, SHARE) };
    let cutoff = wanted.min(affordable.max(least)).min(2.0);
    Level { size, first, roughness, cutoff, share: share(alpha, cutoff) }
}

/// Returns the share of a lobe's light within squared distance `e`.
fn share(alpha: f64, e: f64) -> f64 {
    let square = alpha * alpha;
    let c = (1.0 - square) / 4.0;
    if c < 1e-9 {
        return e - 0.25 * e * e;
    }
    // The integral of (1 - e/2) / (alpha^2 + c e)^2, with t = alpha^2 + c e.
    let to = |e: f64| {
        let t = square + c * e;
        -(1.0 + square / (2.0 * c)) / t - t.ln() / (2.0 * c)
    };
    (to(e) - to(0.0)) / (to(2.0) - to(0.0))
}

/// Returns the squared distance that holds the share `wanted`, by bisection.
fn reaching(alpha: f64, wanted: f64) -> f64 {
    let (mut low, mut high) = (0.0, 2.0);
    for _ in 0..60 {
        let e = 0.5 * (low + high);
        if share(alpha, e) < wanted { low = e } else { high = e }
    }
    high
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shares_match_the_integrated_lobe() {
        for roughness in [0.08, 0.22, 0.5, 0.9, 1.0] {
            let alpha: f64 = roughness * roughness;
            let lobe = |angle: f64| {
                let (c, s) = ((0.5 * angle).cos(), (0.5 * angle).sin());
                angle.cos() * angle.sin() / (alpha * alpha * c * c + s * s).powi(2)
            };
            let sum = |to: f64| {
                let n = 200_000;
                (0..n).map(|i| lobe(to * (f64::from(i) + 0.5) / f64::from(n))).sum::<f64>() * to / f64::from(n)
            };
            for angle in [0.02, 0.3, 1.2_f64] {
                let e = 2.0 - 2.0 * angle.cos();
                let expected = sum(angle) / sum(FRAC_PI_2);
                assert!((share(alpha, e) - expected).abs() < 1e-3, "{roughness} {angle}");
            }
        }
    }

    #[test]
    fn levels_have_the_documented_sizes() {
        for size in [16, 32, 64, 128, 256, 512] {
            let all = levels(size, PRODUCTS);
            assert_eq!(all[0].size, size.min(256));
            assert_eq!((all[0].roughness, all.last().unwrap().roughness), (0.08, 1.0));
            assert_eq!((all.last().unwrap().size, all.last().unwrap().cutoff), (16, 2.0));
            assert!((all[all.len() - 2].roughness - 0.5).abs() < 1e-12);
            let mut texels = 0;
            for l in &all {
                assert_eq!(l.first, texels);
                texels += l.texels();
                assert!(l.share <= 0.9901 || l.roughness == 1.0);
                assert!(l.share > 0.84, "{l:?}");
            }
        }
        // A higher limit on products lets the cone hold its full share.
        assert!(levels(256, 1 << 30)[0].share > 0.9899);
    }
}
