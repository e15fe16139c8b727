//! Workers of a batch: claim runs, supervise the processes that train them, write results.

mod attempts;
mod pass;
mod planning;

pub use planning::Planner;

use crate::admission::{Admission, Demand, DeviceMemory, Permit};
use crate::batch::{Batch, Run, Shard, most_expensive_first};
use crate::error::Result;
use crate::forecast::Forecast;
use crate::heart::Heart;
use crate::lease::Lease;
use crate::process::{Exit, Launcher};
use crate::records::Records;
use crate::result::{RunResult, State};
use crate::store::{Claim, Store};
use crate::summary::Summary;
use crate::timing::Timing;
use std::collections::hash_map::RandomState;
use std::hash::{BuildHasher, Hasher};
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
    /// Whether to train runs again whose failure was temporary.
    pub retry_temporary: bool,
    /// Whether to write the summary. A queue of selected runs does not know the results of the others.
    pub summarize: bool,
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
    /// Why the queue stopped itself: the disk is full or read-only.
    pub storage: Option<String>,
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
    /// Error of the first process that found the disk full or read-only. All other runs would fail as well.
    storage: Mutex<Option<String>>,
    summary: Mutex<()>,
    /// Forecasts by index of the run.
    forecasts: Vec<Option<Forecast>>,
    /// Memory of each worker's device, if known.
    devices: Vec<Option<DeviceMemory>>,
    admission: Admission,
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
            let retry = self.retry_failed || self.retry_temporary && result.is_temporary();
            if result.state == State::Failed && retry {
                again[i] = Some(result);
            } else {
                skipped += usize::from(result.state == State::Done);
                slots[i] = Slot::Ended(Box::new(result));
            }
        }
        let (slots, halt) = (Mutex::new(slots), AtomicBool::new(false));
        let jobs = self.jobs.max(1);
        let mut shared = Shared {
            queue: self,
            order,
            slots,
            again,
            halt,
            storage: Mutex::new(None),
            summary: Mutex::new(()),
            forecasts: Vec::new(),
            devices: (0..jobs).map(|worker| self.launcher.device(worker)).collect(),
            admission: Admission::default(),
            // Workers that start together look at different leases first.
            cursor: AtomicUsize::new(RandomState::new().build_hasher().finish() as usize),
        };
        shared.forecasts = shared.forecasts()?;
        let forecasts = &shared.forecasts;
        // Without any forecast, the order by the estimate stays.
        most_expensive_first(&mut shared.order, |i| forecasts[i].as_ref().map_or(0, Forecast::cost));
        let errors: Vec<_> = std::thread::scope(|scope| {
            let shared = &shared;
            let jobs: Vec<_> = (0..jobs).map(|worker| scope.spawn(move || shared.job(worker))).collect();
            jobs.into_iter().filter_map(|job| job.join().ok().and_then(Result::err)).collect()
        });
        if let Some(error) = errors.into_iter().next() {
            return Err(error);
        }
        let storage = lock(&shared.storage).take();
        match shared.summarize(true) {
            // The first error is the one to report.
            Err(_) if storage.is_some() => {}
            written => written?,
        }
        let slots = lock(&shared.slots);
        let mut report = Report { runs: shared.order.len(), skipped, storage, ..Report::default() };
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

    /// Returns the memory that a run is admitted with.
    fn demand(&self, i: usize) -> Demand {
        match &self.forecasts[i] {
            Some(forecast) => {
                let limit = self.queue.batch.limits.memory_budget.unwrap_or(u64::MAX);
                Demand::Bytes(forecast.bytes.min(limit))
            }
            // Where no run has a forecast, no device is shared.
            None => Demand::Alone,
        }
    }

    /// Claims a run and trains it. Returns its new state, and whether this job trained it.
    fn claim(&self, i: usize, worker: usize, permit: Option<Permit<'_>>) -> Result<(Slot, bool)> {
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
                match self.train(run, lease, worker, permit)? {
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
        if !self.queue.summarize {
            return Ok(());
        }
        let _one = lock(&self.summary);
        Summary::update(self.queue.store, self.queue.batch, last)
    }

    /// Trains a held run. Returns its result; `None` if the queue was stopped or the lease was lost.
    fn train(&self, run: &Run, lease: Lease, worker: usize, permit: Option<Permit<'_>>) -> Result<Option<RunResult>> {
        let Queue { store, batch, timing, .. } = self.queue;
        let taken_over = lease.generation() > 1;
        let heart = Heart::start(lease, timing.heartbeat, timing.give_up);
        let outcome = self.attempts(run, &heart, taken_over, worker, permit);
        let lost = heart.is_lost();
        let Some(lease) = heart.stop() else { return Ok(None) };
        match outcome {
            Ok(Outcome::Result(result)) if !lost => {
                Ok(store.finish(lease, run, batch.evaluate, &result)?.then_some(*result))
            }
            // Without a release, others wait for the lease to expire.
            Ok(Outcome::Stopped) if lock(&self.storage).is_some() => Ok(lease.release().ok().and(None)),
            Ok(Outcome::Stopped) => lease.release().map(|()| None),
            Ok(Outcome::Result(_) | Outcome::Lost) => Ok(None),
            Err(error) => {
                // The first error is the one to report.
                let _ = lease.release();
                Err(error)
            }
        }
    }
}

#[cfg(test)]
mod tests;
