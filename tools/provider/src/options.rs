//! How to start a provider and how long to wait for it.

use serde::{Deserialize, Serialize};

/// Options of a provider.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ProviderOptions {
    /// The command line, split as a shell would; no shell runs it.
    pub command: String,
    /// Seconds to wait for its greeting, in which it may load weights.
    pub start_seconds: f64,
    /// Seconds to wait for each answer.
    pub answer_seconds: f64,
    /// The longest message that is taken, in bytes.
    pub limit: u64,
    /// Seed that goes with every question; the same seed and images should give the same answer.
    pub seed: u64,
}

impl Default for ProviderOptions {
    fn default() -> Self {
        ProviderOptions { command: String::new(), start_seconds: 300.0, answer_seconds: 60.0, limit: 1 << 30, seed: 42 }
    }
}

impl ProviderOptions {
    /// Default options for a command line.
    pub fn new(command: &str) -> ProviderOptions {
        ProviderOptions { command: command.to_owned(), ..ProviderOptions::default() }
    }
}
