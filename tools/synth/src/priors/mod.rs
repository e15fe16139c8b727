//! Simulated predictions of pretrained networks, derived from ground truth.
//!
//! The errors resemble those of networks: blurred borders, biases per object, slow drifts over the image, shading that
//! leaks into albedo, and a little noise. Everything is a function of the view's film and of seeds.

pub(crate) mod maps;
pub(crate) mod masks;
pub(crate) mod semantic;
#[cfg(test)]
mod tests;

use glam::{Vec2, Vec3};

use crate::noise::fractal;
use crate::rng::Rng;

/// Slow drifts over an image, one value in (−1, 1) for each channel.
pub(crate) struct Drift {
    seed: u32,
    scale: f32,
}

impl Drift {
    /// Creates drifts with features about `size` of the image's width across.
    pub(crate) fn new(key: &[u64], width: usize, size: f32) -> Self {
        Self { seed: Rng::new(key).next_u32(), scale: 1.0 / (size * width as f32) }
    }

    /// Returns the drift at a pixel.
    pub(crate) fn at(&self, x: usize, y: usize) -> Vec3 {
        let p = Vec2::new(x as f32, y as f32) * self.scale;
        let channel = |salt: u32| 2.0 * fractal(p, 2, self.seed ^ salt) - 1.0;
        Vec3::new(channel(0x11), channel(0x222), channel(0x3333))
    }
}
