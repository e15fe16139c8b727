//! Errors of settings.

use std::fmt::Display;

/// Setting that does not exist or has an invalid value.
///
/// The sentence names the setting, its value and the allowed values.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ConfigError {
    /// Setting that does not exist.
    #[error("\"{name}\" is not a setting; {}", hint(nearest.as_deref(), known))]
    UnknownSetting {
        /// Name of the setting, with its groups.
        name: String,
        /// Most similar setting, or the one that replaced it.
        nearest: Option<String>,
        /// Settings of the same group.
        known: Vec<String>,
    },
    /// Preset or level of accuracy that does not exist.
    #[error("\"{name}\" is {kind} {}there are {}.", question(nearest.as_deref()), known.join(", "))]
    UnknownName {
        /// What the name is not: "not a preset;" or "no accuracy;".
        kind: &'static str,
        /// The name.
        name: String,
        /// Most similar name.
        nearest: Option<String>,
        /// All names.
        known: Vec<String>,
    },
    /// Value of another type than the setting's.
    #[error("{setting} is {value}, but must be {expected}.")]
    WrongType {
        /// Name of the setting.
        setting: String,
        /// Its value, as TOML.
        value: String,
        /// Expected type.
        expected: String,
    },
    /// Word that the setting does not allow.
    #[error("\"{setting}\" is \"{word}\", but must be one of {}{}", quoted(known), end(nearest.as_deref()))]
    UnknownWord {
        /// Name of the setting.
        setting: String,
        /// The word.
        word: String,
        /// Most similar allowed word.
        nearest: Option<String>,
        /// All allowed words.
        known: Vec<String>,
    },
    /// Item that the list of a setting does not allow.
    #[error("{setting} has {item}, but must be a list of {}.", known.join(", "))]
    UnknownItem {
        /// Name of the setting.
        setting: String,
        /// The item, as TOML.
        item: String,
        /// All allowed items.
        known: Vec<String>,
    },
    /// Value outside the allowed range.
    #[error("{setting} is {value}, but must be {allowed}.")]
    OutOfRange {
        /// Name of the setting.
        setting: String,
        /// Its value.
        value: String,
        /// Allowed values.
        allowed: String,
    },
    /// Values that cannot be combined; a sentence.
    #[error("{0}")]
    Combination(String),
    /// Text or table that cannot be read or written as settings; a sentence.
    #[error("{0}")]
    Format(String),
}

impl ConfigError {
    /// Creates the error of a value outside the allowed range.
    pub(crate) fn range(setting: impl Display, value: impl Display, allowed: impl Into<String>) -> ConfigError {
        let (setting, value) = (setting.to_string(), value.to_string());
        ConfigError::OutOfRange { setting, value, allowed: allowed.into() }
    }

    /// Creates the error of a value of another type.
    pub(crate) fn kind(setting: impl Display, value: impl Display, expected: impl Into<String>) -> ConfigError {
        let (setting, value) = (setting.to_string(), value.to_string());
        ConfigError::WrongType { setting, value, expected: expected.into() }
    }
}

/// Suggests the most similar name, or lists all.
fn hint(nearest: Option<&str>, known: &[String]) -> String {
    match nearest {
        Some(near) => format!("did you mean \"{near}\"?"),
        None => format!("there are {}.", known.join(", ")),
    }
}

/// Suggests the most similar name before a list.
fn question(nearest: Option<&str>) -> String {
    nearest.map_or_else(String::new, |near| format!("did you mean \"{near}\"? "))
}

/// Suggests the most similar word after a list, or ends the sentence.
fn end(nearest: Option<&str>) -> String {
    nearest.map_or_else(|| ".".to_owned(), |near| format!("; did you mean \"{near}\"?"))
}

/// Lists words in quotation marks.
fn quoted(words: &[String]) -> String {
    words.iter().map(|word| format!("\"{word}\"")).collect::<Vec<_>>().join(", ")
}

/// Result with this crate's error.
pub type Result<T> = std::result::Result<T, ConfigError>;
