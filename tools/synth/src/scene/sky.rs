//! Environment outside the windows: sky, horizon, ground and a soft sun.

use glam::Vec3;

use crate::noise::smoothstep;

/// Radiance by direction, smooth enough to need no importance sampling.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Sky {
    /// Radiance straight up.
    pub(crate) zenith: Vec3,
    /// Radiance at the horizon.
    pub(crate) horizon: Vec3,
    /// Radiance below the horizon.
    pub(crate) ground: Vec3,
    /// Radiance added around the sun.
    pub(crate) sun: Vec3,
    /// Unit direction of the sun.
    pub(crate) sun_direction: Vec3,
}

/// Directional light.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Sun {
    /// Unit direction to the sun.
    pub(crate) toward: Vec3,
    /// Irradiance of a surface that faces it.
    pub(crate) irradiance: Vec3,
}

impl Sky {
    /// Black environment.
    pub(crate) const DARK: Self =
        Self { zenith: Vec3::ZERO, horizon: Vec3::ZERO, ground: Vec3::ZERO, sun: Vec3::ZERO, sun_direction: Vec3::Y };

    /// Returns the radiance from a unit direction.
    pub(crate) fn radiance(&self, direction: Vec3) -> Vec3 {
        let up = direction.y;
        let above = self.horizon.lerp(self.zenith, up.max(0.0).sqrt());
        let glow = (10.0 * (direction.dot(self.sun_direction) - 1.0)).exp();
        let base = self.ground.lerp(above, smoothstep(-0.12, 0.06, up));
        base + self.sun * glow
    }

    /// Estimates the mean luminance, to choose between lights.
    pub(crate) fn mean(&self) -> f32 {
        crate::color::luminance(0.4 * self.horizon + 0.2 * self.zenith + 0.4 * self.ground + 0.1 * self.sun)
    }

    /// Returns a latitude–longitude map, rows from straight up.
    ///
    /// The direction of a pixel is (sin θ sin φ, cos θ, −sin θ cos φ), with φ from −π to π.
    pub(crate) fn map(&self, width: usize, height: usize) -> Vec<Vec3> {
        use std::f32::consts::{PI, TAU};
        let rows = (0..height).map(|y| PI * (y as f32 + 0.5) / height as f32);
        rows.flat_map(|theta| {
            (0..width).map(move |x| {
                let phi = TAU * (x as f32 + 0.5) / width as f32 - PI;
                let (st, ct) = theta.sin_cos();
                self.radiance(Vec3::new(st * phi.sin(), ct, -st * phi.cos()))
            })
        })
        .collect()
    }

    /// Returns the sky with all radiance multiplied by a factor.
    pub(crate) fn scaled(self, factor: f32) -> Self {
        Self {
            zenith: self.zenith * factor,
            horizon: self.horizon * factor,
            ground: self.ground * factor,
            sun: self.sun * factor,
            sun_direction: self.sun_direction,
        }
    }
}
