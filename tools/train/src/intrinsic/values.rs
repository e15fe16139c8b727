//! The numbers of a step: weights, rates, and what the visibility field is told.

use super::Intrinsic;
use sgs_passes::pipeline::{FieldStep, IntrinsicStepValues, MaterialWeights, Step};
use sgs_run::field_box;

impl Intrinsic {
    /// The uniforms of a step: weights of photographs and priors, whose offsets are the same.
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

    /// What is left of the learning rates of materials at a step: all until the middle, then ever less.
    fn share(&self, step: u32) -> f32 {
        let s = &self.required.intrinsic;
        let done = f64::from(step) / f64::from(s.steps.max(1));
        f64::from(s.rates.materials_last).powf((2.0 * done - 1.0).clamp(0.0, 1.0)) as f32
    }

    /// The uniform of the visibility field.
    fn field_step(&self, step: &Step) -> FieldStep {
        let s = &self.required.intrinsic;
        let [low, high] = self.bounds;
        let size: [f32; 3] = std::array::from_fn(|i| high[i] - low[i]);
        let pixels = step.camera.size[0] * step.camera.size[1];
        let pairs = f64::from(pixels) * f64::from(self.light_model.lights);
        FieldStep {
            jitter: s.visibility.jitter * 0.5 * size.iter().fold(0.0_f32, |m, v| m.max(*v)),
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

/// By how much lights are brighter than the published start, which is for boxes of side 3: light falls off with the square
/// of the distance, so that the same picture in a larger unit needs as much more.
pub(super) fn light_scale(bounds: &[[f32; 3]; 2]) -> f32 {
    let side = (0..3).map(|i| bounds[1][i] - bounds[0][i]).fold(0.0, f32::max);
    (side / 3.0).powi(2).max(1e-12)
}
