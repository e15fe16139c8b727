//! Settings of the provider that training queries: command line and time limits.

use crate::error::ConfigError;
use serde::{Deserialize, Serialize};
use sgs_provider::{Fallback, ProviderOptions};

/// A provider of region masks (docs/guide/priors.md).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ProviderSettings {
    /// Command line of the provider; empty uses none. Steps that compare a region query it for masks in training view and
    /// pseudo-views.
    pub command: String,
    /// After a failure of the provider: `stop` ends training, `go-on` continues without it.
    pub on_failure: Fallback,
    /// Time limits of its start and of an answer, in seconds.
    pub seconds: [f64; 2],
}

impl Default for ProviderSettings {
    fn default() -> Self {
        let o = ProviderOptions::default();
        ProviderSettings {
            command: String::new(),
            on_failure: Fallback::default(),
            seconds: [o.start_seconds, o.answer_seconds],
        }
    }
}

impl ProviderSettings {
    /// Checks values that the types do not constrain.
    pub(super) fn check(&self) -> crate::Result<()> {
        let [start, answer] = self.seconds;
        if [start, answer].iter().any(|s| !(*s > 0.0 && s.is_finite())) {
            let value = format_args!("[{start}, {answer}]");
            return Err(ConfigError::range("provider.seconds", value, "two finite numbers above 0"));
        }
        Ok(())
    }
}
