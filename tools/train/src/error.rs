//! Errors of training: one sentence each, naming what to do.

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
    /// A network that was asked failed.
    #[error("{0}.")]
    Provider(#[from] sgs_provider::ProviderError),
    /// A setting is wrong.
    #[error(transparent)]
    Config(#[from] sgs_config::ConfigError),
    /// The run directory cannot be used.
    #[error(transparent)]
    Run(#[from] sgs_run::RunError),
    /// What settings ask for is impossible with this scene, run or provider.
    #[error("{0}")]
    Setting(String),
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
    /// Training cannot go on.
    #[error("Training stopped at step {step}: {reason}.{advice}")]
    Diverged {
        /// The step.
        step: u32,
        /// Why.
        reason: String,
        /// How to continue, after a space; empty where nothing is kept.
        advice: String,
    },
}

impl TrainError {
    /// Makes the error of a training that has diverged, before anything is kept of it.
    pub(crate) fn diverged(step: u32, reason: impl Into<String>) -> TrainError {
        TrainError::Diverged { step, reason: reason.into(), advice: String::new() }
    }

    /// Whether the device's memory did not suffice.
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
