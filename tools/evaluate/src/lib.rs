//! Image metrics, and evaluation of a run against photographs and ground truth.

mod align;
mod error;
mod evaluate;
mod measures;
pub mod metrics;
mod shaded;
mod speed;
mod valid;

pub use error::{EvaluateError, Result};
pub use evaluate::{EvaluateOptions, Rendered, evaluate, evaluate_classes, normals_from_depth};
pub use measures::{
    AlbedoMetrics, BouncesPsnr, Evaluation, Means, Nvs, RELIT_MEAN, RelitMetrics, RelitSet, Semantic, ShadedMetrics,
    ViewMetrics,
};
pub use shaded::{RelitPair, evaluate_shaded, mean, measure_relit};
pub use speed::{Fps, render_fps, shade_fps};
