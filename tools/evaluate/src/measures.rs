//! What evaluation reports: metrics of views and their means.

use crate::error::Result;
use crate::metrics::{self, Lpips, LpipsAbout};
use crate::speed::Fps;
use serde::Serialize;
use sgs_scene::Image;
use std::collections::BTreeMap;

/// Metrics of one view; what has no ground truth is absent.
#[derive(Clone, Debug, Serialize)]
pub struct ViewMetrics {
    /// The view's name.
    pub name: String,
    /// Novel-view synthesis.
    pub nvs: Nvs,
    /// Mean angular error of normals, degrees; a pixel without a rendered normal counts as 90°.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub normal_mae_deg: Option<f64>,
    /// Share of the pixels with a true normal that have a rendered one, 0 to 1.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub normal_coverage: Option<f64>,
    /// Mean relative error of depth.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub depth_rel: Option<f64>,
    /// Classes.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub semantic: Option<Semantic>,
    /// Materials and the shaded picture ([`crate::evaluate_shaded`]).
    #[serde(flatten)]
    pub shaded: Option<ShadedMetrics>,
}

/// Image metrics.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Nvs {
    /// dB, joint mean squared error.
    pub psnr: f64,
    /// Structural similarity.
    pub ssim: f64,
    /// FLIP, the mean difference that somebody sees who flips between the two: 0 none, 1 the most ([`metrics::flip`]).
    pub flip: f64,
    /// LPIPS, where there are weights ([`metrics::Lpips`]).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub lpips: Option<f64>,
}

impl Nvs {
    /// Measures a picture against the truth where the mask says that it counts; both display-referred.
    pub(crate) fn of(ours: &Image, theirs: &Image, mask: Option<&Image>, lpips: Option<&Lpips>) -> Result<Nvs> {
        Ok(Nvs {
            psnr: metrics::psnr(ours, theirs, mask)?,
            ssim: metrics::ssim(ours, theirs, mask)?,
            flip: metrics::flip(ours, theirs, mask)?,
            lpips: lpips.map(|l| l.distance(ours, theirs, mask)).transpose()?,
        })
    }
}

/// Metrics of classes.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Semantic {
    /// Share of pixels with the true class.
    pub accuracy: f64,
}

/// Means over the views.
#[derive(Clone, Debug, Serialize)]
pub struct Means {
    /// Novel-view synthesis.
    pub nvs: Nvs,
    /// Degrees.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub normal_mae_deg: Option<f64>,
    /// Share of the pixels with a true normal that have a rendered one, 0 to 1.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub normal_coverage: Option<f64>,
    /// Relative.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub depth_rel: Option<f64>,
    /// Classes.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub semantic: Option<Semantic>,
    /// Materials and the shaded picture ([`crate::evaluate_shaded`]).
    #[serde(flatten)]
    pub shaded: Option<ShadedMetrics>,
    /// Rendering speed, where it was measured ([`crate::render_fps`], [`crate::shade_fps`]).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub fps: Option<Fps>,
}

/// Metrics of a split.
#[derive(Clone, Debug, Serialize)]
pub struct Evaluation {
    /// Means over its views.
    pub mean: Means,
    /// Which LPIPS was measured, if it was.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub lpips: Option<LpipsAbout>,
    /// One entry a view.
    pub views: Vec<ViewMetrics>,
}

/// Metrics of a shaded view, or their means; what has no ground truth is absent.
#[derive(Clone, Debug, Default, Serialize)]
pub struct ShadedMetrics {
    /// The shaded picture, display-referred, as a novel view.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub pbr: Option<Nvs>,
    /// Albedo.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub albedo: Option<AlbedoMetrics>,
    /// Mean squared error of roughness.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub roughness_mse: Option<f64>,
    /// Mean squared error of metallic.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub metallic_mse: Option<f64>,
    /// Under other lights, by name; among means also [`RELIT_MEAN`].
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub relit: BTreeMap<String, RelitSet>,
}

/// Metrics of albedo, compared as it is displayed (sRGB).
#[derive(Clone, Copy, Debug, Serialize)]
pub struct AlbedoMetrics {
    /// dB.
    pub psnr: f64,
    /// Structural similarity.
    pub ssim: f64,
    /// dB after one gain per channel for all views together. The gain is fitted and applied in linear light.
    pub psnr_scaled: f64,
    /// dB after one gain per channel for this view alone. The gain is fitted and applied to sRGB values.
    pub psnr_scaled_per_view: f64,
    /// LPIPS, where there are weights.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub lpips: Option<f64>,
}

/// Key of the mean over all relit sets that were measured.
pub const RELIT_MEAN: &str = "mean";

/// Metrics of a view under other lights, or of their mean, display-referred.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct RelitMetrics {
    /// dB.
    pub psnr: f64,
    /// Structural similarity.
    pub ssim: f64,
    /// dB after one gain for all channels of all linear pixels of all views of the set.
    pub psnr_gain: f64,
    /// dB after one gain for all channels of all linear pixels of this view.
    pub psnr_gain_per_view: f64,
}

/// A relit set: its metrics, or why it has none.
#[derive(Clone, Debug, Serialize)]
#[serde(untagged)]
pub enum RelitSet {
    /// It was rendered and measured.
    Measured(RelitMetrics),
    /// It could not be rendered.
    Skipped {
        /// One sentence.
        reason: String,
    },
}

impl RelitSet {
    /// The metrics, if the set was measured.
    pub fn metrics(&self) -> Option<&RelitMetrics> {
        match self {
            RelitSet::Measured(metrics) => Some(metrics),
            RelitSet::Skipped { .. } => None,
        }
    }
}

/// A measure in which no pixel counts (a view of the sky alone) is absent, as one without ground truth is.
pub(crate) fn known<T>(value: std::result::Result<T, metrics::MetricError>) -> Result<Option<T>> {
    match value {
        Err(metrics::MetricError::Empty { .. }) => Ok(None),
        other => Ok(Some(other?)),
    }
}
