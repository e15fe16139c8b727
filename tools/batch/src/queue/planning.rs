//! Forecasts of open runs, before the first of them starts.

use super::{Shared, Slot, lock};
use crate::batch::Run;
use crate::error::{Result, failed};
use crate::forecast::{self, Forecast};
use crate::process::{Launch, Phase};
use std::collections::HashSet;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Instant;

impl Shared<'_> {
    /// Forecasts the open runs; one process for all seeds of a scene and variant, several side by side.
    ///
    /// Returns the forecasts by index of the run. None are made where no two workers share a device: then nothing is
    /// admitted by memory, and the estimated cost is enough for the order; nor for a single run. A run that cannot be planned has none; its
    /// training says why.
    pub(super) fn forecasts(&self) -> Result<Vec<Option<Forecast>>> {
        let (batch, root) = (self.queue.batch, self.queue.store.root());
        let open: Vec<usize> = {
            let slots = lock(&self.slots);
            self.order.iter().copied().filter(|i| matches!(slots[*i], Slot::Open)).collect()
        };
        // The first run of each scene and variant stands for all seeds.
        let mut kinds: Vec<usize> = open.clone();
        kinds.sort_by_key(|i| (&batch.runs[*i].scene, &batch.runs[*i].variant, *i));
        kinds.dedup_by_key(|i| (&batch.runs[*i].scene, &batch.runs[*i].variant));
        kinds.sort_unstable();
        let mut forecasts = vec![None; batch.runs.len()];
        let known = self.devices.iter().flatten();
        let distinct: HashSet<&str> = known.clone().map(|device| device.uuid.as_str()).collect();
        if open.len() <= 1 || known.count() == distinct.len() {
            return Ok(forecasts);
        }
        let (next, errors) = (AtomicUsize::new(0), Mutex::new(Vec::new()));
        std::thread::scope(|scope| {
            for worker in 0..self.queue.jobs.clamp(1, kinds.len().max(1)) {
                let (next, errors, kinds) = (&next, &errors, &kinds);
                scope.spawn(move || {
                    while let Some(&i) = kinds.get(next.fetch_add(1, Ordering::SeqCst)) {
                        let run = &batch.runs[i];
                        if self.stopping() || Forecast::read(root, run).is_some() {
                            continue;
                        }
                        if let Err(error) = self.plan(run, worker) {
                            lock(errors).push(error);
                            break;
                        }
                    }
                });
            }
        });
        if let Some(error) = errors.into_inner().ok().and_then(|errors| errors.into_iter().next()) {
            return Err(error);
        }
        for i in open {
            forecasts[i] = Forecast::read(root, &batch.runs[i]);
        }
        Ok(forecasts)
    }

    /// Runs the process that plans a run, and stores its forecast.
    fn plan(&self, run: &Run, worker: usize) -> Result<()> {
        let (store, batch, timing) = (self.queue.store, self.queue.batch, &self.queue.timing);
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
        let mut process = self.queue.launcher.start(&launch).map_err(failed("used to start a process", &launch.log))?;
        let mut last = Instant::now();
        let exit = loop {
            if let Some(exit) = process.poll().map_err(failed("polled", &launch.log))? {
                break exit;
            }
            if self.stopping() {
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
