//! Masks of valid pixels: what invalid pixels hold changes neither training nor measures.

use serde_json::{Value, json};
use sgs_passes::scene::EMBEDDING;
use sgs_scene::{Image, Scene, SceneOptions, read_exr, read_ids, write_exr, write_ids, write_png};
use sgs_tests::Place;
use sgs_tests::cli::sgs;
use sgs_tests::meaning::Meaning;
use sgs_tests::rooms::{ALBEDO, Room, write_json};
use std::collections::BTreeMap;

/// Returns a mask with every gray: white in a disk that differs between views, black outside, soft between.
fn mask(view: usize, [width, height]: [u32; 2]) -> Image {
    let mut mask = Image::new(width, height, 1);
    let (x0, y0) = (0.3 + 0.05 * view as f32, 0.5);
    for y in 0..height {
        for x in 0..width {
            let at = [x as f32 / width as f32 - x0, y as f32 / height as f32 - y0];
            // Whole steps of 8 bits, which an inverted file holds exactly.
            let gray = (255.0 * (6.0 * (0.45 - at[0].hypot(at[1]))).clamp(0.0, 1.0)).round();
            mask.pixel_mut(x, y)[0] = gray / 255.0;
        }
    }
    mask
}

/// Writes the masks of all views, with changed values.
fn write_masks(place: &Place, room: Room, change: fn(f32) -> f32) {
    std::fs::create_dir_all(place.path("scene/masks")).unwrap();
    for view in 0..room.views {
        let mut mask = mask(view, room.size);
        mask.data.iter_mut().for_each(|v| *v = change(*v));
        write_png(&place.path(&format!("scene/masks/{view:03}.png")), &mask).unwrap();
    }
}

#[test]
fn inverted_masks_train_to_the_same_bits() {
    let room = Room::default();
    let place = Place::new(room);
    let train = |run: &str, masks: &str| {
        sgs(&place.arguments(run, 24, &["--seed", "3", "--set", masks])).ok();
        let measures = place.text(&format!("{run}.json"));
        sgs(&["eval", &place.text(run), "--json", &measures]).ok();
        let measures: Value = serde_json::from_slice(&std::fs::read(&measures).unwrap()).unwrap();
        measures["mean"]["nvs"].clone()
    };
    write_masks(&place, room, |v| v);
    let ordinary = train("ordinary", "masks=true");
    train("ignored", "masks=false");
    write_masks(&place, room, |v| 1.0 - v);
    let inverted = train("inverted", "masks=\"inverted\"");
    train("wrong", "masks=true");
    place.assert_same("ordinary", "inverted");
    assert_eq!(ordinary["psnr"], inverted["psnr"]);
    assert!(ordinary["psnr"].is_number(), "{ordinary}");
    // The masks matter, and so does their sense.
    for other in ["ignored", "wrong"] {
        assert!(place.read("ordinary/scene.ply") != place.read(&format!("{other}/scene.ply")), "{other}");
    }
}

/// View of the room whose files hold other values at its invalid pixels.
struct Poisoned<'a> {
    place: &'a Place,
    scene: &'a Scene,
    view: usize,
    /// Whether each pixel is invalid.
    invalid: Vec<bool>,
}

impl<'a> Poisoned<'a> {
    fn new(place: &'a Place, scene: &'a Scene, view: usize) -> Poisoned<'a> {
        let mask = scene.load_mask(view).unwrap().unwrap();
        let invalid: Vec<bool> = mask.data.iter().map(|v| *v == 0.0).collect();
        assert!(invalid.iter().any(|i| *i) && !invalid.iter().all(|i| *i));
        Poisoned { place, scene, view, invalid }
    }

    /// Returns the path of a file of the view.
    fn path(&self, folder: &str, extension: &str) -> std::path::PathBuf {
        self.place.path(&format!("scene/{folder}/{}.{extension}", self.scene.views[self.view].camera.name))
    }

    fn change(&self, image: &mut Image, by: impl Fn(f32) -> f32) {
        let pixels = image.data.chunks_exact_mut(image.channels as usize).zip(&self.invalid);
        let invalid = pixels.filter(|(_, invalid)| **invalid);
        invalid.flat_map(|(pixel, _)| pixel).for_each(|v| *v = by(*v));
    }

    fn exr(&self, folder: &str, names: &[&str], by: impl Fn(f32) -> f32) {
        let path = self.path(folder, "exr");
        let mut image = read_exr(&path).unwrap().image;
        self.change(&mut image, by);
        write_exr(&path, &image, names).unwrap();
    }

    fn color(&self) {
        let mut image = self.scene.load_image(self.view).unwrap();
        self.change(&mut image, |v| 1.0 - v);
        write_png(&self.path("images", "png"), &image).unwrap();
    }

    fn normal_prior(&self) {
        self.exr("priors/normal", &["X", "Y", "Z"], |v| -v);
    }

    /// Negates the features of the cells. The map has one cell per pixel.
    fn features(&self) {
        let path = self.path("priors/semantic", "npy");
        let mut bytes = std::fs::read(&path).unwrap();
        let start = bytes.len() - self.invalid.len() * 2 * EMBEDDING;
        let cells = bytes[start..].chunks_exact_mut(2 * EMBEDDING).zip(&self.invalid);
        for (cell, _) in cells.filter(|(_, invalid)| **invalid) {
            cell.chunks_exact_mut(2).for_each(|half| half[1] ^= 0x80);
        }
        std::fs::write(&path, bytes).unwrap();
    }

    /// Writes absurd values into the photograph and all ground truth.
    fn measured(&self) {
        self.color();
        self.exr("gt/normal", &["X", "Y", "Z"], |v| -v);
        for folder in ["gt/depth", "gt/roughness", "gt/metallic"] {
            self.exr(folder, &["Y"], |v| 1e3 * (v + 1.0));
        }
        self.exr("gt/albedo", &["R", "G", "B"], |v| 50.0 + v);
        self.exr("gt/relit/lit", &["R", "G", "B"], |v| 0.95 - 0.1 * v);
        let path = self.path("gt/semantic", "png");
        let (width, height, mut ids) = read_ids(&path).unwrap();
        ids.iter_mut().zip(&self.invalid).filter(|(_, invalid)| **invalid).for_each(|(id, _)| *id = 60_000);
        write_ids(&path, width, height, &ids).unwrap();
    }
}

fn open(place: &Place) -> Scene {
    Scene::open(&place.path("scene"), &SceneOptions::default()).unwrap()
}

/// Values of invalid pixels matter only if training ignores the masks.
///
/// Values are colors, prior normals and semantic features.
#[test]
fn invalid_pixels_change_no_byte_of_a_training() {
    let room = Room { priors: true, ..Room::default() };
    let place = Place::new(room);
    Meaning { stride: 1, truth: false, ..Meaning::default() }.write(&room, &place.path("scene"));
    write_masks(&place, room, |v| v);
    let train = |run: &str, masks: &str| {
        sgs(&place.arguments(run, 14, &["--seed", "3", "--set", masks])).ok();
    };
    train("masked", "masks=true");
    train("open0", "masks=false");
    let poisons: [fn(&Poisoned<'_>); 3] = [|p| p.color(), |p| p.normal_prior(), |p| p.features()];
    for (i, poison) in poisons.into_iter().enumerate() {
        let scene = open(&place);
        scene.split.train.iter().for_each(|&view| poison(&Poisoned::new(&place, &scene, view)));
        let (before, after) = (format!("open{i}"), format!("open{}", i + 1));
        train(&after, "masks=false");
        let [before, after] = [before, after].map(|run| place.read(&format!("{run}/scene.ply")));
        assert!(before != after, "values of kind {i} do not matter");
    }
    train("poisoned", "masks=true");
    place.assert_same("masked", "poisoned");
}

/// Adds ground truth of materials and a relit set.
fn write_truth(place: &Place, room: Room) {
    let kinds = ["albedo", "roughness", "metallic", "relit/lit"];
    kinds.iter().for_each(|kind| std::fs::create_dir_all(place.path(&format!("scene/gt/{kind}"))).unwrap());
    for camera in room.cameras() {
        let (walls, [width, height]) = (room.walls(&camera), room.size);
        let file = |kind: &str| place.path(&format!("scene/gt/{kind}/{}.exr", camera.name));
        let image = |of: &dyn Fn(usize) -> Vec<f32>| {
            let data: Vec<f32> = walls.iter().flat_map(|wall| of(*wall)).collect();
            Image { width, height, channels: data.len() as u32 / (width * height), data }
        };
        let color = image(&|wall| ALBEDO[wall].to_vec());
        let gray = image(&|wall| vec![0.2 + 0.1 * wall as f32]);
        for kind in ["albedo", "relit/lit"] {
            write_exr(&file(kind), &color, &["R", "G", "B"]).unwrap();
        }
        for kind in ["roughness", "metallic"] {
            write_exr(&file(kind), &gray, &["Y"]).unwrap();
        }
    }
    let light = json!({"on": true, "position": [0, 0, 0], "point_light_intensity_equivalent": [1, 1, 1]});
    write_json(&place.path("scene/gt/lights.json"), &json!({"training": [light], "relight": {"lit": [light]}}));
}

/// Collects all numbers of a JSON value by path, without those of speed.
fn numbers(value: &Value, path: &str, into: &mut BTreeMap<String, f64>) {
    match value {
        Value::Number(number) => {
            into.insert(path.to_owned(), number.as_f64().unwrap());
        }
        Value::Array(all) => all.iter().enumerate().for_each(|(i, v)| numbers(v, &format!("{path}/{i}"), into)),
        Value::Object(all) => {
            let measures = all.iter().filter(|(key, _)| *key != "fps");
            measures.for_each(|(key, v)| numbers(v, &format!("{path}/{key}"), into));
        }
        _ => {}
    }
}

/// Figures of `sgs eval` that a mask must change.
const FIGURES: [&str; 22] = [
    "nvs/psnr",
    "nvs/ssim",
    "nvs/flip",
    "nvs/psnr_aligned",
    "nvs/ssim_aligned",
    "normal_mae_deg",
    "depth_rel",
    "semantic/accuracy",
    "pbr/psnr",
    "pbr/ssim",
    "pbr/flip",
    "albedo/psnr",
    "albedo/ssim",
    "albedo/psnr_scaled",
    "albedo/psnr_scaled_per_view",
    "roughness_mse",
    "metallic_mse",
    "relit/lit/psnr",
    "relit/lit/ssim",
    "relit/lit/psnr_gain",
    "relit/lit/psnr_gain_per_view",
    "relit/mean/psnr",
];

#[test]
fn invalid_pixels_change_no_measure() {
    let room = Room { priors: true, truth: true, ..Room::default() };
    let place = Place::new(room);
    Meaning::default().write(&room, &place.path("scene"));
    write_truth(&place, room);
    write_masks(&place, room, |v| v);
    crate::evaluate::train_materials(&place);
    let measured = || {
        let mut all = BTreeMap::new();
        numbers(&sgs(&["eval", &place.text("run"), "--align", "--json"]).ok().json(), "", &mut all);
        all
    };
    let before = measured();
    let scene = open(&place);
    scene.split.test.iter().for_each(|&view| Poisoned::new(&place, &scene, view).measured());
    assert_eq!(measured(), before);
    // Without the masks, every figure shows the absurd values.
    std::fs::remove_dir_all(place.path("scene/masks")).unwrap();
    let open = measured();
    for figure in FIGURES {
        let of = |all: &BTreeMap<String, f64>| {
            let path = format!("/mean/{figure}");
            *all.get(&path).unwrap_or_else(|| panic!("{path} is missing: {all:?}"))
        };
        assert!(of(&before) != of(&open), "{figure}: {}", of(&open));
    }
}
