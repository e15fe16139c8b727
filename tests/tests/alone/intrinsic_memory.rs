//! Memory of the intrinsic stage: training allocates what the estimate before the first step says.

use sgs_config::{Parts, Settings, VisibilityKind};
use sgs_scene::{Image, Scene, SceneOptions, Splats, write_ids, write_png};
use sgs_tests::Gpu;
use sgs_tests::cli::sgs;
use sgs_tests::place::Place;
use sgs_tests::priors::provider;
use sgs_tests::rooms::Room;
use sgs_train::{AlbedoComparisons, Intrinsic, TrainError};

/// Tests the estimate of the intrinsic stage with all kinds of steps. Smaller budgets are refused with the sizes.
#[test]
fn intrinsic_memory_matches_estimate() {
    let room = Room { priors: true, ..Room::default() };
    let place = Place::new(room);
    for kind in ["albedo", "masks"] {
        std::fs::create_dir_all(place.path(&format!("scene/priors/{kind}"))).unwrap();
    }
    for camera in room.cameras() {
        let (width, height) = (camera.width, camera.height);
        let file = |kind: &str| place.path(&format!("scene/priors/{kind}/{}.png", camera.name));
        let data = vec![0.5; (3 * width * height) as usize];
        write_png(&file("albedo"), &Image { width, height, channels: 3, data }).unwrap();
        write_ids(&file("masks"), width, height, &vec![3; (width * height) as usize]).unwrap();
    }
    let scene = Scene::open(&place.path("scene"), &SceneOptions::default()).unwrap();
    let gpu = Gpu::fresh();
    let mut s = Settings::default();
    s.geometry.steps = 10;
    s.intrinsic.steps = 12;
    (s.intrinsic.relight_from, s.intrinsic.environment.resolution, s.intrinsic.lights.grid) = (1, 16, 2);
    (s.intrinsic.visibility.levels, s.intrinsic.visibility.log2_table) = (4, 10);
    (s.intrinsic.visibility.coarsest, s.intrinsic.visibility.finest) = (4, 32);
    let splats = Splats::from_points(&scene.points, 1).unwrap();
    let used = || gpu.device().memory_use().0;
    let mut sizes = Vec::new();
    for (field, requested, bits) in [(true, false, 16), (true, false, 32), (true, true, 32), (false, false, 32)] {
        (s.accuracy.weight_bits, s.accuracy.visibility_bits) = (bits, bits);
        if !field {
            (s.intrinsic.visibility.kind, s.intrinsic.environment.every) = (VisibilityKind::None, 4);
        }
        s.intrinsic.relight.provider = if requested { provider("misbehave=nothing") } else { "own".into() };
        let mut training = Intrinsic::new(gpu.device(), &scene, &s, &splats).unwrap();
        training.train(12, |_| {}, || true).unwrap();
        let needs = *training.needs();
        let (cost, unknown) = training.step_cost().unwrap();
        assert!(unknown == 0 && cost.operations > 1e5, "{unknown} passes are not known: {cost:?}");
        sizes.push((needs.surfaces, needs.visibility));
        assert_eq!(training.comparisons(), AlbedoComparisons { cross_view: true, relight: true });
        assert!(needs.cross_view_arena > 0 && needs.relight_arena > 0 && (needs.visibility > 0) == field, "{needs:?}");
        assert_eq!(needs.relit > 0 && needs.estimates > 0, requested, "{needs:?}");
        let (taken, estimated) = (used(), needs.total() - needs.staging);
        println!("{taken} bytes taken, {estimated} estimated");
        assert!(taken == estimated, "{taken} bytes taken, {estimated} estimated: {needs:?}");
        drop(training);
        // The minimum stores surfaces of one view instead of all training views.
        let least =
            needs.total() - needs.surfaces / scene.split.train.len() as u64 * (scene.split.train.len() as u64 - 1);
        s.memory.budget = least - 1;
        let error = Intrinsic::new(gpu.device(), &scene, &s, &splats).err().unwrap();
        assert!(matches!(error, TrainError::Memory(_)), "{error}");
        for word in ["The intrinsic stage needs", "surfaces of views", "environment", "arena", "--memory-budget"] {
            assert!(error.to_string().contains(word), "{word}: {error}");
        }
        assert_eq!(used(), 0);
        // For freshly trained geometry, `Intrinsic::within` drops the faintest splats instead of failing.
        let mut some = splats.clone();
        let mut training = Intrinsic::within(gpu.device(), &scene, &s, &mut some).unwrap();
        assert!(some.len() < splats.len() && some == splats.strongest(some.len()), "{} are left", some.len());
        let output: Vec<_> = training.decisions().iter().map(ToString::to_string).collect();
        assert!(
            output
                .iter()
                .any(|d| d.starts_with("the faintest splats left out: materials and lights of all do not fit"))
        );
        training.train(12, |_| {}, || true).unwrap();
        training.save(&place.path("state")).unwrap();
        drop(training);
        let mut training = Intrinsic::new(gpu.device(), &scene, &s, &some).unwrap();
        training.restore(&place.path("state")).unwrap();
        assert!(
            training.decisions().iter().map(ToString::to_string).eq(output),
            "being stopped has changed what is said"
        );
        drop(training);
        s.memory.budget = least;
        let mut training = Intrinsic::new(gpu.device(), &scene, &s, &splats).unwrap();
        assert!(!training.keeps_surfaces());
        training.train(12, |_| {}, || true).unwrap();
        training.save(&place.path("state")).unwrap();
        drop(training);
        gpu.device().set_memory_budget(None);
        s.memory.budget = 0;
    }
    // The commands below have devices of their own; other tests need not wait for them.
    drop(gpu);
    // Weights in 16 bits take less memory; a 16-bit copy of the tables takes more.
    assert!(sizes[0].0 < sizes[1].0 && sizes[0].1 > sizes[1].1, "{sizes:?}");
    let plan = |more: &[&str]| {
        let scene = place.text("scene");
        sgs(&[&["plan", &scene, "--set", "intrinsic.visibility.log2_table=12"][..], more].concat())
    };
    let found = plan(&["--stage", "intrinsic", "--json"]).ok().json();
    let parts: u64 = found["needs"].as_object().unwrap().values().map(|v| v.as_u64().unwrap()).sum();
    assert!(
        found["needs_bytes"] == parts && found["lights"] == 64 && found["lobes"] == 12 && found["environment"] == 256
    );
    assert!(found["step_operations"].as_f64().unwrap() > 1e6);
    assert!(found["priors"]["albedo"] == true && found["priors"]["roughness"] == false && found["cross_view"] == true);
    let short = plan(&["--stage", "intrinsic", "--json", "--set", "accuracy.weight_bits=16"]).ok().json();
    let surfaces = |plan: &serde_json::Value| plan["needs"]["surfaces"].as_u64().unwrap();
    assert!(surfaces(&short) < surfaces(&found), "{short}");
    let both = plan(&["--stage", "all"]).ok().stdout;
    for word in
        ["densify", "lights      64 of 12 lobes", "visibility  a field of 16 levels", "own prior   every 3 steps"]
    {
        assert!(both.contains(word), "{word}: {both}");
    }
    let words = ["The intrinsic stage needs", "the budget leaves 8.0 of 8.0 MiB"];
    plan(&["--stage", "intrinsic", "--memory-budget", "8M"]).refused(&words);
    // A shortage of the intrinsic stage is reported before the geometry stage begins.
    let all = ["train", &place.text("scene"), "-o", &place.text("all"), "--stage", "all", "--vram", "8M"];
    sgs(&all).refused(&["The intrinsic stage needs", "MiB of device memory"]);
    assert!(!place.path("all").exists());
    // The transport stage alone needs no field of visibility.
    let found = plan(&["--stage", "transport", "--json"]).ok().json();
    let parts: u64 = found["needs"].as_object().unwrap().values().map(|v| v.as_u64().unwrap()).sum();
    assert!(found["needs_bytes"] == parts && found["needs"]["visibility"] == 0 && found["priors"]["albedo"] == true);
    assert!(found["room_bytes"].as_u64().unwrap() < found["needs"]["lights"].as_u64().unwrap());
    assert!(found["surfels"] == 8192 && found["patches"].as_u64().unwrap() > 100 && found["steps"] == 500, "{found}");
    let print = plan(&["--stage", "transport"]).ok().stdout;
    assert!(print.contains("light gains trained") && print.contains("room        8192 surfels"), "{print}");
    let both = plan(&["--stage", "all", "--json"]).ok().json();
    assert!(both["intrinsic"]["lights"] == 64 && both["transport"]["needs"] == found["needs"], "{both}");
    let short = plan(&["--stage", "all", "--json", "--set", "transport.surfels=0"]).ok().json();
    assert!(short.get("transport").is_none() && short["intrinsic"].is_object());
    let words = ["The transport stage needs", "transport.surfels"];
    plan(&["--stage", "transport", "--memory-budget", "8M"]).refused(&words);
    let alone = ["train", &place.text("scene"), "-o", &place.text("all"), "--stage", "transport", "--vram", "8M"];
    sgs(&alone).refused(&words);
    assert!(!place.path("all").exists());
}

/// Tests the same estimate with traced shadows.
#[test]
fn traced_shadow_memory_matches_estimate() {
    let place = Place::new(Room { priors: true, ..Room::default() });
    let scene = Scene::open(&place.path("scene"), &SceneOptions::default()).unwrap();
    let splats = Splats::from_points(&scene.points, 1).unwrap();
    let gpu = Gpu::fresh();
    let mut s = sgs_tests::intrinsic::settings(6);
    s.intrinsic.visibility.kind = VisibilityKind::Traced;
    let mut training = Intrinsic::new(gpu.device(), &scene, &s, &splats).unwrap();
    training.train(6, |_| {}, || true).unwrap();
    training.save(&place.path("state")).unwrap();
    let (needs, (now, most)) = (*training.needs(), gpu.device().memory_use());
    assert!(needs.visibility > 0 && now == needs.total() - needs.staging, "{now} bytes taken: {needs:?}");
    let off = most as f64 / needs.total() as f64 - 1.0;
    assert!(off.abs() < 0.05, "{most} bytes at most, {} estimated: {needs:?}", needs.total());
}

/// Tests that memory of automatic model selection is part of the estimate. Steps release memory during an evaluation;
/// the estimate counts what the evaluation takes beyond that.
#[test]
fn automatic_selection_memory_matches_estimate() {
    if !sgs_tests::takes_long() {
        return;
    }
    let mut s = sgs_tests::intrinsic::settings(12);
    // Many splats dominate the memory, because an evaluation copies them.
    let room = Room { priors: true, spacing: 1, ..Room::default() };
    for (compared, judged) in [(true, false), (false, false), (false, true)] {
        let place = Place::new(room);
        if compared {
            room.write_materials(&place.path("scene"));
        }
        // Every evaluation takes place. Candidates are judged by images rendered without them.
        let a = &mut s.intrinsic.automatic;
        (a.enabled, a.gain, a.limits) = (true, 0.0, [1e3; 2]);
        a.parts = if judged { Parts { sizes: false, metallic: false, ..Parts::ALL } } else { Parts::NONE };
        let scene = Scene::open(&place.path("scene"), &SceneOptions::default()).unwrap();
        let splats = Splats::from_points(&scene.points, 1).unwrap();
        let gpu = Gpu::fresh();
        let mut training = Intrinsic::new(gpu.device(), &scene, &s, &splats).unwrap();
        training.train(12, |_| {}, || true).unwrap();
        training.save(&place.path("state")).unwrap();
        let (needs, most) = (*training.needs(), gpu.device().memory_use().1);
        let off = most as f64 / needs.total() as f64 - 1.0;
        println!(
            "{compared}, {judged}: {most} bytes at most, {} estimated, {} for looking",
            needs.total(),
            needs.looking
        );
        assert!(off.abs() < 0.05, "{most} bytes at most, {} estimated: {needs:?}", needs.total());
        // Steps release less than an evaluation takes, so the evaluation sets the peak.
        let steps = needs.total() - needs.looking;
        assert!(needs.looking > 0 && most > steps + needs.looking / 2, "{most} bytes at most: {needs:?}");
        if judged {
            assert!(training.decisions().iter().any(|d| d.measured.is_some()), "{:?}", training.decisions());
        }
    }
}
