//! Memory budget: training allocates what the estimate before the first step says. Plans that do not fit are refused
//! with their sizes. Refused growth loses no result.

use sgs_config::{Backward, Settings, ShDegree};
use sgs_engine::{BudgetSource, Device, DeviceOptions, Error, ImageFormat, Location};
use sgs_scene::{Scene, SceneOptions};
use sgs_tests::meaning::Meaning;
use sgs_tests::place::Place;
use sgs_tests::priors::provider;
use sgs_tests::rooms::Room;
use sgs_tests::{Gpu, turn};
use sgs_train::{Geometry, Progress, TrainError};

fn settings(steps: u32) -> Settings {
    let mut s = Settings::default();
    s.geometry.steps = steps;
    let d = &mut s.geometry.densify;
    (d.from, d.interval, d.until, d.reset_interval) = (5, 5, 0.8, 12);
    (d.grad_threshold, d.max_gaussians) = (5e-5, 3000);
    s
}

#[test]
fn plans_over_budget_are_refused_with_sizes() {
    let _turn = turn();
    let select = std::env::var("SGS_TEST_DEVICE").ok();
    let options = DeviceOptions { select, validation: true, memory_budget: Some(1 << 20), ..Default::default() };
    let device = Device::open(&options).unwrap();
    let b = device.budget();
    assert_eq!((b.budget, b.used, b.source), (1 << 20, 0, BudgetSource::Configured));
    assert!(b.heap >= b.budget);
    let retained = device.buffer("kept", 1 << 19, Location::Device).unwrap();
    let error = device.buffer("too much", (1 << 19) + 4, Location::Device).unwrap_err();
    assert_eq!(
        error.to_string(),
        "524292 bytes for \"too much\" exceed the memory budget: 524288 of 1048576 bytes are in use."
    );
    let image = device.image("image", [512, 512], ImageFormat::Rgba8Unorm).unwrap_err();
    assert!(matches!(image, Error::OverBudget { used: 524_288, .. }), "{image}");
    assert!(matches!(device.buffer("host", 1 << 20, Location::Upload), Err(Error::OverBudget { .. })));
    // Buffers that fill the budget exactly fit, and refused buffers leave nothing allocated.
    let rest = device.buffer("rest", 1 << 19, Location::Device).unwrap();
    assert_eq!(device.budget().left(), 0);
    drop(retained);
    assert_eq!(device.budget().used, 1 << 19);
    device.set_memory_budget(None);
    assert_ne!(device.budget().source, BudgetSource::Configured);
    drop((device.buffer("more", 4 << 20, Location::Device).unwrap(), rest));
    assert_eq!(device.messages().take(), Vec::<String>::new());
}

#[test]
fn training_memory_matches_estimate() {
    let place = Place::new(Room { priors: true, ..Room::default() });
    let scene = Scene::open(&place.path("scene"), &SceneOptions::default()).unwrap();
    let gpu = Gpu::fresh();
    let cases = [
        (true, Backward::Auto, 32, [0.0; 4]),
        (false, Backward::Auto, 32, [0.0; 4]),
        (false, Backward::Bucket, 32, [1e-4; 4]),
        (true, Backward::Auto, 16, [0.0; 4]),
        (false, Backward::Auto, 16, [1e-4, 0.0, 0.0, 0.0]),
    ];
    for (densify, backward, bits, views) in cases {
        let mut s = settings(4);
        s.geometry.rates.views = views.into();
        s.accuracy.state_bits = bits;
        s.geometry.backward = backward;
        s.geometry.densify.until = if densify { 0.8 } else { 0.0 };
        s.geometry.entry_capacity = 1 << 15;
        let mut training = Geometry::new(gpu.device(), &scene, &s, None).unwrap();
        let needs = *training.needs();
        assert!(needs.priors > 0 && (needs.statistics > 4) == densify);
        assert_eq!(gpu.device().memory_use().0, needs.total() - needs.staging - needs.densify_arena);
        training.train(2, |_| {}, || true).unwrap();
        // Staging aside, the prediction for the end of a training without growth equals its needs.
        let count = training.gaussians().count(gpu.device()).unwrap();
        let sight = training.sight().unwrap();
        let entries = sight.most_entries;
        let foretold = training.expected(count, count, entries).unwrap();
        assert_eq!((foretold.total() - foretold.staging, foretold.bands), (needs.total() - needs.staging, 0));
        assert!(entries > 0 && training.expected(4 * count, count, entries).unwrap().total() >= foretold.total());
        // The estimated cost covers every pass, and more Gaussians cost more.
        let (cost, unknown) = training.step_cost(&sight).unwrap();
        let (more, _) = training.step_cost(&sight.with(4 * count)).unwrap();
        assert!(unknown == 0 && cost.operations > 20.0 * sight.entries && cost.bytes > 100.0 * sight.visible);
        assert!(more.operations > 2.0 * cost.operations && more.bytes > 2.0 * cost.bytes, "{cost:?} {more:?}");
        let room = training.gaussians().capacity;
        drop(training);

        // A budget equal to the needs allows steps. With a byte less, an error is returned and nothing stays allocated.
        s.memory.budget = needs.total() - 1;
        if densify {
            // Capacity to grow is optional at first: a byte less does not cause a refusal.
            let training = Geometry::new(gpu.device(), &scene, &s, None).unwrap();
            assert!(training.needs().total() <= s.memory.budget && training.gaussians().capacity < room);
            drop(training);
            s.memory.budget = needs.staging + needs.photographs;
        }
        let error = Geometry::new(gpu.device(), &scene, &s, None).err().unwrap();
        assert!(matches!(error, TrainError::Memory(_)), "{error}");
        for word in ["The first step needs", "parameters", "moments", "arena", "--memory-budget"] {
            // Less than 64 KiB are not listed, such as the compact parameters of this small room.
            let listed = word != "parameters" || bits == 32;
            assert!(!listed || error.to_string().contains(word), "{word}: {error}");
        }
        assert_eq!(gpu.device().memory_use().0, 0);
        s.memory.budget = needs.total();
        Geometry::new(gpu.device(), &scene, &s, None).unwrap().train(2, |_| {}, || true).unwrap();
        gpu.device().set_memory_budget(None);
    }
}

/// Tests that the peak of a growing training is within 5 % of the estimate. Semantics and pseudo-views are on. The
/// estimate uses statistics of the first views. The number of Gaussians that fit a budget is tested as well.
#[test]
fn densification_memory_matches_estimate() {
    let room = Room { views: 8, size: [64, 48], spacing: 1, priors: true, ..Room::default() };
    let place = Place::new(room);
    Meaning::default().write(&room, &place.path("scene"));
    let scene = Scene::open(&place.path("scene"), &SceneOptions::default()).unwrap();
    let mut s = settings(40);
    (s.geometry.densify.interval, s.geometry.densify.grad_threshold) = (10, 2e-5);
    (s.geometry.densify.max_gaussians, s.geometry.pseudo.poses) = (40_000, 3);
    s.geometry.correspondence_from = 5;
    for auto in [false, true] {
        if auto {
            s.geometry.sh_degree = ShDegree::Auto;
        }
        let gpu = Gpu::fresh();
        let mut training = Geometry::new(gpu.device(), &scene, &s, None).unwrap();
        let count = training.gaussians().count(gpu.device()).unwrap();
        let entries = training.sight().unwrap().most_entries;
        training.train(40, |_| {}, || true).unwrap();
        let (n, peak) = (training.gaussians().count(gpu.device()).unwrap(), gpu.device().memory_use().1);
        drop(training);
        let training = Geometry::new(gpu.device(), &scene, &s, None).unwrap();
        let most = training.expected(n, count, entries).unwrap().total();
        let least = training.expected_without_bands(n, count, entries).unwrap().map_or(most, |n| n.total());
        println!("{count} became {n}: {peak} bytes at most, {least} to {most} foretold");
        assert!(n > 2 * count && (least < most) == auto, "{count} became {n}");
        assert!(peak as f64 > 0.95 * least as f64 && (peak as f64) < 1.05 * most as f64, "{peak}: {least} to {most}");
        drop(training);
        // A step with pseudo-views costs more, and the cost of each of its passes is known.
        let mut bound = s.clone();
        bound.memory.budget = most;
        let mut training = Geometry::new(gpu.device(), &scene, &bound, None).unwrap();
        let sight = training.sight().unwrap();
        let ((step, unknown), Some((pseudo, other))) =
            (training.step_cost(&sight).unwrap(), training.pseudo_step_cost(&sight).unwrap())
        else {
            panic!("there are pseudo-views")
        };
        assert!((unknown, other) == (0, 0), "{unknown} and {other} passes are unknown");
        assert!(pseudo.operations > 1.5 * step.operations, "{step:?} {pseudo:?}");
        // That budget holds at least as many Gaussians, and less than half as many more.
        let fit = training.most_within_budget(count, entries).unwrap();
        assert!(fit >= n && u64::from(fit) < u64::from(n) * 3 / 2, "{fit} of {n}");
        // Within a smaller budget, training completes with fewer Gaussians.
        bound.memory.budget = training.needs().total() * 5 / 4;
        drop((training, gpu));
        let gpu = Gpu::fresh();
        let mut training = Geometry::new(gpu.device(), &scene, &bound, None).unwrap();
        training.train(40, |_| {}, || true).unwrap();
        let (fewer, peak) = (training.gaussians().count(gpu.device()).unwrap(), gpu.device().memory_use().1);
        println!("{fewer} within {} bytes: {peak}", bound.memory.budget);
        assert!(peak <= bound.memory.budget && fewer < n && fewer > count, "{peak} bytes, {fewer} of {n}");
    }
}

/// Tests that images for the provider are part of the estimate. Where they do not fit, training continues without them.
#[test]
fn provider_image_memory_matches_estimate() {
    let room = Room { priors: true, ..Room::default() };
    let place = Place::new(room);
    Meaning::default().write(&room, &place.path("scene"));
    let scene = Scene::open(&place.path("scene"), &SceneOptions::default()).unwrap();
    let mut s = settings(12);
    s.geometry.densify.until = 0.0;
    (s.geometry.correspondence_from, s.geometry.pseudo.poses) = (4, 3);
    s.provider.command = provider("misbehave=nothing");
    let gpu = Gpu::fresh();
    let train = |s: &Settings| {
        let mut training = Geometry::new(gpu.device(), &scene, s, None).unwrap();
        let mut pairs = 0;
        let on_progress = |p: &Progress| {
            if let Progress::Step(r) = p {
                pairs += r.losses.correspondence_pairs;
            }
        };
        training.train(12, on_progress, || true).unwrap();
        (*training.needs(), pairs, gpu.device().memory_use())
    };
    let (needs, pairs, (now, _)) = train(&s);
    assert!(pairs > 0 && needs.requested > 0 && now == needs.total() - needs.staging, "{now} bytes taken: {needs:?}");
    // With a budget of exactly the needs, the provider is still queried.
    s.memory.budget = needs.total();
    let (_, again, (_, peak)) = train(&s);
    assert!(again == pairs && peak <= s.memory.budget, "{again} of {pairs}");
    gpu.device().set_memory_budget(None);
}

/// Tests that training fails if the arena for tile entries may not grow. Training can continue later, with the same
/// result.
#[test]
fn refused_growth_preserves_gaussians() {
    let place = Place::new(Room::default());
    let scene = Scene::open(&place.path("scene"), &SceneOptions::default()).unwrap();
    let gpu = Gpu::fresh();
    let mut s = settings(30);
    let straight = {
        let mut training = Geometry::new(gpu.device(), &scene, &s, None).unwrap();
        training.train(30, |_| {}, || true).unwrap();
        training.splats().unwrap()
    };
    s.geometry.entry_capacity = 8;
    let mut training = Geometry::new(gpu.device(), &scene, &s, None).unwrap();
    training.train(4, |_| {}, || true).unwrap();
    training.save(&place.path("state")).unwrap();
    let state = place.read("state");
    // Sufficient for everything but a larger arena.
    gpu.device().set_memory_budget(Some(gpu.device().memory_use().0 + 4096));
    let error = training.train(30, |_| {}, || true).unwrap_err();
    assert!(
        matches!(&error, TrainError::Engine(Error::OverBudget { what, .. }) if what == "arena of geometry_step"),
        "{error}"
    );
    // A second attempt fails with the same error.
    assert!(matches!(training.train(30, |_| {}, || true), Err(TrainError::Engine(Error::OverBudget { .. }))));
    gpu.device().set_memory_budget(None);
    training.train(30, |_| {}, || true).unwrap();
    assert!(training.splats().unwrap() == straight, "the refusal changed the result");
    // Training from the checkpoint gives the same result.
    assert!(place.read("state") == state);
    let mut training = Geometry::new(gpu.device(), &scene, &s, None).unwrap();
    training.restore(&place.path("state")).unwrap();
    training.train(30, |_| {}, || true).unwrap();
    assert!(training.splats().unwrap() == straight);
}

#[test]
fn densification_stops_where_memory_ends() {
    let place = Place::new(Room { views: 8, size: [64, 48], spacing: 1, ..Room::default() });
    let scene = Scene::open(&place.path("scene"), &SceneOptions::default()).unwrap();
    let mut s = settings(16);
    (s.geometry.densify.grad_threshold, s.geometry.densify.interval) = (0.0, 1);
    (s.geometry.densify.max_gaussians, s.geometry.densify.prune_weight) = (100_000, 0.0);
    let train = |s: &Settings| {
        let mut after = Vec::new();
        let gpu = Gpu::fresh();
        let mut training = Geometry::new(gpu.device(), &scene, s, None).unwrap();
        let on_progress = |p: &Progress| {
            if let Progress::Densified { stats, .. } = p {
                after.push(stats.after);
            }
        };
        training.train(16, on_progress, || true).unwrap();
        (after, gpu.device().memory_use().1, training.needs().total())
    };
    let (free, _, needs) = train(&s);
    let most = *free.iter().max().unwrap();
    assert!(most > 60_000, "{free:?}");
    // Capacity for the first steps and some growth.
    s.memory.budget = needs + needs / 2;
    let (bound, peak, _) = train(&s);
    assert!(*bound.iter().max().unwrap() < most, "{bound:?}");
    assert!(bound.last() > bound.first(), "growth was to go on within the budget: {bound:?}");
    assert_eq!(bound.len(), free.len());
    assert!(peak <= s.memory.budget, "{peak} of {} bytes", s.memory.budget);
}

/// Tests that training completes within every budget that its start fits. This holds after a resume as well, with the
/// same result.
#[test]
fn training_completes_within_a_budget_just_above_its_start() {
    let place = Place::new(Room { views: 8, size: [64, 48], spacing: 1, ..Room::default() });
    let scene = Scene::open(&place.path("scene"), &SceneOptions::default()).unwrap();
    let mut s = settings(24);
    (s.geometry.densify.grad_threshold, s.geometry.densify.max_gaussians) = (0.0, 100_000);
    let most = scene.points.len() as u32;
    let least = |s: &Settings| {
        let starts = |budget: u64| {
            let gpu = Gpu::fresh();
            let s = Settings { memory: sgs_config::MemorySettings { budget }, ..s.clone() };
            // With a smaller budget, training starts from fewer points.
            Geometry::new(gpu.device(), &scene, &s, None)
                .is_ok_and(|t| t.gaussians().count(gpu.device()).unwrap() == most)
        };
        let (mut low, mut high) = (1_u64 << 20, 64_u64 << 20);
        assert!(!starts(low) && starts(high));
        while high - low > 4096 {
            let middle = low + (high - low) / 2;
            *(if starts(middle) { &mut high } else { &mut low }) = middle;
        }
        high
    };
    // Without densification, the budget takes precedence over a constant number of Gaussians.
    for (densify, more, pruned) in [(true, 0, true), (true, 1 << 22, false), (false, 0, true)] {
        s.geometry.densify.until = if densify { 0.8 } else { 0.0 };
        s.memory.budget = least(&Settings { memory: Default::default(), ..s.clone() }) + more;
        let train = |at: Option<u32>| {
            let gpu = Gpu::fresh();
            let mut losses = Vec::new();
            let mut on_progress = |p: &Progress| {
                if let Progress::Step(r) = p {
                    losses.push((r.losses.total, r.gaussians));
                }
            };
            let mut training = Geometry::new(gpu.device(), &scene, &s, None).unwrap();
            if let Some(at) = at {
                training.train(at, &mut on_progress, || true).unwrap();
                training.save(&place.path("state")).unwrap();
                drop(training);
                training = Geometry::new(gpu.device(), &scene, &s, None).unwrap();
                training.restore(&place.path("state")).unwrap();
            }
            training.train(24, &mut on_progress, || true).unwrap();
            let decisions: Vec<_> = training.decisions().iter().map(ToString::to_string).collect();
            let peak = gpu.device().memory_use().1;
            assert!(peak <= s.memory.budget, "{peak} of {} bytes", s.memory.budget);
            assert_eq!(gpu.device().messages().take(), Vec::<String>::new());
            (training.splats().unwrap(), losses, decisions)
        };
        let (splats, losses, decisions) = train(None);
        println!("{} bytes: {} points, then {} Gaussians: {decisions:?}", s.memory.budget, most, splats.len());
        assert!(splats.len() > most as usize / 4, "{} of {most} are left", splats.len());
        // Until opacities are reset, losses stay below the first.
        assert!(
            losses.iter().all(|l| l.0.is_finite()) && losses[6..12].iter().all(|l| l.0 < losses[0].0),
            "{losses:?}"
        );
        let output = |what: &str| decisions.iter().any(|d| d.starts_with(what));
        assert_eq!(output("the faintest Gaussians left out"), pruned, "{decisions:?}");
        for at in [3, 7, 15] {
            let (again, _, reported) = train(Some(at));
            assert_eq!(reported, decisions, "resumed at {at}");
            assert!(again == splats, "resumed at {at}: the splats differ");
        }
    }
}
