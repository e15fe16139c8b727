//! Regions of training views and of pseudo-views. They are loaded from files and semantic maps, and turned into bits on
//! the device. Cameras of pseudo-views are written as a file.

use half::f16;
use sgs_config::PseudoOptions;
use sgs_engine::graph::Graph;
use sgs_passes::loss::{pack_mask, region_mask};
use sgs_passes::scene::EMBEDDING;
use sgs_passes::splat::{Screen, wanted_words};
use sgs_scene::{Camera, Scene, SceneOptions, write_ids, write_npy_f16, write_npy_f32};
use sgs_shaders::structs::Step;
use sgs_tests::cli::sgs;
use sgs_tests::rooms::Room;
use sgs_tests::{Gpu, Place};
use sgs_train::{PseudoMaps, PseudoViews, RegionMaps, RegionSource, SemanticData};

const SIZE: [u32; 2] = [32, 24];
/// Number of pixels of a view.
const PIXELS: usize = 32 * 24;

fn open(place: &Place) -> Scene {
    Scene::open(&place.path("scene"), &SceneOptions::default()).unwrap()
}

/// Creates four training views (000, 002, 003, 004) and one test view.
fn place() -> Place {
    Place::new(Room { views: 5, ..Default::default() })
}

fn write_mask(place: &Place, name: &str, size: [u32; 2], id: impl Fn(u32, u32) -> u16) {
    let path = place.path("scene/priors/masks").join(format!("{name}.png"));
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    let ids: Vec<u16> = (0..size[0] * size[1]).map(|p| id(p % size[0], p / size[0])).collect();
    write_ids(&path, size[0], size[1], &ids).unwrap();
}

/// Returns the device's bits of a region. The view's ids start at pixel `first`.
fn bits(gpu: &Gpu, ids: &[u8], first: u32, region: u32) -> Vec<u32> {
    let mut g = Graph::new("region");
    let step = g.uniform("step", size_of::<Step>() as u64);
    let mut values = Step { region_offset: first, region, ..Default::default() };
    values.camera.size = SIZE;
    let screen = Screen { step, largest: SIZE, tile: [8, 8] };
    let id_buffer = g.input("ids", ids.len() as u64);
    let mask = g.external("mask", 4 * wanted_words(screen.pixels()));
    region_mask(&mut g, gpu.tuning(), &screen, id_buffer, mask).unwrap();
    gpu.run(g, &[(step, bytemuck::bytes_of(&values).to_vec()), (id_buffer, ids.to_vec())]).get(mask)
}

fn mask_of(id: impl Fn(u32, u32) -> bool) -> Vec<u32> {
    pack_mask(&(0..PIXELS as u32).map(|p| id(p % SIZE[0], p / SIZE[0])).collect::<Vec<bool>>())
}

#[test]
fn masks_of_any_size_become_bits_on_the_device() {
    let gpu = Gpu::new();
    let place = place();
    write_mask(&place, "000", SIZE, |x, y| 1 + u16::from(x >= 20) * 599 * u16::from(y < 12));
    write_mask(&place, "002", [16, 12], |x, _| if x < 4 { 600 } else { 0 });
    write_mask(&place, "003", SIZE, |_, _| 0);
    // View 004 has no mask. Masks of test views are not read.
    write_mask(&place, "001", SIZE, |_, _| 77);
    let scene = open(&place);
    let maps = RegionMaps::load(gpu.device(), &scene, None).unwrap().unwrap();
    assert_eq!(maps.source, RegionSource::Masks);
    let regions: Vec<_> = maps.views.iter().map(|v| v.regions.clone()).collect();
    assert_eq!(regions, [vec![(1, 624), (600, 144)], vec![(600, 192)], vec![], vec![]]);
    assert_eq!(maps.views.iter().map(|v| v.first as usize).collect::<Vec<_>>(), [0, PIXELS, 2 * PIXELS, 3 * PIXELS]);
    let buffer = maps.upload(gpu.device()).unwrap();
    assert_eq!(buffer.bytes(), maps.bytes());
    let ids = gpu.device().download(&buffer, 0, buffer.bytes()).unwrap();
    let of = |view: usize, region| bits(&gpu, &ids, maps.views[view].first, region);
    assert_eq!(of(0, 600), mask_of(|x, y| x >= 20 && y < 12));
    assert_eq!(of(1, 600), mask_of(|x, _| x < 8));
    assert_eq!(of(2, 600), mask_of(|_, _| false));
    assert!((1..20).all(|step| [1, 600].contains(&maps.draw(0, 3, step)) && maps.draw(2, 3, step) == 0));
}

#[test]
fn unreadable_masks_are_refused_and_empty_ones_ignored() {
    let gpu = Gpu::new();
    let place = place();
    assert_eq!(RegionMaps::load(gpu.device(), &open(&place), None).unwrap(), None);
    write_mask(&place, "000", SIZE, |_, _| 0);
    assert_eq!(RegionMaps::load(gpu.device(), &open(&place), None).unwrap(), None);
    std::fs::write(place.path("scene/priors/masks/002.png"), b"nothing").unwrap();
    let error = RegionMaps::load(gpu.device(), &open(&place), None).unwrap_err().to_string();
    assert!(error.contains("002.png") && error.contains("cannot be read as PNG") && !error.contains('\n'), "{error}");
}

#[test]
fn without_masks_regions_are_the_classes_of_the_targets() {
    let gpu = Gpu::new();
    let place = place();
    let folder = place.path("scene/priors/semantic");
    std::fs::create_dir_all(&folder).unwrap();
    // Three classes have unit text embeddings. View 000 has them in three columns, and one cell is zero.
    let mut text = vec![0.0_f32; 3 * EMBEDDING];
    (0..3).for_each(|c| text[c * EMBEDDING + c] = 1.0);
    write_npy_f32(&folder.join("text_embeddings.npy"), &[3, EMBEDDING], &text).unwrap();
    std::fs::write(folder.join("labels.json"), r#"{"labels": ["wall", "chair", "lamp"]}"#).unwrap();
    let mut features = vec![f16::ZERO; 6 * EMBEDDING];
    (0..5).for_each(|cell| features[cell * EMBEDDING + cell % 3] = f16::ONE);
    write_npy_f16(&folder.join("000.npy"), &[2, 3, EMBEDDING], &features).unwrap();
    let scene = open(&place);
    let semantic = SemanticData::load(gpu.device(), &scene).unwrap().unwrap();
    let maps = RegionMaps::load(gpu.device(), &scene, Some(&semantic)).unwrap().unwrap();
    assert_eq!(maps.source, RegionSource::Labels);
    let expected = |x: u32, y: u32| {
        // Samples lie at columns 0, 15.5 and 31, and at rows 0 and 23.
        let column = if x < 8 {
            0
        } else if x < 24 {
            1
        } else {
            2
        };
        if column == 2 && y >= 12 { 0 } else { column + 1 }
    };
    let all: Vec<u16> = (0..PIXELS as u32).map(|p| expected(p % SIZE[0], p / SIZE[0])).collect();
    assert_eq!(maps.ids(0), all);
    assert!(maps.views[1..].iter().all(|v| v.regions.is_empty()));
    // Masks take precedence over classes.
    write_mask(&place, "004", SIZE, |_, _| 9);
    let maps = RegionMaps::load(gpu.device(), &open(&place), Some(&semantic)).unwrap().unwrap();
    assert_eq!((maps.source, maps.views[3].regions.clone()), (RegionSource::Masks, vec![(9, 768)]));
}

#[test]
fn masks_of_pseudo_views_are_complete_or_absent() {
    let gpu = Gpu::new();
    let place = place();
    let scene = open(&place);
    let pseudo = PseudoViews::new(&scene, &PseudoOptions { poses: 3, ..Default::default() }).unwrap();
    assert_eq!(PseudoMaps::load(&scene, &pseudo).unwrap(), None);
    let number = |view: usize, which: usize, index: u32| (100 * view + 10 * which) as u16 + index as u16 + 1;
    let each = |f: &mut dyn FnMut(usize, usize, u32)| {
        (0..4).for_each(|v| (0..2).for_each(|w| (0..3).for_each(|i| f(v, w, i))));
    };
    each(&mut |v, w, i| {
        let name = format!("pseudo/{}", pseudo.name(v, w, i));
        write_mask(&place, &name, [8, 6], |x, _| if x == 2 { number(v, w, i) } else { 0 });
    });
    let maps = PseudoMaps::load(&scene, &pseudo).unwrap().unwrap();
    assert_eq!(maps.bytes(), 2 * 24 * PIXELS as u64);
    let buffer = maps.upload(gpu.device()).unwrap();
    let ids = gpu.device().download(&buffer, 0, buffer.bytes()).unwrap();
    for (v, w, i) in [(0, 0, 0), (0, 1, 2), (2, 0, 1), (3, 1, 2)] {
        let found = bits(&gpu, &ids, maps.first(v, w, i), u32::from(number(v, w, i)));
        assert_eq!(found, mask_of(|x, _| (8..12).contains(&x)), "{v} {w} {i}");
    }
    // Training views do not use masks of pseudo-views.
    assert_eq!(RegionMaps::load(gpu.device(), &scene, None).unwrap(), None);
    std::fs::remove_file(place.path("scene/priors/masks/pseudo/002_1_01.png")).unwrap();
    let error = PseudoMaps::load(&scene, &pseudo).unwrap_err().to_string();
    assert!(error.contains("002_1_01.png") && error.contains("1 of 24"), "{error}");
}

#[test]
fn cameras_of_pseudo_views_are_written() {
    let place = place();
    let scene = place.text("scene");
    let file = place.text("pseudo.json");
    let output = sgs(&["pseudo", &scene, "-o", &file, "--json"]).ok().json();
    assert_eq!(
        (output["views"].as_u64(), output["poses"].as_u64(), output["cameras"].as_u64()),
        (Some(4), Some(20), Some(160))
    );
    let expected = PseudoViews::new(&open(&place), &PseudoOptions::default()).unwrap().cameras();
    let found = Camera::read_transforms(&place.path("pseudo.json")).unwrap();
    assert_eq!(found.len(), 160);
    for (a, b) in expected.iter().zip(&found) {
        assert_eq!((&a.name, a.width, a.fx, a.cy), (&b.name, b.width, b.fx, b.cy));
        assert!((a.position() - b.position()).length() < 1e-9);
    }
    let set = ["neighbors=test", "position=cubic"].map(|s| format!("geometry.pseudo.{s}"));
    let options: Vec<&str> = set.iter().flat_map(|s| ["--set", s]).collect();
    sgs(&[&["pseudo", &scene, "-o", &file][..], &options].concat()).ok();
    let found = Camera::read_transforms(&place.path("pseudo.json")).unwrap();
    assert_eq!((found.len(), found[20].name.as_str()), (160, "000_1_00"));
    let test = &open(&place).views[1].camera;
    assert!((found[20].position() - test.position()).length() < 1e-9);
    let refused = |set: &str, words: &str| {
        sgs(&["pseudo", &scene, "-o", &file, "--set", set]).refused(&[words]);
    };
    refused("geometry.pseudo.neighbors=all", "\"geometry.pseudo.neighbors\" is \"all\"");
    refused("geometry.pseudo.lambda_t=1", "\"geometry.pseudo.lambda_t\" is not a setting");
    sgs(&["pseudo", &place.text("none"), "-o", &file]).refused(&["none"]);
}
