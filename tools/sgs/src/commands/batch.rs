//! Training of many scenes by a manifest: `sgs batch`.

use crate::common::Common;
use crate::failure::{Kind, failure};
use crate::output;
use crate::ui::{SUPERVISED, Stop};
use sgs_batch::{
    Baseline, Batch, Exit, Launch, Launcher, Manifest, Phase, Process, Progress, Queue, Shard, State, Store, Summary,
    Timing, Verdict,
};
use std::io::{Read, Write};
use std::path::PathBuf;
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
    /// Number of runs that are trained side by side.
    #[arg(long, value_name = "N", default_value = "1", value_parser = clap::value_parser!(u16).range(1..))]
    jobs: u16,
    /// Devices that the jobs take in turn, as --device names them.
    #[arg(long, value_name = "A,B", value_delimiter = ',', conflicts_with = "device")]
    devices: Vec<String>,
    /// Train only part I of N parts of the runs. I is 1 to N.
    #[arg(long, value_name = "I/N", value_parser = Shard::parse)]
    shard: Option<Shard>,
    /// Train failed runs again.
    #[arg(long)]
    retry_failed: bool,
    /// Fail if a PSNR is lower than in this summary by more than the tolerance.
    #[arg(long, value_name = "SUMMARY.jsonl")]
    baseline: Option<PathBuf>,
    /// Largest loss of PSNR against the baseline, in dB.
    #[arg(long, value_name = "DB", default_value = "0.1", requires = "baseline", value_parser = tolerance)]
    tolerance: f64,
}

fn tolerance(text: &str) -> Result<f64, String> {
    text.parse().ok().filter(|v: &f64| *v >= 0.0 && v.is_finite()).ok_or_else(|| "a number of at least 0".into())
}

pub fn run(common: &Common, a: &Args) -> anyhow::Result<()> {
    let begun = Instant::now();
    let manifest = Manifest::read(&a.manifest)?;
    for folder in &manifest.ignored {
        tracing::warn!("\"{}\" is left out: it holds no scene.", folder.display());
    }
    let baseline = a.baseline.as_deref().map(Baseline::read).transpose()?;
    output::check_batch(&a.output)?;
    let stop = Stop::on_signals()?;
    let batch = Batch::new(&manifest, env!("CARGO_PKG_VERSION"), &a.output, &stop)?;
    let stopped = || stop.failure(format!("stopped in {}; the same command goes on from there", a.output.display()));
    // Then scenes may be without their hashes.
    if stop.load(Ordering::SeqCst) {
        return Err(stopped());
    }
    let store = Store::open(&a.output, Timing::EXPIRY)?;
    batch.write_configs(store.root())?;
    let queue = Queue {
        store: &store,
        batch: &batch,
        launcher: &Programs { common, devices: &a.devices, stage: batch.stage.name() },
        stop: &stop,
        progress: &|progress| show(common, progress),
        jobs: usize::from(a.jobs),
        retry_failed: a.retry_failed,
        shard: a.shard,
        timing: Timing::default(),
    };
    let report = queue.work()?;
    if report.stopped {
        return Err(stopped());
    }
    let runs = report.runs;
    if let Some(first) = report.failed.first() {
        let failed = report.failed.len();
        let (name, error) = (first.name(), first.error.as_deref().unwrap_or("no reason is known"));
        return Err(failure(Kind::Failed, format!("{failed} of {runs} runs failed; the first, {name}: {error}")));
    }
    if let Some(baseline) = &baseline {
        match baseline.compare(&Summary::read(&store, &batch)?.results, a.tolerance) {
            Verdict::Worse(text) => return Err(failure(Kind::Failed, format!("{text}."))),
            Verdict::Passed(count) if !common.quiet => eprintln!("{count} values are within {} dB", a.tolerance),
            Verdict::Passed(_) => {}
        }
    }
    let summary = a.output.join("summary.jsonl");
    let (done, skipped) = (report.done, report.skipped);
    let answer = serde_json::json!({
        "runs": runs,
        "done": done,
        "skipped": skipped,
        "seconds": begun.elapsed().as_secs_f64(),
        "summary": summary.display().to_string(),
    });
    if !common.answer(&answer)? {
        println!("{runs} runs: {done} done, {skipped} skipped; wrote {}", summary.display());
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
                eprintln!("failed {ended} of {total}: {name}: {error}");
            } else {
                let psnr = result.measures.get("nvs.psnr").map(|v| format!(", {v:.1} dB")).unwrap_or_default();
                eprintln!("done {ended} of {total}: {name}{psnr}, {:.0} s", result.seconds);
            }
        }
        Progress::Again { name, reason, delay } => {
            eprintln!("again in {:.0} s: {name}: {reason}", delay.as_secs_f64());
        }
    }
}

/// Starts this program for each run.
struct Programs<'a> {
    common: &'a Common,
    devices: &'a [String],
    stage: &'static str,
}

impl Launcher for Programs<'_> {
    fn start(&self, launch: &Launch<'_>) -> std::io::Result<Box<dyn Process>> {
        let mut command = Command::new(std::env::current_exe()?);
        match launch.phase {
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
        let turn = self.devices.get(launch.worker % self.devices.len().max(1));
        if let Some(device) = turn.or(self.common.device.as_ref()) {
            command.args(["--device", device]);
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
    let quoted = words.map(|word| {
        let word = word.to_string_lossy();
        let plain = |c: char| c.is_ascii_alphanumeric() || "-_./=:,+".contains(c);
        if !word.is_empty() && word.chars().all(plain) {
            word.into_owned()
        } else {
            format!("'{}'", word.replace('\'', "'\\''"))
        }
    });
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
