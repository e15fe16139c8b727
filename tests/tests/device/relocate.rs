//! Markov chain Monte Carlo against its reference.
//!
//! Relocation of Gaussians and noise on means.

use sgs_engine::graph::Graph;
use sgs_passes::Tuning;
use sgs_passes::cost::{Counts, of_plan};
use sgs_passes::optim::{Relocate, position_noise, relocate};
use sgs_passes::pipeline::{DensifyRule, DensifyStep, GeometryOptions, GeometryStep, InputSizes};
use sgs_passes::reference::project::rotation;
use sgs_passes::reference::relocate as reference;
use sgs_passes::reference::rng::Pcg;
use sgs_passes::scene::{GaussianData, Group, Layout, Model, Storage};
use sgs_passes::splat::Channels;
use sgs_shaders::structs::{Densify, DensifyStats, Step, Work};
use sgs_tests::whole::step_options;
use sgs_tests::{Gpu, Tolerance, assert_close};

const MODEL: Model = Model { sh_degree: 1, normals: true, semantics: true, mip: false };

/// Opacity below which a Gaussian is dead.
const LEAST: f64 = 0.005;

/// Group whose first number encodes the index of the original Gaussian. Copies retain it.
const TAG: Group = Group::Semantics;

fn bytes<T: bytemuck::NoUninit>(data: &[T]) -> Vec<u8> {
    bytemuck::cast_slice(data).to_vec()
}

fn work_of(count: usize) -> Work {
    Work { x: count.div_ceil(256).max(1) as u32, y: 1, z: 1, count: count as u32 }
}

/// Gaussians of a capacity with pairs of moments. The rest of the capacity is NaN.
#[derive(Clone)]
struct Scene {
    count: usize,
    capacity: usize,
    parameters: GaussianData,
    moments: GaussianData,
}

impl Scene {
    /// Builds random Gaussians with opacities from logits.
    fn new(logits: &[f32], capacity: usize, seed: u32) -> Scene {
        let mut rng = Pcg::new(seed);
        let (mut parameters, mut moments) = (GaussianData::default(), GaussianData::default());
        for group in MODEL.groups() {
            let width = group.width() as usize;
            let fill = |n: usize, rng: &mut Pcg| {
                let mut values = vec![f32::from_bits(u32::MAX); n * capacity];
                // Numbers that 16 bits hold, so that compact storage keeps them.
                values[..n * logits.len()].fill_with(|| (64.0 * rng.normal()).round() as f32 / 64.0);
                values
            };
            parameters.groups[group as usize] = fill(width, &mut rng);
            moments.groups[group as usize] = fill(2 * width, &mut rng);
            for pair in moments.groups[group as usize].as_chunks_mut::<2>().0 {
                *pair = pair.map(|x| (x * 8.0).abs().round() / 8.0);
            }
        }
        parameters.groups[Group::OpacityLogits as usize][..logits.len()].copy_from_slice(logits);
        let width = TAG.width() as usize;
        (0..logits.len()).for_each(|i| parameters.groups[TAG as usize][i * width] = i as f32);
        Scene { count: logits.len(), capacity, parameters, moments }
    }

    /// Builds Gaussians of which this fraction is dead: faint ones, and some with a number that is not finite.
    fn random(count: usize, capacity: usize, dead: f64, seed: u32) -> Scene {
        let mut rng = Pcg::new(seed ^ 0x55);
        let of = |rng: &mut Pcg| if rng.uniform() < dead { rng.range(-9.0, -5.5) } else { rng.range(-5.2, 9.0) };
        let logits: Vec<f32> = (0..count).map(|_| of(&mut rng) as f32).collect();
        let mut scene = Scene::new(&logits, capacity, seed);
        for i in (0..count).filter(|i| i % 17 == 3 && dead > 0.0) {
            let group = [Group::Means, Group::LogScales, Group::Rotations, Group::OpacityLogits, Group::Sh0][i % 5];
            let width = group.width() as usize;
            let bad = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY][i % 3];
            scene.parameters.groups[group as usize][i * width + i % width] = bad;
        }
        scene
    }

    fn row(data: &GaussianData, group: Group, i: usize, pairs: usize) -> &[f32] {
        let width = pairs * group.width() as usize;
        &data.group(group)[i * width..][..width]
    }

    fn logit(&self, i: usize) -> f64 {
        f64::from(self.parameters.group(Group::OpacityLogits)[i])
    }

    fn valid(&self, i: usize) -> bool {
        let groups = [Group::Means, Group::LogScales, Group::Rotations, Group::OpacityLogits, Group::Sh0];
        groups.iter().all(|g| Scene::row(&self.parameters, *g, i, 1).iter().all(|x| x.is_finite()))
    }

    fn alive(&self, i: usize) -> bool {
        self.valid(i) && reference::opacity(self.logit(i)) >= LEAST
    }

    /// Returns the scene after relocation and the reported counts.
    fn run(&self, gpu: &Gpu, cap: u32, seed: u32, storage: Storage) -> (Scene, DensifyStats) {
        let mut g = Graph::new("relocate");
        let layout =
            Layout { model: MODEL, capacity: self.capacity as u32, training: true, statistics: false, storage };
        let handles = layout.declare(&mut g, true);
        let stats = g.external("stats", size_of::<DensifyStats>() as u64);
        let settings = g.uniform("settings", size_of::<Densify>() as u64);
        let a = Relocate::of(&handles, settings, stats).unwrap();
        relocate(&mut g, gpu.tuning(), &a).unwrap();
        let values = Densify { prune_opacity: LEAST as f32, cap, seed, grad_threshold: f32::NAN, ..Default::default() };
        let [first, second] = MODEL.moments_to_columns(&self.moments);
        let [first, second] = storage.store_moments([&first, &second]);
        let inputs = [
            (settings, bytes(&[values])),
            (handles.work, bytes(&[work_of(self.count)])),
            (handles.parameters, bytes(&storage.store(&MODEL, &MODEL.to_columns(&self.parameters)))),
            (handles.semantics, bytes(self.parameters.group(Group::Semantics))),
            (a.moments.first, bytes(&first)),
            (a.moments.second, bytes(&second)),
            (a.moments.semantics, bytes(self.moments.group(Group::Semantics))),
        ];
        let out = gpu.run(g, &inputs);
        let work: Work = out.get(handles.work)[0];
        assert_eq!(work, work_of(work.count as usize));
        let words = |buffer| out.get::<u32>(buffer);
        let moments = storage.load_moments([&words(a.moments.first), &words(a.moments.second)]);
        let columns = storage.load(&MODEL, &words(handles.parameters));
        let mut after = Scene {
            count: work.count as usize,
            capacity: self.capacity,
            parameters: MODEL.from_columns(&columns, self.capacity),
            moments: MODEL.moments_from_columns([&moments[0], &moments[1]], self.capacity),
        };
        after.parameters.groups[Group::Semantics as usize] = out.get(handles.semantics);
        after.moments.groups[Group::Semantics as usize] = out.get(a.moments.semantics);
        (after, out.get(stats)[0])
    }

    /// Returns the scene as storage holds it.
    fn stored(&self, storage: Storage) -> Scene {
        let mut scene = self.clone();
        let columns = storage.load(&MODEL, &storage.store(&MODEL, &MODEL.to_columns(&self.parameters)));
        let [first, second] = MODEL.moments_to_columns(&self.moments);
        let [first, second] = storage.store_moments([&first, &second]);
        let [first, second] = storage.load_moments([&first, &second]);
        let semantics = Group::Semantics as usize;
        scene.parameters = MODEL.from_columns(&columns, self.capacity);
        scene.parameters.groups[semantics] = self.parameters.groups[semantics].clone();
        scene.moments = MODEL.moments_from_columns([&first, &second], self.capacity);
        scene.moments.groups[semantics] = self.moments.groups[semantics].clone();
        scene
    }

    /// Returns the original Gaussian of each slot.
    fn origins(&self) -> Vec<usize> {
        (0..self.count).map(|i| Scene::row(&self.parameters, TAG, i, 1)[0] as usize).collect()
    }

    /// Compares relocation with the reference. Returns the scene after it and the counts.
    fn check(&self, gpu: &Gpu, cap: u32, seed: u32, storage: Storage) -> (Scene, DensifyStats) {
        let (after, stats) = self.run(gpu, cap, seed, storage);
        self.stored(storage).compare(&after, &stats, cap, seed);
        (after, stats)
    }

    fn compare(&self, after: &Scene, stats: &DensifyStats, cap: u32, seed: u32) {
        let n = self.count;
        let alive: Vec<bool> = (0..n).map(|i| self.alive(i)).collect();
        let dead: Vec<usize> = (0..n).filter(|i| !alive[*i]).collect();
        let any = dead.len() < n;
        let grown = reference::grown(n as u32, cap.min(self.capacity as u32)) as usize;
        let count = if any { grown } else { n };
        let moved = if any { dead.len() } else { 0 };
        assert_eq!((after.count, stats.before as usize, stats.after as usize), (count, n, count), "{stats:?}");
        assert_eq!((stats.pruned as usize, stats.cloned as usize), (moved, moved + count - n), "{stats:?}");
        let wanted = if any { reference::grown(n as u32, u32::MAX) as usize } else { n };
        assert_eq!((stats.refused as usize, stats.split), (wanted - count, 0), "{stats:?}");
        let origins = after.origins();
        let slots: Vec<usize> = dead.iter().take(moved).copied().chain(n..count).collect();
        // The reference's weights may round to the neighboring number.
        let weights: Vec<u32> = (0..n)
            .map(|i| match alive[i] {
                true => reference::weight(reference::opacity(self.logit(i)), n as u32, seed, i as u32),
                false => 0,
            })
            .collect();
        let mut sums = vec![0_u64];
        weights.iter().for_each(|w| sums.push(sums.last().unwrap() + u64::from(*w)));
        let total = u32::try_from(sums[n]).unwrap();
        let mut copies = vec![0; n];
        for (draw, slot) in slots.iter().enumerate() {
            let parent = origins[*slot];
            assert!(alive[parent], "slot {slot} is a copy of the dead Gaussian {parent}");
            let target = u64::from(reference::target(total, seed, draw as u32));
            let (low, high) = (sums[parent], sums[parent + 1]);
            let slack = n as u64;
            assert!(low <= target + slack && target < high + slack, "draw {draw}: {low} <= {target} < {high}");
            copies[parent] += 1;
        }
        for slot in 0..count {
            let from = origins[slot];
            let is_copy = slot >= n || (!alive[slot] && any);
            assert!(is_copy || from == slot, "slot {slot} has lost its Gaussian");
            let drawn = copies[from] > 0;
            for group in MODEL.groups() {
                let corrected = drawn && matches!(group, Group::OpacityLogits | Group::LogScales);
                let (was, is) =
                    (Scene::row(&self.parameters, group, from, 1), Scene::row(&after.parameters, group, slot, 1));
                if !corrected {
                    assert!(bytes(was) == bytes(is), "{} of slot {slot}", group.name());
                }
                let moments = Scene::row(&after.moments, group, slot, 2);
                let own = group == Group::Semantics && !is_copy;
                match drawn && !own {
                    true => assert!(moments.iter().all(|m| m.to_bits() == 0), "moments of {} {slot}", group.name()),
                    false => {
                        let same = Scene::row(&self.moments, group, from, 2).iter().zip(moments).all(|(a, b)| a == b);
                        assert!(same || !any || !self.valid(from), "moments of {} {slot}", group.name());
                    }
                }
            }
            if drawn {
                let (logit, shrink) = corrected(self.logit(from), copies[from] + 1);
                let found = Scene::row(&after.parameters, Group::OpacityLogits, slot, 1);
                assert_close("logit", &[logit], found, Tolerance::new(2e-5, 2e-6));
                let was = Scene::row(&self.parameters, Group::LogScales, from, 1);
                let expected: Vec<f64> = was.iter().map(|s| f64::from(*s) + shrink).collect();
                let found = Scene::row(&after.parameters, Group::LogScales, slot, 1);
                assert_close("log scales", &expected, found, Tolerance::new(2e-5, 1e-6));
            }
        }
        for group in MODEL.groups() {
            let end = count * group.width() as usize;
            let behind = after.parameters.group(group)[end..].iter();
            let moments = &after.moments.group(group)[2 * end..];
            // Compact storage has the largest moments in place of NaN.
            assert!(behind.chain(moments).all(|x| x.is_nan() || *x > 1e38), "written behind the end");
        }
    }
}

/// Returns logit and change of log scales of `n` Gaussians in the place of one.
fn corrected(logit: f64, n: u32) -> (f64, f64) {
    // -log(1 - opacity) by the logit: opacities may round to 1.
    let depth = logit.max(0.0) + (-logit.abs()).exp().ln_1p();
    let part = depth / f64::from(n);
    let opacity = reference::opacity(logit);
    let each = -(-part).exp_m1();
    // Terms of the sum cancel where many opaque Gaussians take one place.
    let factor = match n <= 40 && opacity < 0.999 {
        true => reference::scale_factor(opacity, each, n),
        false => opacity / reference::opacity_along_line(each.min(1.0 - 1e-16), n),
    };
    ((each.ln() + part).max((LEAST / (1.0 - LEAST)).ln()), factor.ln())
}

#[test]
fn relocation_matches_reference() {
    let gpu = Gpu::new();
    let shapes = [(1, 2, 0.0), (2, 3, 0.5), (19, 40, 0.2), (256, 300, 0.1), (300, 300, 0.5), (1000, 1100, 0.05)];
    for (seed, (count, capacity, dead)) in shapes.into_iter().enumerate() {
        for storage in [Storage::Exact, Storage::Compact] {
            Scene::random(count, capacity, dead, seed as u32).check(&gpu, u32::MAX, 7 + seed as u32, storage);
        }
    }
}

/// Tests no Gaussian, none alive, none dead, a low cap, and one for all others.
#[test]
fn relocation_at_the_edges() {
    let gpu = Gpu::new();
    let run = |logits: &[f32], capacity: usize, cap: u32| {
        Scene::new(logits, capacity, 2).check(&gpu, cap, 3, Storage::Exact).1
    };
    assert_eq!(run(&[], 4, 4).after, 0);
    let stats = run(&[-7.0; 50], 60, 60);
    assert_eq!((stats.after, stats.pruned, stats.cloned, stats.refused), (50, 0, 0, 0));
    let stats = run(&[0.0; 100], 200, 103);
    assert_eq!((stats.after, stats.pruned, stats.cloned, stats.refused), (103, 0, 3, 2));
    let stats = run(&[0.0; 100], 200, 40);
    assert_eq!((stats.after, stats.cloned, stats.refused), (100, 0, 5));
    for logit in [-5.2, 0.0, 5.0, 17.0, 30.0, 80.0] {
        for count in [2, 30, 700] {
            let mut logits = vec![-9.0; count];
            logits[count / 2] = logit;
            let stats = run(&logits, count, u32::MAX);
            assert_eq!((stats.pruned as usize, stats.cloned as usize), (count - 1, count - 1));
        }
    }
}

/// Gaussians are drawn in proportion to their opacities, however many they are.
#[test]
fn draws_are_proportional_to_opacity() {
    let gpu = Gpu::new();
    let opacities: [f64; 4] = [0.1, 0.2, 0.3, 0.4];
    let logits: Vec<f32> =
        (0..8000).map(|i| if i < 4 { (opacities[i] / (1.0 - opacities[i])).ln() as f32 } else { -9.0 }).collect();
    let (after, _) = Scene::new(&logits, 8000, 4).run(&gpu, u32::MAX, 11, Storage::Exact);
    let origins = after.origins();
    for (i, o) in opacities.into_iter().enumerate() {
        let drawn = origins.iter().filter(|from| **from == i).count() as f64 - 1.0;
        let (mean, sigma) = (7996.0 * o, (7996.0 * o * (1.0 - o)).sqrt());
        assert!((drawn - mean).abs() < 4.0 * sigma, "{i}: {drawn} of {mean} ± {sigma}");
    }
}

/// Each pass of relocation and of a step has a cost.
#[test]
fn passes_have_costs() {
    let tuning = Tuning::for_subgroups(32);
    let counts = Counts { gaussians: 1000.0, moved: 100.0, ..Default::default() };
    for storage in [Storage::Exact, Storage::Compact] {
        let layout = Layout { model: MODEL, capacity: 1500, training: true, statistics: false, storage };
        let plan = DensifyStep::plan(&tuning, &layout, DensifyRule::Relocation).unwrap();
        assert_eq!(of_plan(&plan, &counts).1, 0);
        let inputs = InputSizes { targets: 4 * 64 * 48, ..Default::default() };
        let colors = Channels { colors: true, normals: false, depth: false };
        let layout = Layout { model: Model { semantics: false, normals: false, ..MODEL }, ..layout };
        let options = GeometryOptions { mcmc: true, ..step_options([64, 48], colors) };
        let plan = GeometryStep::plan(&tuning, &layout, &inputs, &options).unwrap();
        assert!(plan.passes.iter().any(|p| p.name == "position_noise"));
        assert_eq!(of_plan(&plan, &counts).1, 0);
    }
}

#[test]
fn relocation_is_deterministic_per_seed() {
    let gpu = Gpu::new();
    let scene = Scene::random(900, 1000, 0.3, 3);
    let run = |seed| {
        let (after, _) = scene.run(&gpu, u32::MAX, seed, Storage::Exact);
        (after.parameters.groups.map(|p| bytes(&p)), after.moments.groups.map(|m| bytes(&m)))
    };
    let first = run(1);
    assert!(run(1) == first && run(2) != first);
}

#[test]
fn relocation_checks_can_fail() {
    let gpu = Gpu::new();
    let scene = Scene::random(300, 400, 0.3, 12);
    let (after, stats) = scene.run(&gpu, u32::MAX, 5, Storage::Exact);
    scene.compare(&after, &stats, u32::MAX, 5);
    let origins = after.origins();
    let drawn = (0..300).find(|i| scene.alive(*i) && origins.iter().filter(|from| *from == i).count() > 1).unwrap();
    let fails = |seed: u32, plant: &dyn Fn(&mut Scene, &mut DensifyStats)| {
        let (mut after, mut stats) = (after.clone(), stats);
        plant(&mut after, &mut stats);
        let check = std::panic::AssertUnwindSafe(|| scene.compare(&after, &stats, u32::MAX, seed));
        assert!(std::panic::catch_unwind(check).is_err());
    };
    fails(6, &|_, _| {});
    fails(5, &|_, stats| stats.cloned += 1);
    fails(5, &|after, _| after.count -= 1);
    fails(5, &|after, _| after.parameters.groups[Group::OpacityLogits as usize][drawn] += 1e-3);
    fails(5, &|after, _| after.parameters.groups[Group::LogScales as usize][3 * drawn] += 1e-3);
    fails(5, &|after, _| after.moments.groups[Group::Means as usize][6 * drawn] = 1.0);
}

/// Returns means after noise.
fn noise_of(gpu: &Gpu, scene: &Scene, strength: f32, seed: u32, flag: u32, storage: Storage) -> Vec<f32> {
    let mut g = Graph::new("noise");
    let layout = Layout { model: MODEL, capacity: scene.capacity as u32, training: true, statistics: false, storage };
    let handles = layout.declare(&mut g, true);
    let step = g.uniform("step", size_of::<Step>() as u64);
    let flags = g.input("flags", 4);
    position_noise(&mut g, &gpu.tuning(), step, &handles, flags).unwrap();
    let values = Step { seed, noise: strength, ..Default::default() };
    let stored = storage.store(&MODEL, &MODEL.to_columns(&scene.parameters));
    let inputs = [
        (step, bytes(&[values])),
        (flags, bytes(&[flag])),
        (handles.work, bytes(&[work_of(scene.count)])),
        (handles.parameters, bytes(&stored)),
    ];
    let out = gpu.run(g, &inputs);
    let after = MODEL.from_columns(&storage.load(&MODEL, &out.get::<u32>(handles.parameters)), scene.capacity);
    let before = MODEL.from_columns(&storage.load(&MODEL, &stored), scene.capacity);
    for group in MODEL.groups().filter(|g| *g != Group::Means && *g != Group::Semantics) {
        assert!(bytes(after.group(group)) == bytes(before.group(group)), "{} has moved", group.name());
    }
    after.group(Group::Means).to_vec()
}

#[test]
fn noise_matches_reference() {
    let gpu = Gpu::new();
    // Ordinary, large and flat scales; opacities on both sides of the sigmoid's middle.
    for (seed, (log_scale, strength)) in [(-2.0, 80.0), (3.0, 1.0), (-9.0, 1e6)].into_iter().enumerate() {
        let mut scene = Scene::random(400, 420, 0.4, 20 + seed as u32);
        for (i, s) in scene.parameters.groups[Group::LogScales as usize].iter_mut().enumerate() {
            *s = (f64::from(*s) + log_scale - if i % 5 == 0 { 6.0 } else { 0.0 }) as f32;
        }
        scene.parameters.groups[Group::Rotations as usize][..8]
            .copy_from_slice(&[0.0, 0.0, 0.0, 0.0, 3e18, 1e18, 0.0, 0.0]);
        let storage = [Storage::Exact, Storage::Compact][seed % 2];
        let found = noise_of(&gpu, &scene, strength, 9, 0, storage);
        let mut moved = 0;
        for i in 0..400 {
            let of = |g: Group, k: usize| f64::from(Scene::row(&scene.parameters, g, i, 1)[k]);
            let finite = [Group::Means, Group::LogScales, Group::OpacityLogits];
            let is_finite =
                finite.iter().all(|g| Scene::row(&scene.parameters, *g, i, 1).iter().all(|x| x.is_finite()));
            if !is_finite {
                let was = Scene::row(&scene.parameters, Group::Means, i, 1);
                assert!(bytes(was) == bytes(&found[3 * i..][..3]), "{i} moved");
                continue;
            }
            let q: Vec<f64> = (0..4).map(|k| of(Group::Rotations, k)).collect();
            let m = if q.iter().all(|x| x.is_finite()) { rotation(&q) } else { glam::DMat3::IDENTITY };
            let rows = [0, 1, 2].map(|r| m.row(r).to_array());
            let scale = [0, 1, 2].map(|k| of(Group::LogScales, k).clamp(-16.0, 8.0).exp());
            let noise = reference::noise(of(Group::OpacityLogits, 0), scale, rows, f64::from(strength), 9, i as u32);
            let expected: Vec<f64> = (0..3).map(|k| of(Group::Means, k) + noise[k]).collect();
            let size = noise.iter().fold(0.0, |a: f64, b| a.max(b.abs()));
            moved += usize::from(size > 1e-6);
            assert_close("mean", &expected, &found[3 * i..][..3], Tolerance::new(3e-5 * size + 1e-9, 2e-7));
        }
        assert!(moved > 20, "{moved}");
        assert_ne!(bytes(&noise_of(&gpu, &scene, strength, 10, 0, storage)), bytes(&found));
        let means = scene.parameters.group(Group::Means);
        assert!(bytes(&noise_of(&gpu, &scene, strength, 9, 1, storage)) == bytes(means), "a raised flag stops it");
    }
}

/// Covariance of the noise: that of the Gaussian, squared.
#[test]
fn noise_is_distributed_as_the_squared_covariance() {
    let gpu = Gpu::new();
    let mut scene = Scene::new(&[-6.0; 6000], 6000, 4);
    for i in 0..6000 {
        scene.parameters.groups[Group::Means as usize][3 * i..][..3].fill(0.0);
        // A quarter turn about z: the first axis lies along y.
        scene.parameters.groups[Group::Rotations as usize][4 * i..][..4].copy_from_slice(&[2.0, 0.0, 0.0, 2.0]);
        let log = [0.5_f32.ln(), 0.1_f32.ln(), 0.2_f32.ln()];
        scene.parameters.groups[Group::LogScales as usize][3 * i..][..3].copy_from_slice(&log);
    }
    let found = noise_of(&gpu, &scene, 2.0, 1, 0, Storage::Exact);
    let factor = 2.0 / (1.0 + (100.0 * (reference::opacity(-6.0) - LEAST)).exp());
    for (k, sigma) in [0.01, 0.25, 0.04].into_iter().enumerate() {
        let values: Vec<f64> = (0..6000).map(|i| f64::from(found[3 * i + k]) / (factor * sigma)).collect();
        let average = values.iter().sum::<f64>() / 6000.0;
        let square = values.iter().map(|v| v * v).sum::<f64>() / 6000.0;
        assert!(average.abs() < 0.05 && (square - 1.0).abs() < 0.07, "axis {k}: {average} {square}");
    }
}
