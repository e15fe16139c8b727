//! Errors of comparisons of runs.

/// Error of this crate.
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
        /// Kind of the rows.
        kind: &'static str,
        /// Requested name.
        name: String,
        /// Existing names.
        known: String,
    },
}

/// Result with this crate's error.
pub type Result<T> = std::result::Result<T, StudyError>;
