//! Which network is asked while training, and how long to wait for it.

use crate::error::ConfigError;
use serde::{Deserialize, Serialize};
use sgs_provider::{Fallback, ProviderOptions};

/// A network that lives in another process (docs/guide/priors.md).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ProviderSettings {
    /// Its command line, split as a shell would; empty for none. It is asked where the step's region is in training view
    /// and pseudo-views.
    pub command: String,
    /// Whether its failure stops training (`stop`), or ends what it is asked for (`go-on`).
    pub on_failure: Fallback,
    /// Seconds to wait for its start.
    pub start_seconds: f64,
    /// Seconds to wait for each answer.
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
    /// What cannot be meant.
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
