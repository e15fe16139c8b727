//! Inputs of a simulation: times, failures, sizes and the shared disk.

use super::disk::Protocol;
use anyhow::{Context, ensure};
use serde::{Deserialize, Serialize};
use sgs_batch::{Limits, RunResult, State, Timing, most_expensive_first};
use sgs_passes::rng::Pcg;
use std::path::Path;

/// How run times are drawn from the measured ones.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, clap::ValueEnum)]
#[serde(rename_all = "lowercase")]
pub enum Distribution {
    /// A measured time, drawn at random.
    Empirical,
    /// A lognormal time fitted to the measured ones.
    Lognormal,
}

/// Rates of failures.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Rates {
    /// Probability that an attempt ends with status 75 or by a signal.
    pub temporary: f64,
    /// Probability that a run fails for good.
    pub permanent: f64,
    /// Failures of a worker per hour, after which it is silent.
    pub worker: f64,
    /// Seconds until a failed worker is started again.
    pub repair: f64,
}

impl Default for Rates {
    fn default() -> Self {
        Rates { temporary: 0.0, permanent: 0.0, worker: 0.0, repair: 600.0 }
    }
}

impl Rates {
    /// Parses `temporary=0.02,worker=0.001`, or reads a TOML file with these keys. Other keys keep their values.
    ///
    /// # Errors
    /// If a key is unknown, or a value is out of range.
    pub fn with(self, text: &str) -> anyhow::Result<Rates> {
        let toml = if text.contains('=') {
            text.replace(',', "\n")
        } else {
            std::fs::read_to_string(text).with_context(|| format!("--failures \"{text}\" cannot be read"))?
        };
        let given: toml::Table = toml.parse().with_context(|| format!("--failures \"{text}\" is no list of rates"))?;
        let mut table = toml::Table::try_from(self)?;
        table.extend(given);
        let rates: Rates = table.try_into().with_context(|| format!("--failures \"{text}\" has an unknown rate"))?;
        let share = |name: &str, value: f64| {
            ensure!((0.0..1.0).contains(&value), "--failures: {name} is {value}; use at least 0 and less than 1");
            Ok(())
        };
        share("temporary", rates.temporary)?;
        share("permanent", rates.permanent)?;
        ensure!((0.0..=60.0).contains(&rates.worker), "--failures: worker is {}; use 0 to 60 an hour", rates.worker);
        ensure!((0.0..1e9).contains(&rates.repair), "--failures: repair is {}; use 0 or more seconds", rates.repair);
        Ok(rates)
    }
}

/// Measurements of a real batch.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Measured {
    /// Seconds of the done runs.
    pub seconds: Vec<f64>,
    /// Attempts of all runs.
    pub attempts: u32,
    /// Failed runs.
    pub failed: usize,
    /// Median of the training steps a second.
    pub steps_per_second: f64,
    /// Pairs of seconds and training steps a second of done runs.
    #[serde(skip)]
    pub speeds: Vec<(f64, f64)>,
    /// Mean size of a result in bytes.
    pub result_bytes: f64,
}

impl Measured {
    /// Reads a `summary.jsonl`.
    ///
    /// # Errors
    /// If the file cannot be read, a line is no result, or no run is done.
    pub fn read(path: &Path) -> anyhow::Result<Measured> {
        let text = std::fs::read_to_string(path).with_context(|| format!("\"{}\" cannot be read", path.display()))?;
        let mut results: Vec<RunResult> = Vec::new();
        let lines = text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty());
        for (i, line) in lines {
            let what = || format!("\"{}\": line {} is no result of a run", path.display(), i + 1);
            results.push(serde_json::from_str(line).with_context(what)?);
        }
        let done = || results.iter().filter(|r| r.state == State::Done);
        let seconds: Vec<f64> = done().map(|r| r.seconds).filter(|s| s.is_finite() && *s > 0.0).collect();
        ensure!(!seconds.is_empty(), "\"{}\" has no done run; name the summary of a finished batch", path.display());
        let speeds: Vec<(f64, f64)> =
            done().filter_map(|r| Some((r.seconds, r.steps_per_second?))).filter(|(_, s)| *s > 0.0).collect();
        Ok(Measured {
            attempts: results.iter().map(|r| r.attempts).sum(),
            failed: results.len() - done().count(),
            steps_per_second: crate::stats::median(&speeds.iter().map(|(_, s)| *s).collect::<Vec<_>>()),
            speeds,
            result_bytes: text.len() as f64 / results.len() as f64,
            seconds,
        })
    }

    /// Returns the median seconds of a run outside of its training steps: start, loading and evaluation.
    pub fn overhead(&self, steps: f64) -> f64 {
        let rest: Vec<f64> = self.speeds.iter().map(|(seconds, speed)| (seconds - steps / speed).max(0.0)).collect();
        crate::stats::median(&rest)
    }

    /// Returns the rates of failures.
    ///
    /// `cautious`: by the rule of succession, (failures + 1) / (trials + 2).
    pub fn rates(&self, cautious: bool) -> Rates {
        let runs = (self.seconds.len() + self.failed) as f64;
        let attempts = f64::from(self.attempts).max(runs);
        let rate = |failures: f64, trials: f64| match cautious {
            true => (failures + 1.0) / (trials + 2.0),
            false => (failures / trials).min(0.99),
        };
        Rates {
            temporary: rate(attempts - runs, attempts),
            permanent: rate(self.failed as f64, runs),
            ..Rates::default()
        }
    }
}

/// Sizes of files, and what the shared disk can do.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Disk {
    /// Seconds of one operation.
    pub latency: f64,
    /// Operations a second that the disk serves.
    pub operations: f64,
    /// Bytes a second that the disk serves.
    pub bytes: f64,
}

/// Sizes of the files of a run.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Sizes {
    /// Bytes of a checkpoint.
    pub checkpoint: f64,
    /// Bytes of the other files of a finished run.
    pub run: f64,
    /// Bytes of a result.
    pub result: f64,
    /// Bytes of the hashed files of a scene.
    pub scene: f64,
    /// Hashed files of a scene.
    pub files: f64,
    /// Folders of a scene, itself included.
    pub folders: f64,
}

/// All inputs of a simulation.
#[derive(Clone, Debug, Serialize)]
pub struct Plan {
    /// Number of runs.
    pub rooms: usize,
    /// Number of workers, each with one device.
    pub devices: usize,
    /// Seed of all draws.
    pub seed: u32,
    /// Measured seconds.
    #[serde(skip)]
    pub times: Vec<f64>,
    /// How times are drawn.
    pub distribution: Distribution,
    /// Mean seconds of a run; the measured mean if `None`.
    pub mean: Option<f64>,
    /// Standard deviation of the logarithm of estimated cost over time.
    pub estimate_error: f64,
    /// Rates of failures.
    pub rates: Rates,
    /// Seconds that a repeated attempt needs to load scene and checkpoint.
    pub resume: f64,
    /// Seconds between checkpoints.
    pub checkpoint: f64,
    /// Sizes of files.
    pub sizes: Sizes,
    /// The shared disk.
    pub disk: Disk,
    /// Version of the queue's use of the disk.
    pub protocol: Protocol,
    /// Share of the workers that is lost at half of the lower bound, for good.
    pub lose: f64,
    /// Intervals of the queue.
    #[serde(skip)]
    pub timing: Timing,
    /// Time after which a lease expires.
    #[serde(skip)]
    pub expiry: f64,
    /// How often a run is started again.
    #[serde(skip)]
    pub retries: u32,
}

/// How an attempt ends.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum End {
    /// The run is done.
    Done,
    /// The attempt fails after this share of its remaining work.
    Temporary(f64),
    /// The run fails for good after this share of its work.
    Permanent(f64),
}

/// Run of a simulation.
#[derive(Clone, Debug, PartialEq)]
pub struct Job {
    /// Seconds without failures.
    pub seconds: f64,
    /// Estimated cost.
    pub cost: u128,
    /// Ends of its attempts, first to last.
    pub ends: Vec<End>,
}

impl Job {
    /// Returns the seconds of work that no queue can avoid.
    pub fn necessary(&self) -> f64 {
        match self.ends[0] {
            End::Permanent(share) => share * self.seconds,
            _ => self.seconds,
        }
    }
}

impl Plan {
    /// Creates a plan without failures on a disk that costs nothing.
    pub fn ideal(times: Vec<f64>, devices: usize) -> Plan {
        let none = Sizes { checkpoint: 0.0, run: 0.0, result: 0.0, scene: 0.0, files: 0.0, folders: 1.0 };
        Plan {
            rooms: times.len(),
            devices,
            seed: 0,
            times,
            distribution: Distribution::Empirical,
            mean: None,
            estimate_error: 0.0,
            rates: Rates::default(),
            resume: 0.0,
            checkpoint: f64::INFINITY,
            sizes: none,
            disk: Disk { latency: 0.0, operations: f64::INFINITY, bytes: f64::INFINITY },
            protocol: Protocol::Current,
            lose: 0.0,
            timing: Timing::default(),
            expiry: Timing::EXPIRY.as_secs_f64(),
            retries: Limits::default().retries,
        }
    }

    /// Draws the runs.
    pub fn jobs(&self) -> Vec<Job> {
        let logs: Vec<f64> = self.times.iter().map(|t| t.ln()).collect();
        let count = logs.len() as f64;
        let center = logs.iter().sum::<f64>() / count;
        let deviation = (logs.iter().map(|l| (l - center).powi(2)).sum::<f64>() / count).sqrt();
        let measured = match self.distribution {
            Distribution::Empirical => self.times.iter().sum::<f64>() / count,
            Distribution::Lognormal => (center + 0.5 * deviation * deviation).exp(),
        };
        let scale = self.mean.map_or(1.0, |mean| mean / measured);
        let mut random = Pcg::new(self.seed);
        let job = |_| {
            let (which, normal, error) = (random.uniform(), random.normal(), random.normal());
            let drawn = match self.distribution {
                Distribution::Empirical => self.times[(which * count) as usize % self.times.len()],
                Distribution::Lognormal => (center + deviation * normal).exp(),
            };
            let seconds = scale * drawn;
            let cost = (1e3 * seconds * (self.estimate_error * error).exp()) as u128;
            let fails = random.uniform() < self.rates.permanent;
            let at = random.uniform();
            let mut ends = Vec::new();
            for _ in 0..=self.retries {
                let (fate, at) = (random.uniform(), random.uniform());
                ends.push(if fate < self.rates.temporary { End::Temporary(at) } else { End::Done });
            }
            if fails {
                ends = vec![End::Permanent(at)];
            }
            Job { seconds, cost, ends }
        };
        (0..self.rooms).map(job).collect()
    }

    /// Returns the indices of runs in the order in which the queue starts them.
    pub fn order(jobs: &[Job]) -> Vec<usize> {
        let mut order: Vec<usize> = (0..jobs.len()).collect();
        most_expensive_first(&mut order, |i| jobs[i].cost);
        order
    }
}
