//! Tile sizes that settings allow: entries differ, and training differs only by the order of sums.

use sgs_config::{Backward, Settings};
use sgs_passes::pipeline::IntrinsicReport;
use sgs_scene::{Scene, SceneOptions, Splats};
use sgs_tests::meaning::Meaning;
use sgs_tests::rooms::Room;
use sgs_tests::{Gpu, Place, intrinsic};
use sgs_train::{Geometry, Intrinsic, Progress};

const STEPS: u32 = 12;

/// Fails if losses differ from another training by more than accumulated rounding.
fn assert_same_course(what: &str, found: &[f32], expected: &[f32]) {
    assert_eq!((found.len(), expected.len()), (STEPS as usize, STEPS as usize), "{what}");
    for (step, (a, b)) in found.iter().zip(expected).enumerate() {
        assert!((a - b).abs() <= 1e-3 * b.abs(), "{what}, step {}: {a} and {b}", step + 1);
    }
}

#[test]
fn geometry_training_is_equal_for_every_tile_size() {
    let room = Room { priors: true, ..Room::default() };
    let place = Place::new(room);
    Meaning::default().write(&room, &place.path("scene"));
    let scene = Scene::open(&place.path("scene"), &SceneOptions::default()).unwrap();
    let gpu = Gpu::new();
    let train = |rows: u32, backward: Backward| {
        let mut s = Settings::default();
        s.geometry.steps = STEPS;
        (s.geometry.densify.until, s.geometry.backward) = (0.0, backward);
        (s.geometry.correspondence_from, s.geometry.pseudo.poses) = (6, 3);
        s.train.tile_rows = rows;
        let (mut losses, mut entries) = (Vec::new(), 0);
        let on_progress = |p: &Progress| {
            if let Progress::Step(r) = p {
                losses.push(r.losses.total);
                entries += u64::from(r.entries);
            }
        };
        let mut training = Geometry::new(gpu.device(), &scene, &s, None).unwrap();
        training.train(STEPS, on_progress, || true).unwrap();
        (losses, entries, training.splats().unwrap())
    };
    for backward in [Backward::Pixel, Backward::Splat, Backward::Bucket] {
        let [own, short, medium, tall] = [0, 8, 16, 32].map(|rows| train(rows, backward));
        assert!(own == medium, "sixteen rows are what suits every device");
        assert!(short.1 > medium.1 && medium.1 > tall.1, "entries: {} {} {}", short.1, medium.1, tall.1);
        assert_same_course(&format!("{backward:?}, eight rows"), &short.0, &own.0);
        assert_same_course(&format!("{backward:?}, thirty-two rows"), &tall.0, &own.0);
    }
}

#[test]
fn material_training_is_equal_for_every_tile_size() {
    let (place, _) = intrinsic::place();
    let gpu = Gpu::new();
    let scene = Scene::open(&place.path("scene"), &SceneOptions::default()).unwrap();
    let splats = Splats::from_points(&scene.points, 1).unwrap();
    for bits in [32, 16] {
        let train = |rows: u32| {
            let mut s = intrinsic::settings(STEPS);
            (s.train.tile_rows, s.accuracy.weight_bits) = (rows, bits);
            let mut losses = Vec::new();
            let on_progress = |r: &IntrinsicReport| losses.push(r.shaded + r.albedo);
            let mut training = Intrinsic::new(gpu.device(), &scene, &s, &splats).unwrap();
            training.train(STEPS, on_progress, || true).unwrap();
            losses
        };
        let own = train(0);
        assert_same_course("sixteen rows", &train(16), &own);
        assert_same_course("eight rows", &train(8), &own);
        assert_same_course("thirty-two rows", &train(32), &own);
    }
}

#[test]
fn invalid_tile_sizes_are_refused() {
    for rows in [1, 4, 12, 64] {
        let mut s = Settings::default();
        s.train.tile_rows = rows;
        let error = s.check().unwrap_err().to_string();
        assert_eq!(error, format!("train.tile_rows is {rows}, but must be 0, 8, 16 or 32."));
    }
}
