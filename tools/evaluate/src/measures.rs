//! Results of evaluation: metrics of views and their means.

use crate::error::Result;
use crate::metrics::{self, Lpips, LpipsAbout};
use crate::speed::Fps;
use serde::Serialize;
use sgs_scene::Image;
use std::collections::BTreeMap;

/// Metrics of one view. A metric without ground truth is absent.
#[derive(Clone, Debug, Serialize)]
pub struct ViewMetrics {
    /// Name of the view.
    pub name: String,
    /// Metrics of novel-view synthesis.
    pub nvs: Nvs,
    /// Mean angular error of normals in degrees. A pixel without a rendered normal counts as 90°.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub normal_mae_deg: Option<f64>,
    /// Share of the pixels with a true normal that have a rendered one, 0 to 1.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub normal_coverage: Option<f64>,
    /// Mean relative error of depth.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub depth_rel: Option<f64>,
    /// Mean relative difference from the depth that a sensor measured.
    ///
    /// Measured after alignment if the view was aligned.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sensor_depth_rel: Option<f64>,
    /// Metrics of classes.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub semantic: Option<Semantic>,
    /// Metrics of materials and of the shaded image ([`crate::evaluate_shaded`]).
    #[serde(flatten)]
    pub shaded: Option<ShadedMetrics>,
}

/// Image metrics.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Nvs {
    /// PSNR in dB, from the mean squared error of all channels together.
    pub psnr: f64,
    /// Structural similarity.
    pub ssim: f64,
    /// Mean FLIP: the difference that an observer sees when alternating both images. 0 none, 1 the largest
    /// ([`metrics::flip`]).
    pub flip: f64,
    /// LPIPS, where weights are available ([`metrics::Lpips`]).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub lpips: Option<f64>,
    /// PSNR in dB after alignment with the photograph.
    ///
    /// Aligned are the camera, and the exposure if training learned exposures.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub psnr_aligned: Option<f64>,
    /// Structural similarity after the same alignment.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ssim_aligned: Option<f64>,
}

impl Nvs {
    /// Compares an image with the truth where the mask counts. Both are display-referred.
    pub(crate) fn of(ours: &Image, theirs: &Image, mask: Option<&Image>, lpips: Option<&Lpips>) -> Result<Nvs> {
        Ok(Nvs {
            psnr: metrics::psnr(ours, theirs, mask)?,
            ssim: metrics::ssim(ours, theirs, mask)?,
            flip: metrics::flip(ours, theirs, mask)?,
            lpips: lpips.map(|l| l.distance(ours, theirs, mask)).transpose()?,
            psnr_aligned: None,
            ssim_aligned: None,
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
    /// Metrics of novel-view synthesis.
    pub nvs: Nvs,
    /// Mean angular error of normals in degrees.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub normal_mae_deg: Option<f64>,
    /// Share of the pixels with a true normal that have a rendered one, 0 to 1.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub normal_coverage: Option<f64>,
    /// Mean relative error of depth.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub depth_rel: Option<f64>,
    /// Mean relative difference from the depth that a sensor measured.
    ///
    /// Measured after alignment if the view was aligned.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sensor_depth_rel: Option<f64>,
    /// Metrics of classes.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub semantic: Option<Semantic>,
    /// Metrics of materials and of the shaded image ([`crate::evaluate_shaded`]).
    #[serde(flatten)]
    pub shaded: Option<ShadedMetrics>,
    /// Rendering speed, where measured ([`crate::render_fps`], [`crate::shade_fps`]).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub fps: Option<Fps>,
}

/// Metrics of a split.
#[derive(Clone, Debug, Serialize)]
pub struct Evaluation {
    /// Means over its views.
    pub mean: Means,
    /// Description of the LPIPS that was measured, if any.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub lpips: Option<LpipsAbout>,
    /// Metrics of each view.
    pub views: Vec<ViewMetrics>,
}

/// Metrics of a shaded view, or their means. A metric without ground truth is absent.
#[derive(Clone, Debug, Default, Serialize)]
pub struct ShadedMetrics {
    /// Display-referred shaded image, measured as a novel view.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub pbr: Option<Nvs>,
    /// Metrics of albedo.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub albedo: Option<AlbedoMetrics>,
    /// Mean squared error of roughness.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub roughness_mse: Option<f64>,
    /// Mean squared error of metallic.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub metallic_mse: Option<f64>,
    /// Metrics under other lights, by name of the relit set. Means also have the entry [`RELIT_MEAN`].
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub relit: BTreeMap<String, RelitSet>,
    /// PSNR by how often light bounces, by name of the relit set. Means of runs with emitters alone.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub relit_bounces: BTreeMap<String, BouncesPsnr>,
}

/// PSNR in dB of a relit set under parts of the light. Mean over the views.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct BouncesPsnr {
    /// Direct light of the true lights.
    pub direct: f64,
    /// With one bounce.
    pub one_bounce: f64,
    /// With all bounces.
    pub all_bounces: f64,
    /// Learned emitters with all bounces; those nearest to changed true lights change as these do.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub learned_emitters: Option<f64>,
}

/// Metrics of albedo, compared as it is displayed (sRGB).
#[derive(Clone, Copy, Debug, Serialize)]
pub struct AlbedoMetrics {
    /// PSNR in dB.
    pub psnr: f64,
    /// Structural similarity.
    pub ssim: f64,
    /// PSNR in dB after one gain per channel for all views together. The gain is fitted and applied to linear values.
    pub psnr_scaled: f64,
    /// PSNR in dB after one gain per channel for this view alone. The gain is fitted and applied to sRGB values.
    pub psnr_scaled_per_view: f64,
    /// LPIPS, where weights are available.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub lpips: Option<f64>,
}

/// Key of the mean over all relit sets that were measured.
pub const RELIT_MEAN: &str = "mean";

/// Metrics of a view under other lights, or of their mean. Images are display-referred.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct RelitMetrics {
    /// PSNR in dB.
    pub psnr: f64,
    /// Structural similarity.
    pub ssim: f64,
    /// PSNR in dB after one gain for all channels and views. The gain is fitted to linear pixels of all views of the
    /// set.
    pub psnr_gain: f64,
    /// PSNR in dB after one gain for all channels of this view. The gain is fitted to its linear pixels.
    pub psnr_gain_per_view: f64,
}

/// Relit set: its metrics, or the reason why it has none.
#[derive(Clone, Debug, Serialize)]
#[serde(untagged)]
pub enum RelitSet {
    /// The set was rendered and measured.
    Measured(RelitMetrics),
    /// The set could not be rendered.
    Skipped {
        /// Reason, one sentence.
        reason: String,
    },
}

impl RelitSet {
    /// Returns the metrics, if the set was measured.
    pub fn metrics(&self) -> Option<&RelitMetrics> {
        match self {
            RelitSet::Measured(metrics) => Some(metrics),
            RelitSet::Skipped { .. } => None,
        }
    }
}

/// Returns none for a metric in which no pixel counts. A view of the sky alone is thus treated as one without ground
/// truth.
pub(crate) fn known<T>(value: std::result::Result<T, metrics::MetricError>) -> Result<Option<T>> {
    match value {
        Err(metrics::MetricError::Empty { .. }) => Ok(None),
        other => Ok(Some(other?)),
    }
}
