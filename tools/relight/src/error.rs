//! Errors of relighting. Each is one sentence that says what to do.

use sgs_transport::TransportError;
use std::path::PathBuf;

/// Errors of this crate.
#[derive(Debug, thiserror::Error)]
pub enum RelightError {
    /// GPU error.
    #[error(transparent)]
    Engine(#[from] sgs_engine::Error),
    /// Scene error.
    #[error(transparent)]
    Scene(#[from] sgs_scene::SceneError),
    /// Run error.
    #[error(transparent)]
    Run(#[from] sgs_run::RunError),
    /// Invalid setting.
    #[error(transparent)]
    Config(#[from] sgs_config::ConfigError),
    /// Evaluation error.
    #[error(transparent)]
    Evaluate(#[from] sgs_evaluate::EvaluateError),
    /// Error of comparing two images.
    #[error(transparent)]
    Metric(#[from] sgs_evaluate::metrics::MetricError),
    /// Error of training colors.
    #[error(transparent)]
    Train(#[from] sgs_train::TrainError),
    /// Error of light that bounces.
    #[error(transparent)]
    Transport(TransportError),
    /// File that cannot be used.
    #[error("\"{path}\": {reason}.", path = path.display())]
    File {
        /// Path of the file.
        path: PathBuf,
        /// Cause.
        reason: String,
    },
    /// Edit that is impossible, or that names something impossible.
    #[error("{0}")]
    Edit(String),
}

/// Result with [`RelightError`] as its error.
pub type Result<T> = std::result::Result<T, RelightError>;

impl From<TransportError> for RelightError {
    fn from(error: TransportError) -> RelightError {
        match error {
            TransportError::Engine(error) => error.into(),
            TransportError::Scene(error) => error.into(),
            TransportError::Run(error) => error.into(),
            other => RelightError::Transport(other),
        }
    }
}
