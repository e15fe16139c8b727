//! Injected faults during training: errors are typed, and files stay complete. Training continues from the last
//! checkpoint on the same device, with the same result.

use sgs_config::Settings;
use sgs_engine::device::{Fault, FaultKind, Faults, Objects};
use sgs_engine::{Device, DeviceOptions, Error};
use sgs_scene::{Scene, SceneOptions, Splats};
use sgs_tests::cli::sgs;
use sgs_tests::place::Place;
use sgs_tests::rooms::Room;
use sgs_tests::turn;
use sgs_train::{Geometry, TrainError};
use std::collections::BTreeMap;

const STEPS: u32 = 11;
const SAVED: u32 = 3;

fn settings() -> Settings {
    let mut s = Settings::default();
    s.geometry.steps = STEPS;
    // Entries overflow at once. Gaussians are added twice, and opacities are reset once.
    s.geometry.entry_capacity = 8;
    let d = &mut s.geometry.densify;
    (d.from, d.interval, d.until, d.reset_interval) = (5, 5, 0.8, 6);
    (d.grad_threshold, d.max_gaussians) = (5e-5, 3000);
    s
}

fn open(faults: &Faults, objects: &Objects) -> Device {
    let select = std::env::var("SGS_TEST_DEVICE").ok();
    let options = DeviceOptions {
        select,
        validation: true,
        faults: faults.clone(),
        objects: objects.clone(),
        ..Default::default()
    };
    Device::open(&options).unwrap()
}

/// Trains from the checkpoint to the end. The caller drops the training.
fn go_on(device: &Device, scene: &Scene, place: &Place) -> Result<(Splats, Geometry), TrainError> {
    let mut training = Geometry::new(device, scene, &settings(), None)?;
    training.restore(&place.path("state"))?;
    training.train(STEPS, |_| {}, || true)?;
    let splats = training.splats()?;
    training.save(&place.path("later"))?;
    Ok((splats, training))
}

#[test]
fn failed_training_continues_from_its_checkpoint() {
    let _turn = turn();
    let place = Place::new(Room::default());
    let scene = Scene::open(&place.path("scene"), &SceneOptions::default()).unwrap();
    let (faults, objects) = (Faults::default(), Objects::default());
    let device = open(&faults, &objects);
    let mut training = Geometry::new(&device, &scene, &settings(), None).unwrap();
    training.train(SAVED, |_| {}, || true).unwrap();
    training.save(&place.path("state")).unwrap();
    training.train(STEPS, |_| {}, || true).unwrap();
    let straight = training.splats().unwrap();
    drop(training);
    let state = place.read("state");

    faults.record();
    let (splats, training) = go_on(&device, &scene, &place).unwrap();
    // Calls during the drop of the training can fail too, but have no way to report.
    let calls = faults.take_record();
    assert!(splats == straight, "a checkpoint was to change nothing");
    drop(training);
    let later = place.read("later").len();
    // Each call for each object fails once, at its first or last occurrence in turn. The error code changes from case
    // to case.
    let mut places: BTreeMap<(&str, &str), Vec<usize>> = BTreeMap::new();
    for (n, call) in calls.iter().enumerate() {
        places.entry((call.call, &call.what)).or_default().push(n);
    }
    let budget = std::env::var("SGS_TEST_FAULTS").ok().and_then(|n| n.parse().ok()).unwrap_or(48);
    let stride = places.len().div_ceil(budget);
    println!("{} calls, {} of a kind and thing, every {stride}th of them fails", calls.len(), places.len());
    assert!(places.len() > 60);
    for (i, ((name, what), at)) in places.iter().enumerate().skip(stride / 2).step_by(stride) {
        let kinds: Vec<_> = FaultKind::of(name).iter().filter(|k| **k != FaultKind::DeviceLost).collect();
        let kind = *kinds[i % kinds.len()];
        let n = if i.is_multiple_of(2) { at[0] } else { at[at.len() - 1] };
        let context = format!("call {n}, {name} for \"{what}\", {kind:?}");
        faults.inject(Fault { call: Fault::ANY, skip: n as u64, result: kind });
        match go_on(&device, &scene, &place) {
            Ok((splats, training)) => {
                assert_eq!(*name, "vkSetDebugUtilsObjectNameEXT", "{context}: nobody noticed");
                assert!(splats == straight, "{context}");
                drop(training);
            }
            Err(TrainError::Engine(error)) => {
                let text = error.to_string();
                assert!(text.contains(what), "{context}: {text}");
                assert!(!matches!(error, Error::Graph(_) | Error::Unbound { .. }), "{context}: {text}");
            }
            Err(error) => panic!("{context}: {error}"),
        }
        faults.clear();
        assert!(place.read("state") == state, "{context}: the checkpoint changed");
        let saved = place.read("later");
        assert!(!saved.is_empty(), "{context}");
        device.wait(device.last_ticket(), "the rest").unwrap();
        assert_eq!((device.collect(), device.memory_use().0), (0, 0), "{context}");
    }
    assert!(go_on(&device, &scene, &place).unwrap().0 == straight);
    assert_eq!(place.read("later").len(), later);

    // A lost device stays lost; training continues on a new one.
    faults.inject(Fault { call: "vkQueueSubmit2", skip: 60, result: FaultKind::DeviceLost });
    assert!(matches!(go_on(&device, &scene, &place), Err(TrainError::Engine(Error::DeviceLost(_)))));
    assert!(matches!(go_on(&device, &scene, &place), Err(TrainError::Engine(Error::DeviceLost(_)))));
    let messages = device.messages().clone();
    drop(device);
    assert_eq!(objects.alive(), []);
    assert_eq!(messages.take(), Vec::<String>::new());
    let device = open(&faults, &objects);
    assert!(go_on(&device, &scene, &place).unwrap().0 == straight);
    let messages = device.messages().clone();
    drop(device);
    assert_eq!(messages.take(), Vec::<String>::new());
}

/// Tests that refused capacity for Gaussians ends densification, not training.
#[test]
fn refused_gaussian_capacity_ends_densification() {
    let _turn = turn();
    let place = Place::new(Room { views: 8, size: [64, 48], spacing: 1, ..Room::default() });
    let scene = Scene::open(&place.path("scene"), &SceneOptions::default()).unwrap();
    let mut s = settings();
    s.geometry.entry_capacity = 1 << 18;
    (s.geometry.densify.grad_threshold, s.geometry.densify.interval) = (0.0, 1);
    (s.geometry.densify.max_gaussians, s.geometry.densify.prune_weight) = (100_000, 0.0);
    let faults = Faults::default();
    let device = open(&faults, &Objects::default());
    let train = || {
        let mut training = Geometry::new(&device, &scene, &s, None)?;
        let first = training.gaussians().capacity;
        training.train(8, |_| {}, || true)?;
        Ok::<_, TrainError>((first, training.gaussians().capacity, training.splats()?.len() as u32))
    };
    faults.record();
    let (first, grown, count) = train().unwrap();
    assert!(grown > first && count > first, "{first} {grown} {count}");
    let calls = faults.take_record();
    let all: Vec<usize> =
        (0..calls.len()).filter(|&n| calls[n].call == "vkAllocateMemory" && calls[n].what == "first_moments").collect();
    assert!(all.len() > 1, "{all:?}");
    // The call is counted among allocations alone, because a device need not create cached objects again.
    let like = calls[..all[1]].iter().filter(|c| c.call == "vkAllocateMemory").count();
    faults.inject(Fault { call: "vkAllocateMemory", skip: like as u64, result: FaultKind::OutOfDeviceMemory });
    let (again, bound, count) = train().unwrap();
    assert_eq!((again, bound), (first, first));
    assert_eq!(count, first, "it was to be full");
    assert_eq!(faults.take_fired().len(), 1);
    assert_eq!(device.messages().take(), Vec::<String>::new());
}

#[test]
fn cli_timeouts_report_one_error_and_keep_files() {
    let place = Place::new(Room::default());
    // The time limit is too short for any work.
    sgs(&place.arguments("run", 6, &["--timeout", "0.000000001"])).refused(&["did not finish within"]);
    assert!(!place.path("run/scene.ply").exists());
    // A run keeps its existing files.
    sgs(&place.arguments("run", 20, &[])).ok();
    let before = ["run/scene.ply", "run/log.jsonl", "run/config.toml"].map(|f| place.read(f));
    let text = place.text("run");
    std::fs::remove_file(place.path("run/training.json")).unwrap();
    sgs(&["train", &place.text("scene"), "-o", &text, "--resume", "--timeout", "1e-9"]).refused(&["did not finish"]);
    assert!(before == ["run/scene.ply", "run/log.jsonl", "run/config.toml"].map(|f| place.read(f)));
    place.resume("run").ok();
    assert_eq!(before[0], place.read("run/scene.ply"));
    let seconds = sgs(&place.arguments("run", 6, &["--timeout", "soon"]));
    assert_eq!(seconds.status, Some(2), "{seconds:?}");
}
