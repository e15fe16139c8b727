//! Decisions about the model, with step and measure. `training.json` holds all of them.

use serde::{Deserialize, Serialize};

/// Decision about a component of the model.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Decision {
    /// Step after which the decision was made; 0 before the first step.
    pub step: u32,
    /// Name of the component.
    pub what: String,
    /// Whether the component is modeled.
    pub on: bool,
    /// Reason, with the figures.
    pub reason: String,
    /// Measured value, if any.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub measured: Option<f64>,
    /// Threshold for the measured value, if any.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub requested: Option<f64>,
    /// Setting that overrides the decision.
    pub setting: String,
}

impl Decision {
    /// Makes a decision that memory forced: the component is left out.
    pub(crate) fn of_memory(step: u32, what: &str, reason: String) -> Decision {
        let setting = "memory.budget".to_owned();
        Decision { step, what: what.to_owned(), on: false, reason, measured: None, requested: None, setting }
    }
}

impl std::fmt::Display for Decision {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let verdict = if self.on { "kept" } else { "left out" };
        match self.step {
            0 => write!(f, "{} {verdict}: {} ({})", self.what, self.reason, self.setting),
            step => write!(f, "{} {verdict} after step {step}: {} ({})", self.what, self.reason, self.setting),
        }
    }
}
