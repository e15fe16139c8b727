//! Check of the roofline model on the device that measured a step: `engine-bench roofline --ratios`.
//!
//! A step is predicted twice from the counts of its passes. First from the measured rates of the device alone: bytes,
//! operations, atomics, and a dispatch with its barrier per pass. Then each pass also takes its ratio of time to bound
//! from another step on the same device. Both predictions are compared with the measured times. A step cannot be
//! checked with its own ratios.

use crate::report::{PassRow, Report};
use std::collections::BTreeMap;
use std::fmt::Write;

/// Rates of a device, in units per second, and seconds of an empty pass.
#[derive(Clone)]
struct Rates {
    bytes: f64,
    operations: f64,
    /// Atomic operations per second; absent if not measured.
    atomics: Option<f64>,
    dispatch: f64,
    /// Bytes per second of a kernel that writes a word per invocation, on a processor.
    words: Option<f64>,
}

impl Rates {
    fn of(report: &Report) -> anyhow::Result<Rates> {
        use anyhow::Context;
        let ceiling = report.ceiling.as_ref().context("The report has no measured rates of its device.")?;
        let (bytes, operations) = (ceiling.bytes_per_second, ceiling.operations_per_second);
        let words = (report.device.kind == "cpu").then_some(ceiling.fill_bytes_per_second).filter(|rate| *rate > 0.0);
        let atomics = Some(ceiling.atomics_per_second).filter(|rate| *rate > 0.0);
        Ok(Rates { bytes, operations, atomics, dispatch: ceiling.dispatch_seconds, words })
    }

    /// Predicts the nanoseconds of a pass.
    ///
    /// A software device takes instructions for each word that a lane reads or writes, one after the other with those of
    /// its arithmetic. No kernel comes near the rate of a copy there. Atomics are among these words, and determine the
    /// time of a pass only if they take longer.
    fn predict(&self, pass: &PassRow) -> f64 {
        let work = match self.words {
            Some(words) => 1e9 * (pass.bytes.unwrap_or(0.0) / words + pass.operations.unwrap_or(0.0) / self.operations),
            None => 0.0,
        };
        1e9 * self.dispatch + work.max(self.bound(pass))
    }

    /// Returns the least nanoseconds that bytes, operations and atomics take.
    fn bound(&self, pass: &PassRow) -> f64 {
        let of = |count: Option<f64>, rate: f64| count.unwrap_or(0.0) / rate;
        let atomics = self.atomics.map_or(0.0, |rate| of(pass.atomics, rate));
        1e9 * of(pass.bytes, self.bytes).max(of(pass.operations, self.operations)).max(atomics)
    }
}

/// Measured time of a pass and its two predictions, in nanoseconds.
#[derive(Clone, Debug, PartialEq)]
pub struct Checked {
    name: String,
    measured: f64,
    /// From rates and counts alone.
    counts: f64,
    /// With the ratio of another step; absent if that step lacks the pass.
    ratios: Option<f64>,
}

/// Predicts a step by its counts, and by the ratios of another step.
///
/// # Errors
/// If the devices differ, the steps are the same, or a report has no rates.
pub fn predict(
    (report, passes): (&Report, &[&PassRow]),
    (other, known): (&Report, &[&PassRow]),
) -> anyhow::Result<Vec<Checked>> {
    let device = |r: &Report| (r.device.name.clone(), r.device.subgroup_size);
    anyhow::ensure!(
        device(report) == device(other),
        "The ratios are of {}, and the step of {}; use --against for another device.",
        other.device.name,
        report.device.name
    );
    anyhow::ensure!(
        report.settings != other.settings,
        "The ratios are of the same step, so that they fit it; select another scene or size."
    );
    let (own, mut theirs) = (Rates::of(report)?, Rates::of(other)?);
    // A ratio with atomics does not fit a bound without them, or the other way round.
    let mut alike = own.clone();
    if own.atomics.is_none() || theirs.atomics.is_none() {
        (alike.atomics, theirs.atomics) = (None, None);
    }
    let fixed = known.iter().map(|p| p.nanoseconds.median).fold(f64::INFINITY, f64::min);
    let known: BTreeMap<&str, &PassRow> = known.iter().map(|pass| (pass.pass.as_str(), *pass)).collect();
    let one = |pass: &&PassRow| {
        let bound = alike.bound(pass);
        let ratios = known.get(pass.pass.as_str()).map(|other| {
            let (time, least) = (other.nanoseconds.median, theirs.bound(other));
            // The shortest pass is an empty one. A pass without counts has the same time in every step.
            if least > 0.0 { fixed + (time - fixed) / least * bound } else { time }
        });
        let counts = own.predict(pass);
        Checked { name: pass.pass.clone(), measured: pass.nanoseconds.median, counts, ratios }
    };
    Ok(passes.iter().map(one).collect())
}

fn ms(nanoseconds: f64) -> String {
    format!("{:.3}", nanoseconds * 1e-6)
}

/// Formats a table: the slowest passes, the others, and the sum, each with the ratio of prediction and measurement.
pub fn table(checked: &[Checked], device: &str, rows: usize) -> String {
    let mut order: Vec<&Checked> = checked.iter().collect();
    order.sort_by(|a, b| b.measured.total_cmp(&a.measured).then(a.name.cmp(&b.name)));
    let sum = |of: &[&Checked], name: &str| Checked {
        name: name.to_owned(),
        measured: of.iter().map(|c| c.measured).sum(),
        counts: of.iter().map(|c| c.counts).sum(),
        // A pass without a ratio keeps its prediction by counts, so that sums are of the same passes.
        ratios: Some(of.iter().map(|c| c.ratios.unwrap_or(c.counts)).sum()),
    };
    let mut text = format!(
        "| pass | {device}, measured, ms | from counts, ms | ratio | with ratios, ms | ratio |\n|---|---|---|---|---|---|\n"
    );
    let (shown, rest) = order.split_at(rows.min(order.len()));
    let others = (!rest.is_empty()).then(|| sum(rest, &format!("{} other passes", rest.len())));
    for row in shown.iter().copied().chain(&others).chain([&sum(&order, "sum")]) {
        let of = |predicted: f64| format!("{} | {:.2}", ms(predicted), predicted / row.measured);
        let ratios = row.ratios.map_or("| ".to_owned(), of);
        let _ = writeln!(text, "| {} | {} | {} | {} |", row.name, ms(row.measured), of(row.counts), ratios);
    }
    text
}

/// Returns a sentence on the errors: of the sum, and the mean over passes weighted by their time.
pub fn errors(checked: &[Checked]) -> String {
    let total: f64 = checked.iter().map(|c| c.measured).sum();
    let of = |predicted: &dyn Fn(&Checked) -> f64| {
        let sum: f64 = checked.iter().map(predicted).sum();
        let apart: f64 = checked.iter().map(|c| (predicted(c) - c.measured).abs()).sum();
        format!(
            "{:+.1} % of the sum, {:.1} % of the time in single passes",
            100.0 * (sum / total - 1.0),
            100.0 * apart / total
        )
    };
    let without = checked.iter().filter(|c| c.ratios.is_none()).count();
    let note = if without > 0 { format!(" {without} passes have no ratio.") } else { String::new() };
    format!(
        "Error from counts: {}. Error with ratios of the other step: {}.{note}",
        of(&|c| c.counts),
        of(&|c| c.ratios.unwrap_or(c.counts))
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ceiling::Ceiling;
    use crate::report::DeviceLine;
    use crate::stats::Summary;

    /// Returns a report of a device with 1 GB/s, 1 Gop/s and 10 ns per dispatch.
    fn report(gaussians: u32, passes: &[(&str, f64, Option<f64>)]) -> Report {
        let line = DeviceLine {
            name: "small".into(),
            kind: "discrete".into(),
            driver: "none".into(),
            api: "1.3".into(),
            subgroup_size: 8,
        };
        let mut report = Report::new("step", line, 1, 0);
        report.setting("gaussians", gaussians);
        let ceiling = Ceiling { bytes_per_second: 1e9, operations_per_second: 1e9, ..Default::default() };
        report.ceiling = Some(Ceiling { dispatch_seconds: 1e-8, ..ceiling });
        for (pass, time, bytes) in passes {
            let nanoseconds = Summary::of(&[*time]);
            let (plan, pass) = ("plan".to_owned(), (*pass).to_owned());
            report.passes.push(PassRow {
                plan,
                pass,
                nanoseconds,
                bytes: *bytes,
                operations: None,
                atomics: None,
                share: None,
                bound: None,
            });
        }
        report
    }

    fn passes(report: &Report) -> Vec<&PassRow> {
        report.passes.iter().collect()
    }

    #[test]
    fn step_is_predicted_by_counts_and_by_ratios_of_another() {
        let known = report(1, &[("empty", 20.0, None), ("a", 220.0, Some(100.0)), ("b", 70.0, Some(10.0))]);
        let step = report(
            2,
            &[("a", 440.0, Some(200.0)), ("b", 300.0, Some(40.0)), ("empty", 25.0, None), ("new", 100.0, Some(50.0))],
        );
        let checked = predict((&step, &passes(&step)), (&known, &passes(&known))).unwrap();
        let of = |name: &str| checked.iter().find(|c| c.name == name).unwrap();
        // An empty pass, and the bytes.
        assert!((of("a").counts - 210.0).abs() < 1e-9 && (of("b").counts - 50.0).abs() < 1e-9);
        // 2 ns and 5 ns per byte beyond an empty pass.
        assert!((of("a").ratios.unwrap() - 420.0).abs() < 1e-9 && (of("b").ratios.unwrap() - 220.0).abs() < 1e-9);
        assert_eq!((of("empty").ratios, of("new").ratios), (Some(20.0), None));
        let text = table(&checked, "small", 2);
        assert!(text.contains("| a | 0.000 | 0.000 | 0.48 | 0.000 | 0.95 |"), "{text}");
        assert!(text.contains("2 other passes") && text.lines().count() == 6, "{text}");
        let sentence = errors(&checked);
        // Sums: 865 ns measured, 330 by counts, 720 with ratios; single passes: 535 and 145.
        assert!(sentence.contains("-61.8 % of the sum, 61.8 % of the time"), "{sentence}");
        assert!(sentence.contains("-16.8 % of the sum, 16.8 % of the time"), "{sentence}");
        assert!(sentence.contains("1 passes have no ratio"), "{sentence}");
    }

    #[test]
    fn processors_take_time_for_words_and_for_arithmetic() {
        let mut step = report(2, &[("a", 440.0, Some(200.0))]);
        step.passes[0].operations = Some(50.0);
        assert_eq!(Rates::of(&step).unwrap().predict(&step.passes[0]), 210.0);
        step.device.kind = "cpu".into();
        step.ceiling.as_mut().unwrap().fill_bytes_per_second = 1e8;
        let rates = Rates::of(&step).unwrap();
        assert!((rates.predict(&step.passes[0]) - (10.0 + 2000.0 + 50.0)).abs() < 1e-9);
        assert_eq!(rates.bound(&step.passes[0]), 200.0);
    }

    #[test]
    fn atomics_count_in_ratios_where_both_reports_have_their_rate() {
        let reports = |rates: [f64; 2]| {
            let rows = [("a", 500.0, Some(100.0)), ("empty", 100.0, Some(0.0))];
            let [mut known, mut step] = [1, 2].map(|gaussians| report(gaussians, &rows));
            (known.passes[0].atomics, step.passes[0].atomics) = (Some(200.0), Some(400.0));
            for (report, rate) in [&mut known, &mut step].into_iter().zip(rates) {
                report.ceiling.as_mut().unwrap().atomics_per_second = rate;
            }
            let checked = predict((&step, &passes(&step)), (&known, &passes(&known))).unwrap();
            [checked[0].counts.round(), checked[0].ratios.unwrap().round()]
        };
        // A dispatch of 10 ns, and the longer of 100 ns of bytes and 400 ns of atomics. The other step took 400 ns more than an
        // empty pass, for 200 ns of atomics; this one has twice as many.
        assert_eq!(reports([1e9, 1e9]), [410.0, 100.0 + 400.0 / 200.0 * 400.0]);
        // Ratios of bytes, which are the same in both.
        assert_eq!(reports([0.0, 1e9]), [410.0, 500.0]);
        assert_eq!(reports([1e9, 0.0]), [110.0, 500.0]);
    }

    #[test]
    fn own_ratios_and_other_devices_are_refused() {
        let step = report(2, &[("a", 440.0, Some(200.0))]);
        let error = predict((&step, &passes(&step)), (&step, &passes(&step))).unwrap_err().to_string();
        assert!(error.contains("the same step"), "{error}");
        let mut far = report(1, &[("a", 440.0, Some(200.0))]);
        far.device.name = "large".into();
        let error = predict((&step, &passes(&step)), (&far, &passes(&far))).unwrap_err().to_string();
        assert!(error.contains("large") && error.contains("--against"), "{error}");
    }
}
