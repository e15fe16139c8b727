//! What the intrinsic stage makes smaller or slower while it trains: when, by how much, and that being stopped changes nothing.

use sgs_config::Settings;
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

/// What is looked at after each step, and what there is in the end.
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

    /// Twenty steps, stopped after some, and bytes of the device's memory after each.
    fn train<T>(&self, s: &Settings, stops: &[u32], look: impl Fn(&Intrinsic) -> T) -> (Course<T>, Vec<u64>) {
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
            seen.push(look(&training));
            used.push(self.gpu.device().memory_use().0);
        }
        let decided = training.decisions().iter().map(ToString::to_string).collect();
        (Course { seen, decided, materials: training.splats().unwrap() }, used)
    }
}

/// A hundred decibels are more than anything costs: what is not insisted upon goes as far as it can.
fn eager() -> Settings {
    let mut s = settings(20);
    let a = &mut s.intrinsic.automatic;
    (a.enabled, a.gain, a.ready, a.settled) = (true, 100.0, 100.0, 100.0);
    (a.sizes, a.lights, a.lobes, a.environment, a.visibility) = (false, false, false, false, false);
    (a.levels, a.texels, a.pace) = (false, false, false);
    s
}

fn said<T>(course: &Course<T>, what: &str) -> String {
    course.decided.iter().find(|d| d.starts_with(what)).expect("nothing was decided").clone()
}

/// Levels of the visibility field that are worth nothing go, with their moments; the others go on.
#[test]
fn the_finest_levels_of_the_field_go() {
    let bench = Bench::new();
    let mut s = eager();
    s.intrinsic.automatic.levels = true;
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
    let said = said(&straight, "levels");
    assert!(
        said.contains("1 of 5 stay: without the others pictures lose") && said.contains("gradients have reached"),
        "{said}"
    );
    assert!(used[19] < used[8], "{} bytes before, {} after", used[8], used[19]);
    // What stays is trained further.
    assert!(fields[9].tables != fields[19].tables && fields[9].mlp != fields[19].mlp);
    assert!(bench.train(&s, &[9, 10, 14], field).0 == straight, "being stopped has changed something");

    // Of the run's file the first level is the one that the whole had.
    let path = bench.place.path("field");
    fields[19].save(&path).unwrap();
    assert!(VisibilityFile::load(&path).unwrap() == fields[19]);
    // Insisted upon, all stay.
    s.intrinsic.automatic.levels = false;
    let kept = bench.train(&s, &[12], field).0.seen;
    assert!(kept[..9] == fields[..9] && kept[19].config == whole);
}

/// Texels that are worth nothing go, with their moments; what stays goes on, also where it moves seldom, and in runs that are gone back to.
#[test]
fn texels_go_that_pictures_do_not_need() {
    let bench = Bench::new();
    let mut s = eager();
    s.intrinsic.environment.resolution = 32;
    s.intrinsic.automatic.texels = true;
    let texels = |t: &Intrinsic| t.light().unwrap().environment.unwrap();
    for (pace, every) in [(true, 1), (false, 3)] {
        s.intrinsic.automatic.pace = pace;
        s.intrinsic.environment.every = every;
        let (straight, used) = bench.train(&s, &[], texels);
        let seen = &straight.seen;
        let sizes: Vec<u32> = seen.iter().map(|t| t.size).collect();
        assert_eq!(sizes, [[32; 9].as_slice(), &[16; 11]].concat());
        let said = said(&straight, "texels");
        assert!(said.contains("16 along an edge instead of 32 stay: pictures lose"), "{said}");
        assert!(used[19] < used[8], "{} bytes before, {} after", used[8], used[19]);
        // As much light as before, but for a move like the one before; and it goes on moving.
        let mean = |i: usize| seen[i].data.iter().sum::<f32>() / seen[i].data.len() as f32;
        assert!((mean(9) - mean(8)).abs() < 2.0 * (mean(8) - mean(7)).abs(), "{} {} {}", mean(7), mean(8), mean(9));
        assert!(seen[9] != seen[19]);
        let stopped = bench.train(&s, &[3, 9, 10, 13], texels).0;
        assert!(stopped == straight, "being stopped has changed something");
    }
    // A state with all of them can be gone back to; what the settings do not have is refused.
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
    assert!(error.ends_with("damaged: surroundings cannot have \"32\" texels along an edge."), "{error}");
}

/// How seldom surroundings may move is found half-way, kept in checkpoints, and can be insisted upon.
#[test]
fn surroundings_move_as_seldom_as_pictures_allow() {
    let bench = Bench::new();
    let mut s = eager();
    s.intrinsic.automatic.pace = true;
    let texels = |t: &Intrinsic| t.light().unwrap().environment.unwrap().data;
    let start = texels(&bench.training(&s));
    let moved = |seen: &[Vec<f32>]| -> Vec<u32> {
        let before = std::iter::once(&start).chain(seen);
        before.zip(seen).zip(1..).filter(|((a, b), _)| a != b).map(|(_, step)| step).collect()
    };
    let straight = bench.train(&s, &[], texels).0;
    assert_eq!(moved(&straight.seen), (1..=10).chain([16]).collect::<Vec<_>>());
    let said = said(&straight, "pace");
    assert!(said.contains("surroundings move once in 8 steps: as old as that they cost"), "{said}");
    let stopped = bench.train(&s, &[3, 9, 10, 12, 17], texels).0;
    assert!(stopped == straight, "being stopped has changed something");
    // As long as pictures still gain, nothing becomes slower.
    s.intrinsic.automatic.settled = 0.0;
    assert_eq!(moved(&bench.train(&s, &[], texels).0.seen).len(), 20);
    s.intrinsic.automatic.settled = 100.0;
    // Less is asked, and surroundings move more often; nothing is, or they are insisted upon, and they move with every step.
    s.intrinsic.automatic.gain = 0.0;
    let strict = moved(&bench.train(&s, &[], texels).0.seen);
    assert!(strict.len() > 11, "{strict:?}");
    (s.intrinsic.automatic.gain, s.intrinsic.automatic.pace) = (100.0, false);
    assert_eq!(moved(&bench.train(&s, &[], texels).0.seen).len(), 20);

    // A file that says something else is refused.
    s.intrinsic.automatic.pace = true;
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

/// Surroundings, shadows and lobes can go each by itself, with the same bits after being stopped; and what stays is said, too.
#[test]
fn parts_go_by_themselves_and_what_stays_is_said() {
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
            "environment" => a.environment = true,
            "visibility" => a.visibility = true,
            _ => a.lobes = true,
        }
        let (straight, used) = bench.train(&s, &[], there);
        for (i, seen) in straight.seen.iter().enumerate() {
            assert_eq!(*seen, if i + 1 < from { before } else { after }, "{part} after step {}", i + 1);
        }
        assert!(used[19] < used[8], "{part}: {} bytes before, {} after", used[8], used[19]);
        said(&straight, part);
        let stopped = bench.train(&s, &[from as u32 - 1, from as u32, 17], there).0;
        assert!(stopped == straight, "{part}: being stopped has changed something");
        // Where nothing may be lost, what is worth something stays, and that is said with its measure.
        s.intrinsic.automatic.gain = 0.0;
        let strict = bench.train(&s, &[12], there).0;
        let told: Vec<_> = strict.decided.iter().filter(|d| d.starts_with(part)).collect();
        assert!(!told.is_empty() && told.iter().all(|d| d.contains(" dB (asked: 0)")), "{:?}", strict.decided);
        // Lobes that are merged are kept, too, and are fewer.
        let whole = |d: &&String| d.starts_with(&format!("{part} kept")) && !d.contains("merging the others costs");
        assert_eq!(told.iter().all(whole), strict.seen[19] == before, "{told:?}");
    }
}

/// Of two parts of which either would do one stays: what is judged later is judged without what has just gone.
#[test]
fn parts_are_judged_without_what_has_gone() {
    let bench = Bench::new();
    let shadows = |surroundings: bool| {
        let mut s = eager();
        (s.intrinsic.automatic.environment, s.intrinsic.automatic.visibility) = (surroundings, true);
        said(&bench.train(&s, &[], |_| ()).0, "visibility left out after step 10")
    };
    assert_ne!(shadows(true), shadows(false));
    // Lamps that all go leave the surroundings, whatever these are worth.
    let mut s = eager();
    (s.intrinsic.automatic.lights, s.intrinsic.automatic.environment) = (true, true);
    let course = bench.train(&s, &[], |t| (t.light().unwrap().lights.is_some(), t.environment_size())).0;
    assert!(course.seen[..4].iter().all(|l| l.0) && course.seen[4..].iter().all(|l| *l == (false, Some(16))));
    // Those that are off already are not there when surroundings are judged.
    s.intrinsic.automatic.gain = 2.0;
    let with = |lights: bool| {
        let mut s = s.clone();
        s.intrinsic.automatic.lights = lights;
        bench.train(&s, &[], |_| ()).0.decided.into_iter().find(|d| d.starts_with("environment"))
    };
    assert_ne!(with(true), with(false));
}
