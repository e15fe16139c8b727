//! Learning and determinism of the intrinsic stage.
//!
//! Results depend only on scene, splats, settings and seed.

use sgs_config::VisibilityKind;
use sgs_passes::Accuracy;
use sgs_run::{RunDirectory, Shading, VisibilityFile, displayed, light_of, read_lights, shaded_scene};
use sgs_scene::{Scene, SceneOptions, Splats};
use sgs_tests::Gpu;
use sgs_tests::cli::sgs;
use sgs_tests::intrinsic::{place, settings};
use sgs_train::{Geometry, Intrinsic};

fn geometry(gpu: &Gpu, scene: &Scene) -> Splats {
    let mut training = Geometry::new(gpu.device(), scene, &settings(1), None).unwrap();
    training.train(20, |_| {}, || true).unwrap();
    training.splats().unwrap()
}

#[test]
fn intrinsic_stage_learns_and_ignores_cache_size_and_interruptions() {
    let (place, _) = place();
    let gpu = Gpu::new();
    let scene = Scene::open(&place.path("scene"), &SceneOptions::default()).unwrap();
    let splats = geometry(&gpu, &scene);
    let train_at = |accuracy: Accuracy, bytes: u64, resumed_at: Option<u32>| {
        let mut s = settings(24);
        s.intrinsic.surface_bytes = bytes;
        s.accuracy = accuracy;
        let mut losses = Vec::new();
        let mut training = Intrinsic::new(gpu.device(), &scene, &s, &splats).unwrap();
        let mut report = |r: &sgs_passes::pipeline::IntrinsicReport| {
            losses.push((r.step, r.shaded.to_bits(), r.albedo.to_bits(), r.roughness.to_bits(), r.materials));
        };
        if let Some(at) = resumed_at {
            let file = place.path("state");
            training.train(at, &mut report, || true).unwrap();
            training.save(&file).unwrap();
            training = Intrinsic::new(gpu.device(), &scene, &s, &splats).unwrap();
            training.restore(&file).unwrap();
        }
        training.train(24, &mut report, || true).unwrap();
        (training.splats().unwrap(), training.lights().unwrap(), losses)
    };
    let train = |bytes, resumed_at| train_at(Accuracy::EXACT, bytes, resumed_at);
    let (trained, lights, losses) = train(0, None);
    let mean = |range: std::ops::Range<usize>| {
        let n = range.len() as f32;
        let sum = losses[range].iter().fold([0.0; 3], |s, l| {
            [s[0] + f32::from_bits(l.1), s[1] + f32::from_bits(l.2), s[2] + f32::from_bits(l.3)]
        });
        sum.map(|v| v / n)
    };
    let (first, last) = (mean(0..6), mean(18..24));
    assert!(last[0] < 0.8 * first[0] && last[1] < first[1] && last[2] < 0.95 * first[2], "from {first:?} to {last:?}");
    assert!(losses.iter().all(|l| l.4.albedo_msg > 0.0 && l.4.albedo_edge > 0.0));
    // Every third step compares albedo with pseudo-views. From step 4 on, every third compares it under other lights.
    for (step, .., materials) in &losses {
        let cross = step.is_multiple_of(3);
        assert!(cross == (materials.cross_view > 0.0) || materials.cross_pairs == 0, "step {step}: {materials:?}");
        assert!((step % 3 == 1 && *step >= 4) == (materials.own_count > 0), "step {step}: {materials:?}");
    }
    assert!(losses.iter().any(|l| l.4.cross_view > 0.0), "no pseudo-view was compared");
    // Geometry is unchanged. Materials are added.
    assert_eq!((&trained.means, &trained.sh, &trained.normals), (&splats.means, &splats.sh, &splats.normals));
    let albedo = trained.albedo.as_ref().unwrap();
    assert!(albedo.iter().flatten().all(|v| v.is_finite()) && albedo.iter().flatten().any(|v| v.abs() > 0.05));
    assert!(trained.metallic.is_some());
    // Results are bit-identical if surfaces are recomputed in each step, and after interruptions.
    for (bytes, resumed_at) in [(1, None), (0, Some(7)), (1, Some(16))] {
        let (other, other_lights, report) = train(bytes, resumed_at);
        assert_eq!(report, losses, "{bytes} bytes, resumed at {resumed_at:?}");
        assert!(other == trained && other_lights == lights, "{bytes} bytes, resumed at {resumed_at:?}");
    }
    // 16-bit storage is deterministic and close to 32 bits.
    let short = Accuracy { visibility_bits: 16, weight_bits: 16, ..Accuracy::EXACT };
    let (trained, lights, report) = train_at(short, 0, None);
    let apart = report.iter().zip(&losses).map(|(a, b)| (f32::from_bits(a.1) / f32::from_bits(b.1) - 1.0).abs());
    let apart = apart.fold(0.0, f32::max);
    assert!(report != losses && apart < 0.05, "losses are {apart} apart");
    let (other, other_lights, again) = train_at(short, 1, Some(7));
    assert!(again == report && other == trained && other_lights == lights, "16 bits are not the same every time");
}

#[test]
fn train_command_writes_a_run_that_shades_and_evaluates() {
    let (place, _) = place();
    let arguments = |run: &str, more: &[&str]| -> Vec<String> {
        let mut a: Vec<String> = ["train", &place.text("scene"), "-o", &place.text(run)].map(str::to_owned).to_vec();
        a.extend(["--geometry-steps", "20", "--no-densify", "--intrinsic-steps", "12"].map(str::to_owned));
        for set in [
            "transport.surfels=0",
            "intrinsic.environment.resolution=16",
            "intrinsic.lights.grid=2",
            "intrinsic.visibility.levels=4",
            "intrinsic.visibility.log2_table=10",
            "intrinsic.visibility.finest=64",
        ] {
            a.extend(["--set".to_owned(), set.to_owned()]);
        }
        a.extend(more.iter().map(|s| (*s).to_owned()));
        a
    };
    sgs(&arguments("none", &["--stage", "intrinsic"])).refused(&["none", "--stage geometry", "--start"]);
    sgs(&arguments("a", &["--stage", "all"])).ok();
    for file in ["scene.ply", "lights.json", "environment.exr", "training.json", "checkpoint/intrinsic.safetensors"] {
        assert!(place.path("a").join(file).is_file(), "{file} is missing");
    }
    assert_eq!(read_lights(&place.path("a/lights.json")).unwrap().lights.len(), 8);
    // Two commands, one per stage, give the same result.
    sgs(&arguments("b", &[])).ok();
    assert!(!place.path("b/lights.json").exists());
    sgs(&arguments("b", &["--stage", "intrinsic"])).ok();
    for file in ["scene.ply", "lights.json", "environment.exr"] {
        assert!(place.read(&format!("a/{file}")) == place.read(&format!("b/{file}")), "{file} differs");
    }
    // Metadata of these files is unordered, so compare their contents.
    let field = |run: &str| VisibilityFile::load(&place.path(run).join("visibility.safetensors")).unwrap();
    assert!(field("a") == field("b"));
    // Train materials on the geometry of another file.
    let start = place.text("a/scene.ply");
    sgs(&arguments("c", &["--stage", "intrinsic", "--start", &start])).ok();
    assert!(place.read("a/lights.json") == place.read("c/lights.json"));
    sgs(&arguments("d", &["--start", &start])).refused(&["--start", "--stage intrinsic"]);
    // The run can be evaluated and shaded.
    sgs(&["eval", &place.text("a")]).ok();
    let metrics: serde_json::Value = serde_json::from_slice(&place.read("a/metrics.json")).unwrap();
    assert!(metrics["test"]["mean"]["pbr"]["psnr"].as_f64().unwrap() > 5.0, "{metrics}");
    let run = RunDirectory::open(&place.path("a")).unwrap();
    let gpu = Gpu::new();
    let splats = Splats::read_ply(&place.path("a/scene.ply")).unwrap();
    let light = light_of(&run, &run.settings().unwrap()).unwrap();
    let (lights, environment) = (light.lights.as_ref(), light.environment.as_ref());
    let scene = shaded_scene(gpu.device(), &splats, lights, environment, &light.visibility).unwrap();
    let mut shading = Shading::new(gpu.device(), scene).unwrap();
    let opened = Scene::open(&place.path("scene"), &SceneOptions::default()).unwrap();
    let shaded = shading.shade(&opened.views[0].camera).unwrap();
    let seen = shaded.visibility().unwrap();
    assert!(seen.data.iter().all(|v| (0.0..=1.0).contains(v)) && seen.data.iter().any(|v| *v > 0.01));
    let displayed_image = displayed(&shaded.radiance([0.0; 3]));
    assert!(displayed_image.data.iter().all(|v| v.is_finite()) && displayed_image.data.iter().any(|v| *v > 0.1));
    let (all, parts) = (shaded.radiance([0.0; 3]), (shaded.direct(), shaded.ambient()));
    for ((a, d), e) in all.data.iter().zip(&parts.0.data).zip(&parts.1.data) {
        assert!((a - d - e).abs() <= 1e-5 * a.abs().max(1.0));
    }

    // Direct light without rendering the geometry again gives the same result, whatever gains and views came before.
    let gains: Vec<f32> = lights.unwrap().lights.iter().map(|l| l.gain).collect();
    let alone: Vec<f32> = gains.iter().enumerate().map(|(i, g)| if i % 3 == 1 { 2.0 * g } else { 0.0 }).collect();
    let scene = shaded_scene(gpu.device(), &splats, lights, environment, &light.visibility).unwrap();
    let mut quick = Shading::new(gpu.device(), scene).unwrap().without_visibility();
    for (view, gains) in [(0, &gains), (0, &alone), (1, &alone), (1, &gains), (0, &alone)] {
        let camera = &opened.views[view].camera;
        shading.set_gains(gpu.device(), gains).unwrap();
        quick.set_gains(gpu.device(), gains).unwrap();
        let whole = shading.shade(camera).unwrap();
        let (expected, direct) = (whole.direct(), quick.direct(camera).unwrap());
        assert!(direct == expected && expected.data.iter().any(|v| *v > 0.0), "view {view}");
        assert!(shading.direct(camera).unwrap() == expected);
    }
    assert!(quick.shade(&opened.views[0].camera).unwrap().visibility().is_none());
}

/// Bounds the memory of a step, without the scene.
///
/// The published method needs about 90 GB at these sizes.
#[test]
fn a_large_step_fits_into_two_and_a_half_gigabytes() {
    use sgs_passes::pipeline::{IntrinsicOptions, IntrinsicRates, IntrinsicSizes, IntrinsicStep};
    use sgs_passes::pipeline::{Masks, SurfaceBuilder, SurfaceShape};
    use sgs_passes::scene::{Layout, Model, Storage};
    use sgs_passes::shade::environment::{Environment, EnvironmentOptions};
    use sgs_passes::shade::lights::LightModel;
    use sgs_passes::shade::traced::TracedShape;
    use sgs_passes::shade::visibility::FieldConfig;
    let gpu = Gpu::new();
    let pixels = 1600 * 1200;
    // Twenty splats contribute to each of a million pixels.
    let shape = SurfaceShape { largest: [1600, 1200], gaussians: 1_000_000, weights: 20 * pixels, weight_bits: 32 };
    let environment =
        Environment::new(256, &EnvironmentOptions { smoothness: None, ..EnvironmentOptions::default() }).unwrap();
    let rates = IntrinsicRates {
        albedo: 0.01,
        roughness: 0.01,
        metallic: 0.01,
        light_positions: 0.05,
        lights: 0.05,
        environment: 0.05,
        visibility: 4e-3,
        normals: 0.0,
    };
    let options = IntrinsicOptions {
        albedo_range: sgs_passes::shade::ALBEDO_RANGE,
        shape,
        metallic: false,
        lights: Some((LightModel::default(), 1.0 / 64.0)),
        visibility: Some(FieldConfig::new(16, 19, 32, 4096)),
        traced: None,
        transport: None,
        visibility_jitter: true,
        visibility_sample: 1,
        light_regularizers: [1e-6, 1e-4],
        cull_error: 0.0,
        environment_smooth: 0.0,
        environment_every: 1,
        edge_aware: true,
        gradients: true,
        masks: Masks::Carried,
        cross_view: false,
        relight: false,
        own_prior: false,
        relight_roughness: 0.0,
        rates,
        image: false,
        timestamps: false,
        frames_in_flight: 2,
    };
    let photographs = 12 * 4 * u64::from(pixels);
    let priors = Some(photographs);
    let sizes = IntrinsicSizes { targets: photographs, albedo: priors, roughness: priors, ..Default::default() };
    let step = IntrinsicStep::plan(&gpu.tuning(), &sizes, Some(&environment), &options).unwrap();
    let model = Model { sh_degree: 0, normals: true, semantics: false, mip: false };
    let layout =
        Layout { model, capacity: shape.gaussians, training: false, statistics: false, storage: Storage::Exact };
    let builder = SurfaceBuilder::plan(&gpu.tuning(), &layout, shape, 4_000_000).unwrap();
    let (step, view, builder) = (step.arena_bytes, shape.bytes(), builder.arena_bytes);
    let all = step + view + builder;
    println!("step {step}, one view's surfaces {view}, working them out {builder}: {all} bytes");
    assert!(all < 2_500_000_000, "step {step}, one view's surfaces {view}, working them out {builder}: {all} bytes");
    assert!(step > 0 && view > 0, "nothing was counted");
    // Traced shadows store ray results up to the capacity.
    let sizes_of = |options: &IntrinsicOptions| {
        IntrinsicStep::plan(&gpu.tuning(), &sizes, Some(&environment), options).unwrap().arena_bytes
    };
    let room = 32 << 20;
    let tree = TracedShape { sizes: [1 << 26, 1 << 26], offset: 0.0, clearance: 0.0, room };
    let without = sizes_of(&IntrinsicOptions { visibility: None, ..options });
    let traced = sizes_of(&IntrinsicOptions { visibility: None, traced: Some(tree), ..options });
    assert!(traced <= without + room + (8 << 20), "{traced} bytes, {without} without shadows");
}

/// Culling with an error bound of zero changes nothing.
///
/// With a positive bound, culling skips contributions.
#[test]
fn culling_stays_within_its_error() {
    let (place, _) = place();
    let gpu = Gpu::new();
    let scene = Scene::open(&place.path("scene"), &SceneOptions::default()).unwrap();
    let splats = Splats::from_points(&scene.points, 1).unwrap();
    let first = |kind: VisibilityKind, cull_error: f32| {
        let mut s = settings(1);
        (s.intrinsic.visibility.kind, s.intrinsic.cull_error) = (kind, cull_error);
        s.intrinsic.environment.resolution = 0;
        // Distant lights are faint.
        s.intrinsic.lights.start = 0.3;
        let mut loss = 0.0;
        let mut training = Intrinsic::new(gpu.device(), &scene, &s, &splats).unwrap();
        training.train(1, |r| loss = r.shaded, || true).unwrap();
        (loss, training.lights().unwrap().unwrap(), training.splats().unwrap())
    };
    for kind in [VisibilityKind::Field, VisibilityKind::Traced, VisibilityKind::None] {
        let exact = first(kind, 0.0);
        assert!(first(kind, 1e-9) == exact, "{kind:?}: what reaches everywhere was left out");
        let short = first(kind, 0.5);
        assert!(short.1 != exact.1 && short.0.is_finite(), "{kind:?}: nothing was left out");
        // Culling skips contributions and removes no light.
        assert!(short.1.lights.len() == exact.1.lights.len());
    }
    let mut s = settings(1);
    s.intrinsic.cull_error = f32::INFINITY;
    let error = Intrinsic::new(gpu.device(), &scene, &s, &splats).err().unwrap().to_string();
    assert!(error.contains("intrinsic.cull_error is inf"), "{error}");
}

/// Trains with an environment map updated every third step, on half-size images.
#[test]
fn environment_update_interval_and_half_size_images() {
    let (place, _) = place();
    let gpu = Gpu::new();
    let scene = Scene::open(&place.path("scene"), &SceneOptions::default()).unwrap();
    let splats = Splats::from_points(&scene.points, 1).unwrap();
    let mut s = settings(12);
    (s.intrinsic.environment.every, s.intrinsic.scale) = (3, 0.5);
    let file = place.path("state");
    let new = || Intrinsic::new(gpu.device(), &scene, &s, &splats).unwrap();
    let texels = |t: &Intrinsic| t.light().unwrap().environment.unwrap().data;
    let train = |stops: &[u32]| {
        let mut training = new();
        let (mut losses, mut seen) = (Vec::new(), vec![texels(&training)]);
        for last in 1..=12 {
            training.train(last, |r| losses.push(r.shaded), || true).unwrap();
            seen.push(texels(&training));
            if stops.contains(&last) {
                training.save(&file).unwrap();
                training = new();
                training.restore(&file).unwrap();
            }
        }
        (losses, seen, training.splats().unwrap())
    };
    let straight = train(&[]);
    assert!(straight == train(&[2, 3, 7]), "being stopped has changed something");
    for (step, pair) in straight.1.windows(2).enumerate() {
        assert_eq!(pair[0] != pair[1], (step + 1).is_multiple_of(3), "step {}", step + 1);
    }
    assert!(straight.0.iter().all(|l| l.is_finite()) && straight.0[11] < straight.0[0], "{:?}", straight.0);

    // A quarter of the pixels needs about a quarter of the view's memory.
    let whole = Intrinsic::new(gpu.device(), &scene, &settings(12), &splats).unwrap().surface_bytes();
    let small = new().surface_bytes();
    assert!(small < whole / 2, "{small} of {whole} bytes");
    for (key, value) in [("scale", 0.0), ("scale", 1.5)] {
        let mut s = settings(12);
        s.intrinsic.scale = value;
        let error = Intrinsic::new(gpu.device(), &scene, &s, &splats).err().unwrap().to_string();
        assert!(error.contains(&format!("intrinsic.{key} is {value}")), "{error}");
    }
    s.intrinsic.environment.every = 0;
    let error = Intrinsic::new(gpu.device(), &scene, &s, &splats).err().unwrap().to_string();
    assert_eq!(error, "intrinsic.environment.every is 0, but must be 1 to 64.");
}

/// Albedo stays within the range of the settings, including the published range.
///
/// Initial values within the range are retained.
#[test]
fn albedo_stays_in_its_range() {
    let (place, _) = place();
    let gpu = Gpu::new();
    let scene = Scene::open(&place.path("scene"), &SceneOptions::default()).unwrap();
    let mut splats = geometry(&gpu, &scene);
    // Initial albedo ranges from almost black to almost white.
    splats.albedo = Some((0..splats.len()).map(|i| [-6.0, 0.0, -4.0 + 0.01 * (i % 800) as f32]).collect());
    let train = |range: [f32; 2], start: &Splats, steps: u32| {
        let mut s = settings(8);
        s.intrinsic.albedo_range = range;
        let mut training = Intrinsic::new(gpu.device(), &scene, &s, start).unwrap();
        training.train(steps, |_| {}, || true).unwrap();
        training.splats().unwrap()
    };
    let values = |s: &Splats| -> Vec<f32> {
        let raw = s.albedo.as_ref().unwrap().as_flattened();
        raw.iter().map(|raw| 0.01 + 0.98 / (1.0 + (-raw).exp())).collect()
    };
    let ours = train([0.01, 0.99], &splats, 8);
    let least = values(&ours).into_iter().fold(1.0, f32::min);
    assert!(least < 0.09, "{least}");
    let published = train([0.09, 0.99], &splats, 8);
    assert!(values(&published).iter().all(|v| *v > 0.0899), "an albedo is darker than 0.09");
    let narrow = train([0.3, 0.6], &ours, 8);
    assert!(values(&narrow).iter().all(|v| (0.2999..0.6001).contains(v)), "an albedo is out of its range");
    // Without training, values within the range equal the initial values.
    for (before, after) in values(&ours).iter().zip(values(&train([0.05, 0.99], &ours, 0))) {
        assert!((before.clamp(0.0502, 0.9898) - after).abs() < 2e-4, "{before} {after}");
    }
}

/// Steps record nothing once each graph has replayed each view in each slot.
#[test]
fn steady_state_records_nothing() {
    let (place, _) = place();
    let gpu = Gpu::new();
    let scene = Scene::open(&place.path("scene"), &SceneOptions::default()).unwrap();
    let splats = geometry(&gpu, &scene);
    for bytes in [0, 1] {
        let mut s = settings(210);
        s.intrinsic.surface_bytes = bytes;
        // Every third update of the environment map is a graph of its own.
        s.intrinsic.environment.every = 3;
        let mut training = Intrinsic::new(gpu.device(), &scene, &s, &splats).unwrap();
        training.train(150, |_| {}, || true).unwrap();
        let (before, memory) = (training.host_times(), gpu.device().memory_use().0);
        // Plain, cross-view and relight steps, in two slots each. All surfaces are stored, or one for all views.
        let views = if bytes == 0 { scene.split.train.len() } else { 1 };
        assert_eq!(before.recordings, 3 * 2 * views as u64, "surface_bytes = {bytes}");
        training.train(210, |_| {}, || true).unwrap();
        let after = training.host_times();
        assert_eq!((after.replays, after.recordings), (before.replays + 60, before.recordings));
        assert_eq!(gpu.device().memory_use().0, memory);
    }
}
