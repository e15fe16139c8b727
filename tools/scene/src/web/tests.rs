use super::*;
use crate::splats::tests::waves;
use glam::DMat3;

fn camera() -> Camera {
    Camera {
        name: "</script>\"a\"".into(),
        width: 40,
        height: 30,
        fx: 35.0,
        fy: 36.0,
        cx: 20.5,
        cy: 14.5,
        rotation: DMat3::from_rotation_y(0.3),
        translation: DVec3::new(1.0, 2.0, 3.0),
        near: 0.01,
    }
}

fn page<'a>(splats: &'a Splats, cameras: &'a [Camera], lights: &'a [PageLight]) -> Page<'a> {
    Page { title: "A <b> & \"c\"", splats, cameras, up: DVec3::NEG_Y, background: [0.0; 3], lights, light_degree: 1 }
}

fn light(name: &str, splats: usize) -> PageLight {
    let response = (0..12 * splats).map(|i| (i as f32 * 0.37).sin() * 5.0).collect();
    PageLight { name: name.into(), on: name == "a", color: [1.0, 0.5, 0.25], response }
}

/// Returns the bytes of a chunk's file.
fn bytes(folder: &Path, chunk: usize) -> Vec<u8> {
    let text = std::fs::read_to_string(folder.join(format!("data-{chunk:04}.js"))).unwrap();
    let text = text.strip_prefix(&format!("sgs_chunk({chunk}, \"")).unwrap().strip_suffix("\");\n").unwrap();
    BASE64_STANDARD.decode(text).unwrap()
}

/// Returns the description in `scene.js`.
fn description(folder: &Path) -> serde_json::Value {
    let text = std::fs::read_to_string(folder.join("scene.js")).unwrap();
    serde_json::from_str(text.strip_prefix("sgs_scene(").unwrap().strip_suffix(");\n").unwrap()).unwrap()
}

#[track_caller]
fn near(found: f32, expected: f64, bound: f64) {
    assert!((f64::from(found) - expected).abs() <= bound, "{found} {expected}");
}

#[test]
fn values_of_all_chunks_are_read_back_in_order_within_bounds() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path().join("new/page");
    let n = CHUNK + 77;
    for degree in [0, 3] {
        let mut splats = waves(n, degree);
        // Neither of them shows.
        splats.opacity_logits[5] = -9.0;
        splats.means[CHUNK][1] = f32::NAN;
        let (cameras, lights) = ([camera()], [light("a", n), light("b", n)]);
        let written = write_page(&root, &page(&splats, &cameras, &lights)).unwrap();
        assert_eq!((written.splats, written.files.len()), (n - 2, 7));
        let size: u64 = written.files.iter().map(|f| std::fs::metadata(f).unwrap().len()).sum();
        assert_eq!((written.bytes, &written.files[0]), (size, &root.join("index.html")));
        let kept: Vec<usize> = (0..n).filter(|i| ![5, CHUNK].contains(i)).collect();
        for (chunk, kept) in kept.chunks(CHUNK).enumerate() {
            let bytes = bytes(&root, chunk);
            let read = PageChunk::read(&bytes, degree, 1, 2).unwrap();
            assert!(PageChunk::read(&bytes[1..], degree, 1, 2).is_none());
            assert_eq!((read.splats.len(), read.responses.len()), (kept.len(), 2));
            read.splats.check().unwrap();
            for (k, &i) in kept.iter().enumerate() {
                assert_eq!(read.splats.means[k], splats.means[i]);
                for c in 0..3 {
                    near(read.splats.log_scales[k][c], splats.log_scales[i][c].into(), 1.9e-4);
                }
                near(logistic(read.splats.opacity_logits[k]) as f32, logistic(splats.opacity_logits[i]), 7.7e-6);
                let unit = crate::activation::unit(splats.rotations[i]);
                (0..4).for_each(|c| near(read.splats.rotations[k][c], unit[c], 1.6e-5));
                for band in 0..=degree {
                    let width = 3 * (2 * band + 1);
                    for c in 0..width {
                        let expected = f64::from(splats.sh[band][i * width + c]);
                        near(read.splats.sh[band][k * width + c], expected, (expected.abs() / 2048.0).max(3e-8));
                    }
                }
                for (response, light) in read.responses.iter().zip(&lights) {
                    for c in 0..12 {
                        let expected = f64::from(light.response[12 * i + c]);
                        near(response[12 * k + c], expected, (expected.abs() / 2048.0).max(3e-8));
                    }
                }
            }
        }
        std::fs::remove_dir_all(&root).unwrap();
    }
}

#[test]
fn scene_is_described_and_titles_are_escaped() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path().join("page");
    let splats = waves(20, 1);
    write_page(&root, &page(&splats, &[camera()], &[light("a", 20)])).unwrap();
    let d = description(&root);
    assert_eq!(d["antialiased"], false);
    assert_eq!((&d["degree"], &d["light_degree"], &d["chunk"]), (&1.into(), &1.into(), &CHUNK.into()));
    let view = &d["views"][0];
    assert_eq!((&view["name"], &view["size"]), (&"</script>\"a\"".into(), &json!([40, 30])));
    let position = camera().position();
    for k in 0..3 {
        assert!((view["position"][k].as_f64().unwrap() - position[k]).abs() < 1e-12);
        assert!((view["rotation"][k][0].as_f64().unwrap() - camera().rotation.row(k).x).abs() < 1e-12);
    }
    assert_eq!(d["lights"], json!([{"name": "a", "on": true, "color": [1.0, 0.5, 0.25]}]));
    let data: u64 = ["index.html", "viewer.js", "controls.js", "license.txt", "data-0000.js"]
        .map(|f| std::fs::metadata(root.join(f)).unwrap().len())
        .iter()
        .sum();
    assert_eq!(d["bytes"], data);
    let html = std::fs::read_to_string(root.join("index.html")).unwrap();
    assert!(html.contains("<title>A &lt;b&gt; &amp; &quot;c&quot;</title>") && !html.contains("{{"));
}

#[test]
fn what_cannot_be_shown_is_refused_and_nothing_is_left() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path().join("page");
    let (splats, cameras) = (waves(4, 0), [camera()]);
    let fails = |page: &Page<'_>, words: &str| {
        let error = write_page(&root, page).unwrap_err().to_string();
        assert!(error.contains(words), "{error}");
    };
    fails(&page(&Splats::default(), &cameras, &[]), "the page: it has no splat that shows; export a trained scene");
    let faint = Splats { opacity_logits: vec![-9.0; 4], ..splats.clone() };
    fails(&page(&faint, &cameras, &[]), "no splat that shows");
    fails(&page(&splats, &[], &[]), "no camera");
    fails(&page(&splats, &cameras, &[light("b", 3)]), "the light \"b\" has 36 numbers, but 48 are needed");
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
    // A folder with a file stays as it is; an empty one is used.
    std::fs::create_dir(&root).unwrap();
    std::fs::write(root.join("mine.txt"), "kept").unwrap();
    fails(&page(&splats, &cameras, &[]), "holds files; name a new or an empty directory");
    assert_eq!(std::fs::read_dir(&root).unwrap().count(), 1);
    std::fs::remove_file(root.join("mine.txt")).unwrap();
    write_page(&root, &page(&splats, &cameras, &[])).unwrap();
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1, "no temporary folder is left");
}

#[cfg(unix)]
#[test]
fn failed_page_leaves_no_folder() {
    use std::os::unix::fs::PermissionsExt;
    let folder = tempfile::tempdir().unwrap();
    let closed = folder.path().join("closed");
    std::fs::create_dir(&closed).unwrap();
    std::fs::set_permissions(&closed, std::fs::Permissions::from_mode(0o500)).unwrap();
    let splats = waves(4, 0);
    // An administrator may write everywhere.
    if std::fs::write(closed.join("a"), "").is_err() {
        let error = write_page(&closed.join("page"), &page(&splats, &[camera()], &[])).unwrap_err().to_string();
        assert!(error.starts_with("cannot create"), "{error}");
    }
    std::fs::remove_file(closed.join("a")).ok();
    // A file in place of the target's folder.
    std::fs::write(folder.path().join("file"), "").unwrap();
    assert!(write_page(&folder.path().join("file/page"), &page(&splats, &[camera()], &[])).is_err());
    assert!(write_page(&folder.path().join("file"), &page(&splats, &[camera()], &[])).is_err());
    std::fs::set_permissions(&closed, std::fs::Permissions::from_mode(0o700)).unwrap();
    let names: Vec<_> = std::fs::read_dir(folder.path()).unwrap().map(|e| e.unwrap().file_name()).collect();
    assert_eq!(names.len(), 2, "{names:?}");
}
