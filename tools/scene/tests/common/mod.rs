//! What the tests share: rooms that are written ([`written`]), and rooms that are found.
//!
//! The latter were made outside of this project and lie beside the repository; they are not a part of it. Where they are
//! absent, the tests say so and pass. `SGS_TEST_DATA` names another place.

#![allow(dead_code, reason = "each test program uses its own part")]

pub mod written;

use std::path::{Path, PathBuf};

use sgs_scene::{Image, Scene, SceneOptions};

/// The directory of a room.
pub fn room(name: &str) -> Option<PathBuf> {
    let beside = || Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data");
    let path = std::env::var_os("SGS_TEST_DATA").map_or_else(beside, PathBuf::from).join(name);
    if path.is_dir() {
        return Some(path);
    }
    println!("skipped: {} is absent", path.display());
    None
}

pub fn open(path: &Path) -> Scene {
    Scene::open(path, &SceneOptions::default()).unwrap()
}

/// Mean squared difference where `mask` holds.
pub fn mse(a: &Image, b: &Image, mask: &Image) -> f64 {
    assert_eq!((a.width, a.height, a.channels), (b.width, b.height, b.channels));
    let channels = a.channels as usize;
    let (mut sum, mut count) = (0.0, 0.0);
    for ((a, b), m) in a.data.chunks(channels).zip(b.data.chunks(channels)).zip(&mask.data) {
        if *m > 0.5 {
            sum += a.iter().zip(b).map(|(a, b)| f64::from(a - b).powi(2)).sum::<f64>();
            count += channels as f64;
        }
    }
    sum / count
}
