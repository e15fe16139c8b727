//! Report of a command: tables for people, JSON for programs.
//!
//! Fields may be added; existing fields keep their meaning.

pub mod compare;
pub mod set;
mod text;

use crate::ceiling::Ceiling;
use crate::stats::Summary;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Standings of choices as facts of reports: prefix of their names, and values.
pub mod standing {
    /// Prefix of the fact's name; the name of the choice follows.
    pub const PREFIX: &str = "standing, ";
    /// No other choice dominates it in error and time.
    pub const FRONT: &str = "on the front";
    /// Another choice is more accurate and not slower, but within timing noise.
    pub const TIE: &str = "within noise of the front";
    /// Another choice has no larger error and is significantly faster.
    pub const BEATEN: &str = "beaten";
    /// Matches `exact` up to rounding; not ranked.
    pub const SAME: &str = "as exact";
}

/// Name of the setting that filters the measured choices.
///
/// Reports with other filters are comparable, except for the standings of their choices.
pub const FILTER: &str = "filter";

/// Report of a command.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Report {
    /// Name of the command.
    pub command: String,
    /// Device that ran it.
    pub device: DeviceLine,
    /// Sizes and choices.
    pub settings: BTreeMap<String, serde_json::Value>,
    /// Number of measured repetitions.
    pub repeats: u32,
    /// Number of repetitions before them that are not measured.
    pub warmup: u32,
    /// Peak rates of the device.
    pub ceiling: Option<Ceiling>,
    /// Passes timed by the device's clock.
    pub passes: Vec<PassRow>,
    /// Other measurements.
    pub values: Vec<ValueRow>,
    /// Counts and results.
    pub facts: Vec<Fact>,
    /// Checks that passed.
    pub checks: Vec<String>,
}

/// Device of a report.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DeviceLine {
    /// Device name.
    pub name: String,
    /// Device kind, such as `cpu`.
    pub kind: String,
    /// Driver and version.
    pub driver: String,
    /// Vulkan version.
    pub api: String,
    /// Subgroup size.
    pub subgroup_size: u32,
}

/// Measurement of a pass.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct PassRow {
    /// Plan of the pass.
    pub plan: String,
    /// Name of the pass.
    pub pass: String,
    /// Time of the pass.
    pub nanoseconds: Summary,
    /// Bytes that it must transfer according to the cost model; `None` without a model.
    pub bytes: Option<f64>,
    /// Operations that it must execute according to the cost model.
    pub operations: Option<f64>,
    /// Atomic operations on device memory by the cost model; absent if none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub atomics: Option<f64>,
    /// Fraction of the device's ceiling that the pass reaches.
    ///
    /// This is the larger of the minimum times for bytes and operations, over the measured time.
    pub share: Option<f64>,
    /// Higher bound: `memory` or `arithmetic`.
    pub bound: Option<String>,
}

/// Another measurement.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct ValueRow {
    /// Name of the measurement.
    pub name: String,
    /// Unit of the measurement.
    pub unit: String,
    /// Statistics of its samples.
    pub value: Summary,
    /// Whether an increase over the baseline fails the comparison.
    pub compared: bool,
}

/// Count or result.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Fact {
    /// Name of the fact.
    pub name: String,
    /// Number or text.
    pub value: serde_json::Value,
}

impl Report {
    /// Creates an empty report.
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

    /// Returns the first setting that another report lacks or sets differently.
    ///
    /// Such reports are not comparable. Settings that only the other report has are ignored, since this one may
    /// predate their record.
    pub fn differs(&self, other: &Report) -> Option<(&str, &serde_json::Value)> {
        let same = |name: &str, value| name == FILTER || other.settings.get(name) == Some(value);
        self.settings.iter().find(|(name, value)| !same(name, value)).map(|(name, value)| (name.as_str(), value))
    }

    /// Sets a size or choice.
    pub fn setting(&mut self, name: &str, value: impl Into<serde_json::Value>) {
        self.settings.insert(name.to_owned(), value.into());
    }

    /// Returns a size or choice as text.
    pub fn setting_text(&self, name: &str) -> Option<String> {
        self.settings.get(name).map(|value| value.as_str().map_or_else(|| value.to_string(), str::to_owned))
    }

    /// Adds a fact.
    pub fn fact(&mut self, name: &str, value: impl Into<serde_json::Value>) {
        self.facts.push(Fact { name: name.to_owned(), value: value.into() });
    }

    /// Adds a measurement that is compared.
    pub fn time(&mut self, name: &str, unit: &str, value: Summary) {
        self.values.push(ValueRow { name: name.to_owned(), unit: unit.to_owned(), value, compared: true });
    }

    /// Adds the time of a choice and its ratio to `exact`.
    ///
    /// Comparisons use the absolute time of `exact`, and the ratios of all other choices. Ratios do not depend on the
    /// current speed of the machine.
    pub fn choice(&mut self, what: &str, name: &str, milliseconds: Summary, of_exact: Summary) {
        let own = format!("{what}, {name}");
        if name == "exact" {
            self.time(&own, "ms", milliseconds);
        } else {
            self.value(&own, "ms", milliseconds);
            self.time(&format!("{own}, of exact"), "", of_exact);
        }
    }

    /// Adds a measurement that is not compared.
    pub fn value(&mut self, name: &str, unit: &str, value: Summary) {
        self.values.push(ValueRow { name: name.to_owned(), unit: unit.to_owned(), value, compared: false });
    }

    /// Refuses non-finite figures, which JSON cannot represent.
    ///
    /// # Errors
    /// If a figure is not finite, with a sentence that names it.
    pub fn ensure_finite(&self) -> anyhow::Result<()> {
        let passes = self.passes.iter().map(|p| (format!("{}/{}", p.plan, p.pass), &p.nanoseconds));
        let values = self.values.iter().map(|v| (v.name.clone(), &v.value));
        let mut all = passes.chain(values);
        let wrong = all.find(|(_, s)| ![s.median, s.mad, s.least].iter().all(|v| v.is_finite())).map(|(name, _)| name);
        // Facts are JSON values already; a non-finite number became null.
        let fact = || self.facts.iter().find(|f| f.value.is_null()).map(|f| f.name.clone());
        match wrong.or_else(fact) {
            Some(name) => anyhow::bail!("\"{name}\" is not a finite number, so that there is no report."),
            None => Ok(()),
        }
    }

    /// Adds a check that passed.
    pub fn check(&mut self, what: impl Into<String>) {
        self.checks.push(what.into());
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn non_finite_facts_are_refused_by_name() {
        let device = DeviceLine {
            name: "a".into(),
            kind: "cpu".into(),
            driver: "b".into(),
            api: "1.3.0".into(),
            subgroup_size: 8,
        };
        let report = |value: f64, fact: f64| {
            let mut report = Report::new("tradeoff", device.clone(), 1, 0);
            report.time("mean error, fast", "", Summary::of(&[value]));
            report.fact("image, fast, dB", fact);
            report
        };
        let good = report(1e-3, 40.0);
        good.ensure_finite().unwrap();
        let text = serde_json::to_string(&good).unwrap();
        assert_eq!(serde_json::from_str::<Report>(&text).unwrap().values[0].value, good.values[0].value);
        for wrong in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
            // Serialized, the report could not be read back.
            let bad = report(wrong, 40.0);
            assert!(serde_json::from_str::<Report>(&serde_json::to_string(&bad).unwrap()).is_err());
            assert!(bad.ensure_finite().unwrap_err().to_string().starts_with("\"mean error, fast\" is not"), "{wrong}");
            let message = report(1e-3, wrong).ensure_finite().unwrap_err().to_string();
            assert!(message.starts_with("\"image, fast, dB\" is not a finite number"), "{message}");
        }
    }
}
