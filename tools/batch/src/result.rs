//! Result of a run, as `results/KEY.json` and each line of `summary.jsonl` have it.

use crate::batch::Run;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::collections::BTreeMap;
use std::path::Path;

/// How a run ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum State {
    /// Trained, and evaluated if the manifest says so.
    Done,
    /// Failed; the result has kind and sentence.
    Failed,
}

/// Result of a run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RunResult {
    /// Name of the scene.
    pub scene: String,
    /// Name of the variant.
    pub variant: String,
    /// Seed.
    pub seed: u64,
    /// How the run ended.
    pub state: State,
    /// Exit status of the last process; absent if a signal ended it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub status: Option<i32>,
    /// Kind of the failure: as in `--json` of `sgs train`, or `timeout`, or `killed`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub kind: Option<String>,
    /// Reason of the failure.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub error: Option<String>,
    /// Number of attempts, over all batches.
    pub attempts: u32,
    /// Wall time of the attempts of the batch that finished the run.
    pub seconds: f64,
    /// Device that trained the run.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub device: Option<String>,
    /// Peak device memory of training in bytes, the largest of the stages.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub peak_device_bytes: Option<u64>,
    /// Number of Gaussians.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub gaussians: Option<u64>,
    /// Steps per second of the geometry stage.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub steps_per_second: Option<f64>,
    /// Memory budget of the last attempt in bytes, if any.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub memory_budget: Option<u64>,
    /// Hash of settings, scene and program version.
    pub identity: String,
    /// Whether the run was evaluated.
    pub evaluated: bool,
    /// Means over the test views, by their path in `metrics.json`.
    #[serde(default)]
    pub measures: BTreeMap<String, f64>,
}

impl RunResult {
    /// Creates the result of a run that has not ended.
    pub(crate) fn of(run: &Run) -> RunResult {
        RunResult {
            scene: run.scene.clone(),
            variant: run.variant.clone(),
            seed: run.seed,
            state: State::Failed,
            status: None,
            kind: None,
            error: None,
            attempts: 0,
            seconds: 0.0,
            device: None,
            peak_device_bytes: None,
            gaussians: None,
            steps_per_second: None,
            memory_budget: None,
            identity: run.identity.clone(),
            evaluated: false,
            measures: BTreeMap::new(),
        }
    }

    /// Returns the name of the run: scene, variant and seed.
    pub fn name(&self) -> String {
        format!("{}/{}/seed{}", self.scene, self.variant, self.seed)
    }

    /// Returns whether the result answers a run of a batch. A changed manifest, scene or program asks another run.
    pub fn answers(&self, run: &Run, evaluate: bool) -> bool {
        self.identity == run.identity && (self.state == State::Failed || self.evaluated || !evaluate)
    }

    /// Returns whether another attempt may succeed: the last process ended with status 75 or by a signal.
    pub fn is_temporary(&self) -> bool {
        let killed = self.status.is_none() && self.kind.as_deref() == Some("killed");
        self.state == State::Failed && (killed || self.status == Some(75))
    }

    /// Returns whether each attempt fails: the scene, the settings or the limits of the device are wrong.
    pub fn is_permanent(&self) -> bool {
        self.state == State::Failed && matches!(self.status, Some(2 | 42))
    }

    /// Reads device, memory, speed and measures from a run directory. What is absent stays absent.
    pub(crate) fn read_run(&mut self, directory: &Path) {
        let training = json(&directory.join("training.json"));
        self.device = training["device"].as_str().map(str::to_owned);
        self.gaussians = training["gaussians"].as_u64();
        self.steps_per_second = training["steps_per_second"].as_f64();
        let stages = [&training, &training["intrinsic"], &training["transport"]];
        self.peak_device_bytes = stages.iter().filter_map(|s| s["peak_device_bytes"].as_u64()).max();
        if self.evaluated {
            let metrics = json(&directory.join("metrics.json"));
            flatten("", &metrics["test"]["mean"], &mut self.measures);
        }
    }
}

fn json(path: &Path) -> Value {
    let bytes = std::fs::read(path).unwrap_or_default();
    serde_json::from_slice(&bytes).unwrap_or_default()
}

/// Adds the numbers of a JSON value, named by their path.
fn flatten(path: &str, value: &Value, into: &mut BTreeMap<String, f64>) {
    match value {
        Value::Object(all) => {
            for (key, value) in all {
                let path = if path.is_empty() { key.clone() } else { format!("{path}.{key}") };
                flatten(&path, value, into);
            }
        }
        value => {
            if let Some(number) = value.as_f64() {
                into.insert(path.to_owned(), number);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::batch::tests::run;

    #[test]
    fn measures_are_flattened() {
        let folder = tempfile::tempdir().unwrap();
        let put = |name: &str, text: &str| std::fs::write(folder.path().join(name), text).unwrap();
        put("metrics.json", r#"{"test": {"mean": {"nvs": {"psnr": 30.5, "lpips": null}, "depth_rel": 0.5}}}"#);
        put(
            "training.json",
            r#"{"device": "d", "gaussians": 7, "peak_device_bytes": 5, "transport": {"peak_device_bytes": 9}}"#,
        );
        let mut result = RunResult { evaluated: true, ..RunResult::of(&run("a", 0)) };
        result.read_run(folder.path());
        let measures: Vec<_> = result.measures.iter().map(|(k, v)| (k.as_str(), *v)).collect();
        assert_eq!(measures, [("depth_rel", 0.5), ("nvs.psnr", 30.5)]);
        assert_eq!((result.peak_device_bytes, result.gaussians, result.steps_per_second), (Some(9), Some(7), None));
        assert_eq!(result.device.as_deref(), Some("d"));
    }

    #[test]
    fn failures_are_temporary_permanent_or_neither() {
        let of = |status: Option<i32>, kind: &str| {
            let result = RunResult { status, kind: Some(kind.into()), ..RunResult::of(&run("a", 0)) };
            (result.is_temporary(), result.is_permanent())
        };
        assert_eq!([of(Some(75), "device_lost"), of(None, "killed")], [(true, false); 2]);
        assert_eq!([of(Some(42), "input"), of(Some(2), "usage")], [(false, true); 2]);
        assert_eq!([of(Some(1), "diverged"), of(None, "timeout")], [(false, false); 2]);
        let done = RunResult { state: State::Done, status: Some(75), ..RunResult::of(&run("a", 0)) };
        assert!(!done.is_temporary() && !done.is_permanent());
    }

    #[test]
    fn results_answer_their_identity_and_evaluation() {
        let run = run("a", 0);
        let failed = RunResult::of(&run);
        let trained = RunResult { state: State::Done, ..failed.clone() };
        assert!(failed.answers(&run, true) && trained.answers(&run, false) && !trained.answers(&run, true));
        assert!(RunResult { evaluated: true, ..trained.clone() }.answers(&run, true));
        assert!(!RunResult { identity: "other".into(), ..trained }.answers(&run, false));
    }
}
