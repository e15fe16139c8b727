//! Uniforms of a step: weights, learning rates and the visibility field's step.

use super::Intrinsic;
use sgs_passes::pipeline::{FieldStep, IntrinsicStepValues, MaterialWeights, Step};
use sgs_run::field_box;

/// Standard deviation of the jitter of visibility's smoothness loss. The unit is half the scene's box.
///
/// The published value is 0.01 in a box of side 3.
const JITTER: f32 = 0.01 / 1.5;

impl Intrinsic {
    /// Returns the uniforms of a step.
    /// The loss weights differ for photographs and priors; the pixel offsets are the same.
    pub(super) fn values(&self, step: u32, view: usize) -> IntrinsicStepValues {
        let s = &self.required.intrinsic;
        let (camera, offset) = self.data.views[view];
        let share = self.share(step);
        let whole = Step { lr_share: share, ..self.schedule.step(step, &camera, offset) };
        let with =
            |factor: f32| Step { weight_l1: factor * s.losses.l1, weight_dssim: factor * s.losses.dssim, ..whole };
        IntrinsicStepValues {
            shaded: with(1.0),
            albedo: with(s.losses.albedo),
            roughness: with(s.losses.roughness),
            metallic: with(s.losses.metallic),
            weights: MaterialWeights {
                albedo_msg: s.losses.albedo * s.losses.gradients,
                roughness_msg: s.losses.roughness * s.losses.gradients,
                albedo_edge: s.losses.albedo_smooth,
                roughness_edge: s.losses.roughness_smooth,
                cross_view: s.losses.cross_view,
                relight: s.relight_weight(),
                own_prior: s.own_prior_weight(),
            },
            field: self.field_step(&whole),
            ..Default::default()
        }
    }

    /// Returns the factor on the learning rates of materials at a step.
    /// The factor is 1 until the middle of training, then decays exponentially to `materials_last`.
    fn share(&self, step: u32) -> f32 {
        let s = &self.required.intrinsic;
        let done = f64::from(step) / f64::from(s.steps.max(1));
        f64::from(s.rates.materials_last).powf((2.0 * done - 1.0).clamp(0.0, 1.0)) as f32
    }

    /// Returns the uniform of the visibility field.
    fn field_step(&self, step: &Step) -> FieldStep {
        let s = &self.required.intrinsic;
        let [low, high] = self.bounds;
        let size: [f32; 3] = std::array::from_fn(|i| high[i] - low[i]);
        let pixels = step.camera.size[0] * step.camera.size[1];
        let pairs = f64::from(pixels) * f64::from(self.light_model.lights);
        FieldStep {
            jitter: JITTER * 0.5 * size.iter().fold(0.0_f32, |m, v| m.max(*v)),
            regularizer: (f64::from(s.losses.visibility_jitter) / pairs.max(1.0)) as f32,
            pixels,
            lights: self.light_model.lights,
            seed: step.seed,
            rate: self.options.rates.visibility,
            correction1: step.correction1,
            correction2: step.correction2,
            ..field_box(low, high)
        }
    }
}

/// Returns the ratio of initial light intensities to the published ones.
/// The published start is for boxes of side 3. Light falls off with the square of the distance, so the same image in a
/// larger unit needs proportionally more intensity.
pub(super) fn light_scale(bounds: &[[f32; 3]; 2]) -> f32 {
    let side = (0..3).map(|i| bounds[1][i] - bounds[0][i]).fold(0.0, f32::max);
    (side / 3.0).powi(2).max(1e-12)
}
