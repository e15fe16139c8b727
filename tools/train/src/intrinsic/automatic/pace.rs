//! How often surroundings move: as seldom as pictures allow.
//!
//! Filtering them costs the same whatever a view has of pixels. Once they are learned they hardly change from step to step, and may
//! be filtered once in several (`intrinsic.environment.every`). What their age costs is measured: by the moments of their moves it is known
//! where they were some steps ago, and pictures lose so many decibels with these.

use crate::error::Result;
use crate::intrinsic::Intrinsic;
use crate::memory::allowed;
use crate::shaded::{RunLight, Texels, Visibility};
use sgs_passes::pipeline::{EnvironmentRefresh, IntrinsicOptions, KeptEnvironment};

/// Numbers of steps that are tried.
const SELDOMER: [u32; 4] = [16, 8, 4, 2];

/// Texels as they were that many of the last moves ago: each was as far as the next one would be. `moments` has two numbers a
/// texel, `moves` have been made.
fn earlier(texels: &[f32], moments: &[f32], moves: u32, distance: f32) -> Vec<f32> {
    let correction = |decay: f64| 1.0 - decay.powi(moves.max(1) as i32);
    let (first, second) = (correction(0.9), correction(0.999));
    let back = |(texel, m): (&f32, &[f32; 2])| {
        let size = (f64::from(m[1]) / second).sqrt();
        let moved = if size > 0.0 { f64::from(m[0]) / first / size } else { 0.0 };
        // No texel is darker than black.
        (texel + distance * moved as f32).max(0.0)
    };
    texels.iter().zip(moments.as_chunks::<2>().0).map(back).collect()
}

impl Intrinsic {
    /// The most steps that surroundings may be old, and what that costs; none where they move as seldom already, or memory does
    /// not suffice. `loss`: decibels that pictures lose under such surroundings.
    pub(super) fn pace(&self, gain: f64, mut loss: impl FnMut(&RunLight) -> Result<f64>) -> Result<Option<(u32, f64)>> {
        let (Some((e, _)), Some(texels)) = (&self.environment, &self.parameters.environment) else { return Ok(None) };
        let now = self.options.environment_every;
        let (data, moments) = (texels.download(&self.device)?, texels.download_moments(&self.device)?);
        for every in SELDOMER.into_iter().filter(|every| *every > now) {
            let distance = every as f32 * self.options.rates.environment;
            let old = earlier(&data, &moments, self.moves(self.done), distance);
            let environment = Some(Texels { size: e.size(), data: old });
            let worth = loss(&RunLight { lights: None, environment, visibility: Visibility::None })?;
            if worth <= gain {
                return Ok(self.fits(every)?.then_some((every, worth)));
            }
        }
        Ok(None)
    }

    /// Whether there is memory for surroundings that are kept.
    fn fits(&self, every: u32) -> Result<bool> {
        let Some((e, _)) = self.environment.as_ref().filter(|_| self.seldom.is_none()) else { return Ok(true) };
        let options = IntrinsicOptions { environment_every: every, ..self.options };
        let plan = EnvironmentRefresh::plan(&self.tuning, e, &options)?;
        let bytes = KeptEnvironment::bytes_of(e) + plan.arena_bytes;
        let fits = bytes <= allowed(&self.device, &self.required).left();
        if !fits {
            tracing::info!(
                "surroundings move with every step: there is no room to keep what is filtered ({bytes} bytes)"
            );
        }
        Ok(fits)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn texels_go_back_the_way_they_came() {
        // Adam, with a gradient that stays: every move is as far as the rate.
        let (mut texels, gradient, rate) = (vec![5.0_f64, 1.0, 0.02, 3.0], [2.0, -0.5, -3.0, 0.0], 0.01);
        let mut moments = [[0.0_f64; 2]; 4];
        let mut course = vec![texels.clone()];
        for step in 1..=20 {
            for ((t, m), g) in texels.iter_mut().zip(&mut moments).zip(gradient) {
                *m = [0.9 * m[0] + 0.1 * g, 0.999 * m[1] + 0.001 * g * g];
                let hat = [m[0] / (1.0 - 0.9_f64.powi(step)), m[1] / (1.0 - 0.999_f64.powi(step))];
                *t -= rate * hat[0] / (hat[1].sqrt() + 1e-8);
            }
            course.push(texels.clone());
        }
        let narrow = |v: &[f64]| v.iter().map(|x| *x as f32).collect::<Vec<f32>>();
        let flat: Vec<f64> = moments.concat();
        for steps in [1_u32, 2, 8] {
            let old = earlier(&narrow(&texels), &narrow(&flat), 20, steps as f32 * rate as f32);
            for (a, b) in old.iter().zip(&course[20 - steps as usize]) {
                assert!((f64::from(*a) - b).abs() < 1e-4, "{steps} steps ago: {old:?} {course:?}");
            }
        }
        // Further back than black there is nothing, and what never moved stays.
        let old = earlier(&[0.1, 0.1], &[-1.0, 1.0, 0.0, 0.0], 1000, 3.0);
        assert_eq!(old, [0.0, 0.1]);
    }
}
