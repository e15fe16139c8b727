//! Processes that train and evaluate runs, as a queue sees them.

use crate::admission::DeviceMemory;
use crate::batch::Run;
use std::path::{Path, PathBuf};

/// What a process does with a run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Phase {
    /// Forecasts its work and memory.
    Plan,
    /// Trains it.
    Train,
    /// Evaluates it.
    Evaluate,
}

/// Process to start.
#[derive(Clone, Debug)]
pub struct Launch<'a> {
    /// Run to train or evaluate.
    pub run: &'a Run,
    /// What the process does.
    pub phase: Phase,
    /// Whether to continue the run in the directory.
    pub resume: bool,
    /// Device memory in bytes, if limited.
    pub memory_budget: Option<u64>,
    /// Run directory.
    pub directory: PathBuf,
    /// File of settings.
    pub config: PathBuf,
    /// File to which the process appends its messages.
    pub log: PathBuf,
    /// Index of the worker.
    pub worker: usize,
}

/// How a process ended.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Exit {
    /// Exit status; `None` if a signal ended it.
    pub status: Option<i32>,
    /// Signal that ended it, if any.
    pub signal: Option<i32>,
    /// Standard output: JSON with `error` and `kind` after a failure.
    pub output: String,
}

impl Exit {
    /// Returns kind and sentence of a failure.
    pub(crate) fn failure(&self, log: &Path) -> (String, String) {
        let json: serde_json::Value = serde_json::from_str(&self.output).unwrap_or_default();
        let log = log.display();
        let (kind, sentence) = match (self.status, self.signal) {
            (None, Some(signal)) => ("killed", format!("signal {signal} ended the process; see \"{log}\"")),
            (None, None) => ("killed", format!("a signal ended the process; see \"{log}\"")),
            (Some(status), _) => ("failed", format!("the process ended with status {status}; see \"{log}\"")),
        };
        let text = |key: &str, other: String| json[key].as_str().map_or(other, str::to_owned);
        (text("kind", kind.to_owned()), text("error", sentence))
    }
}

/// Started process.
pub trait Process {
    /// Returns how the process ended; `None` while it runs.
    ///
    /// # Errors
    /// If the system cannot report it.
    fn poll(&mut self) -> std::io::Result<Option<Exit>>;
    /// Asks the process to write a checkpoint and end.
    fn terminate(&mut self);
    /// Ends the process at once.
    fn kill(&mut self);
    /// Tells the process that its supervisor still holds the run.
    fn beat(&mut self);
}

/// Starts processes.
pub trait Launcher: Sync {
    /// Returns the memory of the device that a worker's processes use. Runs are admitted by it.
    ///
    /// Without an answer, each worker trains a run.
    fn device(&self, worker: usize) -> Option<DeviceMemory>;

    /// Starts a process.
    ///
    /// # Errors
    /// If it cannot be started.
    fn start(&self, launch: &Launch<'_>) -> std::io::Result<Box<dyn Process>>;
}
