//! Errors of settings.

/// A setting that does not exist, or whose value is not allowed. The sentence names the setting, the value and what is allowed.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct ConfigError(String);

impl ConfigError {
    /// Makes an error from its sentence.
    pub fn new(sentence: impl Into<String>) -> ConfigError {
        ConfigError(sentence.into())
    }
}

/// Result with this crate's error.
pub type Result<T> = std::result::Result<T, ConfigError>;
