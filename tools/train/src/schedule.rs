//! Schedule: the settings of a step as a function of its number only.
//! Resuming needs nothing but the number.

use sgs_config::{DensifyRule, Rates, Settings};
use sgs_passes::pipeline::{Camera, DensifySettings, Step};

/// Most halvings of a photograph.
pub(crate) const MOST_HALVINGS: u32 = 2;

/// Largest growth of the weight of depth variance: that of step 7000. The published weight grows to 100 times its first
/// value, which makes normals worse in longer runs.
const SPREAD_GROWTH: f64 = 25.0;

/// Markov chain Monte Carlo: weights of the means of opacities and of scales, and the strength of the noise relative to the
/// learning rate. As published, for scenes of extent 1.
const MCMC_OPACITY: f64 = 0.01;
const MCMC_SCALE: f64 = 0.01;
const MCMC_NOISE: f64 = 5e5;

/// Fraction of the steps before cameras and exposures are learned.
const VIEWS_FROM: f64 = 0.05;

/// Schedules of a run.
#[derive(Clone, Debug)]
pub struct Schedule {
    settings: Settings,
    extent: f64,
    views: usize,
    /// Factor on all learning rates.
    rates: f64,
}

impl Schedule {
    /// Makes the schedule for a scene of this extent and number of training views.
    ///
    /// Nothing is learned of the photographs with `geometry.rates.views = "auto"`: what was decided comes as fixed rates.
    pub fn new(settings: &Settings, extent: f64, views: usize) -> Schedule {
        Schedule { settings: settings.clone(), extent, views: views.max(1), rates: 1.0 }
    }

    /// Returns the unit of lengths.
    pub fn extent(&self) -> f64 {
        self.extent
    }

    /// Sets the factor on all learning rates from here on.
    pub fn set_rates(&mut self, factor: f64) {
        self.rates = factor;
    }

    /// Returns the factor on all learning rates.
    pub fn rates(&self) -> f64 {
        self.rates
    }

    /// Returns the training view of a step (from 1).
    /// Each round covers every view once, in a new order.
    pub fn view(&self, step: u32) -> usize {
        let at = u64::from(step.saturating_sub(1));
        let (round, position) = (at / self.views as u64, (at % self.views as u64) as usize);
        let mut order: Vec<usize> = (0..self.views).collect();
        for i in (1..self.views).rev() {
            let j = hash(self.settings.seed, round.wrapping_mul(0x1_0001).wrapping_add(i as u64)) % (i as u64 + 1);
            order.swap(i, j as usize);
        }
        order[position]
    }

    /// Returns how often photographs are halved in a step, at most.
    pub fn halvings(&self, step: u32) -> u32 {
        let g = &self.settings.geometry;
        let coarse = g.coarse * f64::from(g.steps);
        // Each size has an equal share of these steps; the smallest comes first.
        let left = 1.0 - f64::from(step) / coarse.max(f64::MIN_POSITIVE);
        (left * f64::from(MOST_HALVINGS)).ceil().max(0.0) as u32
    }

    /// Returns the largest ratio of a geometry learning rate to its default.
    pub fn roughness(&self) -> f64 {
        let (r, d) = (&self.settings.geometry.rates, Rates::default());
        let times = [
            r.means[0] / d.means[0],
            r.scales / d.scales,
            r.rotations / d.rotations,
            r.opacities / d.opacities,
            r.sh0 / d.sh0,
            r.sh_rest / d.sh_rest,
        ];
        self.settings.geometry.rate_factor() * self.rates * times.into_iter().fold(0.0, f64::max)
    }

    /// Returns the uniform of a step.
    pub fn step(&self, step: u32, camera: &Camera, target_offset: u32) -> Step {
        let g = &self.settings.geometry;
        let done = f64::from(step) / f64::from(g.steps.max(1));
        let [first, last] = g.rates.means;
        let means = first.powf(1.0 - done.min(1.0)) * last.powf(done.min(1.0));
        let factor = g.rate_factor() * self.rates;
        let [turn, gain, lens, radial] = g.rates.views.fixed().unwrap_or_default();
        // Cameras wait until the Gaussians show a room; their last steps are a hundredth of the first.
        let views = if done < VIEWS_FROM { 0.0 } else { factor * 0.01f64.powf(done.min(1.0)) };
        let spread = 10f64.powf(f64::from(step) / 5000.0).min(SPREAD_GROWTH) as f32;
        // In units of the extent, so that the unit of lengths has no effect.
        let mcmc = |value: f64| if g.densify.mcmc() { value } else { 0.0 };
        let noise = mcmc(MCMC_NOISE * factor * means / self.extent.max(f64::MIN_POSITIVE));
        Step {
            camera: *camera,
            background: g.background,
            step,
            target_offset,
            // Bands that the model lacks have no effect.
            sh_degree: g.sh_degree.most(),
            seed: hash(self.settings.seed, u64::from(step)) as u32,
            lr_means: (factor * means * self.extent) as f32,
            lr_scales: (factor * g.rates.scales) as f32,
            lr_rotations: (factor * g.rates.rotations) as f32,
            lr_opacities: (factor * g.rates.opacities) as f32,
            lr_sh0: (factor * g.rates.sh0) as f32,
            lr_sh_rest: (factor * g.rates.sh_rest) as f32,
            lr_normals: (factor * g.rates.normals) as f32,
            lr_semantics: (factor * g.rates.semantics) as f32,
            lr_decoder: (factor * g.rates.decoder) as f32,
            lr_share: 1.0,
            lr_turn: (views * turn) as f32,
            lr_shift: (views * turn * self.extent) as f32,
            lr_gain: (views * gain) as f32,
            lr_lens: (views * lens) as f32,
            lr_radial: (views * radial) as f32,
            correction1: (1.0 / (1.0 - 0.9f64.powf(f64::from(step)))) as f32,
            correction2: (1.0 / (1.0 - 0.999f64.powf(f64::from(step)))) as f32,
            weight_opacity: mcmc(MCMC_OPACITY) as f32,
            weight_scale: mcmc(MCMC_SCALE / self.extent.max(f64::MIN_POSITIVE)) as f32,
            noise: noise as f32,
            weight_l1: g.losses.l1,
            weight_dssim: g.losses.dssim,
            weight_normal: g.losses.normal,
            weight_normal_smooth: g.losses.normal_smooth,
            weight_depth_smooth: g.losses.depth_smooth,
            weight_depth_variance: g.losses.depth_variance * spread,
            weight_depth: g.losses.depth,
            weight_semantic: g.losses.semantic,
            weight_semantic_class: g.losses.semantic_class,
            weight_correspondence: g.losses.correspondence,
            inverse_temperature: 1.0 / g.temperature,
            gather_statistics: u32::from(self.last_densification() >= step),
            ..Step::default()
        }
    }

    /// Returns the last step after which densification may run; 0 if it never runs.
    ///
    /// At least `interval` steps follow. Every clone and every half of a split is thus optimized before it is saved.
    fn last_densification(&self) -> u32 {
        let (d, steps) = (&self.settings.geometry.densify, self.settings.geometry.steps);
        let until = (f64::from(steps) * d.until) as u32;
        if d.enabled() { until.min(steps.saturating_sub(d.interval)) } else { 0 }
    }

    /// Returns whether this step's densification is the last.
    pub fn densifies_last(&self, step: u32) -> bool {
        step + self.settings.geometry.densify.interval > self.last_densification()
    }

    /// Returns the settings of the densification after a step, or none.
    pub fn densify(&self, step: u32) -> Option<DensifySettings> {
        let d = &self.settings.geometry.densify;
        if !d.enabled() || step < d.from || step > self.last_densification() || !step.is_multiple_of(d.interval) {
            return None;
        }
        let after_reset = d.reset_interval > 0 && step > d.reset_interval;
        Some(DensifySettings {
            grad_threshold: d.grad_threshold,
            normal_threshold: if d.rule == DensifyRule::Geometric { d.normal_threshold } else { 0.0 },
            split_size: (d.sizes[0] * self.extent) as f32,
            prune_opacity: d.prune_opacity,
            prune_weight: self.least_weight(),
            prune_size: if after_reset { (d.sizes[1] * self.extent) as f32 } else { f32::MAX },
            cap: d.max_gaussians,
            seed: hash(self.settings.seed ^ 0xdead, u64::from(step)) as u32,
        })
    }

    /// Returns the accumulated blending weight below which a Gaussian is pruned.
    /// The weight accumulates since the last densification. The result is 0 if the interval may miss views.
    fn least_weight(&self) -> f32 {
        let d = &self.settings.geometry.densify;
        // Weights from a subset of the views do not show whether other views need a Gaussian.
        if u64::from(d.interval) + 1 < 2 * self.views as u64 {
            return 0.0;
        }
        d.prune_weight
    }

    /// Returns whether opacities are reset after a step.
    pub fn reset(&self, step: u32) -> bool {
        let d = &self.settings.geometry.densify;
        d.enabled()
            && !d.mcmc()
            && d.reset_interval > 0
            && step.is_multiple_of(d.reset_interval)
            && step < self.last_densification()
    }
}

/// Returns a counter-based hash (SplitMix64).
pub(crate) fn hash(seed: u64, counter: u64) -> u64 {
    let mut z = seed.wrapping_add(counter.wrapping_add(1).wrapping_mul(0x9E37_79B9_7F4A_7C15));
    z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    z ^ (z >> 31)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rounds_cover_every_view_once_in_different_orders() {
        let s = Schedule::new(&Settings::default(), 1.0, 7);
        let round = |r: u32| (1..=7).map(|i| s.view(r * 7 + i)).collect::<Vec<_>>();
        for r in 0..5 {
            let mut seen = round(r);
            seen.sort_unstable();
            assert_eq!(seen, (0..7).collect::<Vec<_>>());
        }
        assert_ne!(round(0), round(1));
    }

    #[test]
    fn photographs_grow_to_full_size_within_the_coarse_steps() {
        let mut settings = Settings::default();
        settings.geometry.steps = 100;
        let at = |s: &Settings| {
            let schedule = Schedule::new(s, 1.0, 1);
            [1, 24, 25, 49, 50, 51, 100].map(|step| schedule.halvings(step))
        };
        assert_eq!(at(&settings), [2, 2, 1, 1, 0, 0, 0]);
        settings.geometry.coarse = 1.0;
        assert_eq!(at(&settings), [2, 2, 2, 2, 1, 1, 0]);
        settings.geometry.coarse = 0.0;
        assert_eq!(at(&settings), [0; 7]);
    }

    #[test]
    fn learned_views_wait_for_a_twentieth_of_the_steps() {
        let mut settings = Settings::default();
        (settings.geometry.rates.factor, settings.geometry.rates.views) = (1.5, [1.0, 3.0, 4.0, 5.0].into());
        let mut rates = |steps: u32, step: u32| {
            settings.geometry.steps = steps;
            let s = Schedule::new(&settings, 2.0, 1).step(step, &Camera::default(), 0);
            [s.lr_turn, s.lr_shift, s.lr_gain, s.lr_lens, s.lr_radial]
        };
        for (steps, step) in [(1000, 1), (1000, 49), (60, 2), (21, 1)] {
            assert_eq!(rates(steps, step), [0.0; 5], "step {step} of {steps}");
        }
        // The shift has the rate of the turn times the extent. Rates fall to a hundredth, also beyond the last step.
        for (steps, step, done) in
            [(1000, 50, 0.05), (1000, 51, 0.051), (60, 3, 0.05), (20, 1, 0.05), (1000, 500, 0.5), (1000, 1000, 1.0)]
        {
            let decay = 1.5 * 0.01_f64.powf(done);
            let near = |(found, expected): (f32, f64)| (f64::from(found) / (decay * expected) - 1.0).abs() < 1e-6;
            let found = rates(steps, step);
            assert!(found.into_iter().zip([1.0, 2.0, 3.0, 4.0, 5.0]).all(near), "step {step} of {steps}: {found:?}");
        }
        assert_eq!(rates(10, 20), rates(10, 10));
        let rolled_back = |rates: f64| {
            let mut schedule = Schedule::new(&settings, 2.0, 1);
            schedule.set_rates(rates);
            schedule.step(10, &Camera::default(), 0).lr_gain
        };
        assert_eq!(rolled_back(0.5), 0.5 * rolled_back(1.0));
    }

    #[test]
    fn weight_pruning_requires_that_all_views_were_rendered() {
        let mut settings = Settings::default();
        settings.geometry.steps = 1000;
        let weight = |views: usize, step| Schedule::new(&settings, 1.0, views).densify(step).unwrap().prune_weight;
        // With 51 views, 100 steps may miss a view.
        assert_eq!((weight(51, 500), weight(51, 600), weight(50, 500), weight(12, 600)), (0.0, 0.0, 1e-4, 1e-4));
    }

    #[test]
    fn depth_variance_stops_growing_where_published_runs_end() {
        let mut settings = Settings::default();
        settings.geometry.steps = 100_000;
        let weight =
            |s: &Settings, step| Schedule::new(s, 1.0, 1).step(step, &Camera::default(), 0).weight_depth_variance;
        let is = |weight: f32, expected: f32| assert!((weight / expected - 1.0).abs() < 1e-5, "{weight} {expected}");
        is(weight(&settings, 1), 0.02 * 10f32.powf(1.0 / 5000.0));
        is(weight(&settings, 5000), 0.2);
        is(weight(&settings, 6980), 0.02 * 10f32.powf(6980.0 / 5000.0));
        is(weight(&settings, 7000), 0.5);
        is(weight(&settings, 100_000), 0.5);
    }

    #[test]
    fn every_preset_optimizes_for_an_interval_after_the_last_densification() {
        for preset in sgs_config::PRESETS {
            let mut settings = Settings::from_table(preset.table().unwrap()).unwrap();
            for steps in [settings.geometry.steps, 1000, 610, 601, 600] {
                settings.geometry.steps = steps;
                let s = Schedule::new(&settings, 1.0, 12);
                let last = (1..=steps).filter(|step| s.densify(*step).is_some()).max();
                let interval = settings.geometry.densify.interval;
                let name = preset.name;
                assert!(last.is_none_or(|last| last + interval <= steps), "{name}: {last:?} of {steps}");
                assert!(steps < 1000 || last.is_some(), "{name} never densifies in {steps} steps");
                assert!(
                    last.is_none_or(|last| (last..=steps).all(|step| !s.reset(step))),
                    "{name} resets after {last:?}"
                );
            }
        }
    }

    #[test]
    fn statistics_are_gathered_through_the_last_densification() {
        let mut settings = Settings::default();
        settings.geometry.steps = 10;
        let d = &mut settings.geometry.densify;
        (d.from, d.interval, d.until) = (1, 1, 0.6);
        let s = Schedule::new(&settings, 1.0, 1);
        let gathers = |step| s.step(step, &Camera::default(), 0).gather_statistics == 1;
        assert!(s.densify(6).is_some() && gathers(6));
        assert!(s.densify(7).is_none() && !gathers(7));
    }
}
