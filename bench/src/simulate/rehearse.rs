//! Rehearsal: the real queue over processes that only sleep, to compare with the simulation.

use super::plan::{End, Job, Plan};
use anyhow::{Context, ensure};
use serde::Serialize;
use sgs_batch::{
    Batch, Exit, Launch, Launcher, Limits, Manifest, Process, Queue, Report, Stage, Store, Timing, Variant,
};
use std::collections::HashMap;
use std::io::Write;
use std::path::Path;
use std::sync::atomic::AtomicBool;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

/// Figures of a rehearsal.
#[derive(Clone, Debug, Serialize)]
pub struct Rehearsal {
    /// Seconds until all workers ended.
    pub end: f64,
    /// Runs with a result.
    pub ended: usize,
    /// Started processes.
    pub starts: usize,
}

/// Process that sleeps, then ends with a status.
struct Sleeper {
    until: Instant,
    status: i32,
}

impl Process for Sleeper {
    fn poll(&mut self) -> std::io::Result<Option<Exit>> {
        let ended = Instant::now() >= self.until;
        Ok(ended.then(|| Exit { status: Some(self.status), signal: None, output: String::new() }))
    }

    fn terminate(&mut self) {
        self.until = Instant::now();
    }

    fn kill(&mut self) {
        self.until = Instant::now();
    }

    fn beat(&mut self) {}
}

/// Starts sleepers that last as long as the drawn runs.
struct Sleepers<'a> {
    jobs: HashMap<String, &'a Job>,
    starts: Mutex<HashMap<String, usize>>,
}

impl Launcher for Sleepers<'_> {
    fn device(&self, _worker: usize) -> Option<sgs_batch::DeviceMemory> {
        None
    }

    fn start(&self, launch: &Launch<'_>) -> std::io::Result<Box<dyn Process>> {
        let name = launch.run.name();
        let job = self.jobs.get(&name).ok_or_else(|| std::io::Error::other("a run without a time"))?;
        let mut starts = self.starts.lock().unwrap_or_else(PoisonError::into_inner);
        let attempt = starts.entry(name).or_default();
        let end = job.ends.get(*attempt).copied().unwrap_or(End::Done);
        *attempt += 1;
        drop(starts);
        // As `sgs batch` does before it starts a process.
        if let Some(folder) = launch.log.parent() {
            std::fs::create_dir_all(folder)?;
        }
        writeln!(std::fs::File::options().create(true).append(true).open(&launch.log)?, "$ sleep")?;
        let (share, status) = match end {
            End::Done => (1.0, 0),
            End::Temporary(share) => (share, 75),
            End::Permanent(share) => (share, 42),
        };
        let until = Instant::now() + Duration::from_secs_f64(share * job.seconds);
        Ok(Box::new(Sleeper { until, status }))
    }
}

/// Runs the real queue with one thread per device in a new directory.
///
/// # Errors
/// If the directory exists or cannot be written, a worker fails, or a run was started more often than it should be.
pub fn rehearse(plan: &Plan, root: &Path) -> anyhow::Result<Rehearsal> {
    let named = || format!("\"{}\" cannot be made; name a new directory", root.display());
    std::fs::create_dir(root).with_context(named)?;
    let jobs = plan.jobs();
    let mut scenes = Vec::new();
    for i in 0..jobs.len() {
        let scene = root.join("scenes").join(format!("room{i:05}"));
        std::fs::create_dir_all(&scene)?;
        std::fs::write(scene.join("transforms.json"), "{}")?;
        scenes.push(scene);
    }
    let manifest = Manifest {
        scenes,
        ignored: Vec::new(),
        variants: vec![Variant { name: "fast".into(), settings: sgs_config::Settings::default() }],
        seeds: vec![0],
        stage: Stage::Geometry,
        evaluate: false,
        limits: Limits { retries: plan.retries, ..Limits::default() },
    };
    let stop = AtomicBool::new(false);
    let out = root.join("out");
    let mut batch = Batch::new(&manifest, env!("CARGO_PKG_VERSION"), Some(&out), &stop)?;
    batch.runs.iter_mut().zip(&jobs).for_each(|(run, job)| run.cost = job.cost);
    let names = batch.runs.iter().map(sgs_batch::Run::name).zip(&jobs);
    let launcher = Sleepers { jobs: names.collect(), starts: Mutex::default() };
    let begun = Instant::now();
    let worker = || -> sgs_batch::Result<Report> {
        let store = Store::open(&out, Timing::EXPIRY)?;
        let queue = Queue {
            store: &store,
            batch: &batch,
            launcher: &launcher,
            stop: &stop,
            progress: &|_| {},
            jobs: 1,
            retry_failed: false,
            retry_temporary: false,
            summarize: true,
            shard: None,
            timing: plan.timing,
        };
        queue.work()
    };
    let reports = std::thread::scope(|scope| {
        let workers: Vec<_> = (0..plan.devices).map(|_| scope.spawn(worker)).collect();
        let reports = workers.into_iter().map(|w| w.join().map_err(|_| anyhow::anyhow!("a worker panicked")));
        reports.map(|report| Ok(report??)).collect::<anyhow::Result<Vec<Report>>>()
    })?;
    let end = begun.elapsed().as_secs_f64();
    let starts = launcher.starts.into_inner().unwrap_or_else(PoisonError::into_inner);
    for (name, count) in &starts {
        // Each attempt but the last ends with a temporary failure.
        let ends = &launcher.jobs[name].ends;
        let planned = ends.iter().position(|e| !matches!(e, End::Temporary(_))).map_or(ends.len(), |i| i + 1);
        ensure!(*count == planned, "{name} was started {count} times, not {planned} times");
    }
    let complete = reports.iter().all(|r| r.done + r.skipped + r.failed.len() == jobs.len() && !r.stopped);
    ensure!(complete && starts.len() == jobs.len(), "a worker ended before all runs had a result");
    Ok(Rehearsal { end, ended: jobs.len(), starts: starts.values().sum() })
}
