//! LPIPS against the `lpips` package, with the same synthetic weights.
//!
//! `make_lpips.py` in `tests/data/metrics` wrote the expected values. Also tests metrics and errors of the command
//! line.

use safetensors::Dtype;
use safetensors::tensor::TensorView;
use serde_json::{Value, json};
use sgs_evaluate::metrics::{Lpips, LpipsRange, MetricError};
use sgs_scene::Image;
use sgs_tests::Place;
use sgs_tests::cli::sgs;
use sgs_tests::rooms::Room;
use std::collections::HashMap;
use std::path::Path;

/// Index of a convolution, outputs, inputs, kernel width.
type Shape = (usize, usize, usize, usize);

const VGG: [Shape; 13] = [
    (0, 64, 3, 3),
    (2, 64, 64, 3),
    (5, 128, 64, 3),
    (7, 128, 128, 3),
    (10, 256, 128, 3),
    (12, 256, 256, 3),
    (14, 256, 256, 3),
    (17, 512, 256, 3),
    (19, 512, 512, 3),
    (21, 512, 512, 3),
    (24, 512, 512, 3),
    (26, 512, 512, 3),
    (28, 512, 512, 3),
];
const ALEX: [Shape; 5] = [(0, 64, 3, 11), (3, 192, 64, 5), (6, 384, 192, 3), (8, 256, 384, 3), (10, 256, 256, 3)];

/// Yields the same numbers as `uniform` in `make_lpips.py`.
fn uniform(tensor: u32, count: usize) -> impl Iterator<Item = f64> {
    (0..count as u32).map(move |i| {
        let mut x = i.wrapping_mul(0x85eb_ca6b).wrapping_add((tensor + 1).wrapping_mul(0x9e37_79b1));
        x = (x ^ (x >> 16)).wrapping_mul(0x7feb_352d);
        x = (x ^ (x >> 15)).wrapping_mul(0x846c_a68b);
        x ^= x >> 16;
        f64::from(x >> 8) / f64::from(1 << 24)
    })
}

/// Names, shapes and values of tensors.
type Tensors = Vec<(String, Vec<usize>, Vec<f32>)>;

/// Returns the weights of `made_up` in `make_lpips.py`.
fn made_up(net: &str) -> Tensors {
    let (shapes, heads) = match net {
        "vgg" => (&VGG[..], [64, 128, 256, 512, 512]),
        _ => (&ALEX[..], [64, 192, 384, 256, 256]),
    };
    let mut all = Tensors::new();
    for &(at, outputs, inputs, width) in shapes {
        for (what, shape) in [("weight", vec![outputs, inputs, width, width]), ("bias", vec![outputs])] {
            let reach = if what == "weight" { (6.0 / (inputs * width * width) as f64).sqrt() } else { 0.1 };
            let numbers = uniform(all.len() as u32, shape.iter().product());
            let numbers = numbers.map(|u| ((2.0 * u - 1.0) * reach) as f32).collect();
            all.push((format!("features.{at}.{what}"), shape, numbers));
        }
    }
    for (i, channels) in heads.into_iter().enumerate() {
        let numbers = uniform(all.len() as u32, channels).map(|u| u as f32).collect();
        all.push((format!("heads.{i}"), vec![channels], numbers));
    }
    all
}

fn write(path: &Path, tensors: &Tensors, meta: &[(&str, &str)]) {
    let meta: HashMap<String, String> = meta.iter().map(|(k, v)| ((*k).to_owned(), (*v).to_owned())).collect();
    let bytes: Vec<Vec<u8>> =
        tensors.iter().map(|(_, _, n)| n.iter().flat_map(|v| v.to_le_bytes()).collect()).collect();
    let views = tensors
        .iter()
        .zip(&bytes)
        .map(|((name, shape, _), bytes)| (name.clone(), TensorView::new(Dtype::F32, shape.clone(), bytes).unwrap()));
    std::fs::write(path, safetensors::serialize(views, Some(meta)).unwrap()).unwrap();
}

fn meta(net: &str) -> [(&str, &str); 2] {
    [("format", "sgs-lpips-1"), ("net", net)]
}

fn data() -> std::path::PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("data/metrics")
}

fn load_image(name: &str) -> Image {
    let stored = image::open(data().join(format!("{name}.png"))).unwrap().into_rgb8();
    let (width, height) = stored.dimensions();
    Image::from_data(width, height, 3, stored.iter().map(|v| f32::from(*v) / 255.0).collect()).unwrap()
}

#[test]
fn lpips_matches_package() {
    let expected: Value = serde_json::from_slice(&std::fs::read(data().join("lpips.json")).unwrap()).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let truth = load_image("truth");
    for net in ["vgg", "alex"] {
        let path = folder.path().join(net);
        write(&path, &made_up(net), &meta(net));
        let plain = Lpips::load(&path, LpipsRange::Plain).unwrap();
        let signed = Lpips::load(&path, LpipsRange::Signed).unwrap();
        assert_eq!((plain.about().net, plain.about().range, signed.about().range), (net, [0, 1], [-1, 1]));
        let pairs = expected["nets"][net].as_object().unwrap();
        assert!(pairs.len() >= 6);
        for (name, pair) in pairs {
            let image = load_image(name);
            // Absolute and relative errors are below 1e-4.
            let near = |found: f64, expected: &Value, what: &str| {
                let expected = expected.as_f64().unwrap();
                let apart = (found - expected).abs();
                assert!(apart < 1e-4 && apart < 1e-4 * expected, "{net} {name} {what}: {found} {expected}");
            };
            let stages = plain.stages(&image, &truth, None).unwrap();
            assert_eq!(stages.len(), 5);
            stages.iter().enumerate().for_each(|(i, v)| near(*v, &pair["layers"][i], &format!("stage {i}")));
            near(stages.iter().sum(), &pair["lpips"], "in all");
            near(signed.distance(&image, &truth, None).unwrap(), &pair["normalized"], "signed");
        }
        assert_eq!(plain.distance(&truth, &truth, None).unwrap(), 0.0);
        // If the mask excludes all pixels, the distance is zero.
        let image = load_image("missing");
        let mut mask = Image::new(truth.width, truth.height, 1);
        mask.data.iter_mut().enumerate().for_each(|(p, v)| *v = f32::from(p as u32 % truth.width > 36));
        let part = plain.distance(&image, &truth, Some(&mask)).unwrap();
        let whole = plain.distance(&image, &truth, None).unwrap();
        assert!(part < 0.5 * whole, "{part} {whole}");
        mask.data.fill(0.0);
        assert!(matches!(plain.distance(&image, &truth, Some(&mask)), Err(MetricError::Empty { .. })));
        let small = Image::new(40, 15, 3);
        let error = plain.distance(&small, &small, None).unwrap_err().to_string();
        assert!(error.starts_with("lpips needs images of at least"), "{error}");
    }
}

/// A small change of any tensor changes the distance beyond the tolerance.
#[test]
fn every_tensor_affects_the_distance() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("alex");
    let (image, truth) = (load_image("dark"), load_image("truth"));
    let distance = |tensors: &Tensors| {
        write(&path, tensors, &meta("alex"));
        Lpips::load(&path, LpipsRange::Plain).unwrap().distance(&image, &truth, None).unwrap()
    };
    let tensors = made_up("alex");
    let right = distance(&tensors);
    for i in 0..tensors.len() {
        let mut changed = tensors.clone();
        changed[i].2.iter_mut().for_each(|v| *v *= 1.1);
        let apart = (distance(&changed) - right).abs();
        assert!(apart > 2e-4 * right, "{}: {apart} of {right}", tensors[i].0);
    }
}

#[test]
fn runs_are_measured_and_bad_files_refused() {
    let place = Place::new(Room { size: [48, 36], ..Room::default() });
    sgs(&place.arguments("run", 4, &["-q"])).ok();
    let run = place.text("run");
    let file = place.text("alex.safetensors");
    let path = place.path("alex.safetensors");
    let tensors = made_up("alex");
    write(&path, &tensors, &meta("alex"));
    let eval = |more: &[&str]| sgs(&[&["eval", &run][..], more].concat());
    let metrics = || -> Value { serde_json::from_slice(&place.read("run/metrics.json")).unwrap() };
    let table = eval(&[]).ok().stdout;
    assert!(!table.contains("LPIPS"));
    assert!(metrics().pointer("/test/mean/nvs/lpips").is_none() && metrics().pointer("/test/lpips").is_none());
    let table = eval(&["--lpips", &file]).ok().stdout;
    let all = metrics();
    assert_eq!(all["test"]["lpips"], json!({"net": "alex", "version": "0.1", "range": [0, 1]}));
    let views = all["test"]["views"].as_array().unwrap();
    let each: Vec<f64> = views.iter().map(|v| v["nvs"]["lpips"].as_f64().unwrap()).collect();
    let mean = all["test"]["mean"]["nvs"]["lpips"].as_f64().unwrap();
    assert!((mean - each.iter().sum::<f64>() / each.len() as f64).abs() < 1e-12 && mean > 1e-4, "{each:?}");
    assert!(table.contains("LPIPS") && table.contains(&format!("{mean:.4}")), "{table}");
    eval(&["--lpips", &file, "--lpips-signed"]).ok();
    assert_eq!(metrics()["test"]["lpips"]["range"], json!([-1, 1]));
    assert!(metrics()["test"]["mean"]["nvs"]["lpips"].as_f64().unwrap() > 1.5 * mean);

    let before = place.read("run/metrics.json");
    let refused = |words: &[&str]| {
        eval(&["--lpips", &file]).refused(words);
    };
    let bytes = place.read("alex.safetensors");
    std::fs::write(&path, &bytes[..5000]).unwrap();
    refused(&["alex.safetensors", "damaged or no weights of LPIPS", "lpips_weights.py"]);
    std::fs::write(&path, "PK").unwrap();
    refused(&["damaged or no weights of LPIPS"]);
    write(&path, &tensors, &[]);
    refused(&["no weights of LPIPS", "does not say \"sgs-lpips-1\""]);
    write(&path, &tensors, &meta("squeeze"));
    refused(&["says net \"squeeze\", but must say \"vgg\" or \"alex\""]);
    write(&path, &tensors, &meta("vgg"));
    refused(&["\"features.0.weight\" is F32 [64, 3, 11, 11], but must be F32 [64, 3, 3, 3]"]);
    write(&path, &tensors[1..].to_vec(), &meta("alex"));
    refused(&["there is no \"features.0.weight\" in it"]);
    let changed = |at: usize, value: f32| {
        let mut tensors = tensors.clone();
        tensors[at].2[3] = value;
        write(&path, &tensors, &meta("alex"));
    };
    changed(2, f32::NAN);
    refused(&["\"features.3.weight\" holds values that are not finite"]);
    changed(11, -0.1);
    refused(&["\"heads.1\" holds weights below 0"]);
    std::fs::remove_file(&path).unwrap();
    refused(&["there is no such file"]);
    assert_eq!(eval(&["--lpips-signed"]).status, Some(2));
    assert!(place.read("run/metrics.json") == before);

    // An image smaller than the network's minimum has no distance.
    let place = Place::new(Room::default());
    sgs(&place.arguments("run", 2, &["-q"])).ok();
    write(&path, &tensors, &meta("alex"));
    sgs(&["eval", &place.text("run"), "--lpips", &file]).refused(&["at least 31 × 31 pixels", "32 × 24"]);
    assert!(!place.path("run/metrics.json").exists());
}
