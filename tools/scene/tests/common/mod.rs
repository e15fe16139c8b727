//! Common code of the tests: synthetic rooms ([`written`]) and external rooms.
//!
//! External rooms are not part of this project and are stored beside the repository. If they are absent, tests report
//! that and pass. `SGS_TEST_DATA` selects another location.

#![allow(dead_code, reason = "each test program uses its own part")]

pub mod written;

use std::path::{Path, PathBuf};

use sgs_scene::{Image, Scene, SceneOptions};

/// Returns the directory of a room if it exists.
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

/// Returns the mean squared difference where `mask` is above one half.
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
