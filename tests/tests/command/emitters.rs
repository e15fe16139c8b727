//! Emitters of a run in `sgs render`: images under all of them, and layers of one each.

use exr::prelude::{ReadChannels, ReadLayers, read};
use sgs_scene::read_exr;
use sgs_tests::cli::sgs;
use sgs_tests::emitting::{EMITTERS, fabricate_emitting};
use std::path::Path;

/// Returns names and linear values of the layers of an EXR file.
fn layers(path: &Path) -> Vec<(String, Vec<[f32; 3]>)> {
    let all = read().no_deep_data().largest_resolution_level().all_channels().all_layers().all_attributes();
    let file = all.from_file(path).unwrap();
    let of = |layer: &exr::image::Layer<_>| {
        let channels: &exr::image::AnyChannels<exr::image::FlatSamples> = &layer.channel_data;
        // In alphabetical order: B, G, R.
        let values: Vec<Vec<f32>> = channels.list.iter().map(|c| c.sample_data.values_as_f32().collect()).collect();
        assert_eq!(values.len(), 3);
        let pixels = (0..values[0].len()).map(|i| [values[2][i], values[1][i], values[0][i]]);
        (layer.attributes.layer_name.as_ref().unwrap().to_string(), pixels.collect())
    };
    file.layer_data.iter().map(of).collect()
}

#[test]
fn layers_of_emitters_add_up_to_the_image() {
    let folder = tempfile::tempdir().unwrap();
    fabricate_emitting(folder.path());
    let text = |name: &str| folder.path().join(name).display().to_string();
    let (run, out) = (text("run"), text("out"));
    sgs(&["render", &run, "-o", &out, "--channels", "pbr,albedo", "--lights", "--format", "exr"]).ok();
    let mut files: Vec<_> = std::fs::read_dir(&out).unwrap().map(|f| f.unwrap().path()).collect();
    files.sort();
    assert_eq!(files.len(), 6, "{files:?}");
    for stem in ["001", "005"] {
        let at = |name: &str| Path::new(&out).join(format!("{stem}_{name}.exr"));
        let (all, parts) = (read_exr(&at("pbr")).unwrap().image, layers(&at("lights")));
        let names: Vec<&str> = parts.iter().map(|(name, _)| name.as_str()).collect();
        assert_eq!(names, EMITTERS);
        let lit = |i: usize| parts[i].1.iter().flatten().any(|v| *v > 0.01);
        // The last emitter is off.
        assert_eq!([lit(0), lit(1), lit(2)], [true, true, false]);
        let largest = all.data.iter().copied().fold(0.0, f32::max);
        for (i, pixel) in all.data.chunks(3).enumerate() {
            for c in 0..3 {
                let sum: f32 = parts.iter().map(|(_, values)| values[i][c]).sum();
                assert!((pixel[c] - sum).abs() <= 1e-6 * largest + 1e-5 * pixel[c], "{} {sum}", pixel[c]);
            }
        }
    }
    // PNG files are for the other channels.
    sgs(&["render", &run, "-o", &out, "--channels", "lights", "--force"]).ok();
    assert!(Path::new(&out).join("001_lights.exr").is_file());
}

#[test]
fn what_emitters_cannot_show_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    fabricate_emitting(folder.path());
    let text = |name: &str| folder.path().join(name).display().to_string();
    let (run, out) = (text("run"), text("out"));
    let render = |more: &[&str]| sgs(&[&["render", &run, "-o", &out][..], more].concat());
    render(&["--channels", "visibility"]).refused_with(2, &["lit by emitters", "leave \"visibility\" out"]);
    let emitters = folder.path().join("run/emitters.json");
    let file = std::fs::read_to_string(&emitters).unwrap();
    std::fs::write(&emitters, file.replace("light 2", "燈")).unwrap();
    render(&["--lights"]).refused_with(2, &["The emitter \"燈\" cannot name a layer", "rename it"]);
    std::fs::write(&emitters, "{}").unwrap();
    render(&["--lights"]).refused(&["emitters.json"]);
    // Without emitters and lights.
    std::fs::remove_file(&emitters).unwrap();
    render(&["--lights"]).refused_with(2, &["has no lights; leave out --lights"]);
    std::fs::write(&emitters, file).unwrap();
    std::fs::rename(folder.path().join("scene"), folder.path().join("moved")).unwrap();
    render(&["--channels", "pbr"]).refused(&["scene", "--scene"]);
    assert!(!Path::new(&out).exists());
    render(&["--channels", "pbr", "--scene", &text("moved")]).ok();
}

#[test]
fn report_shows_each_emitter_alone_and_switched_off() {
    let folder = tempfile::tempdir().unwrap();
    fabricate_emitting(folder.path());
    let text = |name: &str| folder.path().join(name).display().to_string();
    let (run, page) = (text("run"), text("page.html"));
    sgs(&["report", &run, "-o", &page, "--views", "1"]).ok();
    let html = std::fs::read_to_string(&page).unwrap();
    assert!(html.contains("id=\"emitters\"") && html.contains("<figcaption>all emitters"));
    for name in EMITTERS {
        for text in [format!("<figcaption>{name} alone"), format!("<figcaption>without {name}")] {
            assert_eq!(html.matches(&text).count(), 1, "{text}");
        }
    }
    assert!(html.contains("<th>light 2 (off)</th><td>point</td><td>0.0 %</td>"));
    std::fs::remove_file(folder.path().join("run/emitters.json")).unwrap();
    sgs(&["report", &run, "-o", &page, "--views", "1"]).ok();
    assert!(!std::fs::read_to_string(&page).unwrap().contains("id=\"emitters\""));
}
