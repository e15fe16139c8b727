//! What was measured before, ranked as it would be now.

use super::choices::{Choice, of_geometry, of_intrinsic};
use super::front::{Place, Ratio, Standing, standings};
use crate::report::compare::compare;
use crate::report::{FILTER, Report, set::ReportSet, standing};
use crate::workload::lit_settings;
use sgs_passes::Tuning;
use std::path::{Path, PathBuf};

fn here(path: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(path)
}

/// Choices of a report that were ranked when it was made, and where each stands now.
fn ranked(report: &Report, choices: &[Choice]) -> Vec<(String, Standing)> {
    let value = |name: String| report.values.iter().find(|v| v.name == name).map(|v| v.value);
    let names = report.facts.iter().filter_map(|f| f.name.strip_prefix(standing::PREFIX));
    let place = |name: &str| {
        let choice = choices.iter().find(|c| c.name == name).unwrap_or_else(|| panic!("\"{name}\" is no choice"));
        let time = value(format!("step, {name}, of exact")).map_or(Ratio::EXACT, Ratio::from);
        assert!(name == "exact" || time != Ratio::EXACT, "\"{name}\" has no time");
        // Pictures of half the size have no error; geometry goes by its pictures alone.
        let mut error = value(format!("mean error, {name}")).map_or(0.0, |v| v.median);
        if report.settings.contains_key("stage") {
            error = error.max(value(format!("gradient error, {name}")).unwrap().median);
        }
        Place { kind: choice.kind, time, error }
    };
    let (names, places): (Vec<String>, Vec<Place>) = names.map(|name| (name.to_owned(), place(name))).unzip();
    names.into_iter().zip(standings(&places)).collect()
}

#[test]
fn levels_of_accuracy_are_beaten_by_nothing_that_was_measured() {
    let reports = ReportSet::read(&here("results/tradeoff/llvmpipe.json")).unwrap().reports;
    assert!(reports.iter().filter(|r| r.settings.contains_key("stage")).count() >= 1 && reports.len() >= 4);
    let (own, small) = (Tuning::for_subgroups(8), lit_settings(Some(&here("small.toml"))).unwrap());
    let mut wrong = Vec::new();
    for report in &reports {
        let choices = match report.settings.contains_key("stage") {
            true => of_intrinsic(&small, &own),
            false => of_geometry(&own, report.settings["semantics"] == true),
        };
        let ranked = ranked(report, &choices.unwrap());
        for level in ["exact", "balanced", "fast"] {
            let (_, stands) = ranked.iter().find(|(name, _)| name == level).unwrap();
            if *stands == Standing::Beaten {
                wrong.push(format!("{level} of {}", report.settings["scene"]));
            }
        }
        assert!(ranked.iter().any(|(name, stands)| name.starts_with("tiles of") && *stands == Standing::Same));
    }
    assert!(wrong.is_empty(), "beaten: {}", wrong.join(", "));
}

/// What is recorded since they were made, and which choices a run is of, keeps no run from them.
#[test]
fn reports_from_before_are_found_and_compared() {
    let set = ReportSet::read(&here("results/tradeoff/llvmpipe.json")).unwrap();
    for old in &set.reports {
        let mut now = old.clone();
        for (name, value) in [("settings", "the defaults"), ("geometry", "given")] {
            now.settings.entry(name.to_owned()).or_insert_with(|| value.into());
        }
        now.setting(FILTER, "fast");
        let found = set.like(&now).unwrap();
        assert_eq!(found.settings, old.settings);
        let outcome = compare(found, &now, 0.05).unwrap();
        assert!(outcome.slower.is_empty() && outcome.fallen.is_empty() && !outcome.other_choices);
    }
}
