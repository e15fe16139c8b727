//! Training: settings, the geometry stage, checkpoints, evaluation, the run directory, ablations.
//!
//! Knows datasets and schedules; never Vulkan calls. The command line is a thin shell around this crate.

pub mod ablate;
mod asked;
mod checkpoint;
mod classify;
mod contents;
mod convert;
mod correspondence;
mod data;
mod divergence;
mod error;
mod evaluate;
mod evaluate_shaded;
mod exchange;
mod floats;
mod framing;
#[doc(hidden)]
pub mod fuzzed;
mod geometry;
mod head;
mod idle;
mod intrinsic;
mod limits;
mod lock;
mod memory;
pub mod metrics;
mod normals;
mod pseudo;
mod regions;
mod relight;
mod run;
mod schedule;
mod semantics;
mod settings;
mod shaded;
mod shadows;
mod speed;
mod trainer;
mod visibility;

pub use asked::Look;
pub use classify::{Classes, Classifier, NO_RELEVANCE};
pub use contents::{Contents, RunContents, entries};
pub use convert::{camera, gaussian_data, splats};
pub use correspondence::Correspondence;
pub use data::TrainingData;
pub use divergence::RollBack;
pub use error::{Result, TrainError};
pub use evaluate::{
    Evaluation, Means, Nvs, Rendered, Semantic, ViewMetrics, evaluate, evaluate_classes, normals_from_depth,
    render_view,
};
pub use evaluate_shaded::{
    AlbedoMetrics, RELIT_MEAN, RelitMetrics, RelitSet, ShadedMetrics, evaluate_shaded, measure_relit,
};
pub use exchange::{Exchange, read_exchange, read_light, read_splats, write_exchange};
pub use framing::Framing;
pub use geometry::{Decision, Geometry, Progress, Sight, StepLog};
pub use head::SemanticHead;
pub use idle::IdleLoss;
pub use intrinsic::{
    Intrinsic, IntrinsicLog, IntrinsicNeeds, LightFile, LightRow, LobeRow, LoggedLosses, Probe, read_lights,
    write_lights,
};
pub use lock::{DirectoryLock, LockHolder};
pub use memory::{Needs, parse_bytes};
pub use pseudo::{Neighbors, Position, PseudoOptions, PseudoViews};
pub use regions::{LEAST_PIXELS, PseudoMaps, RegionMaps, RegionSource, RegionView};
pub use relight::{
    BakeOptions, Baked, Edit, EnvironmentEdit, Insert, Lamp, LightChange, LightEdit, MaterialEdit, MaterialValues,
    NewLight, Region, Relighter, Relit, Selector, Turn, Where, bake, bake_cameras, baked_psnr, evaluate_relit,
    skip_relit, source_of,
};
pub use run::RunDirectory;
pub use schedule::Schedule;
pub use semantics::{SemanticData, SemanticMaps, SemanticView};
pub use settings::{
    AutomaticSettings, Backward, DensifyOptions, DensifyStatistic, EnvironmentSettings, GeometrySettings,
    IntrinsicLosses, IntrinsicRates, IntrinsicSettings, LightSettings, LobeLayout, LossWeights, MOST_BANDS,
    MaterialStart, MemorySettings, Metallic, OnDivergence, OwnPrior, PRESETS, Preset, ProviderSettings, Rates,
    RelightSettings, Settings, ShDegree, TrainSettings, VisibilityKind, VisibilitySettings, accuracy_named, overlay,
};
pub use shaded::{RunLight, ShadedView, Shading, Texels, Visibility, displayed, light_of, shaded_scene};
pub use shadows::Rays;
pub use speed::{Fps, render_fps, shade_fps};
pub use trainer::{
    Event, Observer, Outcome, Stage, StageEvent, StageKind, StageSummary, StartGeometry, StepFigures, Trainer,
    TrainerOptions,
};
pub use visibility::VisibilityFile;
