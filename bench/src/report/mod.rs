//! What a command found: for people as tables, for programs as JSON. Fields may be added; what stands keeps its meaning.

pub mod compare;
pub mod set;
mod text;

use crate::commands::ceiling::Ceiling;
use crate::stats::Summary;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// How a choice stands among others: facts of reports, by their names and values.
pub mod standing {
    /// How such a fact's name begins; the choice follows.
    pub const PREFIX: &str = "standing, ";
    /// No other is as close and not slower.
    pub const FRONT: &str = "on the front";
    /// Another is, by less than what times vary.
    pub const TIE: &str = "within noise of the front";
    /// Another surely is.
    pub const BEATEN: &str = "beaten";
}

/// A report.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Report {
    /// The command.
    pub command: String,
    /// On what it ran.
    pub device: DeviceLine,
    /// Sizes and choices.
    pub settings: BTreeMap<String, serde_json::Value>,
    /// Measured repetitions.
    pub repeats: u32,
    /// Those before.
    pub warmup: u32,
    /// What the device can do at best.
    pub ceiling: Option<Ceiling>,
    /// Passes by the device's own clock.
    pub passes: Vec<PassRow>,
    /// Other measurements.
    pub values: Vec<ValueRow>,
    /// Counts and outcomes.
    pub facts: Vec<Fact>,
    /// What was checked, and held.
    pub checks: Vec<String>,
}

/// A device.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DeviceLine {
    /// Its name.
    pub name: String,
    /// Its kind.
    pub kind: String,
    /// Driver and version.
    pub driver: String,
    /// Vulkan version.
    pub api: String,
    /// Subgroup size.
    pub subgroup_size: u32,
}

/// One pass.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct PassRow {
    /// The plan that it belongs to.
    pub plan: String,
    /// Its name.
    pub pass: String,
    /// Its time.
    pub nanoseconds: Summary,
    /// Bytes that it must move, by the model; none where there is no model.
    pub bytes: Option<f64>,
    /// Operations that it must do.
    pub operations: Option<f64>,
    /// The share of the device's ceiling that it reaches: the time that bytes or operations alone would take, whichever
    /// is longer, over the time that it took.
    pub share: Option<f64>,
    /// `memory` or `arithmetic`, whichever bound is higher.
    pub bound: Option<String>,
}

/// Another measurement.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct ValueRow {
    /// What.
    pub name: String,
    /// In what unit.
    pub unit: String,
    /// How much.
    pub value: Summary,
    /// Whether less is better and more is worth failing for.
    pub compared: bool,
}

/// A count or an outcome.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Fact {
    /// What.
    pub name: String,
    /// How much, or what came out.
    pub value: serde_json::Value,
}

impl Report {
    /// Empty.
    pub fn new(command: &str, device: DeviceLine, repeats: u32, warmup: u32) -> Report {
        Report {
            command: command.to_owned(),
            device,
            settings: BTreeMap::new(),
            repeats,
            warmup,
            ceiling: None,
            passes: Vec::new(),
            values: Vec::new(),
            facts: Vec::new(),
            checks: Vec::new(),
        }
    }

    /// States a size or choice.
    pub fn setting(&mut self, name: &str, value: impl Into<serde_json::Value>) {
        self.settings.insert(name.to_owned(), value.into());
    }

    /// Adds a fact.
    pub fn fact(&mut self, name: &str, value: impl Into<serde_json::Value>) {
        self.facts.push(Fact { name: name.to_owned(), value: value.into() });
    }

    /// Adds a measurement that is compared.
    pub fn time(&mut self, name: &str, unit: &str, value: Summary) {
        self.values.push(ValueRow { name: name.to_owned(), unit: unit.to_owned(), value, compared: true });
    }

    /// Adds the time of a choice: alone only that of `exact` is compared, others by how they stand to it, since that does not
    /// depend on how fast a machine happens to be.
    pub fn choice(&mut self, what: &str, name: &str, milliseconds: Summary, of_exact: Summary) {
        let own = format!("{what}, {name}");
        if name == "exact" {
            self.time(&own, "ms", milliseconds);
        } else {
            self.value(&own, "ms", milliseconds);
            self.time(&format!("{own}, of exact"), "", of_exact);
        }
    }

    /// Adds a measurement that is not.
    pub fn value(&mut self, name: &str, unit: &str, value: Summary) {
        self.values.push(ValueRow { name: name.to_owned(), unit: unit.to_owned(), value, compared: false });
    }

    /// Says what was checked and held.
    pub fn check(&mut self, what: impl Into<String>) {
        self.checks.push(what.into());
    }
}
