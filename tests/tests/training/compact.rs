//! Training with compact storage: as good as exact training, and the same bits after interruptions.

use sgs_tests::Place;
use sgs_tests::cli::sgs;
use sgs_tests::rooms::Room;
use std::path::Path;

/// Kills and resumes a training with densification, resets and a trial of bands.
#[test]
fn killed_compact_training_resumes_with_the_same_bits() {
    let place = Place::new(Room::default());
    let steps = 90;
    let compact = ["--accuracy", "compact", "--set", "geometry.sh_degree=auto", "--set", "geometry.dense_adam=true"];
    sgs(&place.arguments("straight", steps, &compact)).ok();
    place.train_killed("killed", steps, &compact, &[10, 50]);
    place.assert_same("straight", "killed");
    // The level was in use, and another one is another training.
    let exact = [&["--accuracy", "exact"], &compact[2..]].concat();
    sgs(&place.arguments("exact", steps, &exact)).ok();
    assert_ne!(place.read("straight/scene.ply"), place.read("exact/scene.ply"));
}

/// Images at test views differ by at most 0.1 dB in PSNR.
#[test]
fn compact_training_is_as_good_as_exact() {
    let scene = Path::new(env!("CARGO_MANIFEST_DIR")).join("data/room").display().to_string();
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).display().to_string();
    let number = |name: &str, pointer: &str| {
        let text = std::fs::read_to_string(folder.path().join(name)).unwrap();
        serde_json::from_str::<serde_json::Value>(&text).unwrap().pointer(pointer).unwrap().as_f64().unwrap()
    };
    let [exact, compact] = ["exact", "compact"].map(|level| {
        let run = path(level);
        let options = ["--stage", "geometry", "--geometry-steps", "200", "--no-densify", "--accuracy", level];
        let lean = ["--set", "geometry.semantics=false", "--set", "geometry.normals=false"];
        sgs(&[&["train", &scene, "-o", &run, "-q"], &options[..], &lean].concat()).ok();
        sgs(&["eval", &run, "--json", &path("measures.json")]).ok();
        let bytes = number(&format!("{level}/training.json"), "/peak_device_bytes");
        (number("measures.json", "/mean/nvs/psnr"), bytes)
    });
    assert!(exact.0 > 22.0 && (exact.0 - compact.0).abs() < 0.1, "{exact:?} {compact:?}");
    // 336 bytes less for each of 2500 Gaussians.
    assert!(exact.1 - compact.1 > 336.0 * 2500.0, "{exact:?} {compact:?}");
}
