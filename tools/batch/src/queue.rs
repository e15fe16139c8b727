//! Workers of a batch: claim runs, supervise the processes that train them, write results.

mod attempts;
mod planning;

use crate::admission::{Admission, Demand, DeviceMemory, Permit};
use crate::batch::{Batch, Run, Shard, sort_by_cost};
use crate::error::Result;
use crate::forecast::Forecast;
use crate::heart::Heart;
use crate::lease::Lease;
use crate::process::{Exit, Launcher};
use crate::result::{RunResult, State};
use crate::store::{Claim, Store};
use crate::summary::Summary;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// Intervals of a queue.
#[derive(Clone, Copy, Debug)]
pub struct Timing {
    /// Interval of renewals of a lease.
    pub heartbeat: Duration,
    /// Time without a renewal after which the holder lets a run go.
    pub give_up: Duration,
    /// Interval at which a process is polled.
    pub poll: Duration,
    /// Interval at which runs of other workers are polled.
    pub idle: Duration,
    /// Delay of the first retry; each further one doubles it.
    pub delay: Duration,
    /// Longest delay of a retry.
    pub longest_delay: Duration,
    /// Time from the request to end until a process is killed.
    pub grace: Duration,
}

impl Timing {
    /// Time without a renewal after which other workers take a run over; for [`Store::open`].
    pub const EXPIRY: Duration = Duration::from_secs(15);
}

impl Default for Timing {
    fn default() -> Self {
        Timing {
            heartbeat: Duration::from_secs(2),
            give_up: Duration::from_secs(8),
            poll: Duration::from_millis(50),
            idle: Duration::from_millis(500),
            delay: Duration::from_secs(1),
            longest_delay: Duration::from_secs(60),
            grace: Duration::from_secs(30),
        }
    }
}

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
        for &i in &order {
            let run = &self.batch.runs[i];
            let Some(result) = self.store.result(run).filter(|r| r.answers(run, self.batch.evaluate)) else { continue };
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
        };
        shared.forecasts = shared.forecasts()?;
        let forecasts = &shared.forecasts;
        // Without any forecast, the order by the estimate stays.
        sort_by_cost(&mut shared.order, |i| forecasts[i].as_ref().map(|forecast| forecast.operations));
        let errors: Vec<_> = std::thread::scope(|scope| {
            let shared = &shared;
            let jobs: Vec<_> = (0..jobs).map(|worker| scope.spawn(move || shared.job(worker))).collect();
            jobs.into_iter().filter_map(|job| job.join().ok().and_then(Result::err)).collect()
        });
        if let Some(error) = errors.into_iter().next() {
            return Err(error);
        }
        let storage = lock(&shared.storage).take();
        match shared.summarize() {
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
            if !self.work_once(worker)? {
                std::thread::sleep(self.queue.timing.idle);
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
            None => Demand::Alone,
        }
    }

    /// Trains the first free run that the worker's device admits. Returns false if there is none.
    fn work_once(&self, worker: usize) -> Result<bool> {
        for &i in &self.order {
            if self.stopping() {
                return Ok(true);
            }
            let permit = {
                let mut slots = lock(&self.slots);
                if !matches!(slots[i], Slot::Open) {
                    continue;
                }
                let device = self.devices[worker].as_ref();
                let permit = device.map(|device| self.admission.admit(device, self.demand(i)));
                if matches!(permit, Some(None)) {
                    continue;
                }
                slots[i] = Slot::Working;
                permit.flatten()
            };
            let (slot, worked) = self.claim(i, worker, permit)?;
            let ended = {
                let mut slots = lock(&self.slots);
                slots[i] = slot;
                self.order.iter().filter(|i| matches!(slots[**i], Slot::Ended(_))).count()
            };
            if worked {
                self.ended(i, ended)?;
                return Ok(true);
            }
        }
        Ok(false)
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
        self.summarize()?;
        let slots = lock(&self.slots);
        if let Slot::Ended(result) = &slots[i] {
            (self.queue.progress)(&Progress::Ended { result, ended, total: self.order.len() });
        }
        Ok(())
    }

    fn summarize(&self) -> Result<()> {
        if !self.queue.summarize {
            return Ok(());
        }
        let _one = lock(&self.summary);
        Summary::update(self.queue.store, self.queue.batch)
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
