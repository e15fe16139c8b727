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
    /// Time limit of its start, in seconds.
    pub start_seconds: f64,
    /// Time limit of an answer, in seconds.
    pub answer_seconds: f64,
}

impl Default for ProviderSettings {
    fn default() -> Self {
        let o = ProviderOptions::default();
        ProviderSettings {
            command: String::new(),
            on_failure: Fallback::default(),
            start_seconds: o.start_seconds,
            answer_seconds: o.answer_seconds,
        }
    }
}

impl ProviderSettings {
    /// Checks values that the types do not constrain.
    pub(super) fn check(&self) -> crate::Result<()> {
        for (name, value) in [("start_seconds", self.start_seconds), ("answer_seconds", self.answer_seconds)] {
            if !(value > 0.0 && value.is_finite()) {
                let what = format!("provider.{name} is {value}, but must be a finite number above 0.");
                return Err(ConfigError::new(what));
            }
        }
        Ok(())
    }
}
