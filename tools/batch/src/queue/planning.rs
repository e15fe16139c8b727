//! Forecasts of open runs, before the first of them starts.

use super::{Shared, Slot, lock};
use crate::batch::{Batch, Run};
use crate::error::{Result, failed};
use crate::forecast::{self, Forecast};
use crate::process::{Launch, Launcher, Phase};
use crate::store::Store;
use crate::timing::Timing;
use std::collections::HashSet;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Instant;

/// Forecasts runs; one process for all seeds of a scene and variant, several side by side.
///
/// Forecasts are stored in the directory of the batch and made once. A run that cannot be planned has none; its
/// training says why.
pub struct Planner<'a> {
    /// Directory of the batch, which has the settings of the variants.
    pub store: &'a Store,
    /// Runs.
    pub batch: &'a Batch,
    /// Starts the processes.
    pub launcher: &'a dyn Launcher,
    /// Returns whether to stop.
    pub stop: &'a (dyn Fn() -> bool + Sync),
    /// Number of processes side by side.
    pub jobs: usize,
    /// Intervals.
    pub timing: Timing,
}

impl Planner<'_> {
    /// Forecasts the runs of these indices.
    ///
    /// # Errors
    /// If a process cannot be started, or a forecast cannot be written.
    pub fn plan(&self, runs: &[usize]) -> Result<()> {
        let of = |i: usize| &self.batch.runs[i];
        // The first run of each scene and variant stands for all seeds.
        let mut kinds: Vec<usize> = runs.to_vec();
        kinds.sort_by_key(|i| (&of(*i).scene, &of(*i).variant, *i));
        kinds.dedup_by_key(|i| (&of(*i).scene, &of(*i).variant));
        kinds.sort_unstable();
        let (next, errors) = (AtomicUsize::new(0), Mutex::new(Vec::new()));
        std::thread::scope(|scope| {
            for worker in 0..self.jobs.clamp(1, kinds.len().max(1)) {
                let (next, errors, kinds) = (&next, &errors, &kinds);
                scope.spawn(move || {
                    while let Some(&i) = kinds.get(next.fetch_add(1, Ordering::SeqCst)) {
                        if (self.stop)() || Forecast::read(self.store.root(), of(i)).is_some() {
                            continue;
                        }
                        if let Err(error) = self.plan_one(of(i), worker) {
                            lock(errors).push(error);
                            break;
                        }
                    }
                });
            }
        });
        errors.into_inner().ok().and_then(|errors| errors.into_iter().next()).map_or(Ok(()), Err)
    }

    /// Runs the process that plans a run, and stores its forecast.
    fn plan_one(&self, run: &Run, worker: usize) -> Result<()> {
        let Planner { store, batch, timing, .. } = self;
        let launch = Launch {
            run,
            phase: Phase::Plan,
            resume: false,
            memory_budget: None,
            directory: run.path(store.root(), ""),
            config: store.root().join(&run.config),
            log: forecast::path(store.root(), run, "log"),
            worker,
        };
        let mut process = self.launcher.start(&launch).map_err(failed("used to start a process", &launch.log))?;
        let mut last = Instant::now();
        let exit = loop {
            if let Some(exit) = process.poll().map_err(failed("polled", &launch.log))? {
                break exit;
            }
            if (self.stop)() {
                // It holds nothing and writes nothing.
                process.kill();
            }
            if last.elapsed() >= timing.heartbeat {
                last = Instant::now();
                process.beat();
            }
            std::thread::sleep(timing.poll);
        };
        let settings = batch.settings(run).filter(|_| exit.status == Some(0));
        match settings.and_then(|settings| Forecast::of_answer(&exit.output, run, settings)) {
            Some(forecast) => forecast.write(store.root(), run),
            None => Ok(()),
        }
    }
}

impl Shared<'_> {
    /// Forecasts the open runs. Returns the forecasts by index of the run.
    ///
    /// None are made where no two workers share a device: then nothing is admitted by memory, and the estimated cost is
    /// enough for the order; nor for a single run.
    pub(super) fn forecasts(&self) -> Result<Vec<Option<Forecast>>> {
        let (store, batch) = (self.queue.store, self.queue.batch);
        let open: Vec<usize> = {
            let slots = lock(&self.slots);
            self.order.iter().copied().filter(|i| matches!(slots[*i], Slot::Open)).collect()
        };
        let mut forecasts = vec![None; batch.runs.len()];
        let known = self.devices.iter().flatten();
        let distinct: HashSet<&str> = known.clone().map(|device| device.uuid.as_str()).collect();
        if open.len() <= 1 || known.count() == distinct.len() {
            return Ok(forecasts);
        }
        let (launcher, jobs, timing) = (self.queue.launcher, self.queue.jobs, self.queue.timing);
        Planner { store, batch, launcher, stop: &|| self.stopping(), jobs, timing }.plan(&open)?;
        for i in open {
            forecasts[i] = Forecast::read(store.root(), &batch.runs[i]);
        }
        Ok(forecasts)
    }
}
