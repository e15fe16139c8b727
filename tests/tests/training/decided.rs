//! Automatic reductions of the intrinsic stage during training.
//!
//! Tests when each reduction happens, what it removes, and that interruptions change nothing.

use sgs_config::{Parts, Settings};
use sgs_passes::shade::visibility::FieldConfig;
use sgs_run::{Visibility, VisibilityFile};
use sgs_scene::{Scene, SceneOptions, Splats};
use sgs_tests::intrinsic::{place, settings};
use sgs_tests::{Gpu, Place};
use sgs_train::Intrinsic;

struct Bench {
    place: Place,
    gpu: Gpu,
    scene: Scene,
    splats: Splats,
}

/// Observations after each step, and the final state.
#[derive(PartialEq)]
struct Course<T> {
    seen: Vec<T>,
    decided: Vec<String>,
    materials: Splats,
}

impl Bench {
    fn new() -> Bench {
        let (place, _) = place();
        let scene = Scene::open(&place.path("scene"), &SceneOptions::default()).unwrap();
        let splats = Splats::from_points(&scene.points, 1).unwrap();
        Bench { place, gpu: Gpu::new(), scene, splats }
    }

    fn training(&self, s: &Settings) -> Intrinsic {
        Intrinsic::new(self.gpu.device(), &self.scene, s, &self.splats).unwrap()
    }

    /// Trains 20 steps, with an interruption after each step in `stops`.
    ///
    /// Returns the observations, and the device memory in bytes after each step.
    fn train<T>(&self, s: &Settings, stops: &[u32], observe: impl Fn(&Intrinsic) -> T) -> (Course<T>, Vec<u64>) {
        let file = self.place.path("state");
        let mut training = self.training(s);
        let (mut seen, mut used) = (Vec::new(), Vec::new());
        for last in 1..=20 {
            training.train(last, |_| {}, || true).unwrap();
            if stops.contains(&last) {
                training.save(&file).unwrap();
                training = self.training(s);
                training.restore(&file).unwrap();
            }
            seen.push(observe(&training));
            used.push(self.gpu.device().memory_use().0);
        }
        let decided = training.decisions().iter().map(ToString::to_string).collect();
        (Course { seen, decided, materials: training.splats().unwrap() }, used)
    }
}

/// Returns settings that accept any loss of quality.
///
/// The allowed loss of 100 dB exceeds any contribution, so every enabled reduction goes as far as it can.
fn eager() -> Settings {
    let mut s = settings(20);
    let a = &mut s.intrinsic.automatic;
    (a.enabled, a.gain, a.limits) = (true, 100.0, [100.0; 2]);
    a.parts = Parts { metallic: true, ..Parts::NONE };
    s
}

fn decision<T>(course: &Course<T>, what: &str) -> String {
    course.decided.iter().find(|d| d.starts_with(what)).expect("nothing was decided").clone()
}

/// Field levels without contribution are removed with their moments.
///
/// The other levels are trained further.
#[test]
fn finest_field_levels_are_removed() {
    if !sgs_tests::takes_long() {
        return;
    }
    let bench = Bench::new();
    let mut s = eager();
    s.intrinsic.automatic.parts.levels = true;
    s.intrinsic.visibility.levels = 5;
    let field = |t: &Intrinsic| match t.light().unwrap().visibility {
        Visibility::Learned(field) => *field,
        other => panic!("no field: {other:?}"),
    };
    let (straight, used) = bench.train(&s, &[], field);
    let fields = &straight.seen;
    let whole = FieldConfig::new(5, 10, 4, 32);
    let levels: Vec<FieldConfig> = fields.iter().map(|f| f.config).collect();
    assert!(levels[..9].iter().all(|c| *c == whole) && levels[9..].iter().all(|c| *c == whole.first_levels(1)));
    let decision = decision(&straight, "levels");
    assert!(
        decision.contains("1 of 5 stay: without the others images lose") && decision.contains("gradients have reached"),
        "{decision}"
    );
    assert!(used[19] < used[8], "{} bytes before, {} after", used[8], used[19]);
    // Retained levels are trained further.
    assert!(fields[9].tables != fields[19].tables && fields[9].mlp != fields[19].mlp);
    assert!(bench.train(&s, &[9, 10, 14], field).0 == straight, "being stopped has changed something");

    // The reduced field survives a round trip through its file.
    let path = bench.place.path("field");
    fields[19].save(&path).unwrap();
    assert!(VisibilityFile::load(&path).unwrap() == fields[19]);
    // With the reduction disabled, all levels are retained.
    s.intrinsic.automatic.parts.levels = false;
    let disabled = bench.train(&s, &[12], field).0.seen;
    assert!(disabled[..9] == fields[..9] && disabled[19].config == whole);
}

/// Texels without contribution are removed with their moments.
///
/// The map is trained further, also at longer update intervals and in runs that are rolled back.
#[test]
fn unneeded_environment_texels_are_removed() {
    if !sgs_tests::takes_long() {
        return;
    }
    let bench = Bench::new();
    let mut s = eager();
    s.intrinsic.environment.resolution = 32;
    s.intrinsic.automatic.parts.texels = true;
    let texels = |t: &Intrinsic| t.light().unwrap().environment.unwrap();
    for (automatic_interval, every) in [(true, 1), (false, 3)] {
        s.intrinsic.automatic.parts.update_interval = automatic_interval;
        s.intrinsic.environment.every = every;
        let (straight, used) = bench.train(&s, &[], texels);
        let seen = &straight.seen;
        let sizes: Vec<u32> = seen.iter().map(|t| t.size).collect();
        assert_eq!(sizes, [[32; 9].as_slice(), &[16; 11]].concat());
        let decision = decision(&straight, "texels");
        assert!(
            decision.contains("16 along an edge instead of 32 stay: with averaged texels images lose"),
            "{decision}"
        );
        assert!(used[19] < used[8], "{} bytes before, {} after", used[8], used[19]);
        // Removal changes the mean brightness by less than twice the change of a step. Training continues.
        let mean = |i: usize| seen[i].data.iter().sum::<f32>() / seen[i].data.len() as f32;
        assert!((mean(9) - mean(8)).abs() < 2.0 * (mean(8) - mean(7)).abs(), "{} {} {}", mean(7), mean(8), mean(9));
        assert!(seen[9] != seen[19]);
        let stopped = bench.train(&s, &[3, 9, 10, 13], texels).0;
        assert!(stopped == straight, "being stopped has changed something");
    }
    // A state with all texels can be restored. A size that the settings do not allow is refused.
    let file = bench.place.path("state");
    let mut training = bench.training(&s);
    training.train(5, |_| {}, || true).unwrap();
    training.save(&file).unwrap();
    let before = texels(&training);
    training.train(20, |_| {}, || true).unwrap();
    training.restore(&file).unwrap();
    assert!(texels(&training) == before);
    s.intrinsic.environment.resolution = 16;
    let error = bench.training(&s).restore(&file).err().unwrap().to_string();
    assert!(error.ends_with("damaged: an environment map cannot have \"32\" texels along an edge."), "{error}");
}

/// The update interval of the environment map is chosen halfway through training.
///
/// Checkpoints store the interval. A setting fixes it.
#[test]
fn environment_update_interval_grows_within_allowed_loss() {
    if !sgs_tests::takes_long() {
        return;
    }
    let bench = Bench::new();
    let mut s = eager();
    s.intrinsic.automatic.parts.update_interval = true;
    let texels = |t: &Intrinsic| t.light().unwrap().environment.unwrap().data;
    let start = texels(&bench.training(&s));
    let moved = |seen: &[Vec<f32>]| -> Vec<u32> {
        let before = std::iter::once(&start).chain(seen);
        before.zip(seen).zip(1..).filter(|((a, b), _)| a != b).map(|(_, step)| step).collect()
    };
    let straight = bench.train(&s, &[], texels).0;
    assert_eq!(moved(&straight.seen), (1..=10).chain([16]).collect::<Vec<_>>());
    let decision = decision(&straight, "update_interval");
    assert!(decision.contains("the environment map is updated every 8 steps: at that age it costs"), "{decision}");
    let stopped = bench.train(&s, &[3, 9, 10, 12, 17], texels).0;
    assert!(stopped == straight, "being stopped has changed something");
    // While images still improve, no update interval grows.
    s.intrinsic.automatic.limits[1] = 0.0;
    assert_eq!(moved(&bench.train(&s, &[], texels).0.seen).len(), 20);
    s.intrinsic.automatic.limits[1] = 100.0;
    // A smaller allowed loss gives shorter intervals. With a fixed interval, every step updates.
    s.intrinsic.automatic.gain = 0.0;
    let strict = moved(&bench.train(&s, &[], texels).0.seen);
    assert!(strict.len() > 11, "{strict:?}");
    (s.intrinsic.automatic.gain, s.intrinsic.automatic.parts.update_interval) = (100.0, false);
    assert_eq!(moved(&bench.train(&s, &[], texels).0.seen).len(), 20);

    // A checkpoint with an inconsistent interval is refused.
    s.intrinsic.automatic.parts.update_interval = true;
    bench.train(&s, &[17], texels);
    let right = std::fs::read(bench.place.path("state")).unwrap();
    let at = right.windows(7).position(|w| w == b"8 10 10").expect("the file does not say it");
    let mut training = bench.training(&s);
    for wrong in ["0 9 9", "8 99 9", "8 10 11", "8 10 x", "8"] {
        let text = format!("{wrong:7}");
        let broken = [&right[..at], text.as_bytes(), &right[at + 7..]].concat();
        let path = bench.place.path("wrong");
        std::fs::write(&path, broken).unwrap();
        assert!(training.restore(&path).is_err(), "{wrong} was believed");
    }
}

/// Environment map, shadows and lobes can each be removed alone.
///
/// Results after interruptions are bit-identical. Retained components are reported.
#[test]
fn components_are_removed_alone_and_retained_ones_reported() {
    let bench = Bench::new();
    let there = |t: &Intrinsic| {
        let light = t.light().unwrap();
        let lights = light.lights.unwrap();
        let shadows = matches!(light.visibility, Visibility::Learned(_));
        (light.environment.is_some(), shadows, lights.lights.iter().map(|l| l.lobes.len()).max().unwrap())
    };
    for (part, from, before, after) in [
        ("environment", 10, (true, true, 12), (false, true, 12)),
        ("visibility", 10, (true, true, 12), (true, false, 12)),
        ("lobes", 15, (true, true, 12), (true, true, 1)),
    ] {
        let mut s = eager();
        let a = &mut s.intrinsic.automatic;
        match part {
            "environment" => a.parts.environment = true,
            "visibility" => a.parts.visibility = true,
            _ => a.parts.lobes = true,
        }
        let (straight, used) = bench.train(&s, &[], there);
        for (i, seen) in straight.seen.iter().enumerate() {
            assert_eq!(*seen, if i + 1 < from { before } else { after }, "{part} after step {}", i + 1);
        }
        assert!(used[19] < used[8], "{part}: {} bytes before, {} after", used[8], used[19]);
        decision(&straight, part);
        let stopped = bench.train(&s, &[from as u32 - 1, from as u32, 17], there).0;
        assert!(stopped == straight, "{part}: being stopped has changed something");
        // With no loss allowed, components with a contribution are retained and reported with it.
        s.intrinsic.automatic.gain = 0.0;
        let strict = bench.train(&s, &[12], there).0;
        let retained: Vec<_> = strict.decided.iter().filter(|d| d.starts_with(part)).collect();
        assert!(!retained.is_empty() && retained.iter().all(|d| d.contains(" dB (limit: 0)")), "{:?}", strict.decided);
        // Merged lobes also count as retained, but are fewer than before.
        let whole = |d: &&String| d.starts_with(&format!("{part} kept")) && !d.contains("merging the others costs");
        assert_eq!(retained.iter().all(whole), strict.seen[19] == before, "{retained:?}");
    }
}

/// One of two redundant components is retained.
///
/// Later components are measured without those already removed.
#[test]
fn components_are_measured_without_removed_ones() {
    let bench = Bench::new();
    let shadows = |environment: bool| {
        let mut s = eager();
        (s.intrinsic.automatic.parts.environment, s.intrinsic.automatic.parts.visibility) = (environment, true);
        decision(&bench.train(&s, &[], |_| ()).0, "visibility left out after step 10")
    };
    assert_ne!(shadows(true), shadows(false));
    // If all lights are removed, the environment map is retained, whatever its contribution.
    let mut s = eager();
    (s.intrinsic.automatic.parts.lights, s.intrinsic.automatic.parts.environment) = (true, true);
    let course = bench.train(&s, &[], |t| (t.light().unwrap().lights.is_some(), t.environment_size())).0;
    assert!(course.seen[..4].iter().all(|l| l.0) && course.seen[4..].iter().all(|l| *l == (false, Some(16))));
    // Removed lights are absent when the environment map is measured.
    s.intrinsic.automatic.gain = 2.0;
    let with = |lights: bool| {
        let mut s = s.clone();
        s.intrinsic.automatic.parts.lights = lights;
        bench.train(&s, &[], |_| ()).0.decided.into_iter().find(|d| d.starts_with("environment"))
    };
    assert_ne!(with(true), with(false));
}
