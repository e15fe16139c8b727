//! Metrics of `sgs eval` for a run with materials: gains, relit sets, speed.

use serde_json::{Value, json};
use sgs_scene::{Image, linear_to_srgb, read_exr, write_exr};
use sgs_tests::Place;
use sgs_tests::cli::sgs;
use sgs_tests::rooms::Room;

/// Creates a room, and a short run with materials in `run`.
fn place() -> Place {
    let place = Place::new(Room { priors: true, ..Room::default() });
    train_materials(&place);
    place
}

/// Trains the scene of a place into `run`: few steps of geometry and materials.
pub(crate) fn train_materials(place: &Place) {
    let steps = ["--geometry-steps", "20", "--no-densify", "--intrinsic-steps", "4", "--stage", "all"];
    let sets = [
        "transport.surfels=0",
        "intrinsic.environment.resolution=16",
        "intrinsic.lights.grid=2",
        "intrinsic.visibility.kind=none",
    ];
    let mut arguments: Vec<String> = ["train", &place.text("scene"), "-o", &place.text("run")].map(String::from).into();
    arguments.extend(steps.map(String::from));
    arguments.extend(sets.iter().flat_map(|set| ["--set".to_owned(), (*set).to_owned()]));
    sgs(&arguments).ok();
}

/// Evaluates `run` at the test views.
fn evaluated(place: &Place) -> Value {
    sgs(&["eval", &place.text("run"), "--json"]).ok().json()
}

/// Writes a channel of the run at the test views and returns the stems.
///
/// Files are `shown/STEM_CHANNEL.exr`.
fn show(place: &Place, channel: &str) -> Vec<String> {
    let (_, test) = Room::default().split();
    let mut cameras: Value = serde_json::from_slice(&place.read("scene/transforms.json")).unwrap();
    let is_test = |frame: &Value| test.iter().any(|stem| frame["file_path"].as_str().unwrap().contains(stem.as_str()));
    cameras["frames"].as_array_mut().unwrap().retain(is_test);
    std::fs::write(place.path("cameras.json"), cameras.to_string()).unwrap();
    let (run, file, to) = (place.text("run"), place.text("cameras.json"), place.text("shown"));
    sgs(&["render", &run, "--cameras", &file, "-o", &to, "--channels", channel, "--format", "exr"]).ok();
    test
}

fn displayed(linear: f64) -> f64 {
    f64::from(linear_to_srgb(linear.clamp(0.0, 1.0) as f32))
}

/// The albedo gain of each channel is common to all test views.
///
/// Ground-truth albedo is 0.5 times the run's in one view and 0.9 times in the other. The expected gain follows its
/// definition.
#[test]
fn the_albedo_gain_is_common_to_all_test_views() {
    let place = place();
    let test = show(&place, "albedo");
    std::fs::create_dir_all(place.path("scene/gt/albedo")).unwrap();
    let factors = [0.5_f32, 0.9];
    let mut pairs = Vec::new();
    for (stem, factor) in test.iter().zip(factors) {
        let ours = read_exr(&place.path(&format!("shown/{stem}_albedo.exr"))).unwrap().image;
        let truth = Image { data: ours.data.iter().map(|v| factor * v).collect(), ..ours.clone() };
        let path = place.path(&format!("scene/gt/albedo/{stem}.exr"));
        write_exr(&path, &truth, &["R", "G", "B"]).unwrap();
        pairs.push((ours, read_exr(&path).unwrap().image));
    }
    let gains: Vec<f64> = (0..3)
        .map(|c| {
            let values = pairs.iter().flat_map(|(a, b)| a.data.iter().zip(&b.data).skip(c).step_by(3));
            let (ab, aa) = values.fold((0.0, 0.0), |(ab, aa), (a, b)| {
                (ab + f64::from(*a) * f64::from(*b), aa + f64::from(*a) * f64::from(*a))
            });
            ab / aa
        })
        .collect();
    assert!(gains.iter().all(|g| (0.5..0.9).contains(g)), "{gains:?}");
    let metrics = evaluated(&place);
    let mut sum = 0.0;
    for (i, (ours, truth)) in pairs.iter().enumerate() {
        let values = ours.data.iter().zip(&truth.data).enumerate();
        let squares =
            values.map(|(at, (a, b))| (displayed(gains[at % 3] * f64::from(*a)) - displayed(f64::from(*b))).powi(2));
        let expected = -10.0 * (squares.sum::<f64>() / ours.data.len() as f64).log10();
        let albedo = &metrics["views"][i]["albedo"];
        let found = albedo["psnr_scaled"].as_f64().unwrap();
        assert!((found - expected).abs() < 0.01, "{found}, not {expected}");
        assert!(albedo["psnr_scaled_per_view"].as_f64().unwrap() > found + 3.0, "{albedo}");
        sum += expected;
    }
    let mean = metrics["mean"]["albedo"]["psnr_scaled"].as_f64().unwrap();
    assert!((mean - 0.5 * sum).abs() < 0.01, "{mean}, not {}", 0.5 * sum);
}

/// Each folder of `gt/relit` is reported.
///
/// The report has metrics, or the reason why they are missing.
#[test]
fn every_relit_set_is_reported() {
    let place = place();
    let (_, test) = Room::default().split();
    let gray = Image { width: 32, height: 24, channels: 3, data: vec![0.25; 3 * 32 * 24] };
    let set = |name: &str, stems: &[String]| {
        let folder = place.path(&format!("scene/gt/relit/{name}"));
        std::fs::create_dir_all(&folder).unwrap();
        for stem in stems {
            write_exr(&folder.join(format!("{stem}.exr")), &gray, &["R", "G", "B"]).unwrap();
        }
    };
    for name in ["lit", "dark", "unknown", "painted", "mean"] {
        set(name, &test);
    }
    set("empty", &[]);
    let light = json!({"on": true, "position": [0, 0, 0], "point_light_intensity_equivalent": [1, 1, 1]});
    let dark = json!({"on": true, "position": [0, 0, 0]});
    let lights = json!({"training": [light], "relight": {"lit": [light], "dark": [dark], "mean": [light]}});
    std::fs::write(place.path("scene/gt/lights.json"), lights.to_string()).unwrap();
    std::fs::write(place.path("scene/gt/relit/painted.json"), r#"{"weights": [1, 2]}"#).unwrap();
    let metrics = evaluated(&place);
    let relit = metrics["mean"]["relit"].as_object().unwrap();
    let names: Vec<&str> = relit.keys().map(String::as_str).collect();
    assert_eq!(names, ["dark", "empty", "lit", "mean", "mean_set", "painted", "unknown"]);
    for (name, word) in
        [("dark", "no intensity"), ("empty", "no image"), ("painted", "painted.json"), ("unknown", "unknown.json")]
    {
        let reason = relit[name]["reason"].as_str().unwrap();
        assert!(reason.contains(word) && reason.ends_with('.'), "{name}: {reason}");
        assert!(relit[name].get("psnr").is_none());
        assert!(metrics["views"][0]["relit"].get(name).is_none());
    }
    for key in ["psnr", "ssim", "psnr_gain"] {
        let of = |name: &str| relit[name][key].as_f64().unwrap();
        assert!((of("mean") - of("lit")).abs() < 1e-9 && (of("mean_set") - of("lit")).abs() < 1e-9, "{relit:?}");
    }
    // The ground truth is uniform gray: a gain raises PSNR, but cannot match it.
    assert!(relit["lit"]["psnr_gain"].as_f64().unwrap() > relit["lit"]["psnr"].as_f64().unwrap(), "{relit:?}");
    let fps = &metrics["mean"]["fps"];
    assert!(fps["nvs"].as_f64().unwrap() > 0.0 && fps["pbr"].as_f64().unwrap() > 0.0, "{fps}");
    let recorded: Value = serde_json::from_slice(&place.read("run/metrics.json")).unwrap();
    assert_eq!((&recorded["fps"], &recorded["test"]), (fps, &metrics));
    let table = sgs(&["eval", &place.text("run")]).ok().stdout;
    for words in ["mean of relit sets", "unknown              not measured: Neither", "frames per second"] {
        assert!(table.contains(words), "{words}: {table}");
    }
}

/// Geometry alone cannot be relit, and each set reports that reason.
#[test]
fn relit_sets_of_a_run_without_materials_have_a_reason() {
    let place = Place::new(Room::default());
    sgs(&place.arguments("run", 10, &[])).ok();
    std::fs::create_dir_all(place.path("scene/gt/relit/night")).unwrap();
    let mean = evaluated(&place)["mean"].clone();
    assert!(mean["relit"]["night"]["reason"].as_str().unwrap().contains("no materials"), "{mean}");
    assert!(mean["fps"]["nvs"].as_f64().unwrap() > 0.0 && mean["fps"].get("pbr").is_none(), "{mean}");
}
