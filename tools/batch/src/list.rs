//! List of the runs of a batch, for schedulers.

use crate::batch::Batch;
use crate::forecast::Forecast;
use crate::result::State;
use crate::store::Store;
use serde::Serialize;

/// Run as `sgs batch --list` prints it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Listed {
    /// Name of the scene.
    pub scene: String,
    /// Name of the variant.
    pub variant: String,
    /// Seed.
    pub seed: u64,
    /// Name that `--only` selects the run by.
    pub name: String,
    /// Name of its files in `results` and `leases`.
    pub key: String,
    /// `open`, `done` or `failed`.
    pub state: &'static str,
    /// Estimated cost: pixels of the training views times steps.
    pub cost: u64,
    /// Predicted peak device memory in bytes, if the run was forecast.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub peak_bytes: Option<u64>,
}

/// Lists the runs in the order in which a queue starts them: most expensive first.
pub fn list(store: &Store, batch: &Batch) -> Vec<Listed> {
    let listed = |i: usize| {
        let run = &batch.runs[i];
        let state = match store.result(run).filter(|r| r.answers(run, batch.evaluate)).map(|r| r.state) {
            None => "open",
            Some(State::Done) => "done",
            Some(State::Failed) => "failed",
        };
        Listed {
            scene: run.scene.clone(),
            variant: run.variant.clone(),
            seed: run.seed,
            name: run.name(),
            key: run.key(),
            state,
            cost: u64::try_from(run.cost).unwrap_or(u64::MAX),
            peak_bytes: Forecast::read(store.root(), run).map(|forecast| forecast.bytes),
        }
    };
    batch.order(None).into_iter().map(listed).collect()
}
