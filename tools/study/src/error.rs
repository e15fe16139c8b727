//! Errors of tables of runs.

/// Errors of this crate.
#[derive(Debug, thiserror::Error)]
pub enum StudyError {
    /// The scene cannot be used.
    #[error(transparent)]
    Scene(#[from] sgs_scene::SceneError),
    /// The run cannot be used.
    #[error(transparent)]
    Run(#[from] sgs_run::RunError),
    /// A setting is wrong.
    #[error(transparent)]
    Config(#[from] sgs_config::ConfigError),
    /// No row has this name.
    #[error("There is no {kind} \"{name}\"; there are {known}.")]
    UnknownRow {
        /// What rows are.
        kind: &'static str,
        /// The name.
        name: String,
        /// The names that exist.
        known: String,
    },
}

/// Result with this crate's error.
pub type Result<T> = std::result::Result<T, StudyError>;
