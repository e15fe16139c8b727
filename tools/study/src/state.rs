//! How far a run of a table is, and what it came to.

use serde::ser::{Serialize, SerializeMap, Serializer};
use serde_json::Value;
use sgs_config::{Backward, Settings};
use sgs_evaluate::metrics::LpipsAbout;
use sgs_run::RunDirectory;
use std::path::Path;

/// How far a run with given settings is.
#[derive(Clone, Debug, PartialEq)]
pub enum State {
    /// There is none, or one with other settings.
    Absent,
    /// It was begun and can be gone on with.
    Begun,
    /// Its geometry is trained, but not the materials that are wanted, too, or with other settings.
    Formed,
    /// It is trained, but not measured.
    Trained,
    /// All is known.
    Measured(Box<Measures>),
}

/// What a run is wanted for.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Goal {
    /// Whether materials and lights are trained, too.
    pub materials: bool,
    /// Which LPIPS is measured, if it is.
    pub lpips: Option<LpipsAbout>,
}

impl State {
    /// Looks into a directory.
    pub fn of(root: &Path, asked: &Settings, goal: &Goal) -> State {
        let Ok(run) = RunDirectory::open(root) else { return State::Absent };
        let Ok(began) = run.settings() else { return State::Absent };
        let mut asked = asked.clone();
        // What was left to measurement has been measured, and there may be more memory than before.
        if asked.geometry.backward == Backward::Auto {
            asked.geometry.backward = began.geometry.backward;
        }
        asked.memory = began.memory;
        // Geometry does not depend on what becomes of it.
        let same_materials = asked.intrinsic == began.intrinsic;
        asked.intrinsic.clone_from(&began.intrinsic);
        if asked != began {
            return State::Absent;
        }
        if !(run.path("scene.ply").is_file() && run.path("training.json").is_file()) {
            return State::Begun;
        }
        if goal.materials && !(same_materials && json(&run, "training.json").get("intrinsic").is_some()) {
            return State::Formed;
        }
        let wanted = goal.lpips.and_then(|about| serde_json::to_value(about).ok());
        let measured = |all: &Value| wanted.as_ref().is_none_or(|about| all.pointer("/test/lpips") == Some(about));
        match Measures::read(&run) {
            Some(measures) if measured(&json(&run, "metrics.json")) => State::Measured(Box::new(measures)),
            _ => State::Trained,
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
pub(super) const MEASURES: [Measure; 18] = [
    measure("psnr", "PSNR, dB ↑", 2, "/test/mean/nvs/psnr"),
    measure("ssim", "SSIM ↑", 4, "/test/mean/nvs/ssim"),
    measure("lpips", "LPIPS ↓", 4, "/test/mean/nvs/lpips"),
    measure("pbr_psnr", "shaded PSNR, dB ↑", 2, "/test/mean/pbr/psnr"),
    measure("pbr_ssim", "shaded SSIM ↑", 4, "/test/mean/pbr/ssim"),
    measure("pbr_lpips", "shaded LPIPS ↓", 4, "/test/mean/pbr/lpips"),
    measure("albedo_psnr", "albedo PSNR, dB ↑", 2, "/test/mean/albedo/psnr"),
    measure("albedo_ssim", "albedo SSIM ↑", 4, "/test/mean/albedo/ssim"),
    measure("albedo_lpips", "albedo LPIPS ↓", 4, "/test/mean/albedo/lpips"),
    measure("roughness_mse", "roughness MSE ↓", 5, "/test/mean/roughness_mse"),
    measure("metallic_mse", "metallic MSE ↓", 5, "/test/mean/metallic_mse"),
    measure("relit_psnr", "relit, dB ↑", 2, "/test/mean/relit/mean/psnr"),
    measure("normal_mae_deg", "normals, ° ↓", 2, "/test/mean/normal_mae_deg"),
    measure("depth_rel", "depth, relative ↓", 4, "/test/mean/depth_rel"),
    measure("accuracy", "labels right ↑", 4, "/test/mean/semantic/accuracy"),
    measure("seconds_per_step", "seconds a step ↓", 4, "/steps_per_second"),
    measure("intrinsic_seconds_per_step", "seconds a step of materials ↓", 4, "/intrinsic/steps_per_second"),
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
        let (all, training) = (json(run, "metrics.json"), json(run, "training.json"));
        // The files say how many steps a second takes; of an interrupted run it is the last part's, which is no measure.
        let per_step = |of: &Value, place: &str, part: &Value| {
            let rate = of.pointer(place).and_then(Value::as_f64);
            rate.filter(|rate| part["resumed_from"] == 0 && *rate > 0.0).map(|rate| 1.0 / rate)
        };
        let number = |m: &Measure| match m.key {
            "seconds_per_step" => per_step(&all, m.place, &training),
            "intrinsic_seconds_per_step" => per_step(&training, m.place, &training["intrinsic"]),
            _ => all.pointer(m.place).and_then(Value::as_f64),
        };
        let found = Measures(std::array::from_fn(|i| number(&MEASURES[i])));
        found.get("psnr").map(|_| found)
    }

    /// A measure by its name in JSON: `psnr` (dB), `ssim`, `lpips`; `pbr_` and `albedo_` with one of these; `roughness_mse`,
    /// `metallic_mse`, `relit_psnr` (mean over the relit sets), `normal_mae_deg`, `depth_rel`, `accuracy`, `seconds_per_step` (of
    /// geometry), `intrinsic_seconds_per_step`, `gaussians`. Seconds are those of runs that were not interrupted.
    pub fn get(&self, key: &str) -> Option<f64> {
        MEASURES.iter().zip(self.0).find(|(m, _)| m.key == key).and_then(|(_, value)| value)
    }
}

/// A file of a run; null where there is none, or it is damaged.
fn json(run: &RunDirectory, name: &str) -> Value {
    let text = std::fs::read_to_string(run.path(name)).unwrap_or_default();
    serde_json::from_str(&text).unwrap_or_default()
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
        let state = |asked: &Settings| State::of(&root, asked, &Goal::default());
        assert_eq!(state(&asked), State::Absent);
        let run = RunDirectory::create(&root).unwrap();
        assert_eq!(state(&asked), State::Absent);
        let mut began = asked.clone();
        (began.geometry.backward, began.memory.budget) = (Backward::Splat, 1 << 30);
        run.write_settings(&began).unwrap();
        assert_eq!(state(&asked), State::Begun);
        std::fs::write(run.path("scene.ply"), "").unwrap();
        assert_eq!(state(&asked), State::Begun);
        run.write_json("training.json", &json!({"resumed_from": 0})).unwrap();
        assert_eq!(state(&asked), State::Trained);
        // A file of another split, and one that is no JSON.
        run.write_json("metrics.json", &json!({"train": {"mean": {"nvs": {"psnr": 30.0}}}})).unwrap();
        assert_eq!(state(&asked), State::Trained);
        std::fs::write(run.path("metrics.json"), "{").unwrap();
        assert_eq!(state(&asked), State::Trained);
        let test = json!({"mean": {"nvs": {"psnr": 30.0, "ssim": 0.9}, "semantic": {"accuracy": 0.5}}});
        run.write_json("metrics.json", &json!({"test": &test, "steps_per_second": 4.0, "gaussians": 12})).unwrap();
        let State::Measured(measures) = state(&asked) else { panic!("measures are there") };
        let all = json!({"psnr": 30.0, "ssim": 0.9, "accuracy": 0.5, "seconds_per_step": 0.25, "gaussians": 12.0});
        assert_eq!(serde_json::to_value(*measures).unwrap(), all);
        assert_eq!((measures.get("accuracy"), measures.get("depth_rel")), (Some(0.5), None));
        run.write_json("training.json", &json!({"resumed_from": 9})).unwrap();
        // Materials and LPIPS are wanted, too.
        let goal = |materials: bool, net: Option<&'static str>| {
            let lpips = net.map(|net| LpipsAbout { net, version: "0.1", range: [0, 1] });
            State::of(&root, &asked, &Goal { materials, lpips })
        };
        assert_eq!((goal(true, None), goal(false, Some("vgg"))), (State::Formed, State::Trained));
        run.write_json("training.json", &json!({"resumed_from": 0, "intrinsic": {}})).unwrap();
        let mut with = json!({"test": &test});
        with["test"]["lpips"] = json!({"net": "vgg", "version": "0.1", "range": [0, 1]});
        run.write_json("metrics.json", &with).unwrap();
        assert!(matches!(goal(true, Some("vgg")), State::Measured(_)));
        assert_eq!(goal(true, Some("alex")), State::Trained);
        run.write_json("metrics.json", &json!({"test": &test, "steps_per_second": 4.0, "gaussians": 12})).unwrap();
        run.write_json("training.json", &json!({"resumed_from": 9})).unwrap();
        let timed = |state| matches!(state, State::Measured(m) if m.get("seconds_per_step").is_some());
        assert!(!timed(state(&asked)), "the time of a part was taken for the whole");
        // Other materials may lie on the same geometry.
        run.write_json("training.json", &json!({"resumed_from": 0, "intrinsic": {}})).unwrap();
        asked.intrinsic.losses.l1 = 0.7;
        assert_eq!(State::of(&root, &asked, &Goal { materials: true, lpips: None }), State::Formed);
        assert!(matches!(state(&asked), State::Measured(_)));
        // Any other setting is another run.
        asked.geometry.losses.l1 = 0.7;
        assert_eq!(state(&asked), State::Absent);
    }
}
