//! Start options and time limits of a provider.

use serde::{Deserialize, Serialize};

/// Options of a provider.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ProviderOptions {
    /// Command line, split like in a shell. No shell runs it.
    pub command: String,
    /// Time limit for the greeting in seconds. The provider may load weights in that time.
    pub start_seconds: f64,
    /// Time limit for each answer in seconds.
    pub answer_seconds: f64,
    /// Longest accepted message in bytes.
    pub limit: u64,
    /// Seed of every question. Equal seeds and images should give equal answers.
    pub seed: u64,
}

impl Default for ProviderOptions {
    fn default() -> Self {
        ProviderOptions { command: String::new(), start_seconds: 300.0, answer_seconds: 60.0, limit: 1 << 30, seed: 42 }
    }
}

impl ProviderOptions {
    /// Returns default options for a command line.
    pub fn new(command: &str) -> ProviderOptions {
        ProviderOptions { command: command.to_owned(), ..ProviderOptions::default() }
    }
}
