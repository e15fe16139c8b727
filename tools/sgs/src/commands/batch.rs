//! Training of many scenes by a manifest: `sgs batch`.

use crate::common::Common;
use crate::failure::{Kind, failure, usage};
use crate::message::say;
use crate::output;
use crate::ui::{SUPERVISED, Stop};
use sgs_batch::{
    ArrayScript, Baseline, Batch, DeviceMemory, Exit, Launch, Launcher, Manifest, Phase, Process, Progress, Queue,
    Report, RunResult, Shard, State, Store, Summary, Timing, Verdict, list, quote,
};
use sgs_engine::find_device;
use std::io::{Read, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::atomic::Ordering;
use std::thread::JoinHandle;
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
    #[arg(long, value_name = "N|auto", default_value = "auto", value_parser = jobs)]
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

/// Number of runs side by side.
#[derive(Clone, Copy, Debug)]
enum Jobs {
    Auto,
    Exactly(u16),
}

fn jobs(text: &str) -> Result<Jobs, String> {
    match text {
        "auto" => Ok(Jobs::Auto),
        _ => text.parse().ok().filter(|n| *n > 0).map(Jobs::Exactly).ok_or_else(|| "a number above 0, or auto".into()),
    }
}

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
    let jobs = match a.jobs {
        Jobs::Auto => devices.len().saturating_mul(JOBS_PER_DEVICE),
        Jobs::Exactly(n) => usize::from(n),
    };
    let queue = Queue {
        store: &store,
        batch: &batch,
        launcher: &Programs { common, devices: &devices, stage: batch.stage.name() },
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
    if let Some(error) = report.storage {
        return Err(failure(Kind::Storage, format!("{error}; free space on the disk, and the same command goes on")));
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
        let kind = if a.only.is_empty() { Kind::Failed } else { kind_of(&report.failed) };
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

/// Returns the kind of failures of selected runs. A scheduler acts on its status.
fn kind_of(failed: &[RunResult]) -> Kind {
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

/// Starts this program for each run.
struct Programs<'a> {
    common: &'a Common,
    devices: &'a [Device],
    stage: &'static str,
}

/// Device of jobs.
struct Device {
    /// Option `--device` of the processes; none for the default.
    option: Option<String>,
    memory: DeviceMemory,
}

/// Finds the devices of the jobs. They are not opened: each process opens its own.
fn devices(common: &Common, named: &[String]) -> anyhow::Result<Vec<Device>> {
    let mut options: Vec<Option<String>> = named.iter().cloned().map(Some).collect();
    if options.is_empty() {
        options.push(common.device.clone());
    }
    let find = |option: Option<String>| {
        let found = find_device(option.as_deref())?;
        let memory = DeviceMemory { uuid: found.info.uuid, bytes: found.available_bytes };
        Ok(Device { option, memory })
    };
    options.into_iter().map(find).collect()
}

impl Programs<'_> {
    fn of(&self, worker: usize) -> Option<&Device> {
        self.devices.get(worker % self.devices.len().max(1))
    }
}

impl Launcher for Programs<'_> {
    fn device(&self, worker: usize) -> Option<DeviceMemory> {
        self.of(worker).map(|device| device.memory.clone())
    }

    fn start(&self, launch: &Launch<'_>) -> std::io::Result<Box<dyn Process>> {
        let mut command = Command::new(std::env::current_exe()?);
        match launch.phase {
            Phase::Plan => {
                command.arg("plan").arg(&launch.run.scene_path).args(["--stage", self.stage]);
                command.arg("--config").arg(&launch.config);
            }
            Phase::Train => {
                command.arg("train").arg(&launch.run.scene_path).arg("-o").arg(&launch.directory);
                command.args(["--stage", self.stage, "--seed", &launch.run.seed.to_string()]);
                command.arg("--config").arg(&launch.config);
                if let Some(bytes) = launch.memory_budget {
                    command.args(["--memory-budget", &bytes.to_string()]);
                }
                if launch.resume {
                    command.arg("--resume");
                }
            }
            Phase::Evaluate => {
                command.arg("eval").arg(&launch.directory).arg("--scene").arg(&launch.run.scene_path);
            }
        }
        if let Some(option) = self.of(launch.worker).and_then(|device| device.option.as_ref()) {
            command.args(["--device", option]);
        }
        if let Some(limit) = self.common.timeout {
            command.args(["--timeout", &limit.as_secs_f64().to_string()]);
        }
        if self.common.validate {
            command.arg("--validate");
        }
        command.arg("--json");
        if let Some(folder) = launch.log.parent() {
            std::fs::create_dir_all(folder)?;
        }
        let mut log = std::fs::File::options().create(true).append(true).open(&launch.log)?;
        writeln!(log, "$ {}", line(&command))?;
        command.env(SUPERVISED, "1").stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(log);
        // Ctrl-C of a terminal reaches the batch alone, which then stops its processes once.
        #[cfg(unix)]
        std::os::unix::process::CommandExt::process_group(&mut command, 0);
        let mut child = command.spawn()?;
        let stdout = child.stdout.take();
        let output = std::thread::spawn(move || {
            let mut text = Vec::new();
            // A process that is killed leaves an incomplete answer, which counts as none.
            let _ = stdout.map(|mut pipe| pipe.read_to_end(&mut text));
            String::from_utf8_lossy(&text).into_owned()
        });
        Ok(Box::new(Program { child, output: Some(output) }))
    }
}

/// Formats a command as a line of a shell, for the log.
fn line(command: &Command) -> String {
    let words = std::iter::once(command.get_program()).chain(command.get_args());
    let quoted = words.map(|word| quote(&word.to_string_lossy()));
    quoted.collect::<Vec<_>>().join(" ")
}

/// Started program.
struct Program {
    child: Child,
    output: Option<JoinHandle<String>>,
}

impl Process for Program {
    fn poll(&mut self) -> std::io::Result<Option<Exit>> {
        let Some(status) = self.child.try_wait()? else { return Ok(None) };
        let output = self.output.take().and_then(|thread| thread.join().ok()).unwrap_or_default();
        #[cfg(unix)]
        let signal = std::os::unix::process::ExitStatusExt::signal(&status);
        #[cfg(not(unix))]
        let signal = None;
        Ok(Some(Exit { status: status.code(), signal, output }))
    }

    #[cfg(unix)]
    fn terminate(&mut self) {
        let pid = i32::try_from(self.child.id()).ok().and_then(rustix::process::Pid::from_raw);
        if let Some(pid) = pid {
            // A process that has just ended needs no signal.
            let _ = rustix::process::kill_process(pid, rustix::process::Signal::TERM);
        }
    }

    #[cfg(not(unix))]
    fn terminate(&mut self) {
        self.kill();
    }

    fn kill(&mut self) {
        // Fails only if the process has ended.
        let _ = self.child.kill();
    }

    fn beat(&mut self) {
        // A process that has just ended reads nothing.
        let _ = self.child.stdin.as_mut().map(|pipe| pipe.write_all(b"."));
    }
}

impl Drop for Program {
    fn drop(&mut self) {
        // Only after an error of the supervisor does the process still run.
        if self.output.is_some() {
            let _ = self.child.kill();
            let _ = self.child.wait();
        }
    }
}
