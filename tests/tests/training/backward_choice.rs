//! Choice of the backward kernel: cached by device and sizes, and made after the same step in every training.

use sgs_config::{Backward, Settings};
use sgs_engine::{Device, DeviceOptions};
use sgs_scene::{Scene, SceneOptions, Splats};
use sgs_tests::Place;
use sgs_tests::rooms::Room;
use sgs_train::Geometry;
use std::path::{Path, PathBuf};

fn device(cache: Option<&Path>) -> Device {
    let select = std::env::var("SGS_TEST_DEVICE").ok();
    let pipeline_cache = cache.map(Path::to_owned);
    Device::open(&DeviceOptions { select, pipeline_cache, ..Default::default() }).unwrap()
}

fn scene(room: Room) -> (Place, Scene) {
    let place = Place::new(room);
    let scene = Scene::open(&place.path("scene"), &SceneOptions::default()).unwrap();
    (place, scene)
}

/// Returns settings with densification before and after the choice.
fn settings(steps: u32) -> Settings {
    let mut s = Settings::default();
    s.geometry.steps = steps;
    let d = &mut s.geometry.densify;
    (d.from, d.interval, d.reset_interval, d.grad_threshold, d.max_gaussians) = (5, 5, 12, 5e-5, 3000);
    s
}

/// Trains a few steps and chooses. Returns whether kernels were timed, and the choice.
fn choose(device: &Device, scene: &Scene) -> (bool, Backward) {
    let mut s = settings(8);
    s.geometry.densify.until = 0.0;
    let mut training = Geometry::new(device, scene, &s, None).unwrap();
    training.train(4, |_| (), || true).unwrap();
    (training.choose_backward().unwrap(), training.settings().geometry.backward)
}

/// Returns the cached choices in a folder.
fn choices(folder: &Path) -> Vec<PathBuf> {
    let files = std::fs::read_dir(folder).unwrap().map(|file| file.unwrap().path());
    let mut files: Vec<PathBuf> = files.filter(|file| file.extension().is_some_and(|e| e == "json")).collect();
    files.sort();
    files
}

/// Replaces the kernel of a cached choice.
fn plant(file: &Path, kernel: &str) {
    let mut choice: serde_json::Value = serde_json::from_slice(&std::fs::read(file).unwrap()).unwrap();
    choice["kernel"] = kernel.into();
    std::fs::write(file, choice.to_string()).unwrap();
}

/// Tests that a second training under the same conditions times nothing. Another size of views or count of Gaussians does.
#[test]
fn choice_is_cached_by_device_and_sizes() {
    let folder = tempfile::tempdir().unwrap();
    let (_place, small) = scene(Room::default());
    let gpu = device(Some(folder.path()));
    let (timed, first) = choose(&gpu, &small);
    assert!(timed && first != Backward::Auto);
    assert_eq!(choose(&gpu, &small), (false, first));
    let file = choices(folder.path()).pop().unwrap();
    // A measurement would not choose a kernel because it is in the file.
    for (name, kernel) in [("pixel", Backward::Pixel), ("splat", Backward::Splat), ("bucket", Backward::Bucket)] {
        plant(&file, name);
        assert_eq!(choose(&gpu, &small), (false, kernel));
    }
    let (_place, larger) = scene(Room { size: [64, 48], spacing: 8, ..Room::default() });
    let (_place, denser) = scene(Room { spacing: 2, ..Room::default() });
    for other in [&larger, &denser] {
        assert!(choose(&gpu, other).0);
        assert!(!choose(&gpu, other).0);
    }
    assert_eq!(choices(folder.path()).len(), 3);
    // Without a folder nothing is cached.
    let gpu = device(None);
    assert!(choose(&gpu, &small).0 && choose(&gpu, &small).0);
}

/// Tests that damaged and foreign files are ignored and replaced.
#[test]
fn damaged_choices_are_measured_again() {
    let folder = tempfile::tempdir().unwrap();
    let (_place, room) = scene(Room::default());
    let gpu = device(Some(folder.path()));
    assert!(choose(&gpu, &room).0);
    let file = choices(folder.path()).pop().unwrap();
    let whole = std::fs::read_to_string(&file).unwrap();
    let name = &gpu.info().name;
    assert!(whole.contains(name.as_str()));
    let foreign = whole.replace(name.as_str(), "another GPU");
    for damaged in ["", &whole[..whole.len() / 2], "[1, 2]", "\u{0}\u{1}\u{2}", &foreign] {
        std::fs::write(&file, damaged).unwrap();
        assert!(choose(&gpu, &room).0, "{damaged:?} was read");
        assert!(!choose(&gpu, &room).0, "{damaged:?} was not replaced");
    }
    plant(&file, "atomic");
    assert!(choose(&gpu, &room).0);
}

/// Tests that stops do not change the bits of a training with a choice.
#[test]
fn stops_around_the_choice_change_no_bit() {
    let folder = tempfile::tempdir().unwrap();
    let (place, room) = scene(Room::default());
    let s = settings(26);
    let plain = device(None);
    let mut training = Geometry::new(&plain, &room, &s, None).unwrap();
    training.train(26, |_| (), || true).unwrap();
    let pixel: Splats = training.splats().unwrap();
    drop((training, plain));

    let gpu = device(Some(folder.path()));
    let start = || Geometry::new(&gpu, &room, &s, None).unwrap();
    // The choice is looked up with the sizes after 16 steps.
    let mut training = start();
    training.train(16, |_| (), || true).unwrap();
    assert_eq!(training.settings().geometry.backward, Backward::Auto);
    assert!(training.choose_backward().unwrap());
    plant(&choices(folder.path()).pop().unwrap(), "bucket");
    drop(training);

    let mut whole = start();
    whole.train(26, |_| (), || true).unwrap();
    assert_eq!(whole.settings().geometry.backward, Backward::Bucket);
    let expected = whole.splats().unwrap();
    assert_ne!(expected, pixel, "the kernels give the same bits, so this test cannot fail");
    drop(whole);
    let file = place.path("checkpoint");
    for stop in [14, 15, 16, 17, 18, 21] {
        let mut first = start();
        first.train(stop, |_| (), || true).unwrap();
        let chosen = first.settings().geometry.backward;
        assert_eq!(chosen, if stop > 16 { Backward::Bucket } else { Backward::Auto }, "after {stop} steps");
        first.save(&file).unwrap();
        drop(first);
        // The checkpoint has the choice: the file with it may be gone.
        let lost = choices(folder.path()).pop().filter(|_| stop > 16);
        let text = lost.as_ref().map(|file| std::fs::read(file).unwrap());
        lost.iter().for_each(|file| std::fs::remove_file(file).unwrap());
        let mut second = start();
        second.restore(&file).unwrap();
        assert_eq!(second.settings().geometry.backward, chosen);
        second.train(26, |_| (), || true).unwrap();
        assert_eq!(second.splats().unwrap(), expected, "stopped after {stop} steps");
        if let (Some(file), Some(text)) = (lost, text) {
            std::fs::write(file, text).unwrap();
        }
    }
}
