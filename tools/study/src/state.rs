//! Progress and results of a run in a table.

use serde::ser::{Serialize, SerializeMap, Serializer};
use serde_json::Value;
use sgs_config::{Backward, Settings, TransportSettings};
use sgs_evaluate::metrics::LpipsAbout;
use sgs_run::{RunDirectory, StageKind, read_emitters};
use std::path::Path;

/// Progress of a run with given settings.
#[derive(Clone, Debug, PartialEq)]
pub enum State {
    /// The run does not exist, or has other settings.
    Absent,
    /// The run is incomplete and can be resumed.
    Begun,
    /// The geometry is trained. The requested materials are missing or have other settings.
    Formed,
    /// The run is trained, but not evaluated.
    Trained,
    /// The run is trained and evaluated.
    Measured(Box<Measures>),
}

/// Requested results of a run.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Goal {
    /// Stage that trains materials and lights after the geometry stage, if any.
    pub materials: Option<StageKind>,
    /// LPIPS that is measured, if any.
    pub lpips: Option<LpipsAbout>,
    /// Whether views are measured after alignment, too.
    pub align: bool,
}

impl State {
    /// Reads the state of a run directory.
    pub fn of(root: &Path, requested: &Settings, goal: &Goal) -> State {
        let Ok(run) = RunDirectory::open(root) else { return State::Absent };
        let Ok(began) = run.settings() else { return State::Absent };
        let mut requested = requested.clone();
        // Settings that training chose by measurement do not count. The memory budget may have changed.
        if requested.geometry.backward == Backward::Auto {
            requested.geometry.backward = began.geometry.backward;
        }
        requested.memory = began.memory;
        // Geometry does not depend on the settings of the materials.
        let same_materials = requested.intrinsic == began.intrinsic
            && match goal.materials {
                Some(StageKind::Transport) => same_transport(&run, &requested.transport, &began.transport),
                _ => true,
            };
        requested.intrinsic.clone_from(&began.intrinsic);
        requested.transport = began.transport;
        if requested != began {
            return State::Absent;
        }
        if !(run.path("scene.ply").is_file() && run.path("training.json").is_file()) {
            return State::Begun;
        }
        if let Some(stage) = goal.materials
            && !(same_materials && json(&run, "training.json").get(stage.name()).is_some())
        {
            return State::Formed;
        }
        let wanted = goal.lpips.and_then(|about| serde_json::to_value(about).ok());
        let measured = |all: &Value| wanted.as_ref().is_none_or(|about| all.pointer("/test/lpips") == Some(about));
        match Measures::read(&run) {
            Some(measures)
                if measured(&json(&run, "metrics.json")) && (!goal.align || measures.get("psnr_aligned").is_some()) =>
            {
                State::Measured(Box::new(measures))
            }
            _ => State::Trained,
        }
    }
}

/// Returns whether a run has these settings of the transport stage. Its emitters say which part it leaves out.
fn same_transport(run: &RunDirectory, requested: &TransportSettings, began: &TransportSettings) -> bool {
    let without = read_emitters(&run.emitters()).ok().and_then(|file| file.without);
    TransportSettings { without, ..*began } == *requested
}

/// Measure of a table.
pub(super) struct Measure {
    /// Name in JSON.
    pub key: &'static str,
    /// Heading in the table. An arrow tells whether more or less is better.
    pub heading: &'static str,
    /// Number of decimals.
    pub digits: usize,
    /// JSON pointer into `metrics.json` or `training.json`.
    place: &'static str,
}

/// All measures, in the order of the table.
pub(super) const MEASURES: [Measure; 21] = [
    measure("psnr", "PSNR, dB ↑", 2, "/test/mean/nvs/psnr"),
    measure("psnr_aligned", "PSNR, aligned, dB ↑", 2, "/test/mean/nvs/psnr_aligned"),
    measure("ssim", "SSIM ↑", 4, "/test/mean/nvs/ssim"),
    measure("ssim_aligned", "SSIM, aligned ↑", 4, "/test/mean/nvs/ssim_aligned"),
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
    measure("transport_seconds_per_step", "seconds a step with bounces ↓", 4, "/transport/steps_per_second"),
    measure("gaussians", "Gaussians", 0, "/gaussians"),
];

const fn measure(key: &'static str, heading: &'static str, digits: usize, place: &'static str) -> Measure {
    Measure { key, heading, digits, place }
}

/// Values of all measures. A value that is unknown is absent.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Measures(pub(super) [Option<f64>; MEASURES.len()]);

impl Measures {
    /// Reads the measures of an evaluated run. Returns none if the evaluation is missing or has no PSNR.
    pub fn read(run: &RunDirectory) -> Option<Measures> {
        let (all, training) = (json(run, "metrics.json"), json(run, "training.json"));
        // The files hold steps per second. Those of a resumed run cover its last session only, so they are not used.
        let per_step = |of: &Value, place: &str, part: &Value| {
            let rate = of.pointer(place).and_then(Value::as_f64);
            rate.filter(|rate| part["resumed_from"] == 0 && *rate > 0.0).map(|rate| 1.0 / rate)
        };
        let number = |m: &Measure| match m.key {
            "seconds_per_step" => per_step(&all, m.place, &training),
            "intrinsic_seconds_per_step" => per_step(&training, m.place, &training["intrinsic"]),
            "transport_seconds_per_step" => per_step(&training, m.place, &training["transport"]),
            _ => all.pointer(m.place).and_then(Value::as_f64),
        };
        let found = Measures(std::array::from_fn(|i| number(&MEASURES[i])));
        found.get("psnr").map(|_| found)
    }

    /// Returns a measure by its name in JSON. None if the value is unknown.
    ///
    /// Names: `psnr` (dB), `ssim`, `lpips`; `pbr_` and `albedo_` with one of these; `psnr_aligned` and `ssim_aligned`
    /// (after alignment of each view); `roughness_mse`, `metallic_mse`, `relit_psnr` (mean over the relit sets),
    /// `normal_mae_deg`, `depth_rel`, `accuracy`, `seconds_per_step` (of geometry), `intrinsic_seconds_per_step`,
    /// `transport_seconds_per_step`, `gaussians`. Seconds are known for runs that were not interrupted.
    pub fn get(&self, key: &str) -> Option<f64> {
        MEASURES.iter().zip(self.0).find(|(m, _)| m.key == key).and_then(|(_, value)| value)
    }
}

/// Reads a JSON file of a run. Returns null if the file is missing or damaged.
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
    fn state_follows_from_settings_and_files() {
        let folder = tempfile::tempdir().unwrap();
        let root = folder.path().join("run");
        let mut requested = Settings { seed: 2, ..Settings::default() };
        let state = |requested: &Settings| State::of(&root, requested, &Goal::default());
        assert_eq!(state(&requested), State::Absent);
        let run = RunDirectory::create(&root).unwrap();
        assert_eq!(state(&requested), State::Absent);
        let mut began = requested.clone();
        (began.geometry.backward, began.memory.budget) = (Backward::Splat, 1 << 30);
        run.write_settings(&began).unwrap();
        assert_eq!(state(&requested), State::Begun);
        std::fs::write(run.path("scene.ply"), "").unwrap();
        assert_eq!(state(&requested), State::Begun);
        run.write_json("training.json", &json!({"resumed_from": 0})).unwrap();
        assert_eq!(state(&requested), State::Trained);
        // Metrics of another split, and a file that is not JSON.
        run.write_json("metrics.json", &json!({"train": {"mean": {"nvs": {"psnr": 30.0}}}})).unwrap();
        assert_eq!(state(&requested), State::Trained);
        std::fs::write(run.path("metrics.json"), "{").unwrap();
        assert_eq!(state(&requested), State::Trained);
        let test = json!({"mean": {"nvs": {"psnr": 30.0, "ssim": 0.9}, "semantic": {"accuracy": 0.5}}});
        run.write_json("metrics.json", &json!({"test": &test, "steps_per_second": 4.0, "gaussians": 12})).unwrap();
        let State::Measured(measures) = state(&requested) else { panic!("measures are there") };
        let all = json!({"psnr": 30.0, "ssim": 0.9, "accuracy": 0.5, "seconds_per_step": 0.25, "gaussians": 12.0});
        assert_eq!(serde_json::to_value(*measures).unwrap(), all);
        assert_eq!((measures.get("accuracy"), measures.get("depth_rel")), (Some(0.5), None));
        run.write_json("training.json", &json!({"resumed_from": 9})).unwrap();
        // Materials and LPIPS are requested, too.
        let goal = |materials: bool, net: Option<&'static str>| {
            let lpips = net.map(|net| LpipsAbout { net, version: "0.1", range: [0, 1] });
            let materials = materials.then_some(StageKind::Intrinsic);
            State::of(&root, &requested, &Goal { materials, lpips, align: false })
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
        assert!(!timed(state(&requested)), "the time of a part was taken for the whole");
        // Other materials may be trained on the same geometry.
        run.write_json("training.json", &json!({"resumed_from": 0, "intrinsic": {}})).unwrap();
        requested.intrinsic.losses.dssim = 0.7;
        assert_eq!(
            State::of(&root, &requested, &Goal { materials: Some(StageKind::Intrinsic), ..Goal::default() }),
            State::Formed
        );
        assert!(matches!(state(&requested), State::Measured(_)));
        // Any other setting makes another run.
        requested.geometry.losses.dssim = 0.7;
        assert_eq!(state(&requested), State::Absent);
    }

    #[test]
    fn aligned_measures_are_read_and_required_if_wanted() {
        let folder = tempfile::tempdir().unwrap();
        let (run, requested) = (RunDirectory::create(folder.path()).unwrap(), Settings::default());
        run.write_settings(&requested).unwrap();
        std::fs::write(run.path("scene.ply"), "").unwrap();
        run.write_json("training.json", &json!({"resumed_from": 0})).unwrap();
        let state = |align: bool| State::of(folder.path(), &requested, &Goal { align, ..Goal::default() });
        let write = |nvs: Value| run.write_json("metrics.json", &json!({"test": {"mean": {"nvs": nvs}}})).unwrap();
        write(json!({"psnr": 27.0, "ssim": 0.8}));
        assert!(state(true) == State::Trained && matches!(state(false), State::Measured(_)));
        let nvs = json!({"psnr": 27.0, "psnr_aligned": 32.0, "ssim": 0.8, "ssim_aligned": 0.9});
        write(nvs.clone());
        for align in [true, false] {
            let State::Measured(measures) = state(align) else { panic!("measures are there") };
            assert_eq!(serde_json::to_value(*measures).unwrap(), nvs);
        }
    }
}
