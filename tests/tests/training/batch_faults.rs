//! Faults of batches: full and read-only disks, lost devices, killed processes, clocks that jump, many tiny runs.
//!
//! Each time, every run ends once with the bits of a run alone.

use super::batch::Rooms;
use sgs_batch::{Batch, DeviceMemory, Exit, Launch, Launcher, Manifest, Phase, Process, Queue, Store, Timing};
use sgs_config::Settings;
use sgs_engine::device::{Fault, FaultKind, Faults};
use sgs_engine::{Device, DeviceOptions};
use sgs_run::StageKind;
use sgs_scene::Scene;
use sgs_tests::cli::{Finished, signal, start, start_with, until, wait};
use sgs_train::{Event, Observer, Outcome, Trainer, TrainerOptions};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;

/// File system in memory, mounted on a directory until it is dropped.
struct Disk(PathBuf);

impl Disk {
    /// Mounts a disk of a size. `None` where the user may not.
    fn new(path: &Path, size: &str) -> Option<Disk> {
        std::fs::create_dir(path).unwrap();
        let options = format!("size={size}");
        let mounted = Command::new("mount").args(["-t", "tmpfs", "-o", &options, "tmpfs"]).arg(path).output();
        let mounted = mounted.is_ok_and(|o| o.status.success());
        if !mounted {
            println!("skipped: this user cannot mount a disk");
        }
        mounted.then(|| Disk(path.to_owned()))
    }

    fn remount(&self, options: &str) {
        let options = format!("remount,{options}");
        let done = Command::new("mount").args(["-o", &options]).arg(&self.0).output().unwrap();
        assert!(done.status.success(), "{done:?}");
    }
}

impl Drop for Disk {
    fn drop(&mut self) {
        let _ = Command::new("umount").arg("-l").arg(&self.0).output();
    }
}

fn results(rooms: &Rooms) -> usize {
    std::fs::read_dir(rooms.path("out/results")).unwrap().count()
}

fn logged(rooms: &Rooms, run: &str) -> usize {
    let log = rooms.path(&format!("out/runs/{run}/log.jsonl"));
    std::fs::read_to_string(log).unwrap_or_default().lines().count()
}

/// Checks that all runs are done with the bits of runs alone.
fn all_done(rooms: &Rooms, scenes: &[&str]) {
    let summary = rooms.summary();
    assert_eq!((summary.len(), results(rooms), rooms.leases()), (2 * scenes.len(), 2 * scenes.len(), 0));
    for (name, line) in &summary {
        assert_eq!(line["state"], "done", "{line}");
        let (scene, seed) = name.split_once("/tiny/seed").unwrap();
        assert!(rooms.gaussians(name) == rooms.alone(scene, seed.parse().unwrap()), "{name} differs from a run alone");
    }
}

#[test]
fn full_disk_stops_the_batch_and_loses_nothing() {
    let rooms = Rooms::new(&["kitchen"]);
    rooms.manifest(12);
    // A run needs more than 4 MB, so that the second one finds the disk full.
    let Some(disk) = Disk::new(&rooms.path("out"), "7m") else { return };
    let full: Finished = rooms.batch(&["--json"]);
    full.refused_with(1, &["No space left on device", "the same command goes on"]);
    assert_eq!(full.json()["kind"], "storage");
    assert!(results(&rooms) <= 1, "a full disk was recorded as the failure of a run");
    disk.remount("size=64m");
    let answer = rooms.batch(&["--json"]).ok().json();
    assert!(answer["runs"] == 2 && answer["done"].as_u64() >= Some(1), "{answer}");
    all_done(&rooms, &["kitchen"]);
}

#[test]
fn read_only_disk_stops_the_batch_and_loses_nothing() {
    let rooms = Rooms::new(&["kitchen"]);
    rooms.manifest(12);
    let Some(disk) = Disk::new(&rooms.path("out"), "64m") else { return };
    rooms.batch(&["--shard", "1/2"]).ok();
    // The system makes no disk read-only while a file is open for writing, so that it changes between two commands.
    disk.remount("ro");
    let stopped = rooms.batch(&["--json"]);
    stopped.refused_with(1, &["Read-only file system"]);
    assert_eq!((stopped.json()["kind"].as_str(), results(&rooms)), (Some("storage"), 1));
    disk.remount("rw");
    rooms.batch(&[]).ok();
    all_done(&rooms, &["kitchen"]);
    assert!(rooms.summary().values().all(|line| line["attempts"] == 1));
}

/// Returns the process ids of the programs that a process started.
fn children(of: u32) -> Vec<u32> {
    let processes = std::fs::read_dir("/proc").unwrap().flatten();
    let ids = processes.filter_map(|p| p.file_name().to_str()?.parse::<u32>().ok());
    let parent = |id: &u32| {
        let stat = std::fs::read_to_string(format!("/proc/{id}/stat")).unwrap_or_default();
        let rest = stat.rsplit_once(") ").map(|(_, rest)| rest.to_owned()).unwrap_or_default();
        rest.split(' ').nth(1).and_then(|p| p.parse::<u32>().ok())
    };
    ids.filter(|id| parent(id) == Some(of)).collect()
}

#[test]
fn killed_training_is_repeated_by_its_batch() {
    let rooms = Rooms::new(&["kitchen"]);
    rooms.manifest(60);
    let mut child = start(&rooms.arguments(&["--jobs", "1"]));
    assert!(until(&mut child, || logged(&rooms, "kitchen/tiny/seed0") > 2), "it ended before it was killed");
    for id in children(child.id()) {
        assert!(Command::new("kill").args(["-KILL", &id.to_string()]).status().unwrap().success());
    }
    wait(child).ok();
    all_done(&rooms, &["kitchen"]);
    let attempts: Vec<_> = rooms.summary().values().map(|line| line["attempts"].as_u64().unwrap()).collect();
    assert_eq!(attempts, [2, 1]);
}

/// Number of submissions before the device is lost.
const SUBMISSIONS: u64 = 110;

/// Starts trainings in threads. The first training of each run loses its device.
struct Losing {
    /// Seed of each start, and whether it resumed.
    starts: Mutex<Vec<(u64, bool)>>,
    losses: Arc<AtomicUsize>,
}

struct Training {
    thread: Option<JoinHandle<Exit>>,
    stop: Arc<AtomicBool>,
}

struct Until(Arc<AtomicBool>);

impl Observer for Until {
    fn notify(&mut self, _event: &Event<'_>) {}

    fn should_stop(&mut self) -> bool {
        self.0.load(Ordering::SeqCst)
    }
}

/// Trains a run on a device with faults.
fn train(
    scene: &Path,
    config: &Path,
    seed: u64,
    run: PathBuf,
    resume: bool,
    faults: &Faults,
    stop: Arc<AtomicBool>,
) -> anyhow::Result<Outcome> {
    let table = std::fs::read_to_string(config)?.parse()?;
    let settings = Settings { seed, scene: scene.to_owned(), ..Settings::from_table(table)? };
    let scene = Arc::new(Scene::open(scene, &settings.scene_options())?);
    let select = std::env::var("SGS_TEST_DEVICE").ok();
    let device = Device::open(&DeviceOptions { select, faults: faults.clone(), ..Default::default() })?;
    let options = TrainerOptions { stages: vec![StageKind::Geometry], resume, start: None, run: Some(run) };
    Ok(Trainer::new(&device, scene, &settings, options)?.run(&mut Until(stop))?)
}

impl Launcher for Losing {
    fn device(&self, _worker: usize) -> Option<DeviceMemory> {
        None
    }

    fn start(&self, launch: &Launch<'_>) -> std::io::Result<Box<dyn Process>> {
        assert_eq!(launch.phase, Phase::Train);
        let (stop, faults) = (Arc::new(AtomicBool::new(false)), Faults::default());
        let mut starts = self.starts.lock().unwrap();
        if starts.iter().all(|(seed, _)| *seed != launch.run.seed) {
            // After the first checkpoint, in the middle of the steps.
            faults.inject(Fault { call: "vkQueueSubmit2", skip: SUBMISSIONS, result: FaultKind::DeviceLost });
        }
        starts.push((launch.run.seed, launch.resume));
        let (scene, config, seed) = (launch.run.scene_path.clone(), launch.config.clone(), launch.run.seed);
        let (run, resume, flag, losses) = (launch.directory.clone(), launch.resume, stop.clone(), self.losses.clone());
        let thread = std::thread::spawn(move || match train(&scene, &config, seed, run, resume, &faults, flag) {
            Ok(outcome) => Exit { status: Some(if outcome == Outcome::Finished { 0 } else { 75 }), ..Exit::default() },
            Err(error) => {
                let kind = sgs_api::Kind::of(&error);
                losses.fetch_add(usize::from(kind.name() == "device_lost"), Ordering::SeqCst);
                let output = serde_json::json!({"kind": kind.name(), "error": error.to_string()});
                Exit { status: Some(kind.status()), signal: None, output: output.to_string() }
            }
        });
        Ok(Box::new(Training { thread: Some(thread), stop }))
    }
}

impl Process for Training {
    fn poll(&mut self) -> std::io::Result<Option<Exit>> {
        let ended = self.thread.as_ref().is_none_or(|thread| thread.is_finished());
        Ok(if ended { self.thread.take().map(|thread| thread.join().unwrap()) } else { None })
    }

    fn terminate(&mut self) {
        self.stop.store(true, Ordering::SeqCst);
    }

    fn kill(&mut self) {
        self.terminate();
    }

    fn beat(&mut self) {}
}

#[test]
fn lost_device_is_tried_again() {
    let rooms = Rooms::new(&["kitchen"]);
    rooms.manifest(30);
    let mut manifest = Manifest::read(&rooms.path("rooms.toml")).unwrap();
    manifest.evaluate = false;
    let stop = AtomicBool::new(false);
    let batch = Batch::new(&manifest, "test", None, &stop).unwrap();
    let store = Store::open(&rooms.path("out"), Timing::EXPIRY).unwrap();
    batch.write_configs(store.root()).unwrap();
    let launcher = Losing { starts: Mutex::default(), losses: Arc::default() };
    let queue = Queue {
        store: &store,
        batch: &batch,
        launcher: &launcher,
        stop: &stop,
        progress: &|_| {},
        jobs: 1,
        retry_failed: false,
        retry_temporary: false,
        summarize: true,
        shard: None,
        timing: Timing::default(),
    };
    let report = queue.work().unwrap();
    assert_eq!((report.done, report.failed), (2, Vec::new()));
    assert_eq!(launcher.losses.load(Ordering::SeqCst), 2);
    assert_eq!(*launcher.starts.lock().unwrap(), [(0, false), (0, true), (1, false), (1, true)]);
    all_done(&rooms, &["kitchen"]);
    assert!(rooms.summary().values().all(|line| line["attempts"] == 2));
}

/// One of two commands has a clock that jumps ten years. Nothing is taken over, and nothing is trained twice.
#[test]
fn jumping_clock_changes_nothing() {
    let library = Path::new("/usr/lib/x86_64-linux-gnu/faketime/libfaketimeMT.so.1");
    if !library.is_file() {
        println!("skipped: {} is missing; tools/setup --tests installs it", library.display());
        return;
    }
    let rooms = Rooms::new(&["kitchen", "bath"]);
    rooms.manifest(60);
    let clock = rooms.text("clock");
    std::fs::write(&clock, "+0").unwrap();
    let faked = [
        ("LD_PRELOAD", library.to_str().unwrap()),
        ("FAKETIME_TIMESTAMP_FILE", clock.as_str()),
        ("FAKETIME_NO_CACHE", "1"),
        ("FAKETIME_DONT_FAKE_MONOTONIC", "1"),
    ];
    let mut jumping = start_with(&rooms.arguments(&["--json"]), &faked);
    let first = || ["kitchen", "bath"].iter().any(|scene| logged(&rooms, &format!("{scene}/tiny/seed0")) > 1);
    assert!(until(&mut jumping, first), "it ended before the clock jumped");
    let other = start(&rooms.arguments(&["--json"]));
    for jump in ["+3650d", "-3650d", "+1d"] {
        std::fs::write(&clock, jump).unwrap();
        std::thread::sleep(std::time::Duration::from_secs(1));
    }
    for command in [jumping, other] {
        assert_eq!(wait(command).ok().json()["runs"], 4);
    }
    all_done(&rooms, &["bath", "kitchen"]);
    assert!(rooms.summary().values().all(|line| line["attempts"] == 1), "{:?}", rooms.summary());
}

/// 200 runs by three commands, one of which is killed. Only with `SGS_TEST_LONG`: it takes minutes.
#[test]
fn two_hundred_tiny_runs_end_once() {
    if !sgs_tests::takes_long() {
        return;
    }
    let rooms = Rooms::new(&["kitchen", "bath"]);
    rooms.manifest(3);
    let text = std::fs::read_to_string(rooms.path("rooms.toml")).unwrap();
    let seeds: Vec<String> = (0..100).map(|seed| seed.to_string()).collect();
    let text = text.replace("seeds = [0, 1]", &format!("seeds = [{}]\nevaluate = false", seeds.join(", ")));
    std::fs::write(rooms.path("rooms.toml"), text).unwrap();
    let mut commands: Vec<_> = (0..3).map(|_| start(&rooms.arguments(&["--json"]))).collect();
    let count = || std::fs::read_dir(rooms.path("out/results")).map_or(0, Iterator::count);
    assert!(until(&mut commands[0], || count() > 30), "it ended before it was killed");
    signal(&commands[0], "KILL");
    for command in commands.split_off(1) {
        assert_eq!(wait(command).ok().json()["runs"], 200);
    }
    wait(commands.remove(0));
    let summary = rooms.summary();
    assert_eq!((summary.len(), results(&rooms), rooms.leases()), (200, 200, 0));
    let starts = |name: &str| {
        let log = std::fs::read_to_string(rooms.path(&format!("out/runs/{name}.log"))).unwrap();
        log.lines().filter(|line| line.starts_with("$ ")).count()
    };
    let repeated = summary.keys().filter(|name| starts(name) > 1).count();
    assert!(repeated <= 2, "{repeated} runs were started again, but a command with two jobs was killed");
    for name in ["kitchen/tiny/seed7", "bath/tiny/seed99"] {
        let (scene, seed) = name.split_once("/tiny/seed").unwrap();
        assert!(rooms.gaussians(name) == rooms.alone(scene, seed.parse().unwrap()), "{name} differs from a run alone");
    }
}
