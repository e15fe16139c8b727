//! Simulation of `sgs batch` past this machine: `engine-bench batch`.

use crate::common::Common;
use crate::simulate::disk::Protocol;
use crate::simulate::plan::{Disk, Distribution, Measured, Plan};
use crate::simulate::rehearse::{Rehearsal, rehearse};
use crate::simulate::{Figures, figures};
use anyhow::{Context, ensure};
use serde::Serialize;
use std::path::PathBuf;

/// Most runs times devices of a simulation. More would take hours.
const MOST: usize = 1 << 30;

/// Options of the command.
#[derive(clap::Args, Clone, Debug)]
pub struct Args {
    /// Number of rooms, each with one run; with --sweep the largest of the table.
    #[arg(long, value_name = "ROOMS", value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    simulate: u32,
    /// Number of devices, each with one worker; with --sweep the largest of the table.
    #[arg(long, value_name = "N", default_value_t = 256, value_parser = clap::value_parser!(u32).range(1..=65_536))]
    devices: u32,
    /// Summary of a real batch: run times, attempts and failures.
    #[arg(long, value_name = "SUMMARY.jsonl")]
    times: PathBuf,
    /// Finished run of the batch, whose files are measured.
    #[arg(long, value_name = "DIR")]
    run: Option<PathBuf>,
    /// Scene of the batch, whose files are measured.
    #[arg(long, value_name = "DIR")]
    scene: Option<PathBuf>,
    /// Rates of failures in place of the measured ones: temporary, permanent, worker (an hour), repair (seconds).
    #[arg(long, value_name = "FILE.toml|NAME=RATE,...")]
    failures: Option<String>,
    /// Estimate rates of failures with caution.
    ///
    /// By the rule of succession, (failures + 1) / (trials + 2): a few runs without a failure prove little.
    #[arg(long)]
    cautious: bool,
    /// How run times are drawn.
    #[arg(long, value_name = "KIND", default_value = "empirical")]
    distribution: Distribution,
    /// Mean seconds of a run, to which the measured times are scaled.
    #[arg(long, value_name = "SECONDS", value_parser = positive)]
    mean: Option<f64>,
    /// Error of the estimated cost: standard deviation of the logarithm of cost over time.
    #[arg(long, value_name = "SIGMA", default_value = "0.3", value_parser = not_negative)]
    estimate_error: f64,
    /// Seconds that a repeated attempt needs before it trains. By default those of --run outside of its steps, or 10.
    #[arg(long, value_name = "SECONDS", value_parser = not_negative)]
    resume: Option<f64>,
    /// Share of the workers that is lost at half of the lower bound.
    #[arg(long, value_name = "SHARE", default_value = "0.1", value_parser = share)]
    lose: f64,
    /// Milliseconds of one operation on the shared disk.
    #[arg(long, value_name = "MS", default_value = "1", value_parser = not_negative)]
    latency: f64,
    /// Operations a second that the shared disk serves.
    #[arg(long, value_name = "N", default_value = "20000", value_parser = positive)]
    disk_operations: f64,
    /// Bytes a second that the shared disk serves.
    #[arg(long, value_name = "N", default_value = "1e9", value_parser = positive)]
    disk_rate: f64,
    /// Version of the queue's use of the disk.
    #[arg(long, value_name = "VERSION", default_value = "current")]
    protocol: Protocol,
    /// Simulate a table of scales, with both versions of the queue's use of the disk.
    #[arg(long)]
    sweep: bool,
    /// Write the table of --sweep as Markdown.
    #[arg(long, value_name = "FILE.md", requires = "sweep")]
    table: Option<PathBuf>,
    /// Seed of all draws.
    #[arg(long, value_name = "SEED", default_value_t = 0)]
    seed: u32,
    /// Run the real queue over sleeping processes in this new directory.
    ///
    /// Each device has one thread.
    #[arg(long, value_name = "DIR", conflicts_with = "sweep")]
    rehearse: Option<PathBuf>,
}

fn number(text: &str, what: &str, fits: impl Fn(f64) -> bool) -> Result<f64, String> {
    text.parse().ok().filter(|v: &f64| v.is_finite() && fits(*v)).ok_or_else(|| format!("use {what}"))
}

fn positive(text: &str) -> Result<f64, String> {
    number(text, "a number above 0", |v| v > 0.0)
}

fn not_negative(text: &str) -> Result<f64, String> {
    number(text, "a number of at least 0", |v| v >= 0.0)
}

fn share(text: &str) -> Result<f64, String> {
    number(text, "at least 0 and at most 0.9", |v| (0.0..=0.9).contains(&v))
}

/// Answer as JSON.
#[derive(Serialize)]
struct Answer<'a> {
    command: &'static str,
    plan: &'a Plan,
    measured: &'a Measured,
    figures: &'a [Figures],
    #[serde(skip_serializing_if = "Option::is_none")]
    rehearsal: Option<Rehearsal>,
}

/// Runs the command.
///
/// # Errors
/// If an input cannot be read, or a file cannot be written.
pub fn run(common: &Common, a: &Args) -> anyhow::Result<()> {
    ensure!(common.compare.is_none(), "--compare is for measurements; a simulation has none");
    let measured = Measured::read(&a.times)?;
    let plan = plan(a, &measured)?;
    let (rooms, devices) = (a.simulate as usize, a.devices as usize);
    ensure!(
        rooms * devices <= MOST,
        "{rooms} rooms on {devices} devices are too many; their product is at most {MOST}"
    );
    let all: Vec<Figures> = if a.sweep {
        scales(rooms, devices).into_iter().flat_map(|scale| both(&plan, scale)).collect()
    } else {
        vec![figures(&plan)]
    };
    let rehearsal = a.rehearse.as_deref().map(|root| rehearse(&plan, root)).transpose()?;
    if let Some(path) = &a.table {
        let text = table(&all);
        sgs_scene::atomic_write(path, |f| std::io::Write::write_all(f, text.as_bytes()))?;
    }
    let answer = Answer { command: "batch", plan: &plan, measured: &measured, figures: &all, rehearsal };
    let json = serde_json::to_string_pretty(&answer).context("the figures cannot be written as JSON")?;
    match &common.json {
        Some(path) if path.as_os_str() == "-" => println!("{json}"),
        other => {
            if a.sweep {
                print!("{}", table(&all))
            } else {
                print!("{}", text(&all[0]))
            }
            if let Some(r) = &answer.rehearsal {
                println!("rehearsal: {} runs, {} processes, {:.1} s", r.ended, r.starts, r.end);
            }
            if let Some(path) = other {
                sgs_scene::atomic_write(path, |f| std::io::Write::write_all(f, (json + "\n").as_bytes()))?;
            }
        }
    }
    Ok(())
}

fn plan(a: &Args, measured: &Measured) -> anyhow::Result<Plan> {
    let mut plan = Plan::ideal(measured.seconds.clone(), a.devices as usize);
    plan.rooms = a.simulate as usize;
    plan.seed = a.seed;
    plan.distribution = a.distribution;
    plan.mean = a.mean;
    plan.estimate_error = a.estimate_error;
    plan.rates = measured.rates(a.cautious);
    if let Some(text) = &a.failures {
        plan.rates = plan.rates.with(text)?;
    }
    let mut interval = f64::from(sgs_config::Settings::default().train.checkpoint_interval);
    plan.resume = 10.0;
    if let Some(run) = &a.run {
        let path = run.join("config.toml");
        let text = std::fs::read_to_string(&path).with_context(|| format!("\"{}\" cannot be read", path.display()))?;
        let config: toml::Table = text.parse().with_context(|| format!("\"{}\" is no TOML", path.display()))?;
        let number = |table: &str, key: &str| Some(config.get(table)?.get(key)?.as_integer()? as f64);
        interval = number("train", "checkpoint_interval").unwrap_or(interval);
        plan.resume = number("geometry", "steps").map_or(plan.resume, |steps| measured.overhead(steps));
    }
    plan.resume = a.resume.unwrap_or(plan.resume);
    // A batch that trains no geometry has no speed; then only the end of a run is a checkpoint.
    plan.checkpoint = if measured.steps_per_second > 0.0 { interval / measured.steps_per_second } else { 1e9 };
    plan.sizes.result = measured.result_bytes;
    if let Some(run) = &a.run {
        plan.sizes.measure_run(run)?;
    }
    if let Some(scene) = &a.scene {
        plan.sizes.measure_scene(scene)?;
    }
    plan.disk = Disk { latency: a.latency / 1e3, operations: a.disk_operations, bytes: a.disk_rate };
    plan.protocol = a.protocol;
    plan.lose = a.lose;
    Ok(plan)
}

/// Returns rooms and devices of the rows of a table, up to the given ones.
fn scales(rooms: usize, devices: usize) -> Vec<(usize, usize)> {
    let mut all = Vec::new();
    let mut r = 100;
    while r <= rooms {
        let mut d = 1;
        while d <= devices {
            // More devices than rooms change nothing.
            if d <= r {
                all.push((r, d));
            }
            d *= if d == 1 { 16 } else { 4 };
        }
        r *= 10;
    }
    if !all.contains(&(rooms, devices)) {
        all.push((rooms, devices));
    }
    all
}

fn both(plan: &Plan, (rooms, devices): (usize, usize)) -> Vec<Figures> {
    let at = |protocol| figures(&Plan { rooms, devices, protocol, ..plan.clone() });
    vec![at(Protocol::First), at(Protocol::Current)]
}

/// Formats seconds with a unit.
fn duration(seconds: f64) -> String {
    match seconds {
        s if s < 120.0 => format!("{s:.1} s"),
        s if s < 7200.0 => format!("{:.1} min", s / 60.0),
        s => format!("{:.1} h", s / 3600.0),
    }
}

/// Formats bytes with a unit.
fn bytes(n: f64) -> String {
    match n {
        n if n < 1e6 => format!("{:.1} kB", n / 1e3),
        n if n < 1e9 => format!("{:.1} MB", n / 1e6),
        n => format!("{:.1} GB", n / 1e9),
    }
}

fn text(f: &Figures) -> String {
    let mut lines = vec![
        format!("{} runs on {} devices, {} a run", f.rooms, f.devices, duration(f.mean_seconds)),
        format!(
            "makespan      {}, {:.3} times the lower bound of {}",
            duration(f.makespan),
            f.ratio,
            duration(f.lower_bound)
        ),
        format!("runs          {} done, {} failed, {} temporary failures", f.done, f.failed, f.temporary_failures),
        format!("workers       {} failed, {} runs taken over", f.deaths, f.taken_over),
        format!(
            "waste         {:.2} % of the work; {:.2} % of the time waiting for the disk",
            100.0 * f.waste,
            100.0 * f.blocked
        ),
        format!(
            "disk          {:.0} operations/s, at most {:.0}",
            f.operations_per_second, f.peak_operations_per_second
        ),
        format!("              {}/s, at most {}/s", bytes(f.bytes_per_second), bytes(f.peak_bytes_per_second)),
        format!("summaries     {}, the longest in {}", f.summaries, duration(f.longest_summary)),
        format!(
            "start         {} in {:.0} operations: {}",
            bytes(f.start.bytes),
            f.start.operations,
            duration(f.start.seconds)
        ),
    ];
    if let Some(loss) = &f.loss {
        let takeover = loss.takeover.map_or("not all".to_owned(), |s| format!("in {}", duration(s)));
        lines.push(format!(
            "loss          {} workers: runs taken over {takeover}; {} more, {:.3} times the bound",
            loss.workers,
            duration(loss.extra),
            loss.ratio
        ));
    }
    lines.push(format!("limits        {}", f.broken.as_deref().unwrap_or("none is exceeded")));
    lines.join("\n") + "\n"
}

fn table(all: &[Figures]) -> String {
    let mut text =
        "| rooms | devices | version | makespan / bound | operations/s, most | bytes/s, most | waiting | start | \
                    longest summary | exceeded first |\n|---|---|---|---|---|---|---|---|---|---|\n"
            .to_owned();
    for f in all {
        let version = if f.protocol == Protocol::First { "first" } else { "current" };
        let limit = f.broken.as_deref().unwrap_or("–");
        text += &format!(
            "| {} | {} | {version} | {:.3} | {:.0} | {} | {:.1} % | {} | {} | {limit} |\n",
            f.rooms,
            f.devices,
            f.ratio,
            f.peak_operations_per_second,
            bytes(f.peak_bytes_per_second),
            100.0 * f.blocked,
            duration(f.start.seconds),
            duration(f.longest_summary),
        );
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scales_end_with_the_requested_one() {
        assert_eq!(scales(100, 16), [(100, 1), (100, 16)]);
        let all = [(100, 1), (100, 16), (100, 64), (1000, 1), (1000, 16), (1000, 64), (1000, 256)];
        assert_eq!(scales(1000, 256), all, "no more devices than rooms");
        assert_eq!(scales(50, 3), [(50, 3)]);
    }
}
