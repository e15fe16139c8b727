//! Table and plot of an existing report: `engine-bench front`.
//!
//! The output is the same as that of the original run. Figures come from the report; settings, bounds and standings
//! come from this program.

use super::choices::{Choice, of_geometry, of_intrinsic};
use super::front::Ratio;
use super::record::recorded;
use super::{Presentation, geometry, intrinsic};
use crate::report::{Report, set::ReportSet};
use crate::stats::Summary;
use crate::workload::lit_settings;
use anyhow::{Context, bail, ensure};
use sgs_config::Settings;
use sgs_passes::Tuning;
use std::path::{Path, PathBuf};

/// Options of the command.
#[derive(clap::Args, Clone, Debug)]
pub struct Args {
    /// Report of `tradeoff`, or file with all reports of a device.
    file: PathBuf,
    /// Settings that select the report, such as scene=fox or stage=geometry.
    #[arg(value_name = "NAME=VALUE", value_parser = setting)]
    which: Vec<(String, String)>,
    /// Settings of the intrinsic stage, for an older report that does not record them.
    #[arg(long, value_name = "FILE.toml")]
    config: Option<PathBuf>,
    /// Write a plot of time against error.
    #[arg(long, value_name = "FILE.svg")]
    svg: Option<PathBuf>,
    /// Write the table as Markdown. It is printed if neither --table nor --svg is present.
    #[arg(long, value_name = "FILE.md")]
    table: Option<PathBuf>,
}

fn setting(text: &str) -> Result<(String, String), String> {
    let pair = text.split_once('=').map(|(name, value)| (name.to_owned(), value.to_owned()));
    pair.ok_or_else(|| "a setting looks like scene=fox".into())
}

/// Runs the command.
///
/// # Errors
/// If the file cannot be read, the selection does not match one report, a figure is missing, or a file cannot be
/// written.
pub fn run(a: &Args) -> anyhow::Result<()> {
    let set = ReportSet::read(&a.file)?;
    let (presentation, unknown) = presentation(set.only("tradeoff", &a.which)?, a.config.as_deref())?;
    for name in unknown {
        eprintln!("\"{name}\" is no choice any more, and left out.");
    }
    presentation.write(a.table.as_deref(), a.svg.as_deref())?;
    if a.table.is_none() && a.svg.is_none() {
        print!("{}", presentation.table);
    }
    Ok(())
}

/// Builds the presentation of a report.
///
/// Also returns the names of its choices that no longer exist.
pub fn presentation(report: &Report, config: Option<&Path>) -> anyhow::Result<(Presentation, Vec<String>)> {
    let own = Tuning::for_subgroups(report.device.subgroup_size);
    if report.setting_text("stage").is_some() {
        let (choices, unknown) = chosen(report, of_intrinsic(&base(report, config)?, &own)?)?;
        return Ok((intrinsic::presentation(report, &intrinsic::again(report, choices)?), unknown));
    }
    ensure!(config.is_none(), "--config is for reports of the intrinsic stage.");
    let (choices, unknown) = chosen(report, of_geometry(&own)?)?;
    Ok((geometry::presentation(report, &geometry::again(report, choices)?), unknown))
}

/// Returns the settings that the choices of a report differ from.
fn base(report: &Report, config: Option<&Path>) -> anyhow::Result<Settings> {
    let settings = match (recorded(report)?, config) {
        (Some(settings), None) => return Ok(settings),
        (Some(_), Some(_)) => bail!("The report has settings of its own: --config is for those that have none."),
        (None, None) => bail!("The report is from before settings were recorded: --config says which they were."),
        (None, Some(file)) => lit_settings(Some(file))?,
    };
    let i = &settings.intrinsic;
    for (name, value) in [("lights", i.lights.grid.pow(3)), ("environment", i.environment.resolution)] {
        let own = report.setting_text(name).unwrap_or_default();
        ensure!(own == value.to_string(), "The report has {name} {own}, the settings of --config {value}.");
    }
    Ok(settings)
}

/// Returns the choices of a report in its order, and the names of unknown ones.
fn chosen(report: &Report, known: Vec<Choice>) -> anyhow::Result<(Vec<Choice>, Vec<String>)> {
    let times = report.values.iter().filter(|v| v.unit == "ms");
    let (mut choices, mut unknown) = (Vec::new(), Vec::new());
    for name in times.filter_map(|v| v.name.strip_prefix("step, ")) {
        match known.iter().find(|c| c.name == name) {
            Some(choice) => choices.push(choice.clone()),
            None => unknown.push(name.to_owned()),
        }
    }
    ensure!(choices.first().is_some_and(|c| c.name == "exact"), "The first choice of the report is not \"exact\".");
    Ok((choices, unknown))
}

/// Figures of one choice in a report.
pub struct Figures<'r> {
    /// Report that contains the figures.
    pub report: &'r Report,
    /// Name of the choice.
    pub choice: &'r str,
}

impl Figures<'_> {
    /// Returns a measurement, if present.
    pub fn any(&self, what: &str) -> Option<Summary> {
        let name = format!("{what}, {}", self.choice);
        self.report.values.iter().find(|v| v.name == name).map(|v| v.value)
    }

    /// Returns a measurement, or an error if it is missing.
    pub fn summary(&self, what: &str) -> anyhow::Result<Summary> {
        self.any(what).with_context(|| format!("The report has no {what} of \"{}\".", self.choice))
    }

    /// Returns the median of a measurement.
    pub fn number(&self, what: &str) -> anyhow::Result<f64> {
        Ok(self.summary(what)?.median)
    }

    /// Returns the ratio of a time to that of `exact`.
    pub fn ratio(&self, what: &str) -> anyhow::Result<Ratio> {
        if self.choice == "exact" {
            return Ok(Ratio::EXACT);
        }
        let of_exact = Figures { choice: &format!("{}, of exact", self.choice), ..*self };
        Ok(of_exact.summary(what)?.into())
    }

    /// Returns device memory in bytes.
    pub fn bytes(&self) -> anyhow::Result<u64> {
        Ok((self.number("device memory of training")? * 1e6).round() as u64)
    }

    /// Returns a numeric fact with this unit.
    pub fn fact(&self, what: &str, unit: &str) -> Option<f64> {
        let name = format!("{what}, {}, {unit}", self.choice);
        self.report.facts.iter().find(|f| f.name == name)?.value.as_f64()
    }

    /// Returns a textual fact.
    pub fn text(&self, what: &str) -> Option<&str> {
        let name = format!("{what}, {}", self.choice);
        self.report.facts.iter().find(|f| f.name == name)?.value.as_str()
    }
}

/// Returns an empty report with some settings.
#[cfg(test)]
pub fn report(settings: &[(&str, serde_json::Value)]) -> Report {
    let device = crate::report::DeviceLine {
        name: "a".into(),
        kind: "cpu".into(),
        driver: "b".into(),
        api: "1.3.0".into(),
        subgroup_size: 8,
    };
    let mut report = Report::new("tradeoff", device, 1, 0);
    settings.iter().for_each(|(name, value)| report.setting(name, value.clone()));
    report
}

/// Asserts that a report that is read back has the same presentation.
#[cfg(test)]
pub fn assert_round_trip(report: &Report, first: &Presentation) {
    let mut report: Report = serde_json::from_str(&serde_json::to_string(report).unwrap()).unwrap();
    // Standings are recomputed, not read.
    report.facts.retain(|f| !f.name.starts_with(crate::report::standing::PREFIX));
    let (again, unknown) = presentation(&report, None).unwrap();
    assert!(unknown.is_empty(), "{unknown:?}");
    assert_eq!(again.table, first.table);
    assert!(again.svg().unwrap() == first.svg().unwrap());
    // A choice that no longer exists is left out.
    for figure in &mut report.values {
        figure.name = figure.name.replace(", balanced", ", of old");
    }
    let (again, unknown) = presentation(&report, None).unwrap();
    assert_eq!(unknown, ["of old"]);
    assert_eq!(again.table.lines().count() + 1, first.table.lines().count());
    report.values.retain(|v| v.name != "device memory of training, fast");
    let message = presentation(&report, None).err().unwrap().to_string();
    assert_eq!(message, "The report has no device memory of training of \"fast\".");
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unrecorded_settings_require_config() {
        let small = Path::new(env!("CARGO_MANIFEST_DIR")).join("small.toml");
        let of = |lights: u32| {
            report(&[("stage", "intrinsic".into()), ("lights", lights.into()), ("environment", 32.into())])
        };
        assert_eq!(base(&of(27), Some(&small)).unwrap().intrinsic.visibility.levels, 8);
        let message = |report: &Report, config| base(report, config).unwrap_err().to_string();
        assert!(message(&of(27), None).contains("--config says which they were"));
        assert_eq!(message(&of(64), Some(&small)), "The report has lights 64, the settings of --config 27.");
        let mut newer = of(27);
        newer.setting("settings", "intrinsic.lights.grid=2");
        assert_eq!(base(&newer, None).unwrap().intrinsic.lights.grid, 2);
        assert!(message(&newer, Some(&small)).contains("settings of its own"));
        // Reports of the geometry stage do not use `--config`.
        let message = presentation(&report(&[]), Some(&small)).err().unwrap().to_string();
        assert_eq!(message, "--config is for reports of the intrinsic stage.");
        assert_eq!(setting("size=3x2"), Ok(("size".into(), "3x2".into())));
        assert!(setting("fox").is_err());
    }
}
