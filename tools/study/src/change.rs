//! Variants of the intrinsic stage that leave out one component each.

use super::variant::any;
use crate::error::Result;
use sgs_config::{IntrinsicSettings, MaterialStart, OwnPrior, Settings, VisibilityKind};
use sgs_scene::Scene;

/// Change of a variant relative to the full method.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Change {
    /// No change.
    Nothing,
    /// Initial materials are gray.
    GrayStart,
    /// No point lights.
    Lights,
    /// No environment map.
    Environment,
    /// No occlusion of lights.
    Visibility,
    /// No comparison of albedo between views.
    CrossView,
    /// No comparison with estimates under other lights.
    Relight,
    /// No comparison with the views' own priors, in regions.
    OwnPrior,
    /// No losses of material priors. Materials still start from the priors.
    Priors,
}

impl Change {
    /// Applies the change to settings.
    pub fn apply(self, s: &mut IntrinsicSettings) {
        let own_prior = s.own_prior_weight();
        let l = &mut s.losses;
        match self {
            Change::Nothing => {}
            Change::GrayStart => s.start = MaterialStart::Gray,
            Change::Lights => {
                s.lights.grid = 0;
                // Without lights no relit image can be shown to a provider.
                if s.relight.command().is_some() {
                    l.relight = 0.0;
                }
            }
            Change::Environment => s.environment.resolution = 0,
            Change::Visibility => s.visibility.kind = VisibilityKind::None,
            Change::CrossView => l.cross_view = 0.0,
            Change::Relight => (l.relight, l.own_prior) = (0.0, OwnPrior::Weight(own_prior)),
            Change::OwnPrior => l.own_prior = OwnPrior::Weight(0.0),
            Change::Priors => (l.albedo, l.roughness, l.metallic) = (0.0, 0.0, 0.0),
        }
    }

    /// Returns why the change would have no effect, as the end of a sentence. None if it has an effect.
    pub fn lacks(self, scene: &Scene, settings: &Settings) -> Result<Option<String>> {
        let s = &settings.intrinsic;
        let reason = |text: &str| Ok(Some(text.to_owned()));
        let late = |what: &str, from: u32| {
            (from > s.steps).then(|| format!("it begins at step {from} of {} ({what})", s.steps))
        };
        let mut changed = s.clone();
        self.apply(&mut changed);
        if self != Change::Nothing && changed == *s {
            return reason("the settings leave it out anyway");
        }
        let albedo = || any(scene, |view| Ok(scene.albedo_prior(view)?.is_some()));
        let roughness = || any(scene, |view| Ok(scene.roughness_prior(view)?.is_some()));
        let metallic = || any(scene, |view| Ok(scene.metallic_prior(view)?.is_some()));
        match self {
            Change::Relight if s.relight.command().is_none() => {
                reason("no provider of materials is asked (intrinsic.relight.provider)")
            }
            Change::OwnPrior if s.own_prior_weight() == 0.0 => reason("the settings leave it out anyway"),
            Change::OwnPrior if !albedo()? => reason("the scene has no priors/albedo"),
            Change::Relight | Change::OwnPrior => Ok(late("intrinsic.relight_from", s.relight_from)),
            Change::GrayStart | Change::Priors if !(albedo()? || roughness()? || metallic()?) => {
                reason("the scene has no priors of materials")
            }
            _ => Ok(None),
        }
    }
}
