//! Regression check of one run against another, beyond their noise.
//!
//! A figure counts as worse if its median exceeds the baseline's by more than the noise band
//!
//! > 3 · sqrt(σ² + σ₀²) + tolerance · median₀ + floor
//!
//! with σ = 1.4826 · MAD of either run's samples. This is the spread of single samples, not of the median: runs at
//! different times on a shared machine differ by more than repeats within one run. The tolerance covers variation of
//! clocks and caches between processes. The floor of times is 2 µs, the resolution of a timestamp. For a pass it is
//! at least 0.1 % of its plan; smaller differences are scheduling noise. The floor of ratios, errors and megabytes is
//! the effect of the order of single-precision sums on a number near one. A finite number that becomes non-finite is
//! worse.

use super::{Report, standing};
use crate::stats::Summary;
use std::collections::BTreeMap;
use std::fmt::Write;

/// Standard deviations in the noise band.
const DEVIATIONS: f64 = 3.0;

/// Floor of times in nanoseconds.
const RESOLUTION: f64 = 2000.0;

/// Floor of errors, ratios and megabytes: five halves of a unit in the last place.
///
/// The order of sums causes differences of this size.
const ROUNDING: f64 = 3e-7;

/// Floor of a pass as a fraction of its plan.
const NEGLIGIBLE: f64 = 0.001;

/// Figure that differs between both runs.
#[derive(Clone, Debug, PartialEq)]
pub struct Difference {
    /// Name of the figure.
    pub name: String,
    /// Median of the baseline, in `unit`.
    pub before: f64,
    /// Current median, in `unit`.
    pub now: f64,
    /// Noise band, in `unit`.
    pub band: f64,
    /// Unit of the figure.
    pub unit: String,
}

impl Difference {
    /// Returns the ratio to the baseline; infinity if it is NaN.
    fn growth(&self) -> f64 {
        let growth = self.now / self.before;
        if growth.is_nan() { f64::INFINITY } else { growth }
    }
}

/// Result of a comparison.
#[derive(Clone, Debug, Default)]
pub struct Outcome {
    /// Number of figures in both runs.
    pub compared: usize,
    /// Worse figures, the largest growth first.
    pub slower: Vec<Difference>,
    /// Better figures by the same criterion.
    pub faster: Vec<Difference>,
    /// Choices that left the front.
    pub fallen: Vec<String>,
    /// Whether the runs have different choices. Standings are relative to all choices and are then not compared.
    pub other_choices: bool,
    /// Figures that only the baseline has.
    pub missing: Vec<String>,
    /// Fraction of the baseline that always counts as noise.
    tolerance: f64,
}

/// Compares two reports of one command.
///
/// # Errors
/// If command, device or settings differ.
pub fn compare(baseline: &Report, now: &Report, tolerance: f64) -> anyhow::Result<Outcome> {
    anyhow::ensure!(
        baseline.command == now.command,
        "The baseline is a report of \"{}\", this is \"{}\".",
        baseline.command,
        now.command
    );
    anyhow::ensure!(
        baseline.device == now.device,
        "The baseline was measured on {} ({}), this is {} ({}).",
        baseline.device.name,
        baseline.device.driver,
        now.device.name,
        now.device.driver
    );
    if let Some((name, value)) = baseline.differs(now) {
        let other = now.settings.get(name).map_or("none".to_owned(), ToString::to_string);
        anyhow::bail!("The baseline has {name} {value}, this run {other}.");
    }
    let (before, after) = (times(baseline), times(now));
    let mut outcome = Outcome { tolerance, ..Default::default() };
    for (name, unit, old, resolution) in before {
        let Some((_, _, new, _)) = after.iter().find(|(n, ..)| *n == name) else {
            outcome.missing.push(name);
            continue;
        };
        outcome.compared += 1;
        let band = noise_band(&old, new, tolerance, resolution);
        let difference = Difference { name, before: old.median, now: new.median, band, unit };
        if exceeds(new, &old, band) {
            outcome.slower.push(difference);
        } else if exceeds(&old, new, band) {
            outcome.faster.push(difference);
        }
    }
    outcome.slower.sort_by(|a, b| b.growth().total_cmp(&a.growth()));
    let (before, after) = (standings(baseline), standings(now));
    if before.keys().eq(after.keys()) {
        let fallen = |name: &&&str| before[**name] != standing::BEATEN && after[**name] == standing::BEATEN;
        outcome.fallen = before.keys().filter(fallen).map(|name| (*name).to_owned()).collect();
    } else {
        outcome.other_choices = true;
    }
    anyhow::ensure!(outcome.compared > 0, "The baseline and this run have no time in common.");
    Ok(outcome)
}

/// Returns whether `a` exceeds `b` by more than noise.
///
/// Non-finite figures exceed all finite ones, whatever the band.
fn exceeds(a: &Summary, b: &Summary, band: f64) -> bool {
    let finite = |s: &Summary| s.median.is_finite() && s.mad.is_finite();
    match (finite(a), finite(b)) {
        (true, true) => a.median - b.median > band,
        (of_a, of_b) => of_b && !of_a,
    }
}

/// Returns the noise band.
pub fn noise_band(before: &Summary, now: &Summary, tolerance: f64, resolution: f64) -> f64 {
    DEVIATIONS * before.sigma().hypot(now.sigma()) + tolerance * before.median + resolution
}

/// Returns the standings of choices by their names.
fn standings(r: &Report) -> BTreeMap<&str, &serde_json::Value> {
    r.facts.iter().filter_map(|f| Some((f.name.strip_prefix(standing::PREFIX)?, &f.value))).collect()
}

/// Returns name, unit, value and floor of the compared figures.
fn times(r: &Report) -> Vec<(String, String, Summary, f64)> {
    let floor = |plan: &str| {
        let all: f64 = r.passes.iter().filter(|p| p.plan == plan).map(|p| p.nanoseconds.median).sum();
        RESOLUTION.max(NEGLIGIBLE * all)
    };
    let passes =
        r.passes.iter().map(|p| (format!("{}/{}", p.plan, p.pass), "ns".to_owned(), p.nanoseconds, floor(&p.plan)));
    let values = r.values.iter().filter(|v| v.compared).map(|v| {
        let per_unit = match v.unit.as_str() {
            "s" => 1e-9,
            "ms" => 1e-6,
            "us" => 1e-3,
            // Not a time.
            _ => return (v.name.clone(), v.unit.clone(), v.value, ROUNDING),
        };
        (v.name.clone(), v.unit.clone(), v.value, RESOLUTION * per_unit)
    });
    passes.chain(values).collect()
}

impl Outcome {
    /// Returns the comparison as text.
    pub fn text(&self) -> String {
        let mut out = format!(
            "\ncompared {} figures; noise band: {DEVIATIONS} sqrt(s^2 + s0^2) + {:.0} % + floor, s = 1.4826 MAD, floor {:.0} us or {} % of the plan, {ROUNDING:.0e} of what is no time\n",
            self.compared,
            100.0 * self.tolerance,
            RESOLUTION / 1e3,
            100.0 * NEGLIGIBLE
        );
        for (words, list) in [(["SLOWER", "GROWN"], &self.slower), (["faster", "less"], &self.faster)] {
            for d in list {
                let what = words[usize::from(!["ns", "us", "ms", "s"].contains(&d.unit.as_str()))];
                let _ = writeln!(
                    out,
                    "{what} {}: {:.6} -> {:.6} {} ({:+.1} %, band {:.1} %)",
                    d.name,
                    d.before,
                    d.now,
                    d.unit,
                    100.0 * (d.now / d.before - 1.0),
                    100.0 * d.band / d.before
                );
            }
        }
        for choice in &self.fallen {
            let _ = writeln!(out, "OFF THE FRONT: {choice}, which stood there or close to it");
        }
        if self.other_choices {
            out.push_str(
                "the choices are not those of the baseline, so that how they stand among each other is not compared\n",
            );
        }
        for name in &self.missing {
            let _ = writeln!(out, "not measured now: {name}");
        }
        if self.slower.is_empty() {
            out.push_str("nothing has grown\n");
        }
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::{DeviceLine, FILTER, PassRow};
    use sgs_passes::reference::rng::Pcg;

    fn device() -> DeviceLine {
        DeviceLine { name: "a".into(), kind: "cpu".into(), driver: "b 1".into(), api: "1.3.0".into(), subgroup_size: 8 }
    }

    /// Returns a report of three passes of 0.1, 1 and 10 ms with relative noise. `factor` slows the second.
    fn run(seed: u32, noise: f64, factor: f64) -> Report {
        let mut rng = Pcg::new(seed);
        let mut report = Report::new("step", device(), 20, 3);
        report.setting("gaussians", 1000);
        for (i, (name, time)) in [("small", 1e5), ("middle", 1e6), ("large", 1e7)].into_iter().enumerate() {
            let time = if i == 1 { time * factor } else { time };
            let samples: Vec<f64> = (0..20).map(|_| time * (1.0 + noise * rng.normal().abs())).collect();
            report.passes.push(PassRow {
                plan: "p".into(),
                pass: name.into(),
                nanoseconds: Summary::of(&samples),
                bytes: None,
                operations: None,
                atomics: None,
                share: None,
                bound: None,
            });
        }
        report.time("step", "ms", Summary::of(&[11.1, 11.2, 11.0]));
        report
    }

    #[test]
    fn noise_is_not_reported_as_slowdown() {
        for noise in [0.0, 0.02, 0.1, 0.3] {
            for seed in 0..50 {
                let outcome = compare(&run(2 * seed, noise, 1.0), &run(2 * seed + 1, noise, 1.0), 0.05).unwrap();
                assert_eq!(outcome.compared, 4);
                assert!(outcome.slower.is_empty(), "{noise}: {}", outcome.text());
            }
        }
    }

    #[test]
    fn slowdown_beyond_noise_is_reported() {
        for (noise, factor) in [(0.0, 1.08), (0.02, 1.25), (0.1, 1.7)] {
            for seed in 0..50 {
                let (baseline, slow) = (run(2 * seed, noise, 1.0), run(2 * seed + 1, noise, factor));
                let outcome = compare(&baseline, &slow, 0.05).unwrap();
                let names: Vec<_> = outcome.slower.iter().map(|d| d.name.as_str()).collect();
                assert_eq!(names, ["p/middle"], "{noise} {factor}");
                // In reverse it is an improvement and no failure.
                let outcome = compare(&slow, &baseline, 0.05).unwrap();
                assert!(outcome.slower.is_empty() && outcome.faster.len() == 1, "{noise} {factor}");
            }
        }
    }

    #[test]
    fn changes_within_clock_resolution_or_tolerance_pass() {
        // The plan takes 11.1 ms, so the floor of a pass of 0.5 us is 11.1 us.
        let (mut a, mut b) = (run(1, 0.0, 1.0), run(1, 0.0, 1.0));
        a.passes[0].nanoseconds = Summary::of(&[500.0]);
        b.passes[0].nanoseconds = Summary::of(&[11_000.0]);
        assert!(compare(&a, &b, 0.05).unwrap().slower.is_empty());
        b.passes[0].nanoseconds = Summary::of(&[12_000.0]);
        assert_eq!(compare(&a, &b, 0.05).unwrap().slower.len(), 1);
        // As the only pass of its plan, it has the timestamp resolution as its floor.
        for report in [&mut a, &mut b] {
            report.passes.truncate(1);
        }
        for (now, slower) in [(2400.0, 0), (2600.0, 1)] {
            b.passes[0].nanoseconds = Summary::of(&[now]);
            assert_eq!(compare(&a, &b, 0.05).unwrap().slower.len(), slower);
        }
    }

    #[test]
    fn choices_that_leave_the_front_are_named() {
        let all = [standing::FRONT, standing::TIE, standing::BEATEN];
        let report = |now: &str| {
            let mut report = run(1, 0.0, 1.0);
            report.fact(&format!("{}fast", standing::PREFIX), now);
            report
        };
        for before in all {
            for now in all {
                let outcome = compare(&report(before), &report(now), 0.05).unwrap();
                let fallen = before != standing::BEATEN && now == standing::BEATEN;
                assert_eq!(outcome.fallen, if fallen { vec!["fast"] } else { vec![] }, "{before}, {now}");
                assert_eq!(outcome.text().contains("OFF THE FRONT: fast,"), fallen);
            }
        }
        // A choice that was not measured has not left the front.
        assert!(compare(&report(standing::FRONT), &run(1, 0.0, 1.0), 0.05).unwrap().fallen.is_empty());
    }

    #[test]
    fn standings_are_not_compared_between_different_choices() {
        let report = |filter: Option<&str>, choices: &[(&str, &str)]| {
            let mut report = run(1, 0.0, 1.0);
            if let Some(filter) = filter {
                report.setting(FILTER, filter);
            }
            choices.iter().for_each(|(name, how)| report.fact(&format!("{}{name}", standing::PREFIX), *how));
            report
        };
        let few = report(Some("fast"), &[("fast", standing::FRONT)]);
        let all = report(Some(""), &[("fast", standing::BEATEN), ("faster", standing::FRONT)]);
        let outcome = compare(&few, &all, 0.05).unwrap();
        assert!(outcome.fallen.is_empty() && outcome.text().contains("the choices are not those of the baseline"));
        assert!(compare(&all, &few, 0.05).unwrap().other_choices);
        // Reports without a recorded filter are compared if their choices are equal.
        let old = report(None, &[("fast", standing::FRONT), ("faster", standing::FRONT)]);
        let outcome = compare(&old, &all, 0.05).unwrap();
        assert!(outcome.fallen == ["fast"] && !outcome.text().contains("those of the baseline"));
    }

    #[test]
    fn choices_of_other_settings_are_refused() {
        let report = |settings: Option<&str>| {
            let mut report = run(1, 0.0, 1.0);
            if let Some(settings) = settings {
                report.setting("settings", settings);
            }
            report
        };
        let (old, small, large) = (report(None), report(Some("levels=8")), report(Some("levels=16")));
        let message = compare(&small, &large, 0.05).unwrap_err().to_string();
        assert_eq!(message, "The baseline has settings \"levels=8\", this run \"levels=16\".");
        // An old report does not record its settings.
        assert!(compare(&old, &small, 0.05).is_ok() && compare(&small, &old, 0.05).is_err());
    }

    #[test]
    fn ratios_are_compared_with_their_standard_errors() {
        let report = |value: f64, off: f64| {
            let mut report = run(1, 0.0, 1.0);
            report.time("step, fast, of exact", "", Summary::known(value, off, 8));
            report
        };
        for (now, off, grown) in [(0.95, 0.01, false), (1.0, 0.01, true), (1.0, 0.04, false), (0.7, 0.01, false)] {
            let outcome = compare(&report(0.9, 0.01), &report(now, off), 0.05).unwrap();
            assert_eq!(outcome.slower.len(), usize::from(grown), "{now} ± {off}: {}", outcome.text());
        }
    }

    #[test]
    fn growth_of_tiny_errors_is_reported() {
        let report = |error: f64| {
            let mut report = run(1, 0.0, 1.0);
            report.time("mean error, exact", "", Summary::of(&[error]));
            report
        };
        for (now, grown) in [(2e-7, false), (5e-7, true)] {
            assert_eq!(compare(&report(1e-7), &report(now), 0.05).unwrap().slower.len(), usize::from(grown), "{now}");
        }
    }

    #[test]
    fn values_that_become_non_finite_fail() {
        let report = |value: Summary| {
            let mut report = run(1, 0.0, 1.0);
            report.time("mean error, fast", "", value);
            report
        };
        let good = report(Summary::of(&[1e-3]));
        for wrong in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
            // A non-finite spread makes the band non-finite, too.
            for bad in [Summary::known(wrong, 0.0, 1), Summary::known(1e-3, wrong, 8), Summary::of(&[wrong])] {
                let bad = report(bad);
                let outcome = compare(&good, &bad, 0.05).unwrap();
                assert_eq!(outcome.slower.len(), 1, "{wrong}");
                assert!(outcome.text().contains("GROWN mean error, fast"), "{wrong}: {}", outcome.text());
                assert!(compare(&bad, &bad, 0.05).unwrap().slower.is_empty());
                let outcome = compare(&bad, &good, 0.05).unwrap();
                assert_eq!((outcome.slower.len(), outcome.faster.len()), (0, 1), "{wrong}");
            }
        }
    }

    #[test]
    fn incomparable_reports_are_refused() {
        let base = run(1, 0.0, 1.0);
        let mut other = run(1, 0.0, 1.0);
        other.setting("gaussians", 2000);
        assert!(compare(&base, &other, 0.05).unwrap_err().to_string().contains("gaussians 1000"));
        let mut other = run(1, 0.0, 1.0);
        other.device.driver = "b 2".into();
        assert!(compare(&base, &other, 0.05).is_err());
        let mut other = run(1, 0.0, 1.0);
        other.passes.remove(0);
        assert_eq!(compare(&base, &other, 0.05).unwrap().missing, ["p/small"]);
    }
}
