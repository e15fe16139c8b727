//! Report of a command: tables for people, JSON for programs. Fields may be added; existing fields keep their meaning.

pub mod compare;
pub mod set;
mod text;

use crate::ceiling::Ceiling;
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
    /// It matches `exact` up to rounding and is not ranked.
    pub const SAME: &str = "as exact";
}

/// Name of the setting that filters the measured choices. Reports with other filters are comparable, except for the
/// standings of their choices.
pub const FILTER: &str = "filter";

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
    /// Peak rates of the device.
    pub ceiling: Option<Ceiling>,
    /// Passes by the device's own clock.
    pub passes: Vec<PassRow>,
    /// Other measurements.
    pub values: Vec<ValueRow>,
    /// Counts and outcomes.
    pub facts: Vec<Fact>,
    /// Checks that passed.
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
    /// Whether an increase over the baseline fails the comparison.
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

    /// Returns the first setting that another report lacks or has with another value; the reports are then not comparable.
    /// Settings that only the other report has are ignored: this one may be from before they were recorded.
    pub fn differs(&self, other: &Report) -> Option<(&str, &serde_json::Value)> {
        let same = |name: &str, value| name == FILTER || other.settings.get(name) == Some(value);
        self.settings.iter().find(|(name, value)| !same(name, value)).map(|(name, value)| (name.as_str(), value))
    }

    /// States a size or choice.
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

    /// Adds the time of a choice and its ratio to `exact`. Comparisons use the absolute time of `exact` only, and the ratios
    /// of other choices, which do not depend on the current speed of the machine.
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

    /// Refuses non-finite figures, which JSON cannot represent.
    ///
    /// # Errors
    /// If a figure is not finite, with a sentence that names it.
    pub fn ensure_finite(&self) -> anyhow::Result<()> {
        let passes = self.passes.iter().map(|p| (format!("{}/{}", p.plan, p.pass), &p.nanoseconds));
        let values = self.values.iter().map(|v| (v.name.clone(), &v.value));
        let mut all = passes.chain(values);
        let wrong = all.find(|(_, s)| ![s.median, s.mad, s.least].iter().all(|v| v.is_finite())).map(|(name, _)| name);
        // Facts are JSON already: there it has become nothing.
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
            // As it would be written it could not be read.
            let bad = report(wrong, 40.0);
            assert!(serde_json::from_str::<Report>(&serde_json::to_string(&bad).unwrap()).is_err());
            assert!(bad.ensure_finite().unwrap_err().to_string().starts_with("\"mean error, fast\" is not"), "{wrong}");
            let message = report(1e-3, wrong).ensure_finite().unwrap_err().to_string();
            assert!(message.starts_with("\"image, fast, dB\" is not a finite number"), "{message}");
        }
    }
}
