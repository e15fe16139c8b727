//! Recorded measurements, ranked by the current rules.

use super::again::presentation;
use super::front::Standing;
use crate::report::compare::compare;
use crate::report::{FILTER, set::ReportSet};
use std::path::{Path, PathBuf};

fn here(path: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(path)
}

#[test]
fn no_measured_choice_beats_an_accuracy_level() {
    let reports = ReportSet::read(&here("results/tradeoff/llvmpipe.json")).unwrap().reports;
    assert!(reports.iter().filter(|r| r.settings.contains_key("stage")).count() >= 1 && reports.len() >= 4);
    let small = here("small.toml");
    let mut wrong = Vec::new();
    for report in &reports {
        let without_settings = report.setting_text("stage").is_some() && report.setting_text("settings").is_none();
        let (presentation, unknown) = presentation(report, without_settings.then_some(small.as_path())).unwrap();
        assert!(unknown.is_empty(), "no choices: {unknown:?}");
        for level in ["exact", "balanced", "fast"] {
            let mark = presentation.marks.iter().find(|m| m.name == level).unwrap();
            if mark.standing == Standing::Beaten {
                wrong.push(format!("{level} of {}", report.settings["scene"]));
            }
        }
        assert!(presentation.marks.iter().any(|m| m.name.starts_with("tiles of") && m.standing == Standing::Same));
    }
    assert!(wrong.is_empty(), "beaten: {}", wrong.join(", "));
}

/// Entries that were recorded later and filters do not prevent comparison.
#[test]
fn older_reports_are_found_and_compared() {
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

/// Tables and plots of the document match the recorded reports.
#[test]
fn document_tables_match_recorded_reports() {
    let reports = ReportSet::read(&here("results/tradeoff/llvmpipe.json")).unwrap().reports;
    let document = std::fs::read_to_string(here("../docs/project/tradeoff.md")).unwrap();
    let small = here("small.toml");
    let mut drawings = Vec::new();
    for report in &reports {
        let without_settings = report.setting_text("stage").is_some() && report.setting_text("settings").is_none();
        let (presentation, _) = presentation(report, without_settings.then_some(small.as_path())).unwrap();
        let scene = &report.settings["scene"];
        assert!(document.contains(&presentation.table), "docs/project/tradeoff.md has another table of {scene}");
        drawings.push(presentation.svg().unwrap());
    }
    for name in ["tradeoff-photographs", "tradeoff", "tradeoff-synthetic", "tradeoff-materials"] {
        let file = std::fs::read_to_string(here(&format!("../docs/images/{name}.svg"))).unwrap();
        assert!(drawings.contains(&file), "docs/images/{name}.svg shows something else");
        assert!(document.contains(&format!("(../images/{name}.svg)")));
    }
}
