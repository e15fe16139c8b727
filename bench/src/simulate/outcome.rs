//! Result of a simulation.

use super::load::Load;

/// Result of a simulation.
#[derive(Clone, Debug, Default)]
pub struct Outcome {
    /// Seconds until all runs have a result.
    pub makespan: f64,
    /// Seconds until all workers have ended.
    pub end: f64,
    /// Seconds of work that no queue can avoid.
    pub work: f64,
    /// Longest necessary seconds of a run.
    pub longest: f64,
    /// Runs that are done.
    pub done: usize,
    /// Runs that failed.
    pub failed: usize,
    /// Attempts that ended with a temporary failure.
    pub temporary: usize,
    /// Runs taken over from dead workers.
    pub taken_over: usize,
    /// Workers that died.
    pub deaths: usize,
    /// Claims that another worker won.
    pub lost_races: usize,
    /// Seconds of repeated or failed work, of loading again, and of delays.
    pub wasted: f64,
    /// Seconds in which workers waited for the disk between runs.
    pub blocked: f64,
    /// Longest seconds of one update of the summary.
    pub longest_summary: f64,
    /// Number of written summaries.
    pub summaries: usize,
    /// Seconds from the large loss until all of its runs were claimed again.
    pub takeover: Option<f64>,
    /// Load of the disk.
    pub load: Load,
}

impl Outcome {
    /// Returns the lower bound of the makespan: the work shared equally, or the longest run.
    pub fn bound(&self, devices: usize) -> f64 {
        (self.work / devices as f64).max(self.longest)
    }
}
