//! Errors of settings.

/// Setting that does not exist or has an invalid value.
///
/// The sentence names the setting, its value and the allowed values.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct ConfigError(String);

impl ConfigError {
    /// Creates an error from its sentence.
    pub fn new(sentence: impl Into<String>) -> ConfigError {
        ConfigError(sentence.into())
    }
}

/// Result with this crate's error.
pub type Result<T> = std::result::Result<T, ConfigError>;
