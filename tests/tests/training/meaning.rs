//! Training with semantic priors and pseudo-views. Classes are learned, and the result depends on scene, settings and
//! seed alone.

use half::f16;
use sgs_config::Settings;
use sgs_engine::{Device, DeviceOptions};
use sgs_evaluate::{EvaluateOptions, evaluate_classes};
use sgs_passes::Tuning;
use sgs_passes::pipeline::{GeometryOptions, GeometryStep, InputSizes, Masks, SemanticSizes};
use sgs_passes::scene::{EMBEDDING, Group, Layout, Model, Storage};
use sgs_passes::splat::{BackwardKernel, Channels, Statistic};
use sgs_provider::Fallback;
use sgs_scene::{Scene, SceneOptions, write_ids, write_npy_f16};
use sgs_tests::cli::sgs;
use sgs_tests::meaning::{Meaning, WALLS};
use sgs_tests::priors::provider;
use sgs_tests::rooms::Room;
use sgs_tests::{Gpu, Place};
use sgs_train::{Geometry, Progress};

fn place(room: Room, meaning: Meaning) -> Place {
    let place = Place::new(room);
    meaning.write(&room, &place.path("scene"));
    place
}

fn open(place: &Place) -> Scene {
    Scene::open(&place.path("scene"), &SceneOptions::default()).unwrap()
}

fn device() -> Device {
    let select = std::env::var("SGS_TEST_DEVICE").ok();
    Device::open(&DeviceOptions { select, ..Default::default() }).unwrap()
}

fn settings(steps: u32, from: u32) -> Settings {
    let mut s = Settings::default();
    s.geometry.steps = steps;
    s.geometry.correspondence_from = from;
    s.geometry.densify.until = 0.0;
    s.geometry.sh_degree = 1.into();
    s
}

type Losses = Vec<(u32, [f32; 4])>;

fn train(device: &Device, scene: &Scene, s: &Settings) -> (Geometry, Losses) {
    let mut losses = Vec::new();
    let mut training = Geometry::new(device, scene, s, None).unwrap();
    let on_progress = |p: &Progress| {
        if let Progress::Step(r) = p {
            let l = &r.losses;
            losses.push((r.step, [l.semantic, l.semantic_class, l.correspondence, l.correspondence_class]));
        }
    };
    training.train(s.geometry.steps, on_progress, || true).unwrap();
    (training, losses)
}

/// Returns the mean of a loss over a range of steps.
fn mean(losses: &Losses, steps: std::ops::Range<u32>, which: usize) -> f32 {
    let some: Vec<f32> = losses.iter().filter(|(s, _)| steps.contains(s)).map(|(_, l)| l[which]).collect();
    some.iter().sum::<f32>() / some.len() as f32
}

#[test]
fn classes_are_learned_and_regions_correspond() {
    let room = Room { size: [48, 36], spacing: 3, priors: true, truth: true, ..Room::default() };
    let place = place(room, Meaning { wrong: 0.1, ..Meaning::default() });
    let (device, scene) = (device(), open(&place));
    let mut s = settings(240, 121);
    s.geometry.temperature = 0.2;
    let (training, losses) = train(&device, &scene, &s);
    assert!(mean(&losses, 200..241, 0) < 0.6 * mean(&losses, 1..10, 0), "the cosine: {losses:?}");
    assert!(mean(&losses, 200..241, 1) < 0.8 * mean(&losses, 1..10, 1), "the cross-entropy: {losses:?}");
    // Pseudo-views start at step 121, not before. Some steps compare nothing because both views miss the region.
    let compared = |l: &[f32; 4]| l[2] > 0.0 && l[3] > 0.0;
    assert!(losses.iter().all(|(step, l)| *step >= 121 || !compared(l)), "{losses:?}");
    let late = losses.iter().filter(|(step, l)| *step >= 121 && compared(l)).count();
    assert!(late > 80, "of 120 steps {late} compared a region: {losses:?}");
    assert!(mean(&losses, 121..241, 3) < 1.0, "the regions' class: {losses:?}");
    let head = training.head().unwrap().unwrap();
    let views = &scene.split.test;
    let options = EvaluateOptions { views, background: [0.0; 3], head: Some(&head), lpips: None, align: None };
    let evaluation = evaluate_classes(&device, &scene, training.gaussians(), &options, |_, _| Ok(())).unwrap();
    // Nine in ten samples of the training views are labeled correctly.
    let accuracy = evaluation.mean.semantic.unwrap().accuracy;
    assert!(accuracy > 0.9, "{accuracy}");
    // Without semantic priors, the same scene has neither features nor a head.
    s.geometry.semantics = false;
    s.geometry.steps = 2;
    let (plain, _) = train(&device, &scene, &s);
    assert!(plain.head().unwrap().is_none() && plain.splats().unwrap().semantic.is_none());
}

/// Tests that results do not depend on entry capacity or on resumes. Resumes happen before and after pseudo-views
/// begin, beside densification and opacity resets.
#[test]
fn semantic_training_is_independent_of_capacity_and_resume() {
    let gpu = Gpu::new();
    for (masks, dense) in [(false, false), (true, true), (true, false)] {
        let room = Room::default();
        let place = place(room, Meaning { masks, ..Meaning::default() });
        let scene = open(&place);
        let run = |capacity: u32, resumed_at: Option<u32>| {
            let mut s = settings(26, 12);
            s.geometry.entry_capacity = capacity;
            s.geometry.dense_adam = dense;
            let d = &mut s.geometry.densify;
            (d.until, d.from, d.interval, d.reset_interval, d.grad_threshold) = (0.8, 5, 5, 12, 5e-5);
            d.max_gaussians = 3000;
            let mut reports = Vec::new();
            let mut on_progress = |p: &Progress| match p {
                Progress::Decided(_) => {}
                Progress::Step(r) => reports.push((r.step, r.gaussians, r.entries, r.losses.total.to_bits())),
                Progress::Densified { step, stats } => reports.push((1000 + step, stats.after, 0, 0)),
            };
            let mut training = Geometry::new(gpu.device(), &scene, &s, None).unwrap();
            if let Some(at) = resumed_at {
                let file = place.path("state");
                training.train(at, &mut on_progress, || true).unwrap();
                training.save(&file).unwrap();
                training = Geometry::new(gpu.device(), &scene, &s, None).unwrap();
                training.restore(&file).unwrap();
            }
            training.train(26, &mut on_progress, || true).unwrap();
            (training.splats().unwrap(), training.head().unwrap().unwrap(), reports)
        };
        let expected = run(1 << 16, None);
        assert!(expected.2.iter().filter(|r| r.0 > 1000).count() >= 3, "densification was to happen: {:?}", expected.2);
        for (capacity, resumed_at) in [(1, None), (1 << 16, Some(8)), (700, Some(17))] {
            let found = run(capacity, resumed_at);
            assert_eq!(found.2, expected.2, "capacity {capacity}, resumed at {resumed_at:?}");
            assert!(found.0 == expected.0, "capacity {capacity}, resumed at {resumed_at:?}: the splats differ");
            assert!(found.1 == expected.1, "capacity {capacity}, resumed at {resumed_at:?}: the decoder differs");
        }
    }
}

/// Tests maps of one cell per pixel and maps larger than the image. Their memory is part of the estimate.
#[test]
fn semantic_maps_may_have_the_size_of_the_image() {
    let room = Room { views: 6, ..Room::default() };
    let (fine, coarse) = (Meaning { stride: 1, ..Meaning::default() }, Meaning::default());
    let device = device();
    let run = |place: &Place, scale: f64| {
        let options = SceneOptions { scale, ..SceneOptions::default() };
        let scene = Scene::open(&place.path("scene"), &options).unwrap();
        let mut s = settings(40, 99);
        s.geometry.temperature = 0.2;
        let (training, losses) = train(&device, &scene, &s);
        let bytes = training.needs().semantics;
        assert!(mean(&losses, 36..41, 0) < 0.9 * mean(&losses, 1..6, 0), "the cosine: {losses:?}");
        (bytes, mean(&losses, 36..41, 0))
    };
    let (fine, coarse) = (place(room, fine), place(room, coarse));
    let (many, of_pixels) = run(&fine, 1.0);
    let (few, of_cells) = run(&coarse, 1.0);
    assert!((of_pixels - of_cells).abs() < 0.1, "{of_pixels} {of_cells}");
    // A cell takes 512 halves and its target. Maps have 32 x 24 or 8 x 6 cells for each training view.
    let row = 1024 + size_of::<sgs_shaders::structs::SemanticTarget>() as u64;
    let views = Scene::open(&fine.path("scene"), &SceneOptions::default()).unwrap().split.train.len() as u64;
    assert_eq!(many - few, views * row * (32 * 24 - 8 * 6));
    // At half the image size, a map of 32 x 24 has more cells than the image has pixels. Then 16 x 12 cells are stored.
    let (half, _) = run(&fine, 0.5);
    assert_eq!(many - half, views * row * (32 * 24 - 16 * 12));
}

/// Tests that features change geometry only with the option.
#[test]
fn features_move_geometry_only_if_enabled() {
    // With normals, depth is blended in any case, so rounding is the same.
    let place = place(Room { priors: true, ..Room::default() }, Meaning::default());
    let (device, scene) = (device(), open(&place));
    let run = |semantics: bool, geometry: bool, correspondence: bool| {
        let mut s = settings(12, 6);
        if !correspondence {
            s.geometry.losses.correspondence = 0.0;
        }
        s.geometry.semantics = semantics;
        s.geometry.semantic_geometry = geometry;
        let (training, _) = train(&device, &scene, &s);
        let data = training.gaussians().download(&device).unwrap();
        [Group::Means, Group::OpacityLogits, Group::Sh0].map(|g| data.group(g).to_vec())
    };
    let (without, held) = (run(false, true, false), run(true, false, false));
    assert_eq!(without, held);
    let (moved, compared) = (run(true, true, false), run(true, true, true));
    assert!(without[0] != moved[0] && without[1] != moved[1]);
    assert!(moved[0] != compared[0] && moved[1] != compared[1]);
    assert_eq!(without, run(true, false, true));
}

#[test]
fn invalid_semantic_priors_are_skipped_or_named() {
    let room = Room { views: 6, ..Room::default() };
    let device = device();
    // Maps of NaN, zeros or infinity and a missing map are masked.
    let masked = place(room, Meaning { masks: true, ..Meaning::default() });
    let map = |value: f16| vec![value; 6 * 8 * EMBEDDING];
    let semantic = |place: &Place, name: &str, shape: [usize; 3], data: &[f16]| {
        write_npy_f16(&place.path(&format!("scene/priors/semantic/{name}.npy")), &shape, data).unwrap();
    };
    semantic(&masked, "000", [6, 8, EMBEDDING], &map(f16::NAN));
    semantic(&masked, "002", [6, 8, EMBEDDING], &map(f16::ZERO));
    semantic(&masked, "003", [6, 8, EMBEDDING], &map(f16::INFINITY));
    std::fs::remove_file(masked.path("scene/priors/semantic/004.npy")).unwrap();
    for name in ["000", "002"] {
        write_ids(&masked.path(&format!("scene/priors/masks/{name}.png")), 32, 24, &[0; 32 * 24]).unwrap();
    }
    let (training, losses) = train(&device, &open(&masked), &settings(12, 4));
    let data = training.gaussians().download(&device).unwrap();
    for group in training.gaussians().model.groups() {
        assert!(data.group(group).iter().all(|v| v.is_finite()), "{}", group.name());
    }
    assert!(training.head().unwrap().unwrap().decoder.iter().all(|v| v.is_finite()));
    assert!(losses.iter().all(|(_, l)| l.iter().all(|v| v.is_finite())) && losses.iter().any(|(_, l)| l[2] > 0.0));
    // Without any usable map the term is absent, and everything else is trained.
    for name in ["000", "001", "002", "003", "004", "005"] {
        semantic(&masked, name, [6, 8, EMBEDDING], &map(f16::NAN));
        write_ids(&masked.path(&format!("scene/priors/masks/{name}.png")), 32, 24, &[0; 32 * 24]).unwrap();
    }
    let (training, losses) = train(&device, &open(&masked), &settings(8, 4));
    assert!(losses.iter().all(|(_, l)| *l == [0.0; 4]), "{losses:?}");
    assert!(training.splats().unwrap().means.iter().flatten().all(|v| v.is_finite()));

    // Maps of another width, mismatched names and unreadable files are refused.
    let refused = |spoil: &dyn Fn(&Place), words: &[&str]| {
        let bad = place(room, Meaning::default());
        spoil(&bad);
        sgs(&bad.arguments("run", 4, &["--set", "geometry.correspondence_from=1"])).refused(words);
        assert!(!bad.path("run/scene.ply").exists());
    };
    refused(&|p| semantic(p, "000", [2, 2, 100], &[f16::ONE; 400]), &["000.npy", "100"]);
    refused(
        &|p| std::fs::write(p.path("scene/priors/semantic/labels.json"), r#"{"labels": ["wall"]}"#).unwrap(),
        &["text_embeddings.npy", "1 classes"],
    );
    refused(&|p| std::fs::write(p.path("scene/priors/semantic/000.npy"), "no array").unwrap(), &["000.npy"]);
    refused(
        &|p| {
            std::fs::create_dir_all(p.path("scene/priors/masks")).unwrap();
            std::fs::write(p.path("scene/priors/masks/000.png"), "no image").unwrap();
        },
        &["000.png"],
    );
    assert_eq!(WALLS.len(), 6);
}

/// Tests that no pixel stores 512 values. A larger image adds features and their gradients to the memory of a step: at
/// most three times 32 numbers per view, and less than half of one vector of 512 in all.
#[test]
fn pixel_memory_is_independent_of_embedding_width() {
    let device = device();
    let tuning = Tuning::for_device(device.info());
    let model = Model { semantics: true, ..Model::default() };
    let layout = Layout { model, capacity: 1 << 14, training: true, statistics: true, storage: Storage::Exact };
    let arena = |size: [u32; 2], semantics: bool, pseudo: bool| {
        let sizes = SemanticSizes { samples: 12 * 300, largest: 300, classes: 27 };
        let pixels = u64::from(size[0]) * u64::from(size[1]);
        let inputs = InputSizes {
            targets: 4 * pixels,
            semantics: semantics.then_some(sizes),
            regions: pseudo.then_some(2 * pixels),
            ..InputSizes::default()
        };
        let options = GeometryOptions {
            largest: size,
            entry_capacity: 1 << 15,
            channels: Channels { colors: true, normals: false, depth: true },
            statistics: Some(Statistic::Total),
            mcmc: false,
            dense_adam: false,
            backward: BackwardKernel::Pixel,
            semantic_geometry: true,
            pseudo: pseudo.then_some(Masks::Carried),
            timestamps: false,
            frames_in_flight: 2,
        };
        GeometryStep::plan(&tuning, &layout, &inputs, &options).unwrap().arena_bytes
    };
    let a_pixel = |semantics: bool, pseudo: bool| {
        let [small, large] = [[320, 240], [1280, 960]].map(|size| arena(size, semantics, pseudo) as f64);
        (large - small) / (1280.0 * 960.0 - 320.0 * 240.0)
    };
    let (without, with, both) = (a_pixel(false, false), a_pixel(true, false), a_pixel(true, true));
    assert!(with - without < 3.0 * 128.0, "{without} bytes a pixel become {with}");
    assert!(both - without < 3.0 * 3.0 * 128.0 && both < 0.5 * 3.0 * 2048.0, "{without} bytes a pixel become {both}");
}

/// Tests that a provider supplies the region's masks. Its failure stops training or disables the comparison, as the
/// setting says.
#[test]
fn mask_provider_is_queried_during_training() {
    let place = place(Room::default(), Meaning::default());
    let (device, scene) = (device(), open(&place));
    let requested = |what: &str, on_failure: Fallback| {
        let mut s = settings(9, 5);
        s.provider.command = provider(what);
        (s.provider.on_failure, s.provider.seconds[1]) = (on_failure, 5.0);
        s
    };
    let stand_in = format!("'stand-in={}'", place.text("scene"));
    let s = requested(&stand_in, Fallback::Stop);
    let (training, losses) = train(&device, &scene, &s);
    let compared = losses.iter().filter(|(_, l)| l[2] > 0.0).map(|(step, _)| *step).collect::<Vec<u32>>();
    assert!(compared.len() >= 3 && compared.iter().all(|step| *step >= 5), "{losses:?}");
    // The same requests get the same answers: with an entry capacity of 1, and after a resume.
    let mut again = s.clone();
    again.geometry.entry_capacity = 1;
    let mut second = Geometry::new(&device, &scene, &again, None).unwrap();
    second.train(6, |_| {}, || true).unwrap();
    second.save(&place.path("state")).unwrap();
    let mut third = Geometry::new(&device, &scene, &s, None).unwrap();
    third.restore(&place.path("state")).unwrap();
    third.train(9, |_| {}, || true).unwrap();
    assert!(third.splats().unwrap() == training.splats().unwrap(), "resumed with a provider, splats differ");

    let error = |s: &Settings| match Geometry::new(&device, &scene, s, None) {
        Err(error) => error.to_string(),
        Ok(mut training) => training.train(9, |_| {}, || true).unwrap_err().to_string(),
    };
    for what in ["misbehave=exit", "misbehave=bool-two"] {
        let output = error(&requested(what, Fallback::Stop));
        assert!(output.ends_with('.') && !output.contains('\n'), "{what}: {output}");
        let (training, losses) = train(&device, &scene, &requested(what, Fallback::GoOn));
        assert!(training.step() == 9 && losses.iter().all(|(_, l)| l[2] == 0.0), "{what}: {losses:?}");
    }
    let none = requested("misbehave=cannot-load", Fallback::Stop);
    assert!(!error(&none).contains('\n'));
}
