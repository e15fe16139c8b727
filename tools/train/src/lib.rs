//! Training: the [`Trainer`], its stages, and the providers that it queries.
//!
//! This crate knows datasets and schedules; it makes no Vulkan calls.

mod correspondence;
mod course;
mod data;
mod decision;
mod divergence;
mod error;
mod framing;
#[doc(hidden)]
pub mod fuzzed;
mod geometry;
mod idle;
mod intrinsic;
mod limits;
mod memory;
mod normals;
mod pseudo;
mod reduce;
mod region_provider;
mod regions;
mod schedule;
mod semantics;
mod stage;
mod trainer;
mod transport;
mod uniforms;

pub use correspondence::Correspondence;
pub use data::{Photographs, PixelPriors, TrainingData};
pub use decision::Decision;
pub use divergence::RollBack;
pub use error::{Requirement, Result, TrainError};
pub use framing::Framing;
pub use geometry::{Geometry, Progress, Sight, StepLog};
pub use idle::{IdleLoss, PriorKinds};
pub use intrinsic::{
    AlbedoComparisons, CONSISTENCY_INTERVAL, Intrinsic, IntrinsicLog, IntrinsicNeeds, LoggedLosses, Probe,
};
pub use memory::Needs;
pub use pseudo::PseudoViews;
pub use region_provider::FrameRendering;
pub use regions::{LEAST_PIXELS, PseudoMaps, RegionMaps, RegionSource, RegionView};
pub use schedule::Schedule;
pub use semantics::{SemanticData, SemanticMaps, SemanticView};
pub use stage::{RoomFit, Stage, StageEvent, StepFigures};
pub use trainer::{Event, Observer, Outcome, StageSummary, StartGeometry, Trainer, TrainerOptions};
pub use transport::{Transport, TransportPlan};

pub use sgs_transport::FitNeeds;
