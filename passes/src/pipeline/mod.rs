//! Pipelines: training steps, renders, shaded views and their display.
//!
//! Guarantees: plans are built once and replayed. An overflow of tile entries loses no training state. The flag stays
//! set, and every later step leaves the parameters unchanged. The host grows the buffer and replays from the first step
//! that the overflow affected.

mod align;
mod densify;
mod display;
mod geometry;
mod intrinsic;
mod labeler;
mod lit;
mod render;
mod shaded;
mod shading;
mod status;
mod surface;
mod transport;
mod view;

pub use align::Aligner;
pub use densify::{DensifyRule, DensifyStep, OpacityReset};
pub use display::{Display, DisplayRoom, Font, Shown};
pub use geometry::{
    GeometryOptions, GeometryStep, InputSizes, Inputs, Masks, PSEUDO_VIEWS, SemanticInputs, SemanticSizes,
};
pub use intrinsic::{
    COPIES, EnvironmentMemory, EnvironmentRefresh, IntrinsicInputs, IntrinsicOptions, IntrinsicParameters,
    IntrinsicRates, IntrinsicSizes, IntrinsicStatus, IntrinsicStep, IntrinsicStepValues, LightTrainables, RelitOptions,
    RelitView, StoredEnvironment, TransportTrainables, TransportTraining, ViewImages,
};
pub use labeler::{FeatureImage, LabelMap, Labeler, Query};
pub use lit::{Lighting, LitEnvironment, LitFrame, LitLayer, LitOptions, LitScene, LitView};
pub use render::{RenderedImage, Renderer};
pub use shaded::{Shaded, ShadedEnvironment, ShadedLights, ShadedVisibility};
pub use shading::{ShadedScene, Shader};
pub use status::{RING, Status};
pub use surface::{Surface, SurfaceBuilder, SurfaceHandles, SurfaceShape, WeightColumns};
pub use transport::{
    FrameEmitter, Responder, ShadedTransport, TransportContents, TransportMemory, TransportOptions, TransportScene,
    TransportShape, ViewLights,
};
pub use view::{Frame, View, ViewError, ViewOptions, ViewReport, ViewResult};

pub use sgs_shaders::structs::{
    Camera, Densify as DensifySettings, DensifyStats, FieldStep, IntrinsicReport, LearnedView, LitStep, LossStats,
    MaterialStats, MaterialWeights, SemanticTarget, Step, StepReport,
};
