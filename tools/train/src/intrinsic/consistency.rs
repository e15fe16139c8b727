//! Comparison of a region's albedo in pseudo-views and under other lights.
//!
//! All random choices depend on the seed and the step only, so resuming needs nothing but the step.

use crate::error::Result;
use crate::pseudo::PseudoViews;
use crate::region_provider::Frames;
use crate::regions::{LEAST_PIXELS, RegionInputs, Regions};
use crate::schedule::Schedule;
use crate::semantics::SemanticMaps;
use sgs_config::{IntrinsicSettings, Settings};
use sgs_engine::Device;
use sgs_passes::pipeline::{Camera, IntrinsicOptions, IntrinsicStepValues, PSEUDO_VIEWS, RelitOptions, Step};
use sgs_run::camera;
use sgs_scene::Scene;

/// Number of steps between comparisons of albedo with pseudo-views. The step after each compares albedo under other
/// lights.
pub const CONSISTENCY_INTERVAL: u32 = 3;

/// Comparisons of albedo beside those with photograph and priors.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct AlbedoComparisons {
    /// Whether albedo is compared between pseudo-views.
    pub cross_view: bool,
    /// Whether albedo is compared under other lights.
    pub relight: bool,
}

/// Kind of a step: its comparisons beside those with photograph and priors.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum StepKind {
    /// No further comparison.
    Plain,
    /// Compares albedo with pseudo-views.
    CrossView,
    /// Compares albedo with estimates under other lights, or with the view's own prior.
    Relight,
}

impl StepKind {
    /// All kinds.
    pub const ALL: [StepKind; 3] = [StepKind::Plain, StepKind::CrossView, StepKind::Relight];

    /// Returns the options of this kind of step, from those that all kinds share.
    pub fn options(self, o: &IntrinsicOptions) -> IntrinsicOptions {
        let relight = self == StepKind::Relight;
        IntrinsicOptions {
            cross_view: self == StepKind::CrossView,
            relight: relight && o.relight,
            own_prior: relight && o.own_prior,
            ..*o
        }
    }

    /// Returns the kind of a step that the settings schedule.
    pub fn of(s: &IntrinsicSettings, step: u32) -> StepKind {
        match step % CONSISTENCY_INTERVAL {
            0 if s.losses.cross_view > 0.0 && step > 0 => StepKind::CrossView,
            1 if s.relight_weight() + s.own_prior_weight() > 0.0 && step >= s.relight_from => StepKind::Relight,
            _ => StepKind::Plain,
        }
    }
}

/// Regions and pseudo-views of a scene.
pub(super) struct Consistency {
    pseudo: PseudoViews,
    /// Cameras of the training views.
    views: Vec<sgs_scene::Camera>,
    regions: Regions,
}

impl Consistency {
    /// Lights that a provider of masks is shown: the current ones only.
    pub const SHOWN: RelitOptions = RelitOptions { as_is: true, copies: 0, spacing: 0.0 };

    /// Loads regions and pseudo-views.
    /// Returns none if the scene has no regions, or no step needs any. `largest`: upper bounds of the width and height
    /// of all views. `planned`: starts no provider.
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

    /// Returns the regions.
    pub fn regions(&self) -> &Regions {
        &self.regions
    }

    /// Returns whether every comparing step queries a provider of masks.
    pub fn queries_provider(&self) -> bool {
        matches!(self.regions, Regions::Provider(_))
    }

    /// Returns the cameras of the pseudo-views that training will use.
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

    /// Returns the cameras of a step's pseudo-views, with the offsets of their masks.
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

    /// Fills in the pseudo-views of a step, and its region where regions have numbers.
    pub fn fill(&self, seed: u64, view: usize, values: &mut IntrinsicStepValues) {
        let step = values.shaded.step;
        if let Regions::Numbered { maps, .. } = &self.regions {
            values.shaded.region = maps.draw(view, seed, step);
            values.shaded.region_offset = maps.first(view);
        }
        let region = values.shaded.region;
        values.pseudo = self.drawn(seed, view, step).map(|(c, region_offset)| Step {
            camera: camera(&c),
            step,
            region,
            region_offset,
            ..Step::default()
        });
    }

    /// Returns the camera of a training view.
    pub fn camera(&self, view: usize) -> &sgs_scene::Camera {
        &self.views[view]
    }

    /// Returns the cameras of a step's pseudo-views.
    pub fn pseudo_cameras(&self, seed: u64, view: usize, step: u32) -> [sgs_scene::Camera; PSEUDO_VIEWS] {
        self.drawn(seed, view, step).map(|(camera, _)| camera)
    }

    /// Queries the provider for the step's region in three frames.
    /// Returns false if the provider is no longer available. `masks`: index of the frame whose mask is that of the
    /// training view.
    pub fn ask(
        &mut self,
        device: &Device,
        frames: &Frames<'_>,
        masks: usize,
        seed: u64,
        values: &mut IntrinsicStepValues,
    ) -> Result<bool> {
        let Regions::Provider(requested) = &mut self.regions else { return Ok(true) };
        let Some(pixels) = requested.ask_about(device, frames, seed, values.shaded.step)? else { return Ok(false) };
        // Kernels use the masks directly; region 1 means that the mask is large enough.
        values.shaded.region = u32::from(pixels[masks] >= LEAST_PIXELS as usize);
        values.shaded.mask_offset = requested.words * masks as u32;
        values.pseudo[1].mask_offset = 2 * requested.words;
        Ok(true)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn step_kinds_alternate_by_interval() {
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
