//! Simulation of the queue of `sgs batch` for many runs and devices.

pub mod disk;
pub mod load;
pub mod outcome;
pub mod plan;
pub mod queue;
pub mod rehearse;
pub mod sizes;

use disk::Protocol;
use outcome::Outcome;
use plan::Plan;
use queue::simulate;
use serde::Serialize;

/// Largest ratio of makespan and lower bound that counts as good.
pub const GOOD_RATIO: f64 = 1.1;

/// Figures of one simulation.
#[derive(Clone, Debug, Serialize)]
pub struct Figures {
    /// Number of runs.
    pub rooms: usize,
    /// Number of devices.
    pub devices: usize,
    /// Version of the queue's use of the disk.
    pub protocol: Protocol,
    /// Mean seconds of a run without failures.
    pub mean_seconds: f64,
    /// Seconds until all runs have a result.
    pub makespan: f64,
    /// Seconds until all workers have ended.
    pub end: f64,
    /// Lower bound of the makespan: work over devices, or the longest run.
    pub lower_bound: f64,
    /// Makespan over lower bound.
    pub ratio: f64,
    /// Done and failed runs.
    pub done: usize,
    /// Failed runs.
    pub failed: usize,
    /// Temporary failures.
    pub temporary_failures: usize,
    /// Workers that died.
    pub deaths: usize,
    /// Runs taken over from dead workers.
    pub taken_over: usize,
    /// Claims that another worker won.
    pub lost_races: usize,
    /// Share of the work that was done twice or in vain, with loading and delays.
    pub waste: f64,
    /// Share of the devices' time in which workers waited for the disk between runs.
    pub blocked: f64,
    /// Operations of the queue on the disk, mean a second.
    pub operations_per_second: f64,
    /// Most operations a second, as a mean over ten seconds.
    pub peak_operations_per_second: f64,
    /// All operations by place.
    pub operations: disk::Ops,
    /// Bytes a second, mean: checkpoints, runs, results, summaries.
    pub bytes_per_second: f64,
    /// Most bytes a second.
    pub peak_bytes_per_second: f64,
    /// Number of written summaries.
    pub summaries: usize,
    /// Seconds of the longest update of the summary.
    pub longest_summary: f64,
    /// Start of all workers at once.
    pub start: Start,
    /// Loss of a share of the workers, if requested.
    pub loss: Option<Loss>,
    /// First limit that is exceeded, if any.
    pub broken: Option<String>,
}

/// Hashing of all scenes when all workers start at once.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Start {
    /// Bytes that all workers read.
    pub bytes: f64,
    /// Operations of all workers.
    pub operations: f64,
    /// Seconds that the disk needs for them.
    pub seconds: f64,
}

/// Effect of a loss of workers at half of the lower bound.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Loss {
    /// Workers that are lost for good.
    pub workers: usize,
    /// Seconds until all of their runs are claimed again.
    pub takeover: Option<f64>,
    /// Makespan with the loss.
    pub makespan: f64,
    /// Seconds by which the makespan grows.
    pub extra: f64,
    /// Makespan over the lower bound of the devices that remain.
    pub ratio: f64,
}

/// Simulates a plan, and the same plan with a loss of workers if it has one.
pub fn figures(plan: &Plan) -> Figures {
    let calm = simulate(&Plan { lose: 0.0, ..plan.clone() });
    let loss = (plan.lose > 0.0).then(|| {
        let out = simulate(plan);
        let workers = (plan.lose * plan.devices as f64).round();
        let half = 0.5 * calm.bound(plan.devices);
        // What all devices can do until the loss, and the remaining ones after it.
        let rest = (out.work - half * plan.devices as f64) / (plan.devices as f64 - workers);
        Loss {
            workers: workers as usize,
            takeover: out.takeover,
            makespan: out.makespan,
            extra: out.makespan - calm.makespan,
            ratio: out.makespan / (half + rest).max(out.longest),
        }
    });
    let start = start(plan);
    let bound = calm.bound(plan.devices);
    let ratio = calm.makespan / bound;
    let (peak_operations, peak_bytes) = calm.load.peaks();
    let device_seconds = calm.makespan * plan.devices as f64;
    Figures {
        rooms: plan.rooms,
        devices: plan.devices,
        protocol: plan.protocol,
        mean_seconds: calm.work / plan.rooms as f64,
        makespan: calm.makespan,
        end: calm.end,
        lower_bound: bound,
        ratio,
        done: calm.done,
        failed: calm.failed,
        temporary_failures: calm.temporary,
        deaths: calm.deaths,
        taken_over: calm.taken_over,
        lost_races: calm.lost_races,
        waste: calm.wasted / calm.work,
        blocked: calm.blocked / device_seconds,
        operations_per_second: calm.load.ops.total() / calm.end,
        peak_operations_per_second: peak_operations,
        operations: calm.load.ops,
        bytes_per_second: calm.load.bytes / calm.end,
        peak_bytes_per_second: peak_bytes,
        summaries: calm.summaries,
        longest_summary: calm.longest_summary,
        start,
        loss,
        broken: broken(plan, &calm, ratio, &start),
    }
}

/// Returns what all workers read to hash the scenes at a simultaneous start.
fn start(plan: &Plan) -> Start {
    let (rooms, workers) = (plan.rooms as f64, plan.devices as f64);
    let s = plan.sizes;
    // A listing of each folder, a stat of each entry; then open, stat and read for each file.
    let walk = 2.0 * s.folders + s.files + s.folders - 1.0;
    let hash = s.files + (s.scene / 65_536.0).max(s.files);
    let (bytes, operations) = match plan.protocol {
        Protocol::First => (rooms * workers * s.scene, rooms * workers * (walk + hash)),
        // One worker reads a scene and writes its record: create twice, stat, write, rename. The others read the record.
        // Those that choose one scene at the same time both read it, once at the end of the start.
        Protocol::Current => {
            let read = (rooms + workers).min(rooms * workers);
            (read * s.scene, read * (walk + hash + 5.0) + rooms * workers * 2.0)
        }
    };
    let seconds = (bytes / plan.disk.bytes).max(operations / plan.disk.operations);
    Start { bytes, operations, seconds }
}

/// Names the first limit that a simulation exceeds, the worst first.
fn broken(plan: &Plan, out: &Outcome, ratio: f64, start: &Start) -> Option<String> {
    let (operations, bytes) = out.load.peaks();
    let work = out.bound(plan.devices);
    let limits = [
        (start.seconds / (0.1 * work), "the start takes more than a tenth of the work"),
        (operations / plan.disk.operations, "operations exceed the disk"),
        (bytes / plan.disk.bytes, "bytes exceed the disk"),
        (out.blocked / (0.05 * out.makespan * plan.devices as f64), "workers wait for the disk"),
        (ratio / GOOD_RATIO, "the makespan exceeds 1.1 times the bound"),
    ];
    let exceeded = limits.into_iter().filter(|(by, _)| *by > 1.0);
    exceeded.max_by(|a, b| a.0.total_cmp(&b.0)).map(|(by, what)| format!("{what} ({by:.1} times the limit)"))
}
