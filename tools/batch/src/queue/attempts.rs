//! Attempts of a run: its processes, their supervision, and retries.

use super::{Ended, Outcome, Progress, Queue, Shared, Timing, lock};
use crate::admission::Permit;
use crate::batch::Run;
use crate::error::{Result, failed};
use crate::heart::Heart;
use crate::process::{Exit, Launch, Phase};
use crate::result::{RunResult, State};
use crate::store::Record;
use sgs_run::{DirectoryLock, RunError};
use std::path::Path;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

/// Number of the signal that no process survives.
const SIGKILL: i32 = 9;

impl Shared<'_> {
    /// Attempts a run until it has a result.
    pub(super) fn attempts<'a>(
        &'a self,
        run: &Run,
        heart: &Heart,
        taken_over: bool,
        worker: usize,
        mut permit: Option<Permit<'a>>,
    ) -> Result<Outcome> {
        let Queue { store, batch, .. } = self.queue;
        let directory = run.path(store.root(), "");
        if taken_over {
            // The last holder let the run go, and its processes end without its heartbeat.
            DirectoryLock::remove_foreign(&directory)?;
        }
        let begun = Instant::now();
        let mut result = RunResult { memory_budget: batch.limits.memory_budget, ..RunResult::of(run) };
        let (mut retries, mut waits) = (0, 0);
        loop {
            if self.stopping() {
                return Ok(Outcome::Stopped);
            }
            if heart.is_lost() {
                return Ok(Outcome::Lost);
            }
            let (mut ended, phase) = match self.begin(run, &directory)? {
                Some((resume, record)) => {
                    result.attempts = record.attempts;
                    self.attempt(run, heart, resume, result.memory_budget, worker)?
                }
                None => {
                    let output = r#"{"kind": "locked", "error": "another process writes into the run"}"#.to_owned();
                    (Ended::Exit(Exit { status: Some(1), signal: None, output }), Phase::Train)
                }
            };
            if heart.is_lost() {
                ended = Ended::Lost;
            }
            result.seconds = begun.elapsed().as_secs_f64();
            let exit = match ended {
                Ended::Stopped => return Ok(Outcome::Stopped),
                Ended::Lost => return Ok(Outcome::Lost),
                Ended::Timeout => {
                    let seconds = batch.limits.timeout.unwrap_or_default().as_secs_f64();
                    result.kind = Some("timeout".to_owned());
                    result.error = Some(format!("the attempt took longer than limits.timeout ({seconds} s)"));
                    return Ok(Outcome::Result(Box::new(result)));
                }
                Ended::Exit(exit) => exit,
            };
            result.status = exit.status;
            if exit.status == Some(0) {
                result.evaluated = phase == Phase::Evaluate;
                result.state = State::Done;
                result.read_run(&directory);
                return Ok(Outcome::Result(Box::new(result)));
            }
            let (kind, error) = exit.failure(&run.path(store.root(), "log"));
            if exit.status == Some(130) {
                // A user stopped the process; the whole batch stops.
                self.halt.store(true, Ordering::SeqCst);
                return Ok(Outcome::Stopped);
            }
            if kind == "storage" {
                self.halt.store(true, Ordering::SeqCst);
                lock(&self.storage).get_or_insert(error);
                return Ok(Outcome::Stopped);
            }
            let locked = kind == "locked";
            if locked {
                // A process of a killed worker may still write its checkpoint. That is no attempt.
                waits += 1;
                if let Some(record) = store.record(run).filter(|r| r.identity == run.identity && r.attempts > 0) {
                    store.write_record(run, &Record { attempts: record.attempts - 1, ..record })?;
                }
            } else if matches!(exit.status, Some(75) | None) && retries < batch.limits.retries {
                retries += 1;
                // The system kills processes that exhaust the memory of the host.
                let exhausted = kind == "out_of_memory" || exit.signal == Some(SIGKILL);
                if permit.as_ref().is_some_and(|permit| exhausted && permit.was_shared()) {
                    permit = self.alone(permit.take(), worker, heart);
                } else if kind == "out_of_memory" {
                    let whole = self.devices[worker].as_ref().map(|device| device.bytes);
                    let budget = result.memory_budget.or(whole);
                    result.memory_budget = budget.map(|bytes| (bytes - bytes / 4).max(1));
                }
            } else {
                (result.kind, result.error) = (Some(kind), Some(error));
                result.read_run(&directory);
                return Ok(Outcome::Result(Box::new(result)));
            }
            let delay = self.queue.timing.retry_delay(if locked { waits } else { retries });
            (self.queue.progress)(&Progress::Again { name: run.name(), reason: error, delay });
            self.pause(delay, heart);
        }
    }

    /// Waits until no other run is on the device. `None` if the queue is stopped or the lease is lost.
    fn alone<'a>(&'a self, shared: Option<Permit<'_>>, worker: usize, heart: &Heart) -> Option<Permit<'a>> {
        drop(shared);
        let device = self.devices[worker].as_ref()?;
        let waiting = self.admission.wait(device);
        while !self.stopping() && !heart.is_lost() {
            if let Some(permit) = waiting.admit(device) {
                return Some(permit);
            }
            std::thread::sleep(self.queue.timing.poll);
        }
        None
    }

    /// Waits, unless the queue is stopped or the lease is lost.
    fn pause(&self, delay: Duration, heart: &Heart) {
        let begun = Instant::now();
        while begun.elapsed() < delay && !self.stopping() && !heart.is_lost() {
            std::thread::sleep(self.queue.timing.poll);
        }
    }

    /// Prepares the run directory for an attempt. Returns whether it is resumed, and the new record.
    ///
    /// `None` if another process writes into the directory.
    fn begin(&self, run: &Run, directory: &Path) -> Result<Option<(bool, Record)>> {
        let store = self.queue.store;
        let mut record = match store.record(run) {
            Some(record) if record.identity == run.identity => record,
            before => {
                // Without a record, the directory is not of a batch. Then `sgs train` refuses to replace a run.
                if before.is_some() && !clear(directory)? {
                    return Ok(None);
                }
                Record { identity: run.identity.clone(), attempts: 0 }
            }
        };
        let resume = directory.join("config.toml").is_file() && store.record(run).is_some();
        record.attempts = record.attempts.saturating_add(1);
        store.write_record(run, &record)?;
        Ok(Some((resume, record)))
    }

    /// Trains and evaluates a run once. Also returns the phase that ended.
    fn attempt(
        &self,
        run: &Run,
        heart: &Heart,
        resume: bool,
        memory_budget: Option<u64>,
        worker: usize,
    ) -> Result<(Ended, Phase)> {
        let Queue { store, batch, .. } = self.queue;
        let deadline = batch.limits.timeout.and_then(|limit| Instant::now().checked_add(limit));
        let launch = |phase| Launch {
            run,
            phase,
            resume,
            memory_budget,
            directory: run.path(store.root(), ""),
            config: store.root().join(&run.config),
            log: run.path(store.root(), "log"),
            worker,
        };
        let ended = self.supervise(&launch(Phase::Train), heart, deadline)?;
        if !batch.evaluate || !matches!(&ended, Ended::Exit(exit) if exit.status == Some(0)) {
            return Ok((ended, Phase::Train));
        }
        Ok((self.supervise(&launch(Phase::Evaluate), heart, deadline)?, Phase::Evaluate))
    }

    /// Runs a process to its end.
    fn supervise(&self, launch: &Launch<'_>, heart: &Heart, deadline: Option<Instant>) -> Result<Ended> {
        if self.stopping() {
            return Ok(Ended::Stopped);
        }
        let mut process = self.queue.launcher.start(launch).map_err(failed("used to start a process", &launch.log))?;
        let Timing { poll, grace, .. } = self.queue.timing;
        let mut beats = heart.beats();
        let (mut stopped, mut timed_out) = (false, false);
        let mut kill_at = None;
        let exit = loop {
            if let Some(exit) = process.poll().map_err(failed("polled", &launch.log))? {
                break exit;
            }
            if heart.is_lost() {
                process.kill();
            }
            let late = deadline.is_some_and(|d| Instant::now() >= d);
            if kill_at.is_none() && (self.stopping() || late) {
                stopped = self.stopping();
                timed_out = !stopped;
                process.terminate();
                kill_at = Instant::now().checked_add(grace);
            }
            if kill_at.is_some_and(|at| Instant::now() >= at) {
                process.kill();
            }
            if heart.beats() != beats {
                beats = heart.beats();
                process.beat();
            }
            std::thread::sleep(poll);
        };
        // A process that ended with a result of its own counts, even if it was asked to end.
        let own = matches!(exit.status, Some(status) if ![75, 130, 143].contains(&status));
        Ok(match own {
            _ if heart.is_lost() => Ended::Lost,
            false if timed_out => Ended::Timeout,
            false if stopped => Ended::Stopped,
            _ => Ended::Exit(exit),
        })
    }
}

/// Removes the contents of a run directory. Returns false if another process writes into it.
fn clear(directory: &Path) -> Result<bool> {
    if !directory.exists() {
        return Ok(true);
    }
    let _lock = match DirectoryLock::acquire(directory) {
        Ok(lock) => lock,
        Err(RunError::Locked { .. }) => return Ok(false),
        Err(error) => return Err(error.into()),
    };
    for entry in std::fs::read_dir(directory).map_err(failed("read", directory))? {
        let path = entry.map_err(failed("read", directory))?.path();
        if path.file_name().is_some_and(|name| name == ".lock") {
            continue;
        }
        let removed = if path.is_dir() { std::fs::remove_dir_all(&path) } else { std::fs::remove_file(&path) };
        removed.map_err(failed("removed", &path))?;
    }
    Ok(true)
}
