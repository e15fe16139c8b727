//! Errors of relighting: one sentence each, naming what to do.

use std::path::PathBuf;

/// Errors of this crate.
#[derive(Debug, thiserror::Error)]
pub enum RelightError {
    /// The GPU side failed.
    #[error(transparent)]
    Engine(#[from] sgs_engine::Error),
    /// The scene cannot be used.
    #[error(transparent)]
    Scene(#[from] sgs_scene::SceneError),
    /// The run cannot be used.
    #[error(transparent)]
    Run(#[from] sgs_run::RunError),
    /// A setting is wrong.
    #[error(transparent)]
    Config(#[from] sgs_config::ConfigError),
    /// A measure has no value.
    #[error(transparent)]
    Evaluate(#[from] sgs_evaluate::EvaluateError),
    /// Two images cannot be compared.
    #[error(transparent)]
    Metric(#[from] sgs_evaluate::metrics::MetricError),
    /// Colors cannot be trained.
    #[error(transparent)]
    Train(#[from] sgs_train::TrainError),
    /// A file cannot be used.
    #[error("\"{path}\": {reason}.", path = path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        reason: String,
    },
    /// The edit, or what it names, is impossible.
    #[error("{0}")]
    Edit(String),
}

/// Result with this crate's error.
pub type Result<T> = std::result::Result<T, RelightError>;
