//! Priors of every kind with nothing but NaN: both stages train as without priors.

use half::f16;
use sgs_config::Metallic;
use sgs_passes::scene::EMBEDDING;
use sgs_scene::{Image, Scene, SceneOptions, write_exr, write_ids, write_npy_f16};
use sgs_tests::intrinsic::settings;
use sgs_tests::meaning::Meaning;
use sgs_tests::rooms::Room;
use sgs_tests::{Gpu, Place};
use sgs_train::{Geometry, Intrinsic, Progress};

/// Creates a room with every kind of prior, all values NaN.
fn place() -> Place {
    let room = Room { priors: true, ..Room::default() };
    let place = Place::new(room);
    let scene = place.path("scene");
    room.write_materials(&scene);
    Meaning { masks: true, ..Meaning::default() }.write(&room, &scene);
    let (mut maps, mut features) = (0, 0);
    for kind in ["normal", "albedo", "roughness", "metallic"] {
        let channels: &[&str] = match kind {
            "normal" => &["X", "Y", "Z"],
            "albedo" => &["R", "G", "B"],
            _ => &["Y"],
        };
        let nan = Image { data: vec![f32::NAN; 32 * 24 * channels.len()], ..Image::new(32, 24, channels.len() as u32) };
        for entry in std::fs::read_dir(scene.join("priors").join(kind)).unwrap() {
            let file = entry.unwrap().path();
            std::fs::remove_file(&file).unwrap();
            write_exr(&file.with_extension("exr"), &nan, channels).unwrap();
            maps += 1;
        }
    }
    for camera in room.cameras() {
        let file = scene.join(format!("priors/semantic/{}.npy", camera.name));
        if file.is_file() {
            write_npy_f16(&file, &[6, 8, EMBEDDING], &vec![f16::NAN; 6 * 8 * EMBEDDING]).unwrap();
            features += 1;
        }
        write_ids(&scene.join(format!("priors/masks/{}.png", camera.name)), 32, 24, &[0; 32 * 24]).unwrap();
    }
    assert!(maps >= 24 && features >= 6, "{maps} maps, {features} of features");
    place
}

#[test]
fn all_nan_priors_equal_no_priors() {
    let (gpu, place) = (Gpu::new(), place());
    let device = gpu.device();
    let mut s = settings(12);
    s.intrinsic.metallic = Metallic::On;
    s.geometry.correspondence_from = 1;
    let scene = Scene::open(&place.path("scene"), &SceneOptions::default()).unwrap();
    let mut geometry = Geometry::new(device, &scene, &s, None).unwrap();
    let mut losses = Vec::new();
    let on_progress = |p: &Progress| {
        if let Progress::Step(r) = p {
            losses.push(r.losses);
        }
    };
    geometry.train(12, on_progress, || true).unwrap();
    assert_eq!(losses.len(), 12);
    for l in &losses {
        assert!(l.total.is_finite() && l.l1 > 0.0, "{l:?}");
        assert_eq!(
            [l.normal, l.semantic, l.semantic_class, l.correspondence, l.correspondence_class],
            [0.0; 5],
            "{l:?}"
        );
    }
    let data = geometry.gaussians().download(device).unwrap();
    for group in geometry.gaussians().model.groups() {
        assert!(data.group(group).iter().all(|v| v.is_finite()), "{}", group.name());
    }
    let splats = geometry.splats().unwrap();
    drop(geometry);
    let mut training = Intrinsic::new(device, &scene, &s, &splats).unwrap();
    let mut reports = Vec::new();
    training.train(12, |r| reports.push(*r), || true).unwrap();
    assert_eq!(reports.len(), 12);
    for r in &reports {
        assert!(r.shaded.is_finite() && r.shaded > 0.0, "{r:?}");
        assert_eq!([r.albedo, r.roughness, r.metallic], [0.0; 3], "{r:?}");
    }
    let splats = training.splats().unwrap();
    let (albedo, roughness) = (splats.albedo.unwrap(), splats.roughness.unwrap());
    assert!(albedo.iter().flatten().chain(&roughness).chain(&splats.metallic.unwrap()).all(|v| v.is_finite()));
}
