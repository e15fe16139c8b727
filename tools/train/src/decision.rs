//! Decisions about the model: what, when, and by what measure. `training.json` holds all of them.

use serde::{Deserialize, Serialize};

/// A decision about what is modeled.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Decision {
    /// After which step; 0 before the first.
    pub step: u32,
    /// What it is about.
    pub what: String,
    /// Whether it is modeled.
    pub on: bool,
    /// Why, with the figures.
    pub reason: String,
    /// What was measured, where something was.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub measured: Option<f64>,
    /// What was asked of it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub asked: Option<f64>,
    /// The setting that forces it.
    pub setting: String,
}

impl Decision {
    /// One that memory forced.
    pub(crate) fn of_memory(step: u32, what: &str, reason: String) -> Decision {
        let setting = "memory.budget".to_owned();
        Decision { step, what: what.to_owned(), on: false, reason, measured: None, asked: None, setting }
    }
}

impl std::fmt::Display for Decision {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let kept = if self.on { "kept" } else { "left out" };
        match self.step {
            0 => write!(f, "{} {kept}: {} ({})", self.what, self.reason, self.setting),
            step => write!(f, "{} {kept} after step {step}: {} ({})", self.what, self.reason, self.setting),
        }
    }
}
