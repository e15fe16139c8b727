//! Tests of a small scene directory: its files, its numbers, and cameras that match the images.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

use glam::{Mat4, Vec3, Vec4};
use serde_json::Value;
use sgs_synth::{SceneName, Summary, SynthError, SynthOptions, generate};

fn options(scene: SceneName) -> SynthOptions {
    SynthOptions {
        scene,
        views: 3,
        test_views: 1,
        width: 48,
        height: 36,
        samples_per_pixel: 8,
        points: 300,
        ..SynthOptions::default()
    }
}

fn make(out: &Path, options: &SynthOptions) -> Summary {
    generate(out, options, &|done, total| assert!(done <= total)).expect("a scene is made")
}

/// Returns every file below a directory with its bytes.
fn files(root: &Path) -> BTreeMap<String, Vec<u8>> {
    let mut out = BTreeMap::new();
    let mut folders = vec![root.to_owned()];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
            } else {
                let name = path.strip_prefix(root).unwrap().to_string_lossy().replace('\\', "/");
                out.insert(name, fs::read(&path).unwrap());
            }
        }
    }
    out
}

fn json(root: &Path, name: &str) -> Value {
    serde_json::from_slice(&fs::read(root.join(name)).unwrap()).unwrap()
}

/// Returns world-to-camera matrices in OpenCV axes and the focal length.
fn cameras(root: &Path) -> (Vec<Mat4>, f32) {
    let transforms = json(root, "transforms.json");
    let number = |v: &Value| v.as_f64().unwrap() as f32;
    let frames = transforms["frames"].as_array().unwrap();
    let matrices = frames.iter().map(|frame| {
        let row = |r: usize| {
            let m = &frame["transform_matrix"][r];
            Vec4::new(number(&m[0]), number(&m[1]), number(&m[2]), number(&m[3]))
        };
        let to_world = Mat4::from_cols(row(0), row(1), row(2), row(3)).transpose();
        let flip = Mat4::from_scale(Vec3::new(1.0, -1.0, -1.0));
        (to_world * flip).inverse()
    });
    (matrices.collect(), number(&transforms["fl_x"]))
}

fn depth(root: &Path, stem: &str) -> Vec<f32> {
    use exr::prelude::{ReadChannels, ReadLayers, read};
    let image = read()
        .no_deep_data()
        .largest_resolution_level()
        .all_channels()
        .first_valid_layer()
        .all_attributes()
        .from_file(root.join(format!("gt/depth/{stem}.exr")))
        .unwrap();
    let channels = &image.layer_data.channel_data.list;
    assert_eq!((channels.len(), channels[0].name.to_string().as_str()), (1, "Y"));
    channels[0].sample_data.values_as_f32().collect()
}

#[test]
fn scene_directory_is_complete_and_consistent() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("scene");
    let summary = make(&out, &options(SceneName::LivingRoom));
    assert_eq!((summary.train_views, summary.test_views), (3, 1));
    assert!(summary.clipped < 0.12 && summary.mean > 0.25, "{summary:?}");
    let made = files(&out);
    let mut expected: Vec<String> = [
        "transforms.json",
        "split.json",
        "points.ply",
        "scene.json",
        "priors/priors.json",
        "priors/semantic/labels.json",
        "priors/semantic/text_embeddings.npy",
        "gt/lights.json",
        "gt/semantic/labels.json",
    ]
    .map(str::to_owned)
    .to_vec();
    for stem in ["000", "001", "002", "003"] {
        expected.push(format!("images/{stem}.png"));
        for kind in ["normal", "albedo", "roughness", "metallic", "masks"] {
            expected.push(format!("priors/{kind}/{stem}.png"));
        }
        for kind in ["albedo", "normal", "depth", "roughness", "metallic"] {
            expected.push(format!("gt/{kind}/{stem}.exr"));
        }
        for kind in ["mask", "semantic"] {
            expected.push(format!("gt/{kind}/{stem}.png"));
        }
        if stem != "003" {
            expected.push(format!("priors/semantic/{stem}.npy"));
        }
    }
    for name in &summary.relit {
        expected.push(format!("gt/relit/{name}.json"));
        expected.push(format!("gt/relit/{name}/003.exr"));
    }
    expected.sort();
    assert_eq!(made.keys().cloned().collect::<Vec<_>>(), expected);
    assert_eq!(json(&out, "split.json"), serde_json::json!({"train": ["000", "001", "002"], "test": ["003"]}));
    // A remaining temporary directory would lie beside the output.
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
    features_have_their_shape(&made);
    points_agree_with_images(&out, &made);
    depths_agree_between_views(&out);
}

fn features_have_their_shape(made: &BTreeMap<String, Vec<u8>>) {
    let bytes = &made["priors/semantic/000.npy"];
    assert!(bytes.starts_with(b"\x93NUMPY\x01\x00"));
    let header = String::from_utf8_lossy(&bytes[10..128]);
    assert!(header.contains("'<f2'") && header.contains("(5, 6, 512,)"), "{header}");
    assert_eq!(bytes.len(), 128 + 2 * 5 * 6 * 512);
}

/// Compares the color of every unoccluded point with every training view.
///
/// A flipped axis would fail the comparison.
fn points_agree_with_images(root: &Path, made: &BTreeMap<String, Vec<u8>>) {
    let ply = &made["points.ply"];
    let marker = b"end_header\n";
    let start = ply.windows(marker.len()).position(|w| w == marker).unwrap() + marker.len();
    let float = |record: &[u8], i: usize| f32::from_le_bytes(record[4 * i..4 * i + 4].try_into().unwrap());
    let (matrices, focal) = cameras(root);
    let (mut difference, mut spread, mut count) = (0.0f32, 0.0f32, 0u32);
    let records: Vec<&[u8]> = ply[start..].chunks_exact(27).collect();
    assert_eq!(records.len(), 300);
    for (view, matrix) in matrices.iter().enumerate().take(3) {
        let image = image::open(root.join(format!("images/{view:03}.png"))).unwrap().to_rgb8();
        let depth = depth(root, &format!("{view:03}"));
        for record in &records {
            let point = Vec3::new(float(record, 0), float(record, 1), float(record, 2));
            let normal = Vec3::new(float(record, 3), float(record, 4), float(record, 5));
            assert!((normal.length() - 1.0).abs() < 1e-4);
            let local = matrix.transform_point3(point);
            let (x, y) = (24.0 + focal * local.x / local.z, 18.0 + focal * local.y / local.z);
            if local.z <= 0.0 || !(0.0..48.0).contains(&x) || !(0.0..36.0).contains(&y) {
                continue;
            }
            let index = y as usize * 48 + x as usize;
            if (depth[index] - local.z).abs() > 0.05 * local.z {
                continue;
            }
            let seen = image.get_pixel(x as u32, y as u32).0;
            let mirrored = image.get_pixel(47 - x as u32, y as u32).0;
            let distance =
                |c: [u8; 3]| (0..3).map(|k| (f32::from(c[k]) - f32::from(record[24 + k])).abs()).sum::<f32>() / 3.0;
            difference += distance(seen);
            spread += distance(mirrored);
            count += 1;
        }
    }
    assert!(count > 300, "{count} sightings");
    let (difference, spread) = (difference / count as f32, spread / count as f32);
    assert!(difference < 16.0 && difference < 0.5 * spread, "{difference} against {spread}");
}

/// Compares the depths of one view, reprojected into the next, with its depths.
fn depths_agree_between_views(root: &Path) {
    let (matrices, focal) = cameras(root);
    let (first, second) = (depth(root, "000"), depth(root, "001"));
    let (mut agree, mut inside) = (0u32, 0u32);
    let across = matrices[1] * matrices[0].inverse();
    for (index, z) in first.iter().enumerate() {
        let (x, y) = ((index % 48) as f32 + 0.5, (index / 48) as f32 + 0.5);
        let local = Vec3::new((x - 24.0) / focal, (y - 18.0) / focal, 1.0) * *z;
        let there = across.transform_point3(local);
        let (u, v) = (24.0 + focal * there.x / there.z, 18.0 + focal * there.y / there.z);
        if there.z <= 0.0 || !(0.0..48.0).contains(&u) || !(0.0..36.0).contains(&v) {
            continue;
        }
        inside += 1;
        // Depths need not agree where the second view is occluded, so a fraction of the pixels suffices.
        let seen = second[v as usize * 48 + u as usize];
        agree += u32::from((seen - there.z).abs() < 0.06 * there.z);
    }
    assert!(inside > 300, "{inside} pixels overlap");
    assert!(agree as f32 > 0.6 * inside as f32, "{agree} of {inside}");
}

#[test]
fn output_is_independent_of_thread_count() {
    let folder = tempfile::tempdir().unwrap();
    let options = SynthOptions { views: 2, samples_per_pixel: 4, points: 50, ..options(SceneName::Box) };
    let with = |threads: usize, name: &str| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let out = folder.path().join(name);
        pool.install(|| make(&out, &options));
        files(&out)
    };
    let (one, many) = (with(1, "one"), with(3, "many"));
    assert_eq!(one.keys().collect::<Vec<_>>(), many.keys().collect::<Vec<_>>());
    for (name, bytes) in &one {
        assert!(bytes == &many[name], "{name} differs");
    }
    let other = folder.path().join("other");
    make(&other, &SynthOptions { seed: 9, ..options });
    assert_ne!(files(&other)["images/000.png"], one["images/000.png"]);
}

#[test]
fn all_scenes_generate() {
    let folder = tempfile::tempdir().unwrap();
    for name in SceneName::ALL {
        let small = SynthOptions { views: 2, width: 24, height: 16, samples_per_pixel: 2, points: 20, ..options(name) };
        let out = folder.path().join(name.as_str());
        let summary = make(&out, &small);
        assert!(summary.mean > 0.15 && summary.clipped < 0.2, "{name}: {summary:?}");
        assert_eq!(out.join("gt/environment.exr").exists(), name == SceneName::EnvOnly);
    }
}

#[test]
fn errors_name_option_value_and_limits() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("scene");
    let fail = |options: SynthOptions| generate(&out, &options, &|_, _| {}).unwrap_err().to_string();
    let base = options(SceneName::Box);
    assert_eq!(
        fail(SynthOptions { views: 0, ..base.clone() }),
        "the number of training views is 0 but must lie between 1 and 2000"
    );
    assert_eq!(
        fail(SynthOptions { width: 0, ..base.clone() }),
        "the image width is 0 but must lie between 16 and 2048"
    );
    assert_eq!(
        fail(SynthOptions { height: 1 << 40, ..base.clone() }),
        "the image height is 1099511627776 but must lie between 16 and 2048"
    );
    assert_eq!(
        fail(SynthOptions { samples_per_pixel: 0, ..base.clone() }),
        "the number of samples per pixel is 0 but must lie between 1 and 65536"
    );
    assert_eq!(
        "palace".parse::<SceneName>().unwrap_err().to_string(),
        "there is no scene called `palace`; the scenes are livingroom, diffuse, mirror, envonly, night, box"
    );
    fs::create_dir(&out).unwrap();
    fs::write(out.join("thesis.txt"), "mine").unwrap();
    let occupied = fail(base.clone());
    assert!(occupied.ends_with("already holds something; name another directory, or replace a scene with --force"));
    let error = fail(SynthOptions { replace: true, ..base.clone() });
    assert!(error.ends_with("is not replaced because it is no scene directory: it holds no file of cameras"));
    assert_eq!(fs::read(out.join("thesis.txt")).unwrap(), b"mine");
    let nowhere = generate(Path::new("/"), &base, &|_, _| {}).unwrap_err();
    assert!(matches!(nowhere, SynthError::BadPath(_)));
}
