//! Forecasts of runs: what `sgs plan` says of their work and memory.

use crate::batch::{Run, write_if_changed};
use crate::error::Result;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use sgs_config::Settings;
use std::path::{Path, PathBuf};

/// Predicted work and memory of a run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Forecast {
    /// Hash of what the forecast depends on: settings, stage, scene and program version.
    pub identity: String,
    /// Operations of all steps.
    pub operations: f64,
    /// Peak device memory in bytes, the largest of the stages.
    pub bytes: u64,
}

impl Forecast {
    /// Reads the answer of `sgs plan --json`. `None` if it is none.
    ///
    /// Takes the largest number of Gaussians that the plan expects, four times the initial one. A plan of the transport
    /// stage says nothing of its geometry: then the operations are 0, and the estimated cost orders the runs.
    pub(crate) fn of_answer(answer: &str, run: &Run, settings: &Settings) -> Option<Forecast> {
        let plan: Value = serde_json::from_str(answer).ok()?;
        if let Some(bytes) = plan["peak_bytes"].as_u64() {
            return Some(Forecast { identity: run.plan_identity.clone(), operations: 0.0, bytes });
        }
        let last = plan["expected"].as_array()?.last()?;
        let step = last["pseudo_step_operations"].as_f64().or_else(|| last["step_operations"].as_f64())?;
        let stage = |key: &str, steps: u32| plan[key]["step_operations"].as_f64().unwrap_or(0.0) * f64::from(steps);
        let operations = step * f64::from(settings.geometry.steps)
            + stage("intrinsic", settings.intrinsic.steps)
            + stage("transport", settings.transport.steps);
        let parts = [&last["bytes"], &plan["intrinsic"]["needs_bytes"], &plan["transport"]["peak_bytes"]];
        let bytes = parts.iter().filter_map(|part| part.as_u64()).max()?;
        Some(Forecast { identity: run.plan_identity.clone(), operations, bytes })
    }

    /// Reads the forecast of a run, if it is there and still holds.
    pub(crate) fn read(root: &Path, run: &Run) -> Option<Forecast> {
        let forecast: Forecast = serde_json::from_slice(&std::fs::read(path(root, run, "json")).ok()?).ok()?;
        (forecast.identity == run.plan_identity).then_some(forecast)
    }

    /// Returns the cost that runs are ordered by.
    pub fn cost(&self) -> u128 {
        self.operations as u128
    }

    pub(crate) fn write(&self, root: &Path, run: &Run) -> Result<()> {
        write_if_changed(&path(root, run, "json"), &serde_json::to_string(self).unwrap_or_default())
    }
}

/// Returns a path of a run's forecast: the file itself, or the log of its process. All seeds share it.
pub(crate) fn path(root: &Path, run: &Run, extension: &str) -> PathBuf {
    root.join("plans").join(format!("{}.{}.{extension}", run.scene, run.variant))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::batch::tests::run;

    #[test]
    fn forecast_takes_the_largest_stage_and_all_steps() {
        let run = run("a", 0);
        let mut settings = Settings::default();
        (settings.geometry.steps, settings.intrinsic.steps, settings.transport.steps) = (10, 100, 7);
        let answer = r#"{"expected": [{"bytes": 1, "step_operations": 1.0},
            {"bytes": 50, "step_operations": 3.0, "pseudo_step_operations": 4.0}],
            "intrinsic": {"needs_bytes": 70, "step_operations": 2.0},
            "transport": {"peak_bytes": 60, "step_operations": 1.0}}"#;
        let forecast = Forecast::of_answer(answer, &run, &settings).unwrap();
        assert_eq!((forecast.operations, forecast.bytes), (40.0 + 200.0 + 7.0, 70));
        let geometry = r#"{"expected": [{"bytes": 50, "step_operations": 3.0}]}"#;
        let alone = Forecast::of_answer(geometry, &run, &settings).unwrap();
        assert_eq!((alone.operations, alone.bytes), (30.0, 50));
        let transport = r#"{"peak_bytes": 80, "step_operations": 3.0}"#;
        let alone = Forecast::of_answer(transport, &run, &settings).unwrap();
        assert_eq!((alone.operations, alone.bytes), (0.0, 80));
        for answer in ["", "{}", r#"{"expected": []}"#, r#"{"error": "no", "kind": "input"}"#] {
            assert_eq!(Forecast::of_answer(answer, &run, &settings), None, "{answer}");
        }
        let folder = tempfile::tempdir().unwrap();
        assert_eq!(Forecast::read(folder.path(), &run), None);
        forecast.write(folder.path(), &run).unwrap();
        assert_eq!(Forecast::read(folder.path(), &run), Some(forecast));
        let changed = Run { plan_identity: "other".into(), ..run };
        assert_eq!(Forecast::read(folder.path(), &changed), None);
    }
}
