//! Runs under interruptions, kills, full disks and damaged checkpoints.
//!
//! Results equal those of an undisturbed run, and no earlier checkpoint is lost.

use sgs_tests::Place;
use sgs_tests::cli::{sgs, sgs_after, signal, start, until, wait};
use sgs_tests::rooms::Room;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Duration;

#[test]
fn interrupted_and_killed_runs_match_an_undisturbed_run() {
    let place = Place::new(Room::default());
    let steps = 110;
    sgs(&place.arguments("straight", steps, &[])).ok();
    let steps_logged = place.logged("straight");
    assert_eq!(steps_logged, std::iter::once(1).chain((1..=11).map(|i| 10 * i)).collect::<Vec<_>>());

    // Interrupt twice, as with Ctrl-C.
    let mut child = start(&place.arguments("interrupted", steps, &[]));
    assert!(until(&mut child, || place.logged("interrupted").last() >= Some(&30)), "it was too fast to interrupt");
    signal(&child, "INT");
    let stopped = wait(child);
    assert_eq!(stopped.status, Some(130), "{stopped:?}");
    assert!(stopped.stderr.contains("stopped after step") && stopped.stderr.contains("--resume"), "{stopped:?}");
    assert!(!place.path("interrupted/scene.ply").exists());
    sgs(&["export", &place.text("interrupted"), "-o", &place.text("x.ply")]).refused(&["no scene.ply yet", "--resume"]);
    let scene = place.text("scene");
    let mut child = start(&["train", &scene, "-o", &place.text("interrupted"), "--resume"]);
    assert!(until(&mut child, || place.logged("interrupted").last() >= Some(&80)), "it was too fast to interrupt");
    signal(&child, "TERM");
    assert_eq!(wait(child).status, Some(75));
    place.resume("interrupted").ok();
    place.assert_same("straight", "interrupted");

    // Kill repeatedly, at any point.
    place.train_killed("killed", steps, &[], &[10, 40, 70]);
    place.assert_same("straight", "killed");
    let left = |folder: &str| -> Vec<String> {
        let names = std::fs::read_dir(place.path(folder)).unwrap().map(|e| e.unwrap().file_name());
        names.map(|n| n.to_string_lossy().into_owned()).filter(|n| n.ends_with(".tmp")).collect()
    };
    assert!(left("killed").is_empty() && left("killed/checkpoint").is_empty(), "half-written files are left");

    // A finished run has nothing to resume and stays unchanged.
    place.resume("killed").ok();
    place.assert_same("straight", "killed");
}

/// Suspends and continues a run, as with Ctrl-Z and `fg`.
///
/// Clocks continue meanwhile, and no wait may report a lost device.
#[test]
fn suspended_run_continues() {
    let place = Place::new(Room::default());
    sgs(&place.arguments("straight", 60, &[])).ok();
    let mut child = start(&place.arguments("stopped", 60, &["--timeout", "3"]));
    for step in [1, 20, 40] {
        let there = until(&mut child, || place.logged("stopped").last() >= Some(&step));
        assert!(there, "it ended before it was stopped");
        signal(&child, "STOP");
        std::thread::sleep(Duration::from_secs(4));
        signal(&child, "CONT");
    }
    wait(child).ok();
    place.assert_same("straight", "stopped");
}

/// Small file system that is unmounted on drop.
struct SmallDisk(PathBuf);

impl SmallDisk {
    /// Mounts a file system of `size` at `at`. Returns `None` if mounting is not permitted.
    fn mount(at: &Path, size: &str) -> Option<SmallDisk> {
        std::fs::create_dir_all(at).unwrap();
        let mounted =
            Command::new("mount").args(["-t", "tmpfs", "-o", &format!("size={size}"), "tmpfs"]).arg(at).output();
        mounted.is_ok_and(|o| o.status.success()).then(|| SmallDisk(at.to_owned()))
    }

    fn grow(&self, size: &str) {
        let done = Command::new("mount").args(["-o", &format!("remount,size={size}")]).arg(&self.0).status();
        assert!(done.is_ok_and(|s| s.success()));
    }
}

impl Drop for SmallDisk {
    fn drop(&mut self) {
        let _ = Command::new("umount").arg(&self.0).status();
    }
}

const FIXED: [&str; 3] = ["--no-densify", "--set", "geometry.sh_degree=0"];

#[test]
fn a_full_disk_leaves_the_earlier_checkpoint() {
    let place = Place::new(Room::default());
    sgs(&place.arguments("straight", 30, &FIXED)).ok();
    let checkpoint = place.read("straight/checkpoint/geometry.safetensors").len();
    // The disk fits one checkpoint and the small files, but not a second checkpoint.
    let Some(disk) = SmallDisk::mount(&place.path("full"), &format!("{}k", checkpoint * 3 / 2 / 1024 + 16)) else {
        println!("skipped: mounting is not permitted");
        return;
    };
    let failed = sgs(&place.arguments("full", 30, &FIXED));
    failed.assert_no_panic();
    assert_eq!(failed.status, Some(1), "{failed:?}");
    let sentence = failed.stderr.lines().last().unwrap();
    assert!(sentence.starts_with("sgs: ") && sentence.contains("No space left"), "{failed:?}");
    let earlier = place.read("full/checkpoint/geometry.safetensors");
    // Resuming continues from that checkpoint and fails the same way while the disk is full.
    let again = place.resume("full");
    assert_eq!(again.status, Some(1), "{again:?}");
    again.assert_no_panic();
    assert!(place.read("full/checkpoint/geometry.safetensors") == earlier, "the checkpoint has changed");
    disk.grow("4m");
    place.resume("full").ok();
    place.assert_same("straight", "full");
    drop(disk);
}

#[test]
fn a_kill_in_the_middle_of_a_save_leaves_the_earlier_checkpoint() {
    let place = Place::new(Room::default());
    sgs(&place.arguments("straight", 30, &FIXED)).ok();
    let file = "killed/checkpoint/geometry.safetensors";
    let mut child = start(&place.arguments("killed", 30, &FIXED));
    assert!(until(&mut child, || place.path(file).exists()), "no checkpoint was written");
    signal(&child, "KILL");
    wait(child);
    let earlier = place.read(file);
    let resume = ["train", &place.text("scene"), "-o", &place.text("killed"), "--resume"];
    // The system kills a program that exceeds its file size limit: here 16 KiB, in the middle of a checkpoint.
    let killed = sgs_after("ulimit -f 16", &resume);
    assert_ne!(killed.status, Some(0), "{killed:?}");
    assert!(place.read(file) == earlier, "the checkpoint has changed");
    // Exceed the limit again, with an error instead of a signal.
    let refused = sgs_after("trap '' XFSZ; ulimit -f 16", &resume);
    refused.assert_no_panic();
    assert_eq!(refused.status, Some(1), "{refused:?}");
    assert!(refused.stderr.lines().last().unwrap().contains("geometry.safetensors"), "{refused:?}");
    assert!(place.read(file) == earlier, "the checkpoint has changed");
    place.resume("killed").ok();
    place.assert_same("straight", "killed");
}

#[test]
fn damaged_checkpoints_are_refused() {
    let place = Place::new(Room::default());
    sgs(&place.arguments("run", 14, &FIXED)).ok();
    // The run stops before it writes its last files.
    std::fs::remove_file(place.path("run/training.json")).unwrap();
    let path = place.path("run/checkpoint/geometry.safetensors");
    let whole = std::fs::read(&path).unwrap();
    let with = |bytes: &[u8]| {
        std::fs::write(&path, bytes).unwrap();
        place.resume("run")
    };
    with(&whole[..whole.len() - 9]).refused(&["geometry.safetensors"]);
    with(&whole[..20]).refused(&["geometry.safetensors"]);
    with(b"").refused(&["geometry.safetensors"]);
    let mut nan = whole.clone();
    let end = nan.len();
    nan[end / 2..end].fill(0xff);
    with(&nan).refused(&["geometry.safetensors", "not finite"]);
    std::fs::write(&path, &whole).unwrap();
    let config = place.path("run/config.toml");
    let text = std::fs::read_to_string(&config).unwrap();
    std::fs::write(&config, text.replace("sh_degree = 0", "sh_degree = 2")).unwrap();
    place.resume("run").refused(&["geometry.safetensors", "sh1"]);
    std::fs::write(&config, "scene = 3").unwrap();
    place.resume("run").refused(&["config.toml", "scene is 3"]);
    std::fs::write(&config, text).unwrap();
    place.resume("run").ok();
}
