//! Prediction of a step on other devices from the counts of its passes: `engine-bench roofline`.
//!
//! A pass takes at least its bytes over the bandwidth, its operations over the arithmetic rate, or its atomics over
//! their rate on a device, whichever is longest. This is the roofline model (Williams, Waterman, Patterson 2009) with
//! one more rate. Operations of passes that process tiles take longer where tiles load the schedulers unevenly. A
//! measured report adds how far each pass is from that bound, and the time of a dispatch with its barrier.

use super::own_step;
use super::step::SHAPE;
use super::tiles::Tiles;
use crate::report::set::ReportSet;
use crate::report::{PassRow, Report};
use anyhow::Context;
use std::collections::BTreeMap;
use std::fmt::Write;
use std::path::PathBuf;

/// Options of the command.
#[derive(clap::Args, Clone, Debug)]
pub struct Args {
    /// Report file with a report of `step`.
    report: PathBuf,
    /// Settings that select the report, as gaussians=1000000.
    #[arg(value_name = "NAME=VALUE", value_parser = setting)]
    settings: Vec<(String, String)>,
    /// Devices to predict: 4090, h100, h200, 7900xtx.
    #[arg(long, value_name = "NAMES", value_delimiter = ',', default_value = "4090,h200,7900xtx", value_parser = target)]
    target: Vec<Target>,
    /// Report file with the same step measured on another device. Its device is predicted, and the error printed.
    #[arg(long, value_name = "FILE.json")]
    against: Option<PathBuf>,
    /// Report file of another step on the same device, and settings that select it. The step is predicted from its counts, and with
    /// the ratio of time to bound of each pass of the other step; both errors are printed.
    #[arg(long, value_name = "FILE.json[,NAME=VALUE]", value_delimiter = ',', conflicts_with = "against")]
    ratios: Vec<String>,
    /// Plan to predict; the first of the report by default, which is the training step.
    #[arg(long, value_name = "NAME")]
    plan: Option<String>,
    /// Number of passes to print; the slowest by the first prediction.
    #[arg(long, value_name = "N", default_value = "20")]
    rows: usize,
}

fn setting(text: &str) -> Result<(String, String), String> {
    let (name, value) = text.split_once('=').ok_or("expected NAME=VALUE")?;
    Ok((name.to_owned(), value.to_owned()))
}

/// Rates of a device.
#[derive(Clone, Debug, Default, PartialEq)]
struct Target {
    name: String,
    /// Bytes a second of a kernel that copies.
    bandwidth: f64,
    /// Operations a second, where a multiply-add counts as two.
    arithmetic: f64,
    /// Schedulers, each of which runs a subgroup at a time; absent if unknown.
    schedulers: Option<f64>,
    /// Atomic operations a second; absent if not measured. Datasheets do not state them.
    atomics: Option<f64>,
    /// Nanoseconds of a dispatch with its barrier; absent if not measured.
    dispatch: Option<f64>,
}

/// Datasheet rates: name, bytes a second, operations a second in 32 bits, schedulers.
const DATASHEETS: [(&str, f64, f64, f64); 4] = [
    ("4090", 1.008e12, 82.6e12, 512.0),
    ("h100", 3.35e12, 66.9e12, 528.0),
    ("h200", 4.8e12, 66.9e12, 528.0),
    ("7900xtx", 0.96e12, 61.4e12, 192.0),
];

/// Parts of the datasheet's rates that kernels reach.
///
/// Measured on an H100 (bench/results/nvidia-h100).
const REACHED: (f64, f64) = (0.74, 0.88);

fn target(name: &str) -> Result<Target, String> {
    let found = DATASHEETS.iter().find(|(known, ..)| *known == name.to_lowercase());
    let (name, bandwidth, arithmetic, schedulers) =
        found.ok_or_else(|| format!("unknown device; there are {}", DATASHEETS.map(|d| d.0).join(", ")))?;
    let (bandwidth, arithmetic) = (REACHED.0 * bandwidth, REACHED.1 * arithmetic);
    let (name, schedulers) = ((*name).to_owned(), Some(*schedulers));
    Ok(Target { name, bandwidth, arithmetic, schedulers, ..Default::default() })
}

impl Target {
    /// Returns the device of a report, by its measured rates.
    fn of(report: &Report) -> anyhow::Result<Target> {
        let ceiling = report.ceiling.as_ref().context("The report has no measured rates of its device.")?;
        let measured = |value: f64| (value > 0.0).then_some(value);
        let name = report.device.name.to_lowercase().replace(' ', "");
        let known = DATASHEETS.iter().find(|(known, ..)| name.contains(known));
        Ok(Target {
            name: report.device.name.clone(),
            bandwidth: ceiling.bytes_per_second,
            arithmetic: ceiling.operations_per_second,
            schedulers: known.map(|(.., schedulers)| *schedulers),
            atomics: measured(ceiling.atomics_per_second),
            dispatch: measured(1e9 * ceiling.dispatch_seconds),
        })
    }

    /// Returns the device with the atomic rate that predictions use.
    ///
    /// A device without a measured rate is assumed to have that of the measured device. If that has none, atomics do
    /// not count on either.
    fn beside(&self, own: &Target) -> Target {
        Target { atomics: own.atomics.map(|rate| self.atomics.unwrap_or(rate)), ..self.clone() }
    }

    /// Returns the nanoseconds of a pass without any loss. Tiles count as equally long but for the longest one, and
    /// additions of zeros count.
    fn bound(&self, pass: &PassRow, tiles: &Tiles) -> f64 {
        let of = |count: Option<f64>, rate: f64| count.unwrap_or(0.0) / rate;
        let uneven = self.schedulers.map_or(1.0, |schedulers| tiles.imbalance(&pass.pass, schedulers));
        let atomics = self.atomics.map_or(0.0, |rate| of(pass.atomics, rate));
        1e9 * of(pass.bytes, self.bandwidth).max(of(pass.operations, self.arithmetic) * uneven).max(atomics)
    }
}

/// Returns the number of barriers of a plan; `None` if the report lacks it.
fn barriers(report: &Report, plan: &str) -> Option<u32> {
    // Facts call the plan of each stage its step.
    let kind = if plan.ends_with("_step") { "step" } else { plan };
    let fact = report.facts.iter().find(|fact| fact.name.strip_suffix(SHAPE) == Some(kind))?;
    fact.value.as_str()?.split(", ").nth(2)?.parse().ok()
}

/// Prediction of one pass, in nanoseconds.
#[derive(Clone, Debug, PartialEq)]
struct Predicted {
    name: String,
    measured: f64,
    /// By target: prediction, and the bound without any loss.
    targets: Vec<(f64, f64)>,
}

/// Share of the bound below which latencies determine the time of a pass.
const LATENCY: f64 = 0.05;

/// Share of the bound from which bandwidth or arithmetic limit a pass.
const LIMITED: f64 = 0.4;

/// Share of the bound that passes reach at best.
const BEST: f64 = 0.7;

/// Predicts passes.
///
/// A pass keeps its fixed time, that of a dispatch with its barrier. This is the time of the shortest pass if that is
/// shorter, or if the dispatch was not measured. If the pass is near its bound, it keeps its distance from it. If not,
/// instructions and caches limit it, and their rate grows with the arithmetic rate, which is that of units and clock; it
/// never comes closer to the bound than passes do at best. Passes far below their bound, or without a cost model, keep
/// their time.
fn predict(passes: &[&PassRow], tiles: &Tiles, own: &Target, targets: &[Target]) -> Vec<Predicted> {
    let shortest = passes.iter().map(|p| p.nanoseconds.median).fold(f64::INFINITY, f64::min);
    let fixed = own.dispatch.map_or(shortest, |dispatch| dispatch.min(shortest));
    let one = |pass: &&PassRow| {
        let measured = pass.nanoseconds.median;
        let (bound, variable) = (own.bound(pass, tiles), measured - fixed);
        let of = |target: &Target| {
            let least = target.bound(pass, tiles);
            let time = if bound < LATENCY * measured {
                measured - bound + least
            } else if bound < LIMITED * variable {
                fixed + (variable * own.arithmetic / target.arithmetic).max(least / BEST)
            } else {
                fixed + (variable / bound).max(1.0) * least
            };
            (time, least)
        };
        Predicted { name: pass.pass.clone(), measured, targets: targets.iter().map(of).collect() }
    };
    passes.iter().map(one).collect()
}

/// Returns the passes of a plan; those of the first plan if none is named.
fn passes_of<'a>(report: &'a Report, plan: Option<&str>) -> anyhow::Result<Vec<&'a PassRow>> {
    let first = report.passes.first().context("The report has no passes.")?;
    let plan = plan.unwrap_or(&first.plan);
    let found: Vec<&PassRow> = report.passes.iter().filter(|pass| pass.plan == plan).collect();
    let mut known: Vec<&str> = report.passes.iter().map(|pass| pass.plan.as_str()).collect();
    known.dedup();
    anyhow::ensure!(!found.is_empty(), "The report has no plan \"{plan}\"; there are {}.", known.join(", "));
    Ok(found)
}

fn ms(nanoseconds: f64) -> String {
    format!("{:.3}", nanoseconds * 1e-6)
}

/// Formats the predictions as a Markdown table: the slowest passes, the others, and the sum.
///
/// `barriers`: their number, and the measured nanoseconds of one with its dispatch. The last row has their product,
/// which is assumed to be the same on each device. The fixed times of passes contain it.
fn table(predicted: &[Predicted], own: &str, targets: &[Target], barriers: Option<(u32, f64)>, rows: usize) -> String {
    let mut order: Vec<&Predicted> = predicted.iter().collect();
    order.sort_by(|a, b| b.targets[0].0.total_cmp(&a.targets[0].0).then(a.name.cmp(&b.name)));
    let mut text = format!("| pass | {own}, measured, ms |");
    targets.iter().for_each(|t| {
        let _ = write!(text, " {}, predicted | at best |", t.name);
    });
    text += &format!("\n|---|---|{}\n", "---|---|".repeat(targets.len()));
    let sum = |of: &[&Predicted], name: &str| Predicted {
        name: name.to_owned(),
        measured: of.iter().map(|p| p.measured).sum(),
        targets: (0..targets.len())
            .map(|i| of.iter().fold((0.0, 0.0), |s, p| (s.0 + p.targets[i].0, s.1 + p.targets[i].1)))
            .collect(),
    };
    let (shown, rest) = order.split_at(rows.min(order.len()));
    let others = (!rest.is_empty()).then(|| sum(rest, &format!("{} other passes", rest.len())));
    let all = sum(&order, "sum");
    for row in shown.iter().copied().chain(&others).chain([&all]) {
        let _ = write!(text, "| {} | {} |", row.name, ms(row.measured));
        row.targets.iter().for_each(|(predicted, least)| {
            let _ = write!(text, " {} | {} |", ms(*predicted), ms(*least));
        });
        text.push('\n');
    }
    if let Some((count, each)) = barriers {
        let all = ms(f64::from(count) * each);
        let same = format!(" {all} | |").repeat(targets.len());
        let _ = writeln!(text, "| of it {count} barriers | {all} |{same}");
    }
    text
}

/// Compares predictions for a device with its measured times: a sentence on the sum and the spread of the passes.
fn check(predicted: &[Predicted], other: &Report, passes: &[&PassRow]) -> anyhow::Result<String> {
    let times: BTreeMap<&str, f64> = passes.iter().map(|p| (p.pass.as_str(), p.nanoseconds.median)).collect();
    let pairs: Vec<(f64, f64)> = predicted
        .iter()
        .filter_map(|p| Some((p.targets[0].0, *times.get(p.name.as_str()).filter(|t| **t > 0.0)?)))
        .collect();
    anyhow::ensure!(!pairs.is_empty(), "The two reports have no pass in common.");
    let (sum, real) = pairs.iter().fold((0.0, 0.0), |s, p| (s.0 + p.0, s.1 + p.1));
    let mut ratios: Vec<f64> = pairs.iter().map(|(p, m)| p / m).collect();
    ratios.sort_by(f64::total_cmp);
    let at = |share: f64| ratios[((ratios.len() - 1) as f64 * share).round() as usize];
    let (count, all) = (pairs.len(), predicted.len());
    Ok(format!(
        "{}: predicted {} ms, measured {} ms, ratio {:.2}, for {count} of {all} passes. Ratio of a pass: median {:.2}, middle half \
         {:.2} to {:.2}.",
        other.device.name,
        ms(sum),
        ms(real),
        sum / real,
        at(0.5),
        at(0.25),
        at(0.75)
    ))
}

/// Prints the predictions.
///
/// # Errors
/// If a file cannot be read, or no report or several reports match.
pub fn run(a: &Args) -> anyhow::Result<()> {
    let set = ReportSet::read(&a.report)?;
    let report = set.only("step", &a.settings)?;
    let (own, passes) = (Target::of(report)?, passes_of(report, a.plan.as_deref())?);
    if let Some((file, settings)) = a.ratios.split_first() {
        let settings = settings.iter().map(|text| setting(text)).collect::<Result<Vec<_>, _>>();
        let others = ReportSet::read(file.as_ref())?;
        let other = others.only("step", &settings.map_err(anyhow::Error::msg)?)?;
        let checked = own_step::predict((report, &passes), (other, &passes_of(other, a.plan.as_deref())?))?;
        print!("{}\n{}\n", own_step::table(&checked, &own.name, a.rows), own_step::errors(&checked));
        return Ok(());
    }
    let (tiles, barriers) = (Tiles::of(report), barriers(report, &passes[0].plan).zip(own.dispatch));
    let Some(file) = &a.against else {
        let targets: Vec<Target> = a.target.iter().map(|target| target.beside(&own)).collect();
        let predicted = predict(&passes, &tiles, &own, &targets);
        print!("{}", table(&predicted, &own.name, &targets, barriers, a.rows));
        return Ok(());
    };
    let others = ReportSet::read(file)?;
    let other = others.only("step", &a.settings)?;
    if let Some((name, value)) = report.differs(other) {
        let theirs = other.setting_text(name).unwrap_or_else(|| "none".to_owned());
        anyhow::bail!("The reports are of different steps: {name} is {value} and {theirs}.");
    }
    let targets = [Target::of(other)?.beside(&own)];
    let predicted = predict(&passes, &tiles, &own, &targets);
    print!("{}", table(&predicted, &own.name, &targets, barriers, a.rows));
    println!("\n{}", check(&predicted, other, &passes_of(other, a.plan.as_deref())?)?);
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ceiling::Ceiling;
    use crate::commands::tiles::{ALL_TILES, LONGEST_TILE, TILE};
    use crate::report::DeviceLine;
    use crate::stats::Summary;

    /// Returns a report of a device with 1 GB/s and 1 Gop/s. Its shortest pass takes 100 ns.
    fn report() -> Report {
        let line = DeviceLine {
            name: "small".into(),
            kind: "discrete".into(),
            driver: "none".into(),
            api: "1.3".into(),
            subgroup_size: 32,
        };
        let mut report = Report::new("step", line, 1, 0);
        report.ceiling = Some(Ceiling { bytes_per_second: 1e9, operations_per_second: 1e9, ..Default::default() });
        let mut add = |pass: &str, time: f64, bytes: Option<f64>, operations: Option<f64>| {
            let nanoseconds = Summary::of(&[time]);
            let (plan, pass) = ("plan".to_owned(), pass.to_owned());
            let (atomics, share, bound) = (None, None, None);
            report.passes.push(PassRow { plan, pass, nanoseconds, bytes, operations, atomics, share, bound });
        };
        add("copy", 1100.0, Some(500.0), Some(10.0));
        add("sum", 4100.0, Some(10.0), Some(1000.0));
        add("latency", 400.0, Some(10.0), Some(0.0));
        add("empty", 100.0, Some(0.0), Some(0.0));
        add("unknown", 300.0, None, None);
        report
    }

    /// Returns a device of some rates of bytes and operations.
    fn device(bandwidth: f64, arithmetic: f64) -> Target {
        Target { name: "other".into(), bandwidth, arithmetic, ..Default::default() }
    }

    fn near(a: f64, b: f64) {
        assert!((a - b).abs() < 1e-6, "{a} {b}");
    }

    #[test]
    fn passes_keep_fixed_time_and_distance_from_the_bound() {
        let report = report();
        let (own, passes) = (Target::of(&report).unwrap(), passes_of(&report, None).unwrap());
        let none = Tiles::default();
        let predicted = predict(&passes, &none, &own, &[own.clone(), device(1e10, 2e9)]);
        // The own device is predicted as it was measured.
        predicted.iter().for_each(|p| near(p.targets[0].0, p.measured));
        // Twice the bound of 500 ns, at ten times the bandwidth. Far from the bound of 1000 ns, at twice the rate.
        near(predicted[0].targets[1].0, 100.0 + 2.0 * 50.0);
        near(predicted[1].targets[1].0, 100.0 + 4000.0 / 2.0);
        near(predicted[1].targets[1].1, 500.0);
        // No pass comes closer to the bound than passes do at best.
        let wide = predict(&passes, &none, &own, &[device(5e7, 1e11)]);
        near(wide[1].targets[0].0, 100.0 + 200.0 / 0.7);
        // Latency, and a pass without a model.
        near(predicted[2].targets[1].0, 400.0 - 10.0 + 1.0);
        near(predicted[3].targets[1].0, 100.0);
        near(predicted[4].targets[1].0, 300.0);
    }

    #[test]
    fn uneven_tiles_bound_passes_by_tile() {
        let mut report = report();
        report.setting("size", "426x320");
        report.fact(TILE, "16x16; 44.0 %, 24.4 %");
        let mut pass = report.passes[1].clone();
        let target = Target { schedulers: Some(528.0), ..device(1e9, 1e9) };
        let tiles = Tiles::of(&report);
        // 1000 ns of arithmetic on all schedulers. Of 540 tiles, some of the 528 schedulers have two.
        near(target.bound(&pass, &tiles), 1000.0);
        pass.pass = "blend_bwd".into();
        near(target.bound(&pass, &tiles), 1000.0 * 2.0 * 528.0 / 540.0);
        near(Target { schedulers: None, ..target.clone() }.bound(&pass, &tiles), 1000.0);
        // One scheduler takes a twentieth of the arithmetic, with its part of the rate.
        report.fact(LONGEST_TILE, 500.0);
        report.fact(ALL_TILES, 10_000.0);
        near(target.bound(&pass, &Tiles::of(&report)), 1000.0 * 528.0 / 20.0);
        // Schedulers share the bandwidth.
        pass.operations = None;
        near(target.bound(&pass, &Tiles::of(&report)), 10.0);
    }

    #[test]
    fn device_of_a_known_name_predicts_itself_and_its_like() {
        let mut report = report();
        report.device.name = "NVIDIA H100 80GB HBM3".into();
        report.setting("size", "426x320");
        report.fact(TILE, "16x16; 44.0 %, 24.4 %");
        // Near its bound: 1956 ns with two tiles on the busiest scheduler.
        report.passes[1].pass = "blend_bwd".into();
        let (own, passes) = (Target::of(&report).unwrap(), passes_of(&report, None).unwrap());
        assert_eq!(own.schedulers, Some(528.0));
        let even = Target { schedulers: Some(540.0), ..own.clone() };
        let predicted = predict(&passes, &Tiles::of(&report), &own, &[own.clone(), even]);
        predicted.iter().for_each(|p| near(p.targets[0].0, p.measured));
        near(predicted[1].targets[1].0, 100.0 + 4000.0 * 540.0 / (2.0 * 528.0));
    }

    #[test]
    fn atomics_bound_passes_at_the_rate_of_the_measured_device() {
        let mut report = report();
        report.passes[0].atomics = Some(900.0);
        let none = Tiles::default();
        let bound = |report: &Report| {
            let own = Target::of(report).unwrap();
            let other = Target { atomics: Some(2e9), ..device(1e9, 1e9) };
            let targets = [own.clone(), device(1e9, 1e9).beside(&own), other.beside(&own)];
            targets.map(|target| target.bound(&report.passes[0], &none).round())
        };
        // Without a measured rate, atomics do not count.
        assert_eq!(bound(&report), [500.0; 3]);
        report.ceiling.as_mut().unwrap().atomics_per_second = 1e9;
        assert_eq!(bound(&report), [900.0, 900.0, 500.0]);
        // A pass near the bound of its atomics is not faster where bytes and operations are.
        let (own, passes) = (Target::of(&report).unwrap(), passes_of(&report, None).unwrap());
        let predicted = predict(&passes, &none, &own, &[own.clone(), device(1e12, 1e12).beside(&own)]);
        near(predicted[0].targets[0].0, 1100.0);
        near(predicted[0].targets[1].0, 1100.0);
    }

    #[test]
    fn barriers_have_a_part_of_the_sum() {
        let mut report = report();
        assert_eq!(barriers(&report, "geometry_step"), None);
        report.fact(&format!("step{SHAPE}"), "40, 34, 33");
        report.fact(&format!("render{SHAPE}"), "34, 29, 28");
        let of = |plan: &str| barriers(&report, plan);
        assert_eq!([of("geometry_step"), of("render"), of("densify")], [Some(33), Some(28), None]);
        report.ceiling.as_mut().unwrap().dispatch_seconds = 4e-8;
        let (own, passes) = (Target::of(&report).unwrap(), passes_of(&report, None).unwrap());
        // A pass keeps the time of a dispatch, which is less than that of the shortest pass.
        let targets = [own.clone(), device(1e10, 2e9)];
        let predicted = predict(&passes, &Tiles::default(), &own, &targets);
        predicted.iter().for_each(|p| near(p.targets[0].0, p.measured));
        near(predicted[1].targets[1].0, 40.0 + (4100.0 - 40.0) / 2.0);
        let text = table(&predicted, "small", &targets, Some((50_000, own.dispatch.unwrap())), 2);
        assert!(text.ends_with("\n| of it 50000 barriers | 2.000 | 2.000 | | 2.000 | |\n"), "{text}");
    }

    #[test]
    fn table_has_the_slowest_passes_and_their_sum() {
        let report = report();
        let own = Target::of(&report).unwrap();
        let passes = passes_of(&report, Some("plan")).unwrap();
        let predicted = predict(&passes, &Tiles::default(), &own, std::slice::from_ref(&own));
        let text = table(&predicted, "small", &[own], None, 2);
        let rows: Vec<&str> = text.lines().skip(2).map(|line| line.split(" |").next().unwrap()).collect();
        assert_eq!(rows, ["| sum", "| copy", "| 3 other passes", "| sum"]);
        assert!(text.ends_with("| sum | 0.006 | 0.006 | 0.002 |\n"), "{text}");
        let mut twice = report.clone();
        twice.passes.iter_mut().for_each(|p| p.nanoseconds.median *= 2.0);
        let sentence = check(&predicted, &twice, &passes_of(&twice, None).unwrap()).unwrap();
        assert!(sentence.contains("ratio 0.50, for 5 of 5 passes"), "{sentence}");
        assert!(check(&predicted, &twice, &[]).is_err());
        let error = passes_of(&report, Some("none")).unwrap_err().to_string();
        assert!(error.contains("no plan \"none\"; there are plan"), "{error}");
    }

    #[test]
    fn targets_are_named() {
        assert_eq!(target("H200").unwrap().bandwidth, 0.74 * 4.8e12);
        assert!(target("3dfx").unwrap_err().contains("4090, h100, h200, 7900xtx"));
        assert_eq!(setting("a=b=c"), Ok(("a".into(), "b=c".into())));
        assert!(setting("a").is_err());
    }
}
