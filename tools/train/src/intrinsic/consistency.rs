//! What a step compares beside its own view: a region's albedo in pseudo-views, and under other lights.
//!
//! Everything is drawn from the seed and the number of the step, so that resuming needs nothing but the number.

use crate::convert::camera;
use crate::error::Result;
use crate::pseudo::PseudoViews;
use crate::regions::RegionMaps;
use crate::schedule::Schedule;
use crate::settings::{IntrinsicSettings, Settings};
use sgs_engine::{Device, DeviceBuffer};
use sgs_passes::pipeline::{Camera, IntrinsicOptions, IntrinsicStepValues, PSEUDO_VIEWS, Step};
use sgs_scene::Scene;

/// What a step does beside comparing its view with photograph and priors.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum StepKind {
    /// Nothing.
    Plain,
    /// Compares albedo with pseudo-views.
    CrossView,
    /// Compares albedo under other lights.
    Relight,
}

impl StepKind {
    /// All of them.
    pub const ALL: [StepKind; 3] = [StepKind::Plain, StepKind::CrossView, StepKind::Relight];

    /// The options of such a step, of those that all kinds share.
    pub fn options(self, o: &IntrinsicOptions) -> IntrinsicOptions {
        IntrinsicOptions { cross_view: self == StepKind::CrossView, relight: self == StepKind::Relight, ..*o }
    }

    /// What a step is due, as the settings have it.
    pub fn of(s: &IntrinsicSettings, step: u32) -> StepKind {
        match step % s.consistency_interval {
            0 if s.losses.cross_view > 0.0 && step >= s.cross_view_from => StepKind::CrossView,
            1 if s.losses.relight > 0.0 && step >= s.relight_from => StepKind::Relight,
            _ => StepKind::Plain,
        }
    }
}

/// Regions and pseudo-views.
pub(super) struct Consistency {
    pseudo: PseudoViews,
    maps: RegionMaps,
    /// Numbers of the training views' pixels.
    pub ids: DeviceBuffer,
}

impl Consistency {
    /// None where nothing says what a region is, or nothing asks.
    pub fn load(device: &Device, scene: &Scene, settings: &Settings) -> Result<Option<Consistency>> {
        let s = &settings.intrinsic;
        if (1..=s.steps).all(|step| StepKind::of(s, step) == StepKind::Plain) {
            return Ok(None);
        }
        let Some(maps) = RegionMaps::of_scene(scene)? else {
            tracing::info!("nothing says what a region is; albedo is not compared with other views");
            return Ok(None);
        };
        let pseudo = PseudoViews::new(scene, &settings.geometry.pseudo)?;
        let ids = maps.upload(device)?;
        Ok(Some(Consistency { pseudo, maps, ids }))
    }

    fn drawn(&self, seed: u64, view: usize, step: u32) -> [Camera; PSEUDO_VIEWS] {
        let [first, second] = self.pseudo.draw(seed, step);
        [(0, first), (1, second)].map(|(which, index)| camera(&self.pseudo.camera(view, which, index)))
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

    /// Chooses the region and the pseudo-views of a step.
    pub fn fill(&self, seed: u64, view: usize, values: &mut IntrinsicStepValues) {
        let step = values.shaded.step;
        values.shaded.region = self.maps.draw(view, seed, step);
        values.pseudo = self.drawn(seed, view, step).map(|camera| Step { camera, step, ..Step::default() });
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
