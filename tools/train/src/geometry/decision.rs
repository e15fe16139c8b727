//! Decisions about the model of the geometry stage. `training.json` holds all of them.

use super::Geometry;
use super::lens::{EXPOSURES, SensorFindings};
use crate::decision::Decision;
use crate::error::{Requirement, Result};
use crate::idle::{FoundForGeometry, IdleLoss};
use sgs_config::{DensifyRule, GeometrySettings, Settings};

/// Settings that switch the depth terms.
const DEPTH: &str = "geometry.losses.depth_smooth, geometry.losses.depth_variance";

/// Returns the decisions that follow from data and settings, before the first step.
pub(super) fn initial(s: &Settings, found: FoundForGeometry) -> Vec<Decision> {
    let g = &s.geometry;
    let prior = |what: &str, wanted: bool, weight: f32, found: bool| match (wanted, weight > 0.0, found) {
        (false, ..) => "switched off".to_owned(),
        (_, false, _) => "its losses weigh nothing".to_owned(),
        (.., false) => format!("the scene has no {what} priors"),
        (.., true) => format!("the scene has {what} priors"),
    };
    let regions = if found.semantics && g.losses.correspondence > 0.0 && g.correspondence_from > g.steps {
        format!("there is none before step {}, and training ends at {}", g.correspondence_from, g.steps)
    } else if g.losses.correspondence > 0.0 && !found.semantics {
        "there are no semantics".to_owned()
    } else {
        match (g.losses.correspondence > 0.0, found.regions) {
            (false, _) => "its loss weighs nothing".to_owned(),
            (true, false) => "there are no regions".to_owned(),
            (true, true) => format!("regions are compared from step {} on", g.correspondence_from),
        }
    };
    let normals = prior("normal", g.normals, g.losses.normal + g.losses.normal_smooth, found.normals);
    let depths = prior("depth", true, g.losses.depth, found.depths);
    let depth = match (g.losses.depth_smooth > 0.0, g.losses.depth_variance > 0.0) {
        (true, true) => "smoothness and variance have weights",
        (true, false) => "smoothness has a weight",
        (false, true) => "variance has a weight",
        (false, false) => "its losses weigh nothing",
    };
    let semantics = prior("semantic", g.semantics, g.losses.semantic + g.losses.semantic_class, found.semantics);
    let of = |what: &str, on: bool, reason: String, setting: &str| Decision {
        step: 0,
        what: what.to_owned(),
        on,
        reason,
        measured: None,
        requested: None,
        setting: setting.to_owned(),
    };
    vec![
        of("normals", found.normals, normals, "geometry.normals"),
        of("prior depth", found.depths, depths, "geometry.losses.depth"),
        of("depth terms", g.depth_terms(), depth.to_owned(), DEPTH),
        of("semantics", found.semantics, semantics, "geometry.semantics"),
        of("pseudo-views", found.regions, regions, "geometry.losses.correspondence"),
    ]
}

/// Returns the decision whether cameras, exposures and lens are learned.
pub(super) fn of_views(shown: &SensorFindings) -> Decision {
    let lens = if shown.lens_differs() { "differs from" } else { "agrees with" };
    let percent = 100.0 * shown.exposures;
    Decision {
        step: 0,
        what: "learned cameras, exposures and lens".to_owned(),
        on: shown.differs(),
        reason: format!("by the sensor's depth, exposures differ by {percent:.1} %, and the lens {lens} the given one"),
        measured: Some(shown.exposures),
        requested: Some(EXPOSURES),
        setting: "geometry.rates.views".to_owned(),
    }
}

/// Refuses a geometric statistic of densification without a geometric loss. No Gaussian would be densified.
pub(super) fn check_statistic(g: &GeometrySettings, normals: bool) -> Result<()> {
    let d = &g.densify;
    if !d.enabled() || d.rule != DensifyRule::Geometric || normals || g.depth_terms() {
        return Ok(());
    }
    Err(Requirement::GeometricLoss.into())
}

impl Geometry {
    /// Returns the losses that have a weight and cannot run.
    pub fn idle_losses(&self) -> &[IdleLoss] {
        &self.idle
    }

    /// Returns the decisions about the model.
    pub fn decisions(&self) -> &[Decision] {
        &self.decisions
    }
}
