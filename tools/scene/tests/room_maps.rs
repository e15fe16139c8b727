//! Priors and ground truth of external rooms.

mod common;

use common::{mse, open, room};
use glam::DVec3;
use sgs_scene::{
    DepthDefinition, GroundTruth, GroundTruthKind, Image, NormalFrame, Scene, SceneOptions, linear_to_srgb,
};

fn pixel_angle(a: &[f32], b: &[f32]) -> f64 {
    let [a, b] = [a, b].map(|v| DVec3::new(f64::from(v[0]), f64::from(v[1]), f64::from(v[2])));
    a.cross(b).length().atan2(a.dot(b)).to_degrees()
}

fn is_zero(pixel: &[f32]) -> bool {
    pixel.iter().all(|&v| v == 0.0)
}

/// Returns the mean angle between normal priors and ground truth over all views. Only pixels where both exist count.
fn normal_error(scene: &Scene) -> f64 {
    let truth = GroundTruth::of(scene);
    let (mut sum, mut count) = (0.0, 0.0);
    for i in 0..scene.views.len() {
        let prior = scene.normal_prior(i).unwrap().unwrap();
        let normal = truth.load(GroundTruthKind::Normal, i).unwrap().unwrap();
        let mask = truth.load(GroundTruthKind::Mask, i).unwrap().unwrap();
        assert_eq!((prior.width, prior.height), (normal.width, normal.height));
        for ((p, n), m) in prior.data.chunks(3).zip(normal.data.chunks(3)).zip(&mask.data) {
            if *m > 0.5 && !is_zero(p) && !is_zero(n) {
                sum += pixel_angle(p, n);
                count += 1.0;
            }
        }
    }
    sum / count
}

#[test]
fn normal_priors_are_rotated_to_world_space() {
    let Some(path) = room("whiteroom") else {
        return;
    };
    let scene = open(&path);
    let error = normal_error(&scene);
    assert!((error - 8.7).abs() < 0.15, "{error}");

    let Some(path) = room("whiteroom_m") else {
        return;
    };
    let half = Scene::open(&path, &SceneOptions { scale: 0.5, ..Default::default() }).unwrap();
    let error = normal_error(&half);
    assert!(error < 10.0, "{error}");
}

/// Normals written in a frame are recovered only when read in the same frame.
#[test]
fn normals_of_every_frame_are_converted_to_world_space() {
    let Some(path) = room("whiteroom") else {
        return;
    };
    let scene = open(&path);
    let truth = GroundTruth::of(&scene).load(GroundTruthKind::Normal, 3).unwrap().unwrap();
    let names = ["world", "camera-opencv", "camera-opengl", "camera-stablenormal"];
    let frames =
        [NormalFrame::World, NormalFrame::CameraOpencv, NormalFrame::CameraOpengl, NormalFrame::CameraStablenormal];
    let copy = tempfile::tempdir().unwrap();
    let folder = copy.path().join("priors/normal");
    std::fs::create_dir_all(&folder).unwrap();
    std::fs::create_dir(copy.path().join("images")).unwrap();
    std::fs::copy(path.join("images/003.png"), copy.path().join("images/003.png")).unwrap();
    std::fs::copy(path.join("transforms.json"), copy.path().join("transforms.json")).unwrap();
    std::fs::write(copy.path().join("split.json"), r#"{"train": ["003"]}"#).unwrap();
    std::fs::copy(path.join("points.ply"), copy.path().join("points.ply")).unwrap();
    for (written, frame) in frames.iter().enumerate() {
        let from_world = frame.to_world(scene.views[3].camera.rotation).transpose();
        let mut stored = truth.clone();
        for n in stored.data.chunks_exact_mut(3) {
            let v = from_world * DVec3::new(f64::from(n[0]), f64::from(n[1]), f64::from(n[2]));
            n.copy_from_slice(&[v.x as f32, v.y as f32, v.z as f32]);
        }
        sgs_scene::write_exr(&folder.join("003.exr"), &stored, &["R", "G", "B"]).unwrap();
        for (read, name) in names.iter().enumerate() {
            let settings = format!(r#"{{"normal": {{"frame": "{name}"}}}}"#);
            std::fs::write(copy.path().join("priors/priors.json"), settings).unwrap();
            let prior = open(copy.path()).normal_prior(0).unwrap().unwrap();
            let pairs = prior.data.chunks(3).zip(truth.data.chunks(3)).filter(|(_, t)| !is_zero(t));
            let worst = pairs.map(|(p, t)| pixel_angle(p, t)).fold(0.0, f64::max);
            if read == written {
                assert!(worst < 0.1, "{name}: {worst}");
            } else {
                assert!(worst > 10.0, "written as {}, read as {name}: {worst}", names[written]);
            }
        }
    }
}

#[test]
fn prior_errors_match_the_published_values() {
    let Some(path) = room("whiteroom") else {
        return;
    };
    let scene = open(&path);
    let truth = GroundTruth::of(&scene);
    for (views, albedo_db, roughness, metallic) in
        [(&scene.split.train, 24.8, 0.0060, 0.0031), (&scene.split.test, 24.5, 0.0071, 0.0030)]
    {
        let n = views.len() as f64;
        let (mut db, mut r, mut m) = (0.0, 0.0, 0.0);
        for &i in views {
            let get = |kind| truth.load(kind, i).unwrap().unwrap();
            let mask = get(GroundTruthKind::Mask);
            let srgb = |mut image: Image| {
                image.data.iter_mut().for_each(|v| *v = linear_to_srgb(*v));
                image
            };
            let prior = scene.albedo_prior(i).unwrap().unwrap();
            assert!(prior.valid.data.iter().all(|&v| v == 1.0));
            db -= 10.0 * mse(&srgb(prior.image), &srgb(get(GroundTruthKind::Albedo)), &mask).log10() / n;
            let prior = scene.roughness_prior(i).unwrap().unwrap().image;
            r += mse(&prior, &get(GroundTruthKind::Roughness), &mask) / n;
            let prior = scene.metallic_prior(i).unwrap().unwrap().image;
            m += mse(&prior, &get(GroundTruthKind::Metallic), &mask) / n;
        }
        assert!((db - albedo_db).abs() < 0.1, "albedo {db}");
        assert!((r - roughness).abs() < 2e-4, "roughness {r}");
        assert!((m - metallic).abs() < 2e-4, "metallic {m}");
    }
}

#[test]
fn semantic_features_match_the_correct_class() {
    let Some(path) = room("whiteroom") else {
        return;
    };
    let scene = open(&path);
    let text = scene.text_embeddings().unwrap().unwrap();
    assert_eq!((text.labels.len(), text.channels), (27, 512));
    assert!(scene.semantic_prior(12).unwrap().is_none());
    let (mut right, mut all) = (0, 0);
    for &i in &scene.split.train {
        let map = scene.semantic_prior(i).unwrap().unwrap();
        let classes = GroundTruth::of(&scene).semantic(i).unwrap().unwrap();
        assert_eq!((map.width, map.height, map.channels), (20, 15, 512));
        for cell in 0..map.width * map.height {
            let feature = &map.data[cell * 512..(cell + 1) * 512];
            let score = |c: usize| -> f32 {
                let embedding = &text.data[c * 512..(c + 1) * 512];
                feature.iter().zip(embedding).map(|(a, b)| a.to_f32() * b).sum()
            };
            let best = (0..27).max_by(|&a, &b| score(a).total_cmp(&score(b))).unwrap();
            // A cell covers 8×8 pixels. The cell is correct if its class occurs in them.
            let (x, y) = (cell % 20 * 8, cell / 20 * 8);
            let seen = (0..64).any(|k| usize::from(classes.ids[(y + k / 8) * 160 + x + k % 8]) == best);
            right += usize::from(seen);
            all += 1;
        }
    }
    let share = right as f64 / all as f64;
    assert!(share > 0.93, "{share}");
}

#[test]
fn regions_are_not_interpolated_at_any_scale() {
    let Some(path) = room("whiteroom_m") else {
        return;
    };
    let full = open(&path).region_prior(0).unwrap().unwrap();
    let options = SceneOptions { scale: 0.37, ..Default::default() };
    let small = Scene::open(&path, &options).unwrap().region_prior(0).unwrap().unwrap();
    assert_eq!((full.width, full.height, small.width, small.height), (320, 240, 118, 89));
    let ids = |ids: &[u16]| ids.iter().copied().collect::<std::collections::BTreeSet<_>>();
    assert!(ids(&full.ids).len() > 5);
    assert!(ids(&small.ids).is_subset(&ids(&full.ids)));
}

/// Poses, depth and intrinsics agree. Surface points project to pixels with matching depth.
#[test]
fn points_match_the_depth_maps() {
    for (name, scale) in [("whiteroom", 1.0), ("whiteroom_m", 1.0), ("whiteroom_m", 0.5)] {
        let Some(path) = room(name) else { return };
        let scene = Scene::open(&path, &SceneOptions { scale, ..Default::default() }).unwrap();
        let (mut near, mut all) = (0, 0);
        for i in [0, 5, 17] {
            let camera = &scene.views[i].camera;
            let depth = GroundTruth::of(&scene).load(GroundTruthKind::Depth, i).unwrap().unwrap();
            for p in &scene.points.positions {
                let p = DVec3::from(p.map(f64::from));
                let z = (camera.rotation * p + camera.translation).z;
                let Some(pixel) = camera.project(p) else {
                    continue;
                };
                let (w, h) = (f64::from(camera.width), f64::from(camera.height));
                if pixel.x < 0.0 || pixel.y < 0.0 || pixel.x >= w || pixel.y >= h {
                    continue;
                }
                let surface = f64::from(depth.pixel(pixel.x as u32, pixel.y as u32)[0]);
                // Points behind the surface are occluded, so only points in front of it are errors.
                if surface > 0.0 && z < surface + 0.05 {
                    all += 1;
                    near += usize::from((z - surface).abs() < 0.05 + 0.02 * z);
                }
            }
        }
        let share = f64::from(near as u32) / f64::from(all as u32);
        assert!(all > 1500 && share > 0.9, "{name} at {scale}: {near} of {all}");
    }
}

#[test]
fn relit_ground_truth_is_complete() {
    let Some(path) = room("whiteroom") else {
        return;
    };
    let scene = open(&path);
    let truth = GroundTruth::of(&scene);
    let names = truth.relit_names();
    assert_eq!(names, ["armchair_right", "lamp_ceiling_off", "lamps_recolored_night", "windows_only"]);
    for name in &names {
        assert!(truth.relit(name, 0).unwrap().is_none());
        let relit = truth.relit(name, 12).unwrap().unwrap();
        assert_eq!((relit.width, relit.height, relit.channels), (160, 120, 3));
        assert!(relit.data.iter().any(|&v| v > 1.0) && relit.data.iter().all(|v| v.is_finite()));
        assert_eq!(truth.relit_albedo(name, 12).unwrap().is_some(), name == "armchair_right");
    }
    assert!(truth.relit_edit("armchair_right").is_some() && truth.relit_edit("none").is_none());
    assert!(truth.lights().is_some());
    assert!(truth.load(GroundTruthKind::Depth, 24).is_err());
}

/// Compares the same renders in InteriorVerse's layout with the room. InteriorVerse stores normals in camera axes,
/// depth in millimeters, and half floats.
#[test]
fn interiorverse_ground_truth_matches_the_room() {
    let (Some(release), Some(room)) = (room("whiteroom_interiorverse"), room("whiteroom")) else {
        return;
    };
    let (release, room) = (open(&release), open(&room));
    let (ours, theirs) = (GroundTruth::of(&release), GroundTruth::of(&room));
    assert_eq!(ours.depth_definition().unwrap(), Some(DepthDefinition { unit: 1e-3, along_ray: false }));
    for i in 0..release.views.len() {
        let (a, b) = (&release.views[i].camera, &room.views[i].camera);
        assert!((a.position() - b.position()).length() < 1e-9 && (a.fx, a.cy) == (b.fx, b.cy));
        assert!((a.rotation - b.rotation).to_cols_array().iter().all(|v| v.abs() < 1e-9));
        let both = |kind| [&ours, &theirs].map(|truth| truth.load(kind, i).unwrap().unwrap());
        let [mask, expected] = both(GroundTruthKind::Mask);
        assert_eq!(mask, expected);
        assert_eq!(release.load_mask(i).unwrap(), Some(mask.clone()));
        let counts = |p: &usize| mask.data[*p] > 0.5;
        let [a, b] = both(GroundTruthKind::Normal);
        let angles: Vec<f64> = (0..mask.data.len())
            .filter(counts)
            .filter(|p| !is_zero(&b.data[3 * p..3 * p + 3]))
            .map(|p| pixel_angle(&a.data[3 * p..3 * p + 3], &b.data[3 * p..3 * p + 3]))
            .collect();
        let mean = angles.iter().sum::<f64>() / angles.len() as f64;
        let worst = angles.iter().copied().fold(0.0, f64::max);
        assert!(mean < 0.1 && worst < 1.0, "view {i}: {mean}° on average, {worst}° at worst");
        for (kind, tolerance) in [
            (GroundTruthKind::Depth, 5e-3),
            (GroundTruthKind::Albedo, 1e-3),
            (GroundTruthKind::Roughness, 1e-3),
            (GroundTruthKind::Metallic, 1e-3),
        ] {
            let [a, b] = both(kind);
            let channels = a.channels as usize;
            let pixels = (0..mask.data.len()).filter(counts);
            let values = pixels.flat_map(|p| p * channels..(p + 1) * channels).map(|k| (a.data[k] - b.data[k]).abs());
            let worst = values.fold(0.0, f32::max);
            assert!(worst < tolerance, "view {i}: {kind:?} differs by {worst}");
        }
        assert!(release.normal_prior(i).unwrap().is_none() && release.albedo_prior(i).unwrap().is_none());
    }
}
