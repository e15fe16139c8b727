//! How far a run of an ablation is, and what it came to.

use crate::run::RunDirectory;
use crate::settings::{Backward, Settings};
use serde::ser::{Serialize, SerializeMap, Serializer};
use serde_json::Value;
use std::path::Path;

/// How far a run with given settings is.
#[derive(Clone, Debug, PartialEq)]
pub enum State {
    /// There is none, or one with other settings.
    Absent,
    /// It was begun and can be gone on with.
    Begun,
    /// It is trained, but not measured.
    Trained,
    /// All is known.
    Measured(Measures),
}

impl State {
    /// Looks into a directory.
    pub fn of(root: &Path, asked: &Settings) -> State {
        let Ok(run) = RunDirectory::open(root) else { return State::Absent };
        let Ok(began) = run.settings() else { return State::Absent };
        let mut asked = asked.clone();
        // What was left to measurement has been measured, and there may be more memory than before.
        if asked.geometry.backward == Backward::Auto {
            asked.geometry.backward = began.geometry.backward;
        }
        asked.memory = began.memory;
        if asked != began {
            return State::Absent;
        }
        match (Measures::read(&run), run.path("scene.ply").is_file() && run.path("training.json").is_file()) {
            (_, false) => State::Begun,
            (None, true) => State::Trained,
            (Some(measures), true) => State::Measured(measures),
        }
    }
}

/// One of the measures.
pub(super) struct Measure {
    /// Its name in JSON.
    pub key: &'static str,
    /// Its name in the table, and whether more or less is better.
    pub heading: &'static str,
    /// Digits behind the point.
    pub digits: usize,
    /// Where it stands in `metrics.json`.
    place: &'static str,
}

/// All measures, in the order of the table.
pub(super) const MEASURES: [Measure; 7] = [
    measure("psnr", "PSNR, dB ↑", 2, "/test/mean/nvs/psnr"),
    measure("ssim", "SSIM ↑", 4, "/test/mean/nvs/ssim"),
    measure("normal_mae_deg", "normals, ° ↓", 2, "/test/mean/normal_mae_deg"),
    measure("depth_rel", "depth, relative ↓", 4, "/test/mean/depth_rel"),
    measure("accuracy", "labels right ↑", 4, "/test/mean/semantic/accuracy"),
    measure("seconds_per_step", "seconds a step ↓", 4, "/steps_per_second"),
    measure("gaussians", "Gaussians", 0, "/gaussians"),
];

const fn measure(key: &'static str, heading: &'static str, digits: usize, place: &'static str) -> Measure {
    Measure { key, heading, digits, place }
}

/// A number for every measure; what is not known is absent.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Measures(pub(super) [Option<f64>; MEASURES.len()]);

impl Measures {
    /// What the evaluation of a run left, if it is there and whole.
    pub fn read(run: &RunDirectory) -> Option<Measures> {
        let text = std::fs::read_to_string(run.path("metrics.json")).ok()?;
        let all: Value = serde_json::from_str(&text).ok()?;
        let training = std::fs::read_to_string(run.path("training.json")).unwrap_or_default();
        let training: Value = serde_json::from_str(&training).unwrap_or_default();
        let whole = training["resumed_from"] == 0;
        let number = |m: &Measure| {
            let value = all.pointer(m.place).and_then(Value::as_f64);
            // The file says how many steps a second takes; of an interrupted run it is the last part's, which is no measure.
            if m.key == "seconds_per_step" { value.filter(|v| whole && *v > 0.0).map(|v| 1.0 / v) } else { value }
        };
        let found = Measures(std::array::from_fn(|i| number(&MEASURES[i])));
        found.get("psnr").map(|_| found)
    }

    /// A measure by its name in JSON: `psnr` (dB), `ssim`, `normal_mae_deg`, `depth_rel`, `accuracy`, `seconds_per_step`,
    /// `gaussians`. Seconds are those of runs that were not interrupted.
    pub fn get(&self, key: &str) -> Option<f64> {
        MEASURES.iter().zip(self.0).find(|(m, _)| m.key == key).and_then(|(_, value)| value)
    }
}

impl Serialize for Measures {
    fn serialize<S: Serializer>(&self, s: S) -> Result<S::Ok, S::Error> {
        let mut map = s.serialize_map(None)?;
        for (measure, value) in MEASURES.iter().zip(self.0) {
            if let Some(value) = value {
                map.serialize_entry(measure.key, &value)?;
            }
        }
        map.end()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn a_run_is_recognized_by_its_settings_and_files() {
        let folder = tempfile::tempdir().unwrap();
        let root = folder.path().join("run");
        let mut asked = Settings { seed: 2, ..Settings::default() };
        assert_eq!(State::of(&root, &asked), State::Absent);
        let run = RunDirectory::create(&root).unwrap();
        assert_eq!(State::of(&root, &asked), State::Absent);
        let mut began = asked.clone();
        (began.geometry.backward, began.memory.budget) = (Backward::Splat, 1 << 30);
        run.write_settings(&began).unwrap();
        assert_eq!(State::of(&root, &asked), State::Begun);
        std::fs::write(run.path("scene.ply"), "").unwrap();
        assert_eq!(State::of(&root, &asked), State::Begun);
        run.write_json("training.json", &json!({"resumed_from": 0})).unwrap();
        assert_eq!(State::of(&root, &asked), State::Trained);
        // A file of another split, and one that is no JSON.
        run.write_json("metrics.json", &json!({"train": {"mean": {"nvs": {"psnr": 30.0}}}})).unwrap();
        assert_eq!(State::of(&root, &asked), State::Trained);
        std::fs::write(run.path("metrics.json"), "{").unwrap();
        assert_eq!(State::of(&root, &asked), State::Trained);
        let test = json!({"mean": {"nvs": {"psnr": 30.0, "ssim": 0.9}, "semantic": {"accuracy": 0.5}}});
        run.write_json("metrics.json", &json!({"test": test, "steps_per_second": 4.0, "gaussians": 12})).unwrap();
        let State::Measured(measures) = State::of(&root, &asked) else { panic!("measures are there") };
        let all = json!({"psnr": 30.0, "ssim": 0.9, "accuracy": 0.5, "seconds_per_step": 0.25, "gaussians": 12.0});
        assert_eq!(serde_json::to_value(measures).unwrap(), all);
        assert_eq!((measures.get("accuracy"), measures.get("depth_rel")), (Some(0.5), None));
        run.write_json("training.json", &json!({"resumed_from": 9})).unwrap();
        let timed = |state| matches!(state, State::Measured(m) if m.get("seconds_per_step").is_some());
        assert!(!timed(State::of(&root, &asked)), "the time of a part was taken for the whole");
        // Any other setting is another run.
        asked.geometry.losses.l1 = 0.7;
        assert_eq!(State::of(&root, &asked), State::Absent);
    }
}
