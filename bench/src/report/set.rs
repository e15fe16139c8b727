//! Reports of one device in one file, and their table.
//!
//! The table is part of docs/project/benchmarks.md.

use super::{Report, ValueRow};
use anyhow::Context;
use serde::{Deserialize, Serialize};
use std::fmt::Write;
use std::path::Path;

/// Reports of one device.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct ReportSet {
    /// Reports, one per command and settings.
    pub reports: Vec<Report>,
}

/// Facts that have a row in the table.
const FACTS: [&str; 4] = [
    "step: passes, groups, barriers",
    "step: arena, and without sharing memory, MB",
    "host, a replay without its submission, us",
    "device memory but photographs, bytes a Gaussian",
];

impl ReportSet {
    /// Reads a file of several reports or of a single one.
    ///
    /// # Errors
    /// If the file cannot be read, or contains neither.
    pub fn read(path: &Path) -> anyhow::Result<ReportSet> {
        let text = std::fs::read_to_string(path).map_err(|e| anyhow::anyhow!("\"{}\": {e}.", path.display()))?;
        let value: serde_json::Value = serde_json::from_str(&text)
            .map_err(|e| anyhow::anyhow!("\"{}\" is not a report of engine-bench: {e}.", path.display()))?;
        let set = if value.get("reports").is_some() {
            serde_json::from_value(value)
        } else {
            serde_json::from_value(value).map(|report| ReportSet { reports: vec![report] })
        };
        set.map_err(|e| anyhow::anyhow!("\"{}\" is not a report of engine-bench: {e}.", path.display()))
    }

    /// Returns the baseline report for another one.
    ///
    /// Prefers equal settings, then settings that do not conflict, then the first report of the command.
    ///
    /// # Errors
    /// If no report is of that command.
    pub fn like(&self, other: &Report) -> anyhow::Result<&Report> {
        let mut of_command = self.reports.iter().filter(|r| r.command == other.command);
        let same = of_command.clone().find(|r| r.settings == other.settings);
        same.or_else(|| of_command.clone().find(|r| r.differs(other).is_none()))
            .or_else(|| of_command.next())
            .with_context(|| format!("The baseline has no report of \"{}\".", other.command))
    }

    /// Returns the only report of a command with such settings.
    ///
    /// Reports without a stage count as `geometry`.
    ///
    /// # Errors
    /// If no or several reports match, with a sentence that lists them.
    pub fn only(&self, command: &str, settings: &[(String, String)]) -> anyhow::Result<&Report> {
        let all: Vec<&Report> = self.reports.iter().filter(|r| r.command == command).collect();
        anyhow::ensure!(!all.is_empty(), "There is no report of \"{command}\".");
        let fits =
            |r: &&Report| settings.iter().all(|(name, value)| setting_or_default(r, name).as_ref() == Some(value));
        let found: Vec<&Report> = all.iter().copied().filter(fits).collect();
        let filter: Vec<String> = settings.iter().map(|(name, value)| format!("{name}={value}")).collect();
        let filter = if filter.is_empty() { String::new() } else { format!(" with {}", filter.join(", ")) };
        match found[..] {
            [one] => Ok(one),
            [] => anyhow::bail!("There is no report of \"{command}\"{filter}, but:{}", distinguishing_settings(&all)),
            _ => anyhow::bail!("Reports of \"{command}\"{filter} are:{}", distinguishing_settings(&found)),
        }
    }

    /// Joins several sets, ordered by command and settings.
    ///
    /// # Errors
    /// If devices differ, or two reports have equal command and settings.
    pub fn join(sets: Vec<ReportSet>) -> anyhow::Result<ReportSet> {
        let mut reports: Vec<Report> = sets.into_iter().flat_map(|set| set.reports).collect();
        reports.sort_by_key(key);
        for pair in reports.windows(2) {
            let [a, b] = pair else { continue };
            anyhow::ensure!(a.device == b.device, "\"{}\" and \"{}\" differ.", a.device.name, b.device.name);
            anyhow::ensure!(key(a) != key(b), "There are two reports of \"{}\" with equal settings.", a.command);
        }
        Ok(ReportSet { reports })
    }
}

fn key(r: &Report) -> (String, String) {
    (r.command.clone(), serde_json::to_string(&r.settings).unwrap_or_default())
}

/// Returns a setting as text; `stage` defaults to `geometry`.
fn setting_or_default(report: &Report, name: &str) -> Option<String> {
    report.setting_text(name).or_else(|| (name == "stage").then(|| "geometry".to_owned()))
}

/// Returns a line per report with the settings in which they differ.
fn distinguishing_settings(reports: &[&Report]) -> String {
    let mut names: Vec<&str> = reports.iter().flat_map(|r| r.settings.keys()).map(String::as_str).collect();
    names.sort_unstable();
    names.dedup();
    names.retain(|name| {
        *name == "scene" || reports.iter().any(|r| setting_or_default(r, name) != setting_or_default(reports[0], name))
    });
    let line = |r: &&Report| {
        let all = names.iter().filter_map(|name| Some(format!("{name}={}", setting_or_default(r, name)?)));
        format!("\n  {}", all.collect::<Vec<_>>().join(", "))
    };
    reports.iter().map(line).collect()
}

/// Returns the Markdown table: a row per time with its spread, and a few facts.
pub fn table(sets: &[ReportSet]) -> String {
    let mut out = String::from("| device | measured | sizes | median | MAD | repeats |\n|---|---|---|---|---|---|\n");
    for report in sets.iter().flat_map(|set| &set.reports) {
        let sizes: Vec<String> = ["scene", "gaussians", "size", "elements"]
            .iter()
            .filter_map(|name| Some((name, report.settings.get(*name)?)))
            .map(|(name, value)| match value.as_str() {
                Some(text) => text.to_owned(),
                None => format!("{value} {name}"),
            })
            .collect();
        let sizes = sizes.join(", ");
        let device = &report.device.name;
        for ValueRow { name, unit, value, .. } in report.values.iter().filter(|v| v.compared) {
            let _ = writeln!(
                out,
                "| {device} | {}: {name} | {sizes} | {} {unit} | {} | {} |",
                report.command,
                digits(value.median),
                digits(value.mad),
                value.samples
            );
        }
        for fact in report.facts.iter().filter(|f| FACTS.contains(&f.name.as_str())) {
            let value = match fact.value.as_f64() {
                Some(number) => digits(number),
                None => fact.value.as_str().unwrap_or_default().to_owned(),
            };
            let _ = writeln!(out, "| {device} | {} | {sizes} | {value} | | |", fact.name);
        }
    }
    out
}

/// Formats a number with three significant digits.
fn digits(value: f64) -> String {
    let decimals = (2 - value.abs().max(1e-9).log10().floor() as i32).clamp(0, 6) as usize;
    format!("{value:.decimals$}")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::{DeviceLine, FILTER};
    use crate::stats::Summary;

    fn report(command: &str, gaussians: u32) -> Report {
        let device = DeviceLine {
            name: "a".into(),
            kind: "cpu".into(),
            driver: "b".into(),
            api: "1.3.0".into(),
            subgroup_size: 8,
        };
        let mut report = Report::new(command, device, 3, 1);
        report.setting("gaussians", gaussians);
        report.time("whole", "ms", Summary::of(&[12.34, 12.36, 99.0]));
        report.value("not compared", "ms", Summary::of(&[1.0]));
        report.fact("step: passes, groups, barriers", "3, 2, 2");
        report.fact("unimportant", 1);
        report
    }

    #[test]
    fn table_has_a_row_per_time_and_selected_fact() {
        let set = ReportSet { reports: vec![report("step", 100)] };
        assert_eq!(
            table(&[set]),
            "| device | measured | sizes | median | MAD | repeats |\n|---|---|---|---|---|---|\n\
             | a | step: whole | 100 gaussians | 12.4 ms | 0.0200 | 3 |\n\
             | a | step: passes, groups, barriers | 100 gaussians | 3, 2, 2 | | |\n"
        );
    }

    #[test]
    fn sets_are_joined_matched_and_conflicts_refused() {
        let single = |command, gaussians| ReportSet { reports: vec![report(command, gaussians)] };
        let all = ReportSet::join(vec![single("step", 200), single("passes", 100), single("step", 100)]).unwrap();
        assert_eq!(all.reports.iter().map(|r| r.command.as_str()).collect::<Vec<_>>(), ["passes", "step", "step"]);
        assert_eq!(all.like(&report("step", 200)).unwrap().settings["gaussians"], 200);
        assert!(all.like(&report("scaling", 200)).is_err());
        // Newer settings and filters do not prevent a match.
        let mut newer = report("step", 200);
        newer.setting("settings", "the defaults");
        newer.setting(FILTER, "t");
        assert_eq!(all.like(&newer).unwrap().settings["gaussians"], 200);
        newer.setting("gaussians", 300);
        assert_eq!(all.like(&newer).unwrap().settings["gaussians"], 100);
        assert!(ReportSet::join(vec![single("step", 100), single("step", 100)]).is_err());
        let mut other = report("step", 300);
        other.device.driver = "c".into();
        assert!(ReportSet::join(vec![single("step", 100), ReportSet { reports: vec![other] }]).is_err());
    }

    #[test]
    fn report_is_selected_by_its_settings() {
        let of = |scene: &str, stage: Option<&str>| {
            let mut report = report("tradeoff", 100);
            report.setting("scene", scene);
            stage.iter().for_each(|s| report.setting("stage", *s));
            report
        };
        let reports = vec![report("step", 100), of("fox", None), of("room", None), of("room", Some("intrinsic"))];
        let set = ReportSet { reports };
        let only = |command: &str, settings: &[(&str, &str)]| {
            let settings: Vec<_> = settings.iter().map(|(n, v)| ((*n).to_owned(), (*v).to_owned())).collect();
            set.only(command, &settings)
                .map(|r| (r.setting_text("scene"), r.setting_text("stage")))
                .map_err(|e| e.to_string())
        };
        assert_eq!(only("tradeoff", &[("scene", "fox")]), Ok((Some("fox".into()), None)));
        assert_eq!(only("tradeoff", &[("scene", "room"), ("stage", "geometry")]), Ok((Some("room".into()), None)));
        assert!(only("tradeoff", &[("stage", "intrinsic")]).unwrap().1.is_some() && only("step", &[]).is_ok());
        assert_eq!(
            only("tradeoff", &[("scene", "room")]).unwrap_err(),
            "Reports of \"tradeoff\" with scene=room are:\n  scene=room, stage=geometry\n  scene=room, stage=intrinsic"
        );
        let message = only("tradeoff", &[("gaussians", "7")]).unwrap_err();
        assert!(
            message.starts_with("There is no report of \"tradeoff\" with gaussians=7, but:\n  scene=fox"),
            "{message}"
        );
        assert_eq!(only("scaling", &[]).unwrap_err(), "There is no report of \"scaling\".");
    }

    #[test]
    fn benchmarks_table_matches_recorded_reports() {
        let root = Path::new(env!("CARGO_MANIFEST_DIR"));
        let mut files: Vec<_> = std::fs::read_dir(root.join("results"))
            .unwrap()
            .map(|entry| entry.unwrap().path())
            .filter(|path| path.extension().is_some_and(|e| e == "json"))
            .collect();
        files.sort();
        let sets: Vec<ReportSet> = files.iter().map(|path| ReportSet::read(path).unwrap()).collect();
        let page = std::fs::read_to_string(root.join("../docs/project/benchmarks.md")).unwrap();
        let (_, rest) = page.split_once("<!-- engine-bench table -->\n").expect("the page has a place for the table");
        let (found_table, _) = rest.split_once("<!-- end -->").expect("the table ends");
        assert!(
            found_table == table(&sets),
            "docs/project/benchmarks.md should show (engine-bench table bench/results/*.json)\n{}",
            table(&sets)
        );
    }
}
