//! Two devices in one process, each training in its own thread. Neither affects the other.

use sgs_config::Settings;
use sgs_engine::device::Objects;
use sgs_engine::{Device, DeviceOptions};
use sgs_scene::{Scene, SceneOptions, Splats};
use sgs_tests::place::Place;
use sgs_tests::rooms::Room;
use sgs_tests::turn;
use sgs_train::{Geometry, Progress};
use std::sync::Barrier;

const STEPS: u32 = 40;

fn settings(seed: u64) -> Settings {
    let mut s = Settings { seed, ..Settings::default() };
    s.geometry.steps = STEPS;
    let d = &mut s.geometry.densify;
    (d.from, d.interval, d.reset_interval, d.grad_threshold, d.max_gaussians) = (5, 5, 12, 5e-5, 3000);
    s.geometry.entry_capacity = 300;
    s
}

/// Reports and result of a training.
#[derive(PartialEq)]
struct Outcome {
    reports: Vec<(u32, u32, u32, u32)>,
    splats: Splats,
}

/// Opens a device; returns it with the counts of its objects.
fn open() -> (Device, Objects) {
    let objects = Objects::default();
    let select = std::env::var("SGS_TEST_DEVICE").ok();
    let options = DeviceOptions { select, validation: true, objects: objects.clone(), ..Default::default() };
    (Device::open(&options).unwrap(), objects)
}

/// Closes a device. Fails if validation reported a message or an object is left.
fn close((device, objects): (Device, Objects)) {
    let messages = device.messages().clone();
    drop(device);
    assert_eq!(objects.alive(), []);
    assert_eq!(messages.take(), Vec::<String>::new());
}

fn train(device: &Device, scene: &Scene, s: &Settings) -> Outcome {
    let mut reports = Vec::new();
    let mut training = Geometry::new(device, scene, s, None).unwrap();
    let on_progress = |p: &Progress| {
        if let Progress::Step(r) = p {
            reports.push((r.step, r.gaussians, r.entries, r.losses.total.to_bits()));
        }
    };
    training.train(STEPS, on_progress, || true).unwrap();
    let splats = training.splats().unwrap();
    Outcome { reports, splats }
}

#[test]
fn concurrent_trainings_match_sequential_trainings() {
    let _turn = turn();
    let place = Place::new(Room::default());
    let scene = Scene::open(&place.path("scene"), &SceneOptions::default()).unwrap();
    let all = [settings(1), settings(2)];
    let alone = all.each_ref().map(|s| {
        let opened = open();
        let outcome = train(&opened.0, &scene, s);
        close(opened);
        outcome
    });
    assert!(alone[0] != alone[1], "two seeds were to differ");
    // Both devices are open before either trains, and close when both are done (`sgs_tests::turn`).
    let opened = [open(), open()];
    let barrier = Barrier::new(2);
    let beside = std::thread::scope(|scope| {
        let threads = [0, 1].map(|i| {
            let (device, s) = (&opened[i].0, &all[i]);
            let (scene, barrier) = (&scene, &barrier);
            scope.spawn(move || {
                barrier.wait();
                train(device, scene, s)
            })
        });
        threads.map(|t| t.join().unwrap())
    });
    opened.into_iter().for_each(close);
    for (i, (a, b)) in alone.iter().zip(&beside).enumerate() {
        assert_eq!(a.reports, b.reports, "training {i}");
        assert!(a.splats == b.splats, "training {i}: the splats differ");
    }
}

/// Returns the items outside tests that live as long as the process.
fn globals(source: &str) -> Vec<String> {
    let tested = source.find("#[cfg(test)]").unwrap_or(source.len());
    let words = ["static ", "static mut ", "thread_local!", "lazy_static!"];
    let items = source[..tested].lines().map(|l| l.trim().trim_start_matches("pub ").trim_start_matches("pub(crate) "));
    items.filter(|l| words.iter().any(|w| l.starts_with(w))).map(str::to_owned).collect()
}

#[test]
fn crates_have_no_global_state() {
    assert_eq!(globals("pub static X: u32 = 1;\nthread_local! { }\nfn f(x: &'static str) {}").len(), 2);
    let root = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("..").canonicalize().unwrap();
    let mut open: Vec<_> = ["engine/src", "passes/src", "tools", "shaders-glsl/src"].map(|f| root.join(f)).to_vec();
    let mut found = Vec::new();
    while let Some(folder) = open.pop() {
        for entry in std::fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                open.push(path);
            } else if path.extension().is_some_and(|e| e == "rs")
                && !path.components().any(|c| c.as_os_str() == "tests")
            {
                let name = path.file_name().unwrap().to_string_lossy().into_owned();
                found.extend(
                    globals(&std::fs::read_to_string(&path).unwrap()).into_iter().map(|g| format!("{name}: {g}")),
                );
            }
        }
    }
    assert_eq!(found, [""; 0]);
}
