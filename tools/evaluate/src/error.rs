//! Errors of evaluation.

/// Error of this crate.
#[derive(Debug, thiserror::Error)]
pub enum EvaluateError {
    /// The GPU engine failed.
    #[error(transparent)]
    Engine(#[from] sgs_engine::Error),
    /// The scene cannot be used.
    #[error(transparent)]
    Scene(#[from] sgs_scene::SceneError),
    /// The run cannot be used.
    #[error(transparent)]
    Run(#[from] sgs_run::RunError),
    /// Two images cannot be compared.
    #[error(transparent)]
    Metric(#[from] crate::metrics::MetricError),
}

/// Result with this crate's error.
pub type Result<T> = std::result::Result<T, EvaluateError>;
