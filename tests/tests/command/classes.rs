//! Semantic classes of a trained run with known classes: rendering, queries, accuracy.

use glam::{DVec2, DVec3, Vec3};
use sgs_config::Settings;
use sgs_passes::loss::normalize_embeddings;
use sgs_passes::reference::rng::Pcg;
use sgs_passes::scene::{AUGMENTED, EMBEDDING, FEATURES};
use sgs_run::{RunDirectory, SemanticHead};
use sgs_scene::{
    GroundTruth, GroundTruthKind, Image, RegionMap, Scene, SceneOptions, Splats, TextEmbeddings, read_exr, write_ids,
};
use sgs_tests::Place;
use sgs_tests::cli::{Finished, sgs};
use sgs_tests::rooms::Room;
use std::path::Path;

/// Class names by id. Id 0 is no class.
const CLASSES: [&str; 7] = ["background", "left wall", "carpet", "ceiling", "floor", "right/wall", "front wall"];
const TEMPERATURE: f32 = 0.25;
const CEILING: usize = 3;
const SIZE: [u32; 2] = [48, 36];

/// Returns the class of a position.
///
/// The room has six parts: left, middle and right, each with an upper and a lower half.
fn class(p: DVec3) -> usize {
    let column = if p.x < -0.3 { 0 } else { 1 + usize::from(p.x > 0.3) };
    1 + 2 * column + usize::from(p.y > 0.0)
}

/// Builds class texts and a decoder.
///
/// Text embeddings are not normalized. The decoder maps feature k to the normalized text embedding of class k.
fn head() -> SemanticHead {
    let mut rng = Pcg::new(3);
    let data: Vec<f32> = (0..CLASSES.len() * EMBEDDING).map(|_| 2.0 * rng.normal() as f32).collect();
    let mut decoder = vec![0.0; EMBEDDING * AUGMENTED];
    for (k, text) in normalize_embeddings(&data).chunks(EMBEDDING).enumerate() {
        text.iter().enumerate().for_each(|(row, t)| decoder[row * AUGMENTED + k] = *t);
    }
    let text = TextEmbeddings { labels: CLASSES.map(str::to_owned).to_vec(), channels: EMBEDDING, data };
    SemanticHead { decoder, text, temperature: TEMPERATURE }
}

/// Room with classes as ground truth, and a run on it.
///
/// The run has opaque splats everywhere except on the ceiling, which has none.
struct Known(Place);

impl Known {
    fn new() -> Known {
        let place = Place::new(Room { views: 5, size: SIZE, spacing: 1, truth: true, ..Room::default() });
        let scene = open(&place);
        std::fs::create_dir(place.path("scene/gt/semantic")).unwrap();
        for view in 0..scene.views.len() {
            let camera = &scene.views[view].camera;
            let depth = GroundTruth::of(&scene).load(GroundTruthKind::Depth, view).unwrap().unwrap();
            let id = |(at, z): (usize, &f32)| {
                let pixel = DVec2::new((at as u32 % SIZE[0]).into(), (at as u32 / SIZE[0]).into()) + 0.5;
                class(camera.unproject(pixel, f64::from(*z))) as u16
            };
            let ids: Vec<u16> = depth.data.iter().enumerate().map(id).collect();
            let path = place.path(&format!("scene/gt/semantic/{view:03}.png"));
            write_ids(&path, SIZE[0], SIZE[1], &ids).unwrap();
        }
        let mut splats = Splats::from_points(&scene.points, 0).unwrap();
        splats.opacity_logits.fill(6.0);
        let classes: Vec<usize> = splats.means.iter().map(|m| class(Vec3::from_array(*m).as_dvec3())).collect();
        let feature = |c: &usize| (0..FEATURES).map(|k| if k == *c { 3.0 } else { 0.0 }).collect::<Vec<f32>>();
        splats.semantic = Some((FEATURES, classes.iter().flat_map(feature).collect()));
        splats.means.iter_mut().zip(&classes).filter(|(_, c)| **c == CEILING).for_each(|(m, _)| m[2] = -90.0);
        let run = RunDirectory::create(&place.path("run")).unwrap();
        run.write_settings(&Settings { scene: place.path("scene"), ..Settings::default() }).unwrap();
        splats.write_ply(&run.path("scene.ply")).unwrap();
        head().save(&run.semantics()).unwrap();
        Known(place)
    }

    fn render(&self, source: &str, more: &[&str]) -> Finished {
        let (cameras, out) = (self.0.text("scene/transforms.json"), self.0.text("out"));
        let source = self.0.text(source);
        let mut arguments = vec!["render", &source, "--cameras", &cameras, "-o", &out];
        arguments.extend(more);
        sgs(&arguments)
    }

    fn exr(&self, name: &str) -> Image {
        read_exr(&self.0.path("out").join(name)).unwrap().image
    }

    fn truth(&self, view: usize) -> RegionMap {
        GroundTruth::of(&open(&self.0)).semantic(view).unwrap().unwrap()
    }

    /// Writes a changed copy of the run's splats to `name`.
    fn change(&self, name: &str, change: impl FnOnce(&mut Splats)) -> &Known {
        let mut splats = Splats::read_ply(&self.0.path("run/scene.ply")).unwrap();
        change(&mut splats);
        splats.write_ply(&self.0.path(name)).unwrap();
        self
    }
}

fn open(place: &Place) -> Scene {
    Scene::open(&place.path("scene"), &SceneOptions::default()).unwrap()
}

/// Reads an RGBA image or a gray image with alpha, as stored.
fn pixels<const N: usize>(path: &Path) -> Vec<[u8; N]> {
    let image = image::open(path).unwrap();
    assert_eq!([image.width(), image.height()], SIZE, "{}", path.display());
    assert_eq!(image.color().channel_count(), N as u8, "{}", path.display());
    image.as_bytes().as_chunks::<N>().0.to_vec()
}

/// Returns whether all pixels within 3 pixels of `at` have its class.
///
/// Splats extend beyond their walls, so that pixels at borders mix classes.
fn inside(truth: &RegionMap, at: usize) -> bool {
    let (x, y) = ((at as u32 % truth.width) as i32, (at as u32 / truth.width) as i32);
    let around = (-3..=3).flat_map(|dy| (-3..=3).map(move |dx| (x + dx, y + dy)));
    around.into_iter().all(|(x, y)| {
        let within = x >= 0 && y >= 0 && x < truth.width as i32 && y < truth.height as i32;
        within && truth.ids[(y as u32 * truth.width + x as u32) as usize] == truth.ids[at]
    })
}

#[test]
fn label_maps_show_the_known_classes() {
    let known = Known::new();
    let answer = known.render("run", &["--channels", "alpha,semantic", "--format", "exr", "--json"]).ok().json();
    assert_eq!(answer["files"].as_array().unwrap().len(), 2 * 5);
    known.render("run", &["--channels", "semantic"]).ok();
    let legend: serde_json::Value = serde_json::from_slice(&known.0.read("out/labels.json")).unwrap();
    assert_eq!(answer["labels"], known.0.text("out/labels.json"));
    assert_eq!(legend["none"], -1);
    let classes = legend["classes"].as_array().unwrap();
    let names: Vec<_> = classes.iter().map(|c| c["name"].as_str().unwrap()).collect();
    assert_eq!(names, CLASSES);
    let colors: Vec<[u8; 3]> = classes
        .iter()
        .map(|c| {
            let rgb = u32::from_str_radix(&c["color"].as_str().unwrap()[1..], 16).unwrap().to_be_bytes();
            [rgb[1], rgb[2], rgb[3]]
        })
        .collect();
    let (mut seen, mut missing) = ([0; CLASSES.len()], 0);
    for view in 0..5 {
        let truth = known.truth(view);
        let labels = known.exr(&format!("{view:03}_semantic.exr"));
        let alpha = known.exr(&format!("{view:03}_alpha.exr"));
        let shown = pixels::<4>(&known.0.path(&format!("out/{view:03}_semantic.png")));
        for (at, (&label, rgba)) in labels.data.iter().zip(&shown).enumerate() {
            // Label and color agree. Empty pixels have neither.
            assert_eq!(label == -1.0, alpha.data[at] < 0.5, "view {view}, pixel {at}: alpha {}", alpha.data[at]);
            if label == -1.0 {
                assert_eq!(*rgba, [0; 4]);
            } else {
                let [r, g, b] = colors[label as usize];
                assert_eq!(*rgba, [r, g, b, 255]);
            }
            if inside(&truth, at) {
                let id = truth.ids[at] as usize;
                match id {
                    CEILING => missing += usize::from(label == -1.0),
                    _ => assert_eq!(label, id as f32, "view {view}, pixel {at}"),
                }
                seen[id] += 1;
            }
        }
    }
    assert!(seen[1..].iter().all(|n| *n > 30), "too little is seen: {seen:?}");
    assert!(missing > 30 && missing * 10 > seen[CEILING] * 9, "{missing} of {}", seen[CEILING]);
}

#[test]
fn relevance_is_the_probability_of_the_class() {
    let known = Known::new();
    let queries = ["--query", "floor", "--query", "right/wall", "--query", "floor"];
    let files = known.render("run", &[&["--json", "--format", "exr"], &queries[..]].concat()).ok().json()["files"]
        .as_array()
        .unwrap()
        .len();
    assert_eq!(files, 3 * 5, "color, and each class once");
    assert!(!known.0.path("out/labels.json").exists(), "there is no map that it explains");
    known.render("run", &[&["--channels", "semantic"], &queries[..]].concat()).ok();
    // The decoded feature of a wall is the text embedding of its class.
    let unit: Vec<f64> = normalize_embeddings(&head().text.data).into_iter().map(f64::from).collect();
    let text = |c: usize| &unit[c * EMBEDDING..][..EMBEDDING];
    let cosine = |a: usize, b: usize| text(a).iter().zip(text(b)).map(|(x, y)| x * y).sum::<f64>();
    let probability_at = |t: f64, wall: usize, c: usize| {
        1.0 / (0..CLASSES.len()).map(|k| ((cosine(wall, k) - cosine(wall, c)) / t).exp()).sum::<f64>()
    };
    let probability = |wall: usize, c: usize| probability_at(f64::from(TEMPERATURE), wall, c);
    let mut compared = 0;
    for (query, name) in [(4, "floor"), (5, "right%2Fwall")] {
        for view in 0..5 {
            let truth = known.truth(view);
            let relevance = known.exr(&format!("{view:03}_semantic_{name}.exr")).data;
            let shown = pixels::<2>(&known.0.path(&format!("out/{view:03}_semantic_{name}.png")));
            for (at, (&r, gray)) in relevance.iter().zip(&shown).enumerate() {
                if r == -1.0 {
                    assert_eq!(*gray, [0, 0]);
                } else {
                    // Black is the probability of chance. White is the probability where the decoded text is the
                    // query's.
                    let chance = 1.0 / CLASSES.len() as f64;
                    let shown = (f64::from(r) - chance) / (probability(query, query) - chance) * 255.0;
                    assert!((f64::from(gray[0]) - shown.clamp(0.0, 255.0)).abs() < 0.51 && gray[1] == 255);
                }
                if inside(&truth, at) && truth.ids[at] as usize != CEILING {
                    let expected = probability(truth.ids[at] as usize, query);
                    assert!((f64::from(r) - expected).abs() < 5e-3, "{name}, view {view}, pixel {at}: {r} {expected}");
                    compared += 1;
                }
            }
        }
    }
    assert!(compared > 1000, "{compared}");
    // Query at a temperature that differs from that of training.
    known.render("run", &["--query", "floor", "--temperature", "1", "--format", "exr"]).ok();
    let (truth, relevance) = (known.truth(0), known.exr("000_semantic_floor.exr").data);
    let at = (0..relevance.len()).find(|at| truth.ids[*at] == 4 && inside(&truth, *at)).unwrap();
    let expected = probability_at(1.0, 4, 4);
    assert!((f64::from(relevance[at]) - expected).abs() < 2e-3, "{} {expected}", relevance[at]);
    for t in ["0", "-1", "nan"] {
        let output = known.render("run", &["--query", "floor", &format!("--temperature={t}")]);
        output.refused(&["--temperature is", "at least 0.001"]);
    }
    assert!(probability(4, 4) > 5.0 * probability(5, 4), "floor and wall are hardly told apart");
}

#[test]
fn accuracy_is_measured_against_the_known_classes() {
    let known = Known::new();
    known.render("run", &["--channels", "semantic", "--format", "exr"]).ok();
    // A pixel is right if its label equals the true class. The room has no class 0.
    let share = |view: usize| {
        let (labels, truth) = (known.exr(&format!("{view:03}_semantic.exr")), known.truth(view));
        let right = labels.data.iter().zip(&truth.ids).filter(|(l, t)| **l == f32::from(**t)).count();
        right as f64 / truth.ids.len() as f64
    };
    let run = known.0.text("run");
    let measured = sgs(&["eval", &run, "--json"]).ok().json();
    let accuracy = measured["mean"]["semantic"]["accuracy"].as_f64().unwrap();
    let expected = share(1);
    assert!((accuracy - expected).abs() < 1e-12, "{accuracy} {expected}");
    assert!((0.5..0.99).contains(&accuracy), "the ceiling is missing, the rest is right: {accuracy}");
    assert_eq!(measured["views"][0]["semantic"]["accuracy"], accuracy);
    let recorded: serde_json::Value = serde_json::from_slice(&known.0.read("run/metrics.json")).unwrap();
    assert_eq!(recorded["test"]["mean"]["semantic"]["accuracy"], accuracy);
    let table = sgs(&["eval", &run, "--images", &known.0.text("out")]).ok().stdout;
    let head = table.lines().next().unwrap();
    assert!(head.trim_end().ends_with("labels"), "{table}");
    assert!(table.contains(&format!("{accuracy:.4}")), "{table}");
    assert!(known.0.path("out/001_semantic.png").is_file() && known.0.path("out/labels.json").is_file());

    // Ground truth may list the classes in another order and omit some.
    let order = ["background", "front wall", "carpet", "right/wall", "floor", "ceiling", "ghost"];
    let text = serde_json::json!({ "labels": order }).to_string();
    std::fs::write(known.0.path("scene/gt/semantic/labels.json"), text).unwrap();
    let other = sgs(&["eval", &run, "--json"]).ok().json()["mean"]["semantic"]["accuracy"].as_f64().unwrap();
    let labels = known.exr("001_semantic.exr");
    let truth = known.truth(1);
    let same = |(l, t): (&f32, &u16)| *l >= 0.0 && CLASSES[*l as usize] == order[*t as usize];
    let right = labels.data.iter().zip(&truth.ids).filter(|p| same(*p)).count();
    assert!((other - right as f64 / truth.ids.len() as f64).abs() < 1e-12 && other != accuracy);
    std::fs::write(known.0.path("scene/gt/semantic/labels.json"), "{").unwrap();
    sgs(&["eval", &run]).refused(&["labels.json"]);
    std::fs::remove_file(known.0.path("scene/gt/semantic/labels.json")).unwrap();

    // Without a head no classes are reported.
    std::fs::remove_file(known.0.path("run/semantics.safetensors")).unwrap();
    let measured = sgs(&["eval", &run, "--json"]).ok().json();
    assert!(measured["mean"].get("semantic").is_none() && measured["mean"]["nvs"]["psnr"].is_f64());
}

#[test]
fn runs_without_classes_are_refused() {
    let known = Known::new();
    let semantic = |source: &str| known.render(source, &["--channels", "rgb,semantic"]);
    known.change("plain.ply", |s| s.semantic = None);
    semantic("plain.ply").refused(&["plain.ply", "holds no semantic features", "priors/semantic"]);
    known.render("plain.ply", &["--query", "floor"]).refused(&["holds no semantic features"]);
    known.change("narrow.ply", |s| s.semantic = Some((2, vec![0.5; 2 * s.len()])));
    semantic("narrow.ply").refused(&["narrow.ply", "2 semantic features a splat", "32"]);
    semantic("run/scene.ply").refused(&["scene.ply", "not the decoder", "semantics.safetensors"]);
    known.render("run/scene.ply", &[]).ok();

    known.render("run", &["--query", "flor"]).refused(&["no class \"flor\"", "did you mean \"floor\"?"]);
    known.render("run", &["--query", "wall"]).refused(&["\"left wall\"", "\"front wall\"", "\"right/wall\""]);
    known.render("run", &["--query", ""]).refused(&["no class \"\"", "there are \"background\""]);
    let path = known.0.path("run/semantics.safetensors");
    let whole = std::fs::read(&path).unwrap();
    let run = known.0.text("run");
    let with = |bytes: &[u8]| {
        std::fs::write(&path, bytes).unwrap();
        [semantic("run"), sgs(&["eval", &run])]
    };
    let changed = |from: &str, to: &str| {
        let mut bytes = whole.clone();
        let at = bytes.windows(from.len()).position(|w| w == from.as_bytes()).unwrap();
        bytes.splice(at..at + from.len(), to.bytes());
        bytes
    };
    let mut infinite = whole.clone();
    let end = infinite.len();
    infinite[end - 4..].copy_from_slice(&f32::INFINITY.to_le_bytes());
    for (bytes, word) in [
        (whole[..whole.len() / 2].to_vec(), "damaged"),
        (b"nothing".to_vec(), "damaged"),
        (infinite, "not finite"),
        (changed("\"0.25\"", "\"-0.2\""), "the temperature is -0.2"),
        (changed("[512,33]", "[33,512]"), "\"decoder\" is F32 [33, 512], but must be F32 [512, 33]"),
        (changed("sgs-semantics-1", "sgs-semantics-9"), "not a semantic head"),
    ] {
        for finished in with(&bytes) {
            finished.refused(&["semantics.safetensors", word]);
        }
    }
    std::fs::remove_file(&path).unwrap();
    semantic("run").refused(&["semantics.safetensors", "there is no such file"]);
    assert!(!known.0.path("out/labels.json").exists() && !known.0.path("out/000_semantic.png").exists());
    // Other channels of the run still render.
    known.render("run", &["--channels", "rgb,depth"]).ok();
}

/// Training again deletes the classes of the earlier training.
#[test]
fn retraining_removes_classes() {
    let known = Known::new();
    sgs(&["train", &known.0.text("scene"), "-o", &known.0.text("run"), "--force", "--geometry-steps", "1"]).ok();
    assert!(known.0.path("run/scene.ply").exists() && !known.0.path("run/semantics.safetensors").exists());
}
