//! What a step compares beside its own view: a region's albedo in pseudo-views, and under other lights.
//!
//! Everything is drawn from the seed and the number of the step, so that resuming needs nothing but the number.

use crate::asked::Frames;
use crate::error::Result;
use crate::pseudo::PseudoViews;
use crate::regions::{LEAST_PIXELS, RegionInputs, Regions};
use crate::schedule::Schedule;
use crate::semantics::SemanticMaps;
use sgs_config::{IntrinsicSettings, Settings};
use sgs_engine::Device;
use sgs_passes::pipeline::{Camera, IntrinsicOptions, IntrinsicStepValues, PSEUDO_VIEWS, RelitOptions, Step};
use sgs_run::camera;
use sgs_scene::Scene;

/// What a step does beside comparing its view with photograph and priors.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum StepKind {
    /// Nothing.
    Plain,
    /// Compares albedo with pseudo-views.
    CrossView,
    /// Compares albedo with estimates under other lights, or with the view's own prior.
    Relight,
}

impl StepKind {
    /// All of them.
    pub const ALL: [StepKind; 3] = [StepKind::Plain, StepKind::CrossView, StepKind::Relight];

    /// The options of such a step, of those that all kinds share.
    pub fn options(self, o: &IntrinsicOptions) -> IntrinsicOptions {
        let relight = self == StepKind::Relight;
        IntrinsicOptions {
            cross_view: self == StepKind::CrossView,
            relight: relight && o.relight,
            own_prior: relight && o.own_prior,
            ..*o
        }
    }

    /// What a step is due, as the settings have it.
    pub fn of(s: &IntrinsicSettings, step: u32) -> StepKind {
        match step % s.consistency_interval {
            0 if s.losses.cross_view > 0.0 && step >= s.cross_view_from => StepKind::CrossView,
            1 if s.relight_weight() + s.own_prior_weight() > 0.0 && step >= s.relight_from => StepKind::Relight,
            _ => StepKind::Plain,
        }
    }
}

/// Regions and pseudo-views.
pub(super) struct Consistency {
    pseudo: PseudoViews,
    /// The training views.
    views: Vec<sgs_scene::Camera>,
    regions: Regions,
}

impl Consistency {
    /// What a provider of masks is shown of a view.
    pub const SHOWN: RelitOptions = RelitOptions { as_is: true, copies: 0, spacing: 0.0 };

    /// None if the scene has no regions, or no step needs any. `largest`: columns and rows that no view exceeds.
    pub fn load(
        device: &Device,
        scene: &Scene,
        settings: &Settings,
        largest: [u32; 2],
        planned: bool,
    ) -> Result<Option<Consistency>> {
        let s = &settings.intrinsic;
        if (1..=s.steps).all(|step| StepKind::of(s, step) == StepKind::Plain) {
            return Ok(None);
        }
        let pseudo = PseudoViews::new(scene, &settings.geometry.pseudo)?;
        let inputs = RegionInputs { device, scene, provider: &settings.provider, pseudo: &pseudo, largest, planned };
        let labels = || match settings.geometry.semantics {
            true => SemanticMaps::read(scene)?.map(|maps| maps.labels(device, scene)).transpose(),
            false => Ok(None),
        };
        let Some(regions) = Regions::load(&inputs, labels)? else { return Ok(None) };
        let views = scene.split.train.iter().map(|&i| scene.views[i].camera.clone()).collect();
        Ok(Some(Consistency { pseudo, views, regions }))
    }

    /// The regions.
    pub fn regions(&self) -> &Regions {
        &self.regions
    }

    /// Whether a provider of masks is asked in each step that compares.
    pub fn asks(&self) -> bool {
        matches!(self.regions, Regions::Asked(_))
    }

    /// The pseudo-views that training will see.
    pub fn cameras(&self, settings: &Settings, schedule: &Schedule) -> Vec<Camera> {
        let s = &settings.intrinsic;
        let due = (1..=s.steps).filter(|step| StepKind::of(s, *step) == StepKind::CrossView);
        let mut seen = std::collections::HashSet::new();
        let mut all = Vec::new();
        for step in due {
            let view = schedule.view(step);
            let [first, second] = self.pseudo.draw(settings.seed, step);
            for (which, index) in [(0, first), (1, second)] {
                if seen.insert((view, which, index)) {
                    all.push(camera(&self.pseudo.camera(view, which, index)));
                }
            }
        }
        all
    }

    /// The pseudo-views of a step.
    fn drawn(&self, seed: u64, view: usize, step: u32) -> [(sgs_scene::Camera, u32); PSEUDO_VIEWS] {
        let [first, second] = self.pseudo.draw(seed, step);
        [(0, first), (1, second)].map(|(which, index)| {
            let offset = match &self.regions {
                Regions::Numbered { pseudo: Some((maps, _)), .. } => maps.first(view, which, index),
                _ => 0,
            };
            (self.pseudo.camera(view, which, index), offset)
        })
    }

    /// Chooses the pseudo-views of a step, and its region where regions have numbers.
    pub fn fill(&self, seed: u64, view: usize, values: &mut IntrinsicStepValues) {
        let step = values.shaded.step;
        if let Regions::Numbered { maps, .. } = &self.regions {
            values.shaded.region = maps.draw(view, seed, step);
        }
        let region = values.shaded.region;
        values.pseudo = self.drawn(seed, view, step).map(|(c, target_offset)| Step {
            camera: camera(&c),
            step,
            region,
            target_offset,
            ..Step::default()
        });
    }

    /// The camera of a training view.
    pub fn camera(&self, view: usize) -> &sgs_scene::Camera {
        &self.views[view]
    }

    /// The cameras of a step's pseudo-views.
    pub fn pseudo_cameras(&self, seed: u64, view: usize, step: u32) -> [sgs_scene::Camera; PSEUDO_VIEWS] {
        self.drawn(seed, view, step).map(|(camera, _)| camera)
    }

    /// Asks where the step's region is in three frames. False if there is nobody to ask any more. `masks`: which frame's mask is
    /// that of the training view.
    pub fn ask(
        &mut self,
        device: &Device,
        frames: &Frames<'_>,
        masks: usize,
        seed: u64,
        values: &mut IntrinsicStepValues,
    ) -> Result<bool> {
        let Regions::Asked(asked) = &mut self.regions else { return Ok(true) };
        let Some(pixels) = asked.ask_about(device, frames, seed, values.shaded.step)? else { return Ok(false) };
        // Kernels take the masks as they are; a region is named where there is evidence of one.
        values.shaded.region = u32::from(pixels[masks] >= LEAST_PIXELS as usize);
        values.shaded.mask_offset = asked.words * masks as u32;
        values.pseudo[1].mask_offset = 2 * asked.words;
        Ok(true)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn constraints_take_turns() {
        let s = IntrinsicSettings { relight_from: 7, ..Default::default() };
        let kinds: Vec<StepKind> = (1..=10).map(|step| StepKind::of(&s, step)).collect();
        use StepKind::{CrossView as C, Plain as P, Relight as R};
        assert_eq!(kinds, [P, P, C, P, P, C, R, P, C, R]);
        let none = IntrinsicSettings::default();
        let mut off = none.clone();
        (off.losses.cross_view, off.losses.relight) = (0.0, 0.0);
        assert!((1..=3000).all(|step| StepKind::of(&off, step) == P));
    }
}
