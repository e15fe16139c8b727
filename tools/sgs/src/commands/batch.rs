//! Training of many scenes by a manifest: `sgs batch`.

use super::programs::{Jobs, Programs, devices};
use crate::common::Common;
use crate::failure::{Kind, failure, usage};
use crate::message::say;
use crate::output;
use crate::ui::Stop;
use sgs_batch::{
    ArrayScript, Baseline, Batch, Launch, Manifest, Phase, Planner, Progress, Queue, Report, RunResult, Shard, State,
    Store, Summary, Timing, Verdict, list, quote,
};
use std::ffi::OsString;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;
use std::time::Instant;

#[derive(clap::Args)]
pub struct Args {
    /// Manifest: scenes, variants, seeds and limits (docs/guide/batch.md).
    #[arg(value_name = "MANIFEST.toml")]
    manifest: PathBuf,
    /// Directory of the batch. Several commands, also on several machines, can share it.
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// Number of runs that are trained side by side, or "auto": two per device.
    #[arg(long, value_name = "N|auto", default_value = "auto", value_parser = Jobs::parse)]
    jobs: Jobs,
    /// Devices that the jobs take in turn, as --device names them.
    #[arg(long, value_name = "A,B", value_delimiter = ',', conflicts_with = "device")]
    devices: Vec<String>,
    /// Train only part I of N parts of the runs. I is 1 to N.
    #[arg(long, value_name = "I/N", value_parser = Shard::parse)]
    shard: Option<Shard>,
    /// Train only the run of this name, as --list prints it. May be repeated. Writes no summary.
    #[arg(long, value_name = "SCENE/VARIANT/seedN", conflicts_with_all = ["shard", "baseline"])]
    only: Vec<String>,
    /// Train failed runs again.
    #[arg(long)]
    retry_failed: bool,
    /// Fail if a PSNR is lower than in this summary by more than the tolerance.
    #[arg(long, value_name = "SUMMARY.jsonl")]
    baseline: Option<PathBuf>,
    /// Largest loss of PSNR against the baseline, in dB.
    #[arg(long, value_name = "DB", default_value = "0.1", requires = "baseline", value_parser = tolerance)]
    tolerance: f64,
    /// Print the runs and their states as lines of JSON, and train nothing. With --json, one document.
    #[arg(long, conflicts_with_all = ["only", "shard", "retry_failed", "baseline", "summary", "slurm"])]
    list: bool,
    /// Forecast the memory of the listed runs first. The directory keeps the forecasts.
    #[arg(long, requires = "list")]
    plan: bool,
    /// Write the summary of the existing results, and train nothing.
    #[arg(long, conflicts_with_all = ["only", "shard", "retry_failed", "slurm"])]
    summary: bool,
    /// Write a script for sbatch, a job array with a task per run, and train nothing.
    #[arg(long, value_name = "FILE", conflicts_with_all = ["only", "shard", "jobs", "devices", "baseline"])]
    slurm: Option<PathBuf>,
}

/// Jobs of a device by default: the work of one run on the host overlaps that of another on the device.
///
/// Measured in bench/results/batch/README.md.
const JOBS_PER_DEVICE: usize = 2;

fn tolerance(text: &str) -> Result<f64, String> {
    text.parse().ok().filter(|v: &f64| *v >= 0.0 && v.is_finite()).ok_or_else(|| "a number of at least 0".into())
}

pub fn run(common: &Common, a: &Args) -> anyhow::Result<()> {
    let begun = Instant::now();
    let mut manifest = Manifest::read(&a.manifest)?;
    if !a.only.is_empty() {
        manifest.select(&a.only).map_err(usage)?;
    }
    for folder in &manifest.ignored {
        tracing::warn!("\"{}\" is left out: it holds no scene.", folder.display());
    }
    let baseline = a.baseline.as_deref().map(Baseline::read).transpose()?;
    output::check_batch(&a.output)?;
    let stop = Stop::on_signals()?;
    // Only commands that train share the hashes of scenes, and remove them in the end.
    let shown = a.list || a.summary || a.slurm.is_some();
    let root = (!shown).then_some(a.output.as_path());
    let mut batch = Batch::new(&manifest, env!("CARGO_PKG_VERSION"), root, &stop)?;
    let stopped = || stop.failure(format!("stopped in {}; the same command goes on from there", a.output.display()));
    // Then scenes may be without their hashes.
    if stop.load(Ordering::SeqCst) {
        return Err(stopped());
    }
    if !a.only.is_empty() {
        batch.select(&a.only);
    }
    if a.list {
        if a.plan {
            forecast(common, a, &batch, &stop)?;
        }
        if stop.load(Ordering::SeqCst) {
            return Err(stopped());
        }
        return print_list(common, a, &batch);
    }
    if let Some(file) = &a.slurm {
        return write_array(common, a, &batch, file);
    }
    let store = Store::open(&a.output, Timing::EXPIRY)?;
    if a.summary {
        return finish(common, a, &store, &batch, &summarize(&store, &batch)?, baseline.as_ref(), begun);
    }
    batch.write_configs(store.root())?;
    let devices = devices(common, &a.devices)?;
    let jobs = a.jobs.number(devices.len(), JOBS_PER_DEVICE);
    let stage = batch.stage.name();
    let queue = Queue {
        store: &store,
        batch: &batch,
        launcher: &Programs { common, devices: &devices, arguments: &|launch| arguments(launch, stage) },
        stop: &stop,
        progress: &|progress| show(common, progress),
        jobs,
        retry_failed: a.retry_failed,
        // A scheduler repeats the command of a run, perhaps on another machine, after status 75.
        retry_temporary: !a.only.is_empty(),
        summarize: a.only.is_empty(),
        shard: a.shard,
        timing: Timing::default(),
    };
    let report = queue.work()?;
    if let Some(error) = &report.storage {
        return Err(storage_failure(error));
    }
    if report.stopped {
        return Err(stopped());
    }
    finish(common, a, &store, &batch, &report, baseline.as_ref(), begun)
}

/// Reports failures, compares with the baseline and prints the numbers of runs.
fn finish(
    common: &Common,
    a: &Args,
    store: &Store,
    batch: &Batch,
    report: &Report,
    baseline: Option<&Baseline>,
    begun: Instant,
) -> anyhow::Result<()> {
    let runs = report.runs;
    if let Some(first) = report.failed.first() {
        let failed = report.failed.len();
        let (name, error) = (first.name(), first.error.as_deref().unwrap_or("no reason is known"));
        let kind = if a.only.is_empty() { Kind::Failed } else { failure_of(&report.failed) };
        return Err(failure(kind, format!("{failed} of {runs} runs failed; the first, {name}: {error}")));
    }
    if report.stopped {
        let open = runs - report.skipped - report.done;
        return Err(failure(Kind::Terminated, format!("{open} of {runs} runs have no result; train them first")));
    }
    if let Some(baseline) = baseline {
        match baseline.compare(&Summary::read(store, batch)?.results, a.tolerance) {
            Verdict::Worse(text) => return Err(failure(Kind::Failed, format!("{text}."))),
            Verdict::Passed(count) if !common.quiet => {
                say(format_args!("{count} values are within {} dB", a.tolerance))
            }
            Verdict::Passed(_) => {}
        }
    }
    let (done, skipped) = (report.done, report.skipped);
    let mut answer = serde_json::json!({
        "runs": runs,
        "done": done,
        "skipped": skipped,
        "seconds": begun.elapsed().as_secs_f64(),
    });
    let mut text = format!("{runs} runs: {done} done, {skipped} skipped");
    if a.only.is_empty() {
        let summary = a.output.join("summary.jsonl").display().to_string();
        text += &format!("; wrote {summary}");
        answer["summary"] = summary.into();
    }
    if !common.answer(&answer)? {
        println!("{text}");
    }
    Ok(())
}

/// Returns the error of a queue that a full or read-only disk stopped.
pub fn storage_failure(error: &str) -> anyhow::Error {
    failure(Kind::Storage, format!("{error}; free space on the disk, and the same command goes on"))
}

/// Returns the kind of failures of selected runs. A scheduler acts on its status.
pub fn failure_of(failed: &[RunResult]) -> Kind {
    match failed.iter().find(|result| result.is_temporary()).map(|result| result.kind.as_deref()) {
        Some(Some("out_of_memory")) => Kind::OutOfMemory,
        Some(Some("device_lost")) => Kind::DeviceLost,
        Some(_) => Kind::Terminated,
        None if failed.iter().all(RunResult::is_permanent) => Kind::Input,
        None => Kind::Failed,
    }
}

/// Writes the summary of the existing results. Returns the state of the runs.
fn summarize(store: &Store, batch: &Batch) -> anyhow::Result<Report> {
    Summary::update(store, batch, true)?;
    let results = Summary::read(store, batch)?.results;
    let mut report = Report { runs: batch.runs.len(), stopped: results.len() < batch.runs.len(), ..Report::default() };
    for result in results {
        match result.state {
            State::Done => report.skipped += 1,
            State::Failed => report.failed.push(result),
        }
    }
    Ok(report)
}

/// Forecasts the runs that are not done.
fn forecast(common: &Common, a: &Args, batch: &Batch, stop: &Stop) -> anyhow::Result<()> {
    let store = Store::open(&a.output, Timing::EXPIRY)?;
    batch.write_configs(store.root())?;
    let devices = devices(common, &a.devices)?;
    let stage = batch.stage.name();
    let planner = Planner {
        store: &store,
        batch,
        launcher: &Programs { common, devices: &devices, arguments: &|launch| arguments(launch, stage) },
        stop: &|| stop.load(Ordering::SeqCst),
        jobs: a.jobs.number(devices.len(), JOBS_PER_DEVICE),
        timing: Timing::default(),
    };
    let done = |i: &usize| store.result(&batch.runs[*i]).is_some_and(|r| r.state == State::Done);
    let open: Vec<usize> = batch.order(None).into_iter().filter(|i| !done(i)).collect();
    Ok(planner.plan(&open)?)
}

/// Prints the runs as one document, or one a line.
fn print_list(common: &Common, a: &Args, batch: &Batch) -> anyhow::Result<()> {
    let runs = list(&Store::at(&a.output, Timing::EXPIRY), batch);
    if !common.answer(&serde_json::json!({ "runs": runs }))? {
        for run in &runs {
            println!("{}", serde_json::to_string(run)?);
        }
    }
    Ok(())
}

/// Writes the script of a job array.
fn write_array(common: &Common, a: &Args, batch: &Batch, file: &Path) -> anyhow::Result<()> {
    let path = |path: &Path| anyhow::Ok(std::path::absolute(path)?.display().to_string());
    let mut command = vec![path(&std::env::current_exe()?)?, "batch".into(), path(&a.manifest)?, "-o".into()];
    command.push(path(&a.output)?);
    command.extend(common.device.iter().flat_map(|device| ["--device".into(), device.clone()]));
    if let Some(limit) = common.timeout {
        command.extend(["--timeout".into(), limit.as_secs_f64().to_string()]);
    }
    if common.validate {
        command.push("--validate".into());
    }
    if a.retry_failed {
        command.push("--retry-failed".into());
    }
    let script = ArrayScript::new(batch, &command);
    sgs_scene::atomic_write(file, |f| f.write_all(script.text.as_bytes()))?;
    let (runs, tasks, file) = (batch.runs.len(), script.tasks, file.display());
    if !common.answer(&serde_json::json!({ "runs": runs, "tasks": tasks, "script": file.to_string() }))? {
        println!("{runs} runs in {tasks} tasks; submit them by: sbatch {}", quote(&file.to_string()));
    }
    Ok(())
}

/// Prints an event as one line.
fn show(common: &Common, progress: &Progress<'_>) {
    if common.quiet {
        return;
    }
    match progress {
        Progress::Ended { result, ended, total } => {
            let name = result.name();
            if result.state == State::Failed {
                let error = result.error.as_deref().unwrap_or_default();
                say(format_args!("failed {ended} of {total}: {name}: {error}"));
            } else {
                let psnr = result.measures.get("nvs.psnr").map(|v| format!(", {v:.1} dB")).unwrap_or_default();
                say(format_args!("done {ended} of {total}: {name}{psnr}, {:.0} s", result.seconds));
            }
        }
        Progress::Again { name, reason, delay } => {
            say(format_args!("again in {:.0} s: {name}: {reason}", delay.as_secs_f64()));
        }
    }
}

/// Returns the arguments of the process of a run.
fn arguments(launch: &Launch<'_>, stage: &str) -> Vec<OsString> {
    let (scene, directory, config) = (&launch.run.scene_path, &launch.directory, &launch.config);
    let mut arguments: Vec<OsString> = match launch.phase {
        Phase::Plan => vec!["plan".into(), scene.into(), "--stage".into(), stage.into()],
        Phase::Train => {
            let seed = launch.run.seed.to_string();
            let mut train: Vec<OsString> = vec!["train".into(), scene.into(), "-o".into(), directory.into()];
            train.extend(["--stage", stage, "--seed", &seed].map(OsString::from));
            train
        }
        Phase::Evaluate => return vec!["eval".into(), directory.into(), "--scene".into(), scene.into()],
    };
    arguments.extend(["--config".into(), config.into()]);
    if let Some(bytes) = launch.memory_budget {
        arguments.extend(["--memory-budget".into(), bytes.to_string().into()]);
    }
    if launch.resume {
        arguments.push("--resume".into());
    }
    arguments
}
