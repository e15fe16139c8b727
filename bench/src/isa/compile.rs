//! Compilation of jobs in worker processes.
//!
//! When a compiler crashes, another worker goes on behind the job.

use super::Job;
use super::report::Row;
use super::worker::{Answer, Gpu};
use anyhow::{Context, bail};
use std::io::{BufRead, BufReader, Write};
use std::path::PathBuf;
use std::process::{Child, ChildStdin, Command, ExitStatus, Stdio};
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::time::Duration;

/// Time limit of one kernel.
const LIMIT: Duration = Duration::from_secs(300);

/// GPU family and the driver that compiles for it.
#[derive(Clone, Debug)]
pub struct Target {
    /// Name as in `RADV_FORCE_FAMILY`.
    pub family: String,
    /// Driver file of the Vulkan loader.
    pub driver: PathBuf,
}

/// Running worker.
struct Worker {
    child: Child,
    jobs: Option<ChildStdin>,
    answers: Receiver<Answer>,
}

impl Drop for Worker {
    fn drop(&mut self) {
        // Fails only if the process has ended.
        let _ended = self.child.kill();
        let _status = self.child.wait();
    }
}

impl Target {
    /// Starts a worker and returns it with its device.
    fn start(&self) -> anyhow::Result<(Worker, Gpu)> {
        let program = std::env::current_exe().context("The program cannot find its own file.")?;
        let mut command = Command::new(program);
        command.arg("isa-worker").stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::null());
        command.env("RADV_FORCE_FAMILY", &self.family);
        for variable in ["VK_DRIVER_FILES", "VK_ICD_FILENAMES"] {
            command.env(variable, &self.driver);
        }
        // They would add other drivers or hide this one. A cache on disk would hide changes of the compiler.
        for variable in ["VK_ADD_DRIVER_FILES", "VK_LOADER_DRIVERS_SELECT", "VK_LOADER_DRIVERS_DISABLE", "RADV_DEBUG"] {
            command.env_remove(variable);
        }
        command.env("MESA_SHADER_CACHE_DISABLE", "true");
        let mut child = command.spawn().context("The process for the compiler cannot be started.")?;
        let (Some(jobs), Some(output)) = (child.stdin.take(), child.stdout.take()) else {
            bail!("The process for the compiler has no pipes.");
        };
        let (send, answers) = channel();
        std::thread::spawn(move || {
            for line in BufReader::new(output).lines().map_while(Result::ok) {
                let Ok(answer) = serde_json::from_str(&line) else { return };
                if send.send(answer).is_err() {
                    return;
                }
            }
        });
        let mut worker = Worker { child, jobs: Some(jobs), answers };
        let (family, driver) = (&self.family, self.driver.display());
        match worker.answers.recv_timeout(LIMIT) {
            Ok(Answer::Gpu(gpu)) => Ok((worker, gpu)),
            Ok(Answer::Refused(why)) => bail!("\"{driver}\" cannot compile for {family}: {why}"),
            Ok(Answer::Compiled(_)) => bail!("\"{driver}\" answered out of order."),
            Err(_) => bail!("\"{driver}\" cannot compile for {family}: the driver {}.", worker.end()),
        }
    }

    /// Returns the device that the driver stands for.
    ///
    /// # Errors
    /// If the driver is missing, does not know the family, or reports no statistics.
    pub fn gpu(&self) -> anyhow::Result<Gpu> {
        let (worker, gpu) = self.start()?;
        worker.finish()?;
        Ok(gpu)
    }

    /// Compiles jobs in order. A job on which the compiler crashes gets a row that says so.
    ///
    /// # Errors
    /// If the driver cannot be started.
    pub fn compile(&self, jobs: &[Job]) -> anyhow::Result<Vec<Row>> {
        let mut rows = Vec::with_capacity(jobs.len());
        let mut worker = None;
        for job in jobs {
            let running = match &mut worker {
                Some(running) => running,
                None => worker.insert(self.start()?.0),
            };
            let (statistics, problem) = match running.ask(job) {
                Ok(Answer::Compiled(statistics)) => (statistics, None),
                Ok(Answer::Refused(why)) => (Default::default(), Some(why)),
                Ok(Answer::Gpu(_)) => bail!("\"{}\" answered out of order.", self.driver.display()),
                Err(why) => {
                    worker = None;
                    (Default::default(), Some(why))
                }
            };
            rows.push(Row::new(&self.family, job, statistics, problem));
        }
        worker.map_or(Ok(()), Worker::finish)?;
        Ok(rows)
    }
}

impl Worker {
    /// Returns the answer to a job, or how the compiler failed. The worker is of no use after a failure.
    fn ask(&mut self, job: &Job) -> Result<Answer, String> {
        let mut line = serde_json::to_string(job).map_err(|e| e.to_string())?;
        line.push('\n');
        // A worker that has ended also gives no answer, which is handled below.
        if let Some(jobs) = &mut self.jobs {
            let _sent = jobs.write_all(line.as_bytes()).and_then(|()| jobs.flush());
        }
        match self.answers.recv_timeout(LIMIT) {
            Ok(answer) => Ok(answer),
            Err(RecvTimeoutError::Timeout) => Err(format!("the compiler took more than {} s", LIMIT.as_secs())),
            Err(RecvTimeoutError::Disconnected) => Err(format!("the compiler {}", self.end())),
        }
    }

    /// Lets the worker end, and checks that it destroyed everything.
    fn finish(mut self) -> anyhow::Result<()> {
        self.jobs = None;
        let status = self.child.wait()?;
        anyhow::ensure!(status.success(), "The process for the compiler {} after its last kernel.", ended(status));
        Ok(())
    }

    /// Says how the process ended.
    fn end(&mut self) -> String {
        match self.child.try_wait() {
            Ok(Some(status)) => ended(status),
            _ => {
                // Its output is closed, so that it ends soon.
                std::thread::sleep(Duration::from_millis(200));
                let status = self.child.try_wait().ok().flatten();
                status.map_or_else(|| "gave no answer".to_owned(), ended)
            }
        }
    }
}

#[cfg(unix)]
fn ended(status: ExitStatus) -> String {
    use std::os::unix::process::ExitStatusExt;
    match status.signal() {
        Some(signal) => format!("crashed (signal {signal})"),
        None => format!("ended with status {}", status.code().unwrap_or(-1)),
    }
}

#[cfg(not(unix))]
fn ended(status: ExitStatus) -> String {
    format!("ended with status {}", status.code().unwrap_or(-1))
}
