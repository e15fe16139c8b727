//! Errors of training: one sentence each, naming what to do.

use sgs_run::StageKind;
use sgs_transport::TransportError;
use std::path::{Path, PathBuf};

/// Errors of this crate.
#[derive(Debug, thiserror::Error)]
pub enum TrainError {
    /// The GPU side failed.
    #[error(transparent)]
    Engine(#[from] sgs_engine::Error),
    /// The scene cannot be used.
    #[error(transparent)]
    Scene(#[from] sgs_scene::SceneError),
    /// A provider failed.
    #[error("{0}.")]
    Provider(#[from] sgs_provider::ProviderError),
    /// A setting is wrong.
    #[error(transparent)]
    Config(#[from] sgs_config::ConfigError),
    /// The run directory cannot be used.
    #[error(transparent)]
    Run(#[from] sgs_run::RunError),
    /// The room cannot be fitted.
    #[error(transparent)]
    Transport(TransportError),
    /// Something that the settings require is missing.
    #[error(transparent)]
    Requirement(#[from] Requirement),
    /// The device's memory does not suffice.
    #[error("{0}")]
    Memory(String),
    /// The device does not allow buffers of the size that training needs.
    #[error("{0}")]
    Limit(String),
    /// A file of a run cannot be used.
    #[error("\"{path}\": {reason}.", path = path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        reason: String,
    },
    /// Training diverged and cannot go on.
    #[error("Training stopped at step {step}: {reason}.{advice}")]
    Diverged {
        /// The step.
        step: u32,
        /// The reason.
        reason: String,
        /// How to continue, after a space; empty where nothing is saved.
        advice: String,
    },
}

/// Unmet requirement of the settings. The scene, run, provider or device does not meet it.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Requirement {
    /// Geometry is both trained and provided.
    #[error("Geometry cannot be trained and given at once; train the intrinsic stage alone, or give no geometry.")]
    OneGeometry,
    /// A stage after the geometry stage has no geometry.
    #[error("The stage requires geometry; train the geometry stage first, or name a file.")]
    Geometry,
    /// A run directory holds no geometry.
    #[error(
        "\"{path}\": no geometry; train it first with --stage geometry or all, or give it with --start.",
        path = .0.display()
    )]
    GeometryIn(PathBuf),
    /// The settings leave the transport stage out.
    #[error("transport.surfels is 0, which leaves the transport stage out; set it to 64 or more.")]
    Surfels,
    /// Neither a stage nor a result holds Gaussians.
    #[error("The training holds no Gaussians; start a stage first.")]
    Gaussians,
    /// The geometry of a stage is empty.
    #[error("The geometry has no Gaussians to train materials for; train the geometry stage first.")]
    NotEmpty,
    /// The training has ended with an error.
    #[error("The training has ended with an error and cannot continue; resume its run.")]
    NotFailed,
    /// No stage has started.
    #[error("Nothing is trained yet; there is nothing to save.")]
    ActiveStage,
    /// A checkpoint is beyond the last step.
    #[error(
        "\"{path}\" is the state after step {step}, but {kind}.steps is {steps}; set {kind}.steps to {step} or more.",
        path = .path.display()
    )]
    MoreSteps {
        /// Checkpoint.
        path: PathBuf,
        /// Its stage.
        kind: StageKind,
        /// Its step.
        step: u32,
        /// Number of steps of the settings.
        steps: u32,
    },
    /// Views or region maps hold more pixels than 32 bits count.
    #[error("{what} hold more than 2^32 pixels; use {remedy}.")]
    FewerPixels {
        /// "The training views" or "Region maps".
        what: &'static str,
        /// Options that reduce them.
        remedy: &'static str,
    },
    /// Text embeddings have another width than the decoder.
    #[error(
        "The text embeddings are {found} wide, but the decoder makes {expected} numbers; compute priors/semantic with CLIP \
         ViT-B/16 or a network of that width."
    )]
    EmbeddingWidth {
        /// Width of the file.
        found: usize,
        /// Width of the decoder.
        expected: usize,
    },
    /// Semantic maps hold more cells than one buffer can.
    #[error("The semantic maps hold {0} cells, more than the 16777215 that one buffer can; make them smaller.")]
    FewerCells(u64),
    /// A provider does not answer the questions that a loss asks.
    #[error("The provider of {setting} offers no {missing}; it offers {offers}. {remedy}.")]
    ProviderOffer {
        /// Setting that names the provider.
        setting: &'static str,
        /// Missing answer.
        missing: String,
        /// What the provider offers.
        offers: String,
        /// How to continue.
        remedy: &'static str,
    },
    /// Densification by geometric losses runs without one.
    #[error(
        "geometry.densify.rule = \"geometric\" requires a loss of normals or depth; give geometry.losses.depth_smooth a weight, use \
         another statistic, or add --no-densify."
    )]
    GeometricLoss,
    /// The device has no atomic additions of floats.
    #[error(
        "geometry.backward is \"atomic\", but the device has no atomics of 32-bit floats (shaderBufferFloat32AtomicAdd); use \
         \"auto\"."
    )]
    FloatAtomics,
    /// An environment map or visibility field of the settings' size is not possible.
    #[error("{setting}: {reason}")]
    Size {
        /// Table of the settings.
        setting: &'static str,
        /// What is wrong.
        reason: String,
    },
}

impl From<TransportError> for TrainError {
    fn from(error: TransportError) -> TrainError {
        match error {
            TransportError::Engine(error) => error.into(),
            TransportError::Scene(error) => error.into(),
            TransportError::Run(error) => error.into(),
            other => TrainError::Transport(other),
        }
    }
}

impl TrainError {
    /// Makes the error of a training that has diverged, before anything of it is saved.
    pub(crate) fn diverged(step: u32, reason: impl Into<String>) -> TrainError {
        TrainError::Diverged { step, reason: reason.into(), advice: String::new() }
    }

    /// Returns whether the device's memory did not suffice.
    pub fn is_out_of_memory(&self) -> bool {
        match self {
            TrainError::Engine(error) => error.is_out_of_memory(),
            TrainError::Run(error) => error.is_out_of_memory(),
            TrainError::Memory(_) => true,
            _ => false,
        }
    }
}

/// Result with this crate's error.
pub type Result<T> = std::result::Result<T, TrainError>;

/// Makes an error about a file.
pub(crate) fn error(path: &Path, reason: String) -> TrainError {
    TrainError::File { path: path.to_owned(), reason }
}
