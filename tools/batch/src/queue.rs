//! Workers of a batch: claim runs, supervise the processes that train them, write results.

use crate::batch::{Batch, Run, Shard};
use crate::error::{Result, failed};
use crate::heart::Heart;
use crate::lease::Lease;
use crate::process::{Exit, Launch, Launcher, Phase};
use crate::records::Records;
use crate::result::{RunResult, State};
use crate::store::{Claim, Record, Store};
use crate::summary::Summary;
use crate::timing::Timing;
use sgs_run::{DirectoryLock, RunError};
use std::collections::hash_map::RandomState;
use std::hash::{BuildHasher, Hasher};
use std::path::Path;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// Event of a queue, for people.
#[derive(Clone, Debug)]
pub enum Progress<'a> {
    /// A run of this worker ended.
    Ended {
        /// Its result.
        result: &'a RunResult,
        /// Number of runs with a result.
        ended: usize,
        /// Number of all runs.
        total: usize,
    },
    /// A run is started again after a delay.
    Again {
        /// Name of the run.
        name: String,
        /// Reason.
        reason: String,
        /// Delay.
        delay: Duration,
    },
}

/// Runs of a batch, worked off by several jobs.
pub struct Queue<'a> {
    /// Directory that all workers share.
    pub store: &'a Store,
    /// Runs.
    pub batch: &'a Batch,
    /// Starts the processes.
    pub launcher: &'a dyn Launcher,
    /// Flag that stops the queue.
    pub stop: &'a AtomicBool,
    /// Receives events.
    pub progress: &'a (dyn Fn(&Progress<'_>) + Sync),
    /// Number of processes side by side.
    pub jobs: usize,
    /// Whether to train failed runs again.
    pub retry_failed: bool,
    /// Part of the runs; all if `None`.
    pub shard: Option<Shard>,
    /// Intervals.
    pub timing: Timing,
}

/// State of a batch after its queue ended.
#[derive(Clone, Debug, Default)]
pub struct Report {
    /// Number of runs.
    pub runs: usize,
    /// Runs that were done before.
    pub skipped: usize,
    /// Runs that were done since, also by other workers.
    pub done: usize,
    /// Failed runs in the order of the manifest, also earlier ones.
    pub failed: Vec<RunResult>,
    /// Whether the queue was stopped before all runs had a result.
    pub stopped: bool,
}

/// Progress of a run within a queue.
#[derive(Clone, Debug)]
enum Slot {
    Open,
    Working,
    Ended(Box<RunResult>),
}

/// State that the jobs share.
struct Shared<'a> {
    queue: &'a Queue<'a>,
    order: Vec<usize>,
    slots: Mutex<Vec<Slot>>,
    /// Failed results to replace.
    again: Vec<Option<RunResult>>,
    /// Ends all jobs: after an error, or after a user stopped a process.
    halt: AtomicBool,
    summary: Mutex<()>,
    /// Position of the next look at leases of others.
    cursor: AtomicUsize,
}

/// How the attempts of a run ended.
enum Outcome {
    Result(Box<RunResult>),
    Stopped,
    Lost,
}

/// How a process ended, or why it was ended.
enum Ended {
    Exit(Exit),
    Timeout,
    Stopped,
    Lost,
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Queue<'_> {
    /// Works until each run has a result, or until the queue is stopped.
    ///
    /// Also waits for runs of other workers, and takes over those of dead workers.
    ///
    /// # Errors
    /// If the directory cannot be read or written. Failures of runs are results.
    pub fn work(&self) -> Result<Report> {
        let order = self.batch.order(self.shard);
        let mut slots = vec![Slot::Open; self.batch.runs.len()];
        let mut again = vec![None; slots.len()];
        let mut skipped = 0;
        let there = self.store.result_keys()?;
        for &i in &order {
            let run = &self.batch.runs[i];
            if !there.contains(&run.key()) {
                continue;
            }
            let Some(result) = self.store.answer(run, self.batch.evaluate) else { continue };
            if result.state == State::Failed && self.retry_failed {
                again[i] = Some(result);
            } else {
                skipped += usize::from(result.state == State::Done);
                slots[i] = Slot::Ended(Box::new(result));
            }
        }
        let (slots, halt) = (Mutex::new(slots), AtomicBool::new(false));
        // Workers that start together look at different leases first.
        let cursor = AtomicUsize::new(RandomState::new().build_hasher().finish() as usize);
        let shared = Shared { queue: self, order, slots, again, halt, summary: Mutex::new(()), cursor };
        let errors: Vec<_> = std::thread::scope(|scope| {
            let shared = &shared;
            let jobs: Vec<_> = (0..self.jobs.max(1)).map(|worker| scope.spawn(move || shared.job(worker))).collect();
            jobs.into_iter().filter_map(|job| job.join().ok().and_then(Result::err)).collect()
        });
        if let Some(error) = errors.into_iter().next() {
            return Err(error);
        }
        shared.summarize(true)?;
        let slots = lock(&shared.slots);
        let mut report = Report { runs: shared.order.len(), skipped, ..Report::default() };
        let mut done = 0;
        let mut order = shared.order.clone();
        order.sort_unstable();
        for i in order {
            match &slots[i] {
                Slot::Ended(result) if result.state == State::Done => done += 1,
                Slot::Ended(result) => report.failed.push((**result).clone()),
                Slot::Open | Slot::Working => report.stopped = true,
            }
        }
        report.done = done - skipped;
        if !report.stopped {
            Records::remove(self.store.root());
        }
        Ok(report)
    }
}

impl Shared<'_> {
    fn stopping(&self) -> bool {
        self.halt.load(Ordering::SeqCst) || self.queue.stop.load(Ordering::SeqCst)
    }

    /// Runs one job. An error ends the other jobs as well.
    fn job(&self, worker: usize) -> Result<()> {
        let worked = self.work(worker);
        if worked.is_err() {
            self.halt.store(true, Ordering::SeqCst);
        }
        worked
    }

    fn work(&self, worker: usize) -> Result<()> {
        while !self.stopping() {
            let all = lock(&self.slots);
            if self.order.iter().all(|i| matches!(all[*i], Slot::Ended(_))) {
                break;
            }
            drop(all);
            if let Some(held) = self.work_once(worker)? {
                let begun = Instant::now();
                let delay = self.queue.timing.idle_delay(held);
                while begun.elapsed() < delay && !self.stopping() {
                    std::thread::sleep(self.queue.timing.idle.min(delay));
                }
            }
        }
        Ok(())
    }

    /// Claims a run and trains it. Returns its new state, and whether this job trained it.
    fn claim(&self, i: usize, worker: usize) -> Result<(Slot, bool)> {
        let Queue { store, batch, .. } = *self.queue;
        let run = &batch.runs[i];
        let again = self.again[i].as_ref();
        Ok(match store.claim(run, batch.evaluate, again)? {
            Claim::Ended(result) => (Slot::Ended(result), false),
            Claim::Busy => (Slot::Open, false),
            Claim::Held(lease) => {
                if again.is_some() {
                    store.forget(run)?;
                }
                match self.train(run, lease, worker)? {
                    Some(result) => (Slot::Ended(Box::new(result)), true),
                    None => (Slot::Open, false),
                }
            }
        })
    }

    /// Reports the end of a run and updates the summary. `ended`: number of runs that had ended then.
    fn ended(&self, i: usize, ended: usize) -> Result<()> {
        let Queue { store, batch, timing, .. } = self.queue;
        if !store.has_fresh_summary(&batch.runs[i], timing.summary_interval(batch.runs.len())) {
            self.summarize(false)?;
        }
        let slots = lock(&self.slots);
        if let Slot::Ended(result) = &slots[i] {
            (self.queue.progress)(&Progress::Ended { result, ended, total: self.order.len() });
        }
        Ok(())
    }

    fn summarize(&self, last: bool) -> Result<()> {
        let _one = lock(&self.summary);
        Summary::update(self.queue.store, self.queue.batch, last)
    }

    /// Trains a held run. Returns its result; `None` if the queue was stopped or the lease was lost.
    fn train(&self, run: &Run, lease: Lease, worker: usize) -> Result<Option<RunResult>> {
        let Queue { store, batch, timing, .. } = self.queue;
        let taken_over = lease.generation() > 1;
        let heart = Heart::start(lease, timing.heartbeat, timing.give_up);
        let outcome = self.attempts(run, &heart, taken_over, worker);
        let lost = heart.is_lost();
        let Some(lease) = heart.stop() else { return Ok(None) };
        match outcome {
            Ok(Outcome::Result(result)) if !lost => {
                Ok(store.finish(lease, run, batch.evaluate, &result)?.then_some(*result))
            }
            Ok(Outcome::Stopped) => lease.release().map(|()| None),
            Ok(Outcome::Result(_) | Outcome::Lost) => Ok(None),
            Err(error) => {
                // The first error is the one to report.
                let _ = lease.release();
                Err(error)
            }
        }
    }

    /// Attempts a run until it has a result.
    fn attempts(&self, run: &Run, heart: &Heart, taken_over: bool, worker: usize) -> Result<Outcome> {
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
            let locked = kind == "locked";
            if locked {
                // A process of a killed worker may still write its checkpoint. That is no attempt.
                waits += 1;
                if let Some(record) = store.record(run).filter(|r| r.identity == run.identity && r.attempts > 0) {
                    store.write_record(run, &Record { attempts: record.attempts - 1, ..record })?;
                }
            } else if matches!(exit.status, Some(75) | None) && retries < batch.limits.retries {
                retries += 1;
                if kind == "out_of_memory" {
                    result.memory_budget = result.memory_budget.map(|bytes| (bytes - bytes / 4).max(1));
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

mod pass;

#[cfg(test)]
mod tests;
