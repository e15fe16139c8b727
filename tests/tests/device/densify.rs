//! Densification on a device against its reference and against invariants.

use sgs_engine::graph::Graph;
use sgs_passes::optim::{Densify, densify, opacity_reset};
use sgs_passes::reference::densify as reference;
use sgs_passes::reference::densify::{Candidate, Origin, Settings};
use sgs_passes::reference::rng::Pcg;
use sgs_passes::scene::{GaussianData, Group, Layout, Model, Storage};
use sgs_shaders::structs::{self, DensifyStats, Work};
use sgs_tests::{Gpu, Tolerance, assert_close};

const SETTINGS: Settings = Settings {
    grad_threshold: 1e-4,
    normal_threshold: 0.0,
    split_size: 0.01,
    prune_opacity: 0.005,
    prune_weight: 1e-4,
    prune_size: 1.0,
    cap: usize::MAX,
    seed: 77,
};

const MODEL: Model = Model { sh_degree: 3, normals: true, semantics: false, mip: false };

/// Group whose first number encodes the index of the original Gaussian.
///
/// Copies retain the number.
const TAG: usize = Group::Sh1 as usize;

fn bytes<T: bytemuck::NoUninit>(data: &[T]) -> Vec<u8> {
    bytemuck::cast_slice(data).to_vec()
}

fn width(group: usize) -> usize {
    Group::ALL[group].width() as usize
}

#[derive(Clone)]
struct Scene {
    count: usize,
    capacity: usize,
    parameters: [Vec<f32>; Group::COUNT],
    moments: [Vec<f32>; Group::COUNT],
    statistics: Vec<f32>,
}

#[derive(Clone, Copy, PartialEq)]
enum Fate {
    Keep,
    Faint,
    Unseen,
    Huge,
    Nan,
    Clone,
    Split,
}

impl Scene {
    /// Builds Gaussians with unambiguous fates. The rest of the capacity is NaN.
    fn new(fates: &[Fate], capacity: usize, seed: u32) -> Scene {
        let mut rng = Pcg::new(seed);
        let mut scene = Scene {
            count: fates.len(),
            capacity,
            parameters: std::array::from_fn(|g| vec![f32::from_bits(u32::MAX); capacity * width(g)]),
            moments: std::array::from_fn(|g| vec![f32::from_bits(u32::MAX); 2 * capacity * width(g)]),
            statistics: vec![f32::from_bits(u32::MAX); 4 * capacity],
        };
        for (i, &fate) in fates.iter().enumerate() {
            for g in 0..9 {
                let w = width(g);
                scene.parameters[g][i * w..][..w].fill_with(|| rng.normal() as f32);
                scene.moments[g][2 * i * w..][..2 * w].fill_with(|| rng.normal() as f32);
            }
            let size = match fate {
                Fate::Huge => 3.0,
                Fate::Split => rng.range(0.02, 0.5),
                _ => rng.range(0.001, 0.009),
            };
            let log_scale = (size as f32).ln();
            scene.parameters[Group::LogScales as usize][3 * i..][..3].copy_from_slice(&[
                log_scale - 1.0,
                log_scale,
                log_scale - 0.3,
            ]);
            let opacity = if fate == Fate::Faint { -6.0 } else { rng.range(-4.0, 4.0) as f32 };
            scene.parameters[Group::OpacityLogits as usize][i] = opacity;
            scene.parameters[TAG][i * width(TAG)] = i as f32;
            if fate == Fate::Nan {
                let g = [Group::Means, Group::LogScales, Group::Rotations, Group::OpacityLogits, Group::Sh0][i % 5];
                let bad = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY][i % 3];
                let w = g.width() as usize;
                scene.parameters[g as usize][i * w + i % w] = bad;
            }
            let seen = [0.0, 1.0, 2.0, 8.0][rng.next_u32() as usize % 4_usize];
            let gradient = match fate {
                Fate::Clone | Fate::Split => rng.range(2e-4, 1e-2) * f64::from(1.0_f32.max(seen)),
                _ => rng.range(0.0, 0.9e-4) * f64::from(seen),
            };
            let weight = if fate == Fate::Unseen { 0.5e-4 } else { rng.range(0.01, 10.0) };
            // About as large as the screen gradient times 1e-3.
            let by_normal = 1e-3 * gradient * rng.range(0.5, 2.0);
            scene.statistics[4 * i..][..4].copy_from_slice(&[gradient as f32, seen, weight as f32, by_normal as f32]);
        }
        scene
    }

    fn random(count: usize, capacity: usize, seed: u32) -> Scene {
        let mut rng = Pcg::new(seed ^ 0x55);
        let kinds = [Fate::Keep, Fate::Faint, Fate::Unseen, Fate::Huge, Fate::Nan, Fate::Clone, Fate::Split];
        // The share of each fate differs between scenes, so both growth and shrinkage occur.
        let odds: Vec<f64> = kinds.iter().map(|_| rng.uniform().powi(3)).collect();
        let total: f64 = odds.iter().sum();
        let fates: Vec<Fate> = (0..count)
            .map(|_| {
                let mut at = total * rng.uniform();
                let found = odds.iter().position(|o| {
                    at -= o;
                    at < 0.0
                });
                kinds[found.unwrap_or(0)]
            })
            .collect();
        Scene::new(&fates, capacity, seed)
    }

    fn candidate(&self, i: usize) -> Candidate {
        let of = |g: Group, k: usize| f64::from(self.parameters[g as usize][i * g.width() as usize + k]);
        Candidate {
            mean: [0, 1, 2].map(|k| of(Group::Means, k)),
            log_scale: [0, 1, 2].map(|k| of(Group::LogScales, k)),
            rotation: [0, 1, 2, 3].map(|k| of(Group::Rotations, k)),
            opacity_logit: of(Group::OpacityLogits, 0),
            sh0: [0, 1, 2].map(|k| of(Group::Sh0, k)),
            statistics: [0, 1, 2, 3].map(|k| f64::from(self.statistics[4 * i + k])),
        }
    }

    fn parameter(&self, g: usize, slot: usize) -> &[f32] {
        &self.parameters[g][slot * width(g)..][..width(g)]
    }

    fn moment(&self, g: usize, slot: usize) -> &[f32] {
        &self.moments[g][2 * slot * width(g)..][..2 * width(g)]
    }

    /// Returns the densified scene and the reported statistics.
    fn run(&self, gpu: &Gpu, s: &Settings) -> (Scene, DensifyStats) {
        self.run_in(gpu, s, Storage::Exact)
    }

    fn run_in(&self, gpu: &Gpu, s: &Settings, storage: Storage) -> (Scene, DensifyStats) {
        let mut g = Graph::new("densify");
        let layout = Layout { model: MODEL, capacity: self.capacity as u32, training: true, statistics: true, storage };
        let handles = layout.declare(&mut g, true);
        let stats = g.external("stats", size_of::<DensifyStats>() as u64);
        let settings = g.uniform("settings", size_of::<structs::Densify>() as u64);
        let a = Densify::of(&handles, settings, stats).unwrap();
        densify(&mut g, gpu.tuning(), &a).unwrap();
        let values = structs::Densify {
            grad_threshold: s.grad_threshold as f32,
            normal_threshold: s.normal_threshold as f32,
            split_size: s.split_size as f32,
            prune_opacity: s.prune_opacity as f32,
            prune_weight: s.prune_weight as f32,
            prune_size: s.prune_size as f32,
            cap: u32::try_from(s.cap).unwrap_or(u32::MAX),
            seed: s.seed,
        };
        let data = |groups: &[Vec<f32>; Group::COUNT]| GaussianData { groups: groups.clone() };
        let [first, second] = MODEL.moments_to_columns(&data(&self.moments));
        let [first, second] = storage.store_moments([&first, &second]);
        let inputs = [
            (settings, bytes(&[values])),
            (handles.work, bytes(&[work_of(self.count)])),
            (a.statistics, bytes(&self.statistics)),
            (handles.parameters, bytes(&storage.store(&MODEL, &MODEL.to_columns(&data(&self.parameters))))),
            (a.moments.first, bytes(&first)),
            (a.moments.second, bytes(&second)),
        ];
        let out = gpu.run(g, &inputs);
        let work: Work = out.get(handles.work)[0];
        assert_eq!(work, work_of(work.count as usize));
        let words = |buffer| out.get::<u32>(buffer);
        let moments = storage.load_moments([&words(a.moments.first), &words(a.moments.second)]);
        let parameters = storage.load(&MODEL, &words(handles.parameters));
        let after = Scene {
            count: work.count as usize,
            capacity: self.capacity,
            parameters: MODEL.from_columns(&parameters, self.capacity).groups,
            moments: MODEL.moments_from_columns([&moments[0], &moments[1]], self.capacity).groups,
            statistics: out.get(a.statistics),
        };
        (after, out.get(stats)[0])
    }

    /// Checks the invariants that hold for any reference.
    fn check_invariants(&self, after: &Scene, stats: &DensifyStats, cap: usize) {
        let most = (self.count - stats.pruned as usize).max(cap.min(self.capacity));
        assert!(after.count <= most && (self.count == 0) == (after.count == 0), "{stats:?}");
        assert_eq!((stats.before as usize, stats.after as usize), (self.count, after.count));
        assert_eq!(stats.after, stats.before - stats.pruned + stats.cloned + stats.split, "{stats:?}");
        let mut seen = vec![0; self.count];
        for slot in 0..after.count {
            let tag = after.parameters[TAG][slot * width(TAG)];
            assert!(tag >= 0.0 && tag < self.count as f32, "slot {slot} holds what was no Gaussian: {tag}");
            seen[tag as usize] += 1;
        }
        let copies = |n| seen.iter().filter(|&&c| c == n).count();
        assert_eq!(copies(0), stats.pruned as usize, "a Gaussian was lost or should have been");
        assert_eq!(copies(2), (stats.cloned + stats.split) as usize);
        assert_eq!(copies(0) + copies(1) + copies(2), self.count);
        assert!(after.statistics.iter().all(|s| s.to_bits() == 0));
        for g in 0..9 {
            let end = self.count.max(after.count);
            let behind = &after.parameters[g][end * width(g)..];
            let behind_moments = &after.moments[g][2 * end * width(g)..];
            assert!(behind.iter().chain(behind_moments).all(|x| x.to_bits() == u32::MAX), "written behind the end");
        }
    }

    /// Compares each slot with the reference. Copies must match bit for bit.
    fn check(&self, gpu: &Gpu, s: &Settings) -> (Scene, DensifyStats) {
        let (after, stats) = self.run(gpu, s);
        self.check_invariants(&after, &stats, s.cap);
        let verdicts: Vec<_> = (0..self.count).map(|i| reference::verdict(&self.candidate(i), s)).collect();
        let (slots, refused) = reference::layout(&verdicts, s.cap.min(self.capacity));
        assert_eq!((after.count, stats.refused as usize), (slots.len(), refused), "{stats:?}");
        let weightless = (0..self.count).filter(|i| reference::weightless(&self.candidate(*i), s)).count();
        if verdicts.iter().any(|v| !matches!(v, reference::Verdict::Prune { .. })) {
            assert_eq!(stats.weightless as usize, weightless, "{stats:?}");
        }
        for (slot, origin) in slots.into_iter().enumerate() {
            let (from, keeps_moments, half) = match origin {
                Origin::Same(i) => (i, true, None),
                Origin::Duplicate(i) => (i, false, None),
                Origin::Half(i, which) => (i, false, Some(which)),
            };
            for g in 0..9 {
                let drawn = half.is_some() && (g == Group::Means as usize || g == Group::LogScales as usize);
                if !drawn {
                    let same = bytes(self.parameter(g, from)) == bytes(after.parameter(g, slot));
                    assert!(same, "group {g} of slot {slot}, {origin:?}");
                }
                let moments = after.moment(g, slot);
                let same = match keeps_moments {
                    true => bytes(self.moment(g, from)) == bytes(moments),
                    false => moments.iter().all(|m| m.to_bits() == 0),
                };
                assert!(same, "moments of group {g} of slot {slot}, {origin:?}");
            }
            if let Some(which) = half {
                let candidate = self.candidate(from);
                let (mean, log_scale) = reference::half(&candidate, from, which, s.seed);
                let size = candidate.log_scale.iter().fold(f64::MIN, |a, &b| a.max(b)).exp();
                // Rounding of a logarithm, a root, a sine and a rotation, at up to 5.8 standard deviations.
                assert_close("mean", &mean, after.parameter(0, slot), Tolerance::new(1e-5 * size, 2e-7));
                assert_close("log scale", &log_scale, after.parameter(1, slot), Tolerance::new(0.0, 2e-7));
            }
        }
        (after, stats)
    }
}

fn work_of(count: usize) -> Work {
    let groups = count.div_ceil(256).max(1);
    let x = groups.min(65535);
    Work { x: x as u32, y: groups.div_ceil(x) as u32, z: 1, count: count as u32 }
}

#[test]
fn densify_matches_reference() {
    let gpu = Gpu::new();
    for (seed, (count, capacity)) in
        [(1, 2), (2, 2), (7, 9), (255, 600), (256, 512), (257, 300), (1000, 1000), (5000, 20000), (9000, 9100)]
            .into_iter()
            .cycle()
            .take(36)
            .enumerate()
    {
        Scene::random(count, capacity, seed as u32).check(&gpu, &SETTINGS);
    }
}

/// Large normal gradients refine Gaussians despite small screen gradients.
///
/// This is the published statistic. Under the cap, both gradients rank by their multiples of their thresholds.
#[test]
fn large_normal_gradients_refine_gaussians() {
    let gpu = Gpu::new();
    let by_normals = Settings { normal_threshold: 1e-7, ..SETTINGS };
    for (seed, (count, capacity)) in [(2, 2), (257, 300), (1000, 1000), (5000, 20000)].into_iter().enumerate() {
        Scene::random(count, capacity, 40 + seed as u32).check(&gpu, &by_normals);
    }
    let mut scene = Scene::new(&[Fate::Keep; 300], 600, 6);
    let of_normals = |s: &mut Scene, i: usize, by_normal: f32| {
        s.statistics[4 * i..][..4].copy_from_slice(&[1e-5, 2.0, 1.0, by_normal]);
    };
    (0..300).for_each(|i| of_normals(&mut scene, i, if i < 100 { 4e-7 } else { 1e-8 }));
    assert_eq!(scene.check(&gpu, &SETTINGS).1.cloned, 0);
    assert_eq!(scene.check(&gpu, &by_normals).1.cloned, 100);
    // A normal gradient of four thresholds wins the only free slot over screen gradients of three thresholds.
    scene.statistics.as_chunks_mut::<4>().0[..100].iter_mut().for_each(|s| *s = [6e-4, 2.0, 1.0, 0.0]);
    of_normals(&mut scene, 70, 8e-7);
    let (after, stats) = scene.check(&gpu, &Settings { cap: 301, ..by_normals });
    assert_eq!((stats.cloned, after.parameters[TAG][300 * width(TAG)]), (1, 70.0));
}

#[test]
fn densify_of_one_kind_only() {
    use Fate::{Clone, Faint, Huge, Keep, Nan, Split, Unseen};
    let gpu = Gpu::new();
    for n in [1, 2, 300] {
        for fate in [Keep, Faint, Unseen, Huge, Nan, Clone, Split] {
            let (_, stats) = Scene::new(&vec![fate; n], 2 * n, 5).check(&gpu, &SETTINGS);
            let n = n as u32;
            let expected = match fate {
                Keep => (n, 0, 0, 0),
                Clone => (2 * n, 0, n, 0),
                Split => (2 * n, 0, 0, n),
                _ => (1, n - 1, 0, 0),
            };
            assert_eq!((stats.after, stats.pruned, stats.cloned, stats.split), expected);
        }
    }
    // No Gaussians; then two valid Gaussians among many with NaN.
    let (after, _) = Scene::new(&[], 4, 1).check(&gpu, &SETTINGS);
    assert_eq!(after.count, 0);
    let mut fates = [Nan; 400];
    (fates[233], fates[300]) = (Faint, Unseen);
    let (after, stats) = Scene::new(&fates, 400, 1).check(&gpu, &SETTINGS);
    assert_eq!((after.parameters[TAG][0], stats.invalid), (233.0, 398));
}

/// Splits of Gaussians with degenerate quaternions match the reference.
///
/// Quaternions are zero or far from unit length.
#[test]
fn splits_of_degenerate_quaternions_match_reference() {
    let gpu = Gpu::new();
    let mut scene = Scene::new(&[Fate::Split; 300], 600, 4);
    let rotations = &mut scene.parameters[Group::Rotations as usize][..1200];
    for (i, q) in rotations.as_chunks_mut::<4>().0.iter_mut().enumerate() {
        *q = [[0.0; 4], [3e-30, 1e-30, 0.0, 2e-30], [3e18, 1e18, 0.0, 2e18]][i % 3];
    }
    let (after, stats) = scene.check(&gpu, &SETTINGS);
    assert_eq!((after.count, stats.split, stats.invalid), (600, 300, 0));
    assert!(after.parameters[Group::Means as usize][..1800].iter().all(|x| x.is_finite()));
}

#[test]
fn densify_fills_the_cap_exactly() {
    let gpu = Gpu::new();
    let fates: Vec<Fate> = (0..2000).map(|i| [Fate::Clone, Fate::Split, Fate::Keep, Fate::Faint][i % 4]).collect();
    let scene = Scene::new(&fates, 4000, 9);
    for cap in [0, 1, 1499, 1500, 1501, 1900, 2000, 2001, 2499, 2500, 4000] {
        let (after, stats) = scene.check(&gpu, &Settings { cap, ..SETTINGS });
        assert_eq!(after.count, cap.clamp(1500, 2500));
        assert_eq!(stats.refused as usize, 2500 - after.count);
    }
    // The capacity of the buffers is a cap as well.
    let (after, _) = Scene::new(&fates, 2100, 9).check(&gpu, &SETTINGS);
    assert_eq!(after.count, 2100);
    // Gaussians with equal gradients are ordered by index.
    let mut equal = Scene::new(&[Fate::Clone; 1000], 1100, 9);
    equal.statistics.as_chunks_mut::<4>().0.iter_mut().for_each(|s| *s = [0.5, 1.0, 1.0, 0.0]);
    let (after, _) = equal.check(&gpu, &SETTINGS);
    assert_eq!(after.count, 1100);
    assert_eq!(after.parameters[TAG][1099 * width(TAG)], 99.0);
}

#[test]
fn densify_is_deterministic_per_seed() {
    let gpu = Gpu::new();
    let scene = Scene::random(3000, 5000, 3);
    let run = |seed| {
        let (after, stats) = scene.run(&gpu, &Settings { seed, cap: 3100, ..SETTINGS });
        (after.parameters.map(|p| bytes(&p)), after.moments.map(|m| bytes(&m)), stats)
    };
    let first = run(1);
    assert!((0..3).all(|_| run(1) == first));
    let other = run(2);
    assert!(other.0[Group::Means as usize] != first.0[Group::Means as usize]);
    assert!(other.0[Group::Sh0 as usize] == first.0[Group::Sh0 as usize] && other.2 == first.2);
}

#[test]
fn split_halves_are_distributed_as_their_parent() {
    let gpu = Gpu::new();
    let mut scene = Scene::new(&[Fate::Split; 4000], 8000, 1);
    for i in 0..4000 {
        scene.parameters[Group::Means as usize][3 * i..][..3].copy_from_slice(&[1.0, 2.0, 3.0]);
        // A quarter turn about z, so that the first axis lies along y.
        scene.parameters[Group::Rotations as usize][4 * i..][..4].copy_from_slice(&[2.0, 0.0, 0.0, 2.0]);
        let log = [0.1_f32.ln(), 0.01_f32.ln(), 0.02_f32.ln()];
        scene.parameters[Group::LogScales as usize][3 * i..][..3].copy_from_slice(&log);
    }
    let (after, _) = scene.check(&gpu, &SETTINGS);
    for (k, (mean, sigma)) in [(1.0, 0.01), (2.0, 0.1), (3.0, 0.02)].into_iter().enumerate() {
        let values: Vec<f64> = (0..8000).map(|i| (f64::from(after.parameters[0][3 * i + k]) - mean) / sigma).collect();
        let average = values.iter().sum::<f64>() / 8000.0;
        let square = values.iter().map(|v| v * v).sum::<f64>() / 8000.0;
        assert!(average.abs() < 0.04 && (square - 1.0).abs() < 0.06, "axis {k}: {average} {square}");
    }
}

/// Checks that planted errors fail the invariants and the comparison.
#[test]
fn densify_checks_can_fail() {
    let gpu = Gpu::new();
    let scene = Scene::random(500, 900, 12);
    let (after, stats) = scene.run(&gpu, &SETTINGS);
    scene.check_invariants(&after, &stats, usize::MAX);
    let fails = |plant: &dyn Fn(&mut Scene, &mut DensifyStats)| {
        let (mut after, mut stats) = (after.clone(), stats);
        plant(&mut after, &mut stats);
        let check = std::panic::AssertUnwindSafe(|| scene.check_invariants(&after, &stats, usize::MAX));
        assert!(std::panic::catch_unwind(check).is_err());
    };
    fails(&|after, _| after.parameters[TAG].copy_within(..9, 9));
    fails(&|after, _| after.parameters[TAG][0] = f32::NAN);
    fails(&|_, stats| stats.cloned += 1);
    fails(&|after, _| after.statistics[5] = 1.0);
    fails(&|after, _| *after.moments[2].last_mut().unwrap() = 0.0);
    fails(&|after, _| after.count += 1);
    // A reference with another threshold differs.
    let verdicts = |s: &Settings| (0..500).map(|i| reference::verdict(&scene.candidate(i), s)).collect::<Vec<_>>();
    let other = Settings { grad_threshold: 1e-3, ..SETTINGS };
    assert_ne!(reference::layout(&verdicts(&SETTINGS), 900).0, reference::layout(&verdicts(&other), 900).0);
}

/// Compact storage keeps and moves the same numbers, if 16 bits hold them.
#[test]
fn compact_storage_moves_the_same_numbers() {
    let gpu = Gpu::new();
    let mut scene = Scene::random(300, 450, 12);
    let compact = Storage::Compact;
    let data = |groups: &[Vec<f32>; Group::COUNT]| GaussianData { groups: groups.clone() };
    let words = compact.store(&MODEL, &MODEL.to_columns(&data(&scene.parameters)));
    let [first, second] = MODEL.moments_to_columns(&data(&scene.moments));
    let [first, second] = compact.store_moments([&first, &second]);
    let [first, second] = compact.load_moments([&first, &second]);
    scene.parameters = MODEL.from_columns(&compact.load(&MODEL, &words), scene.capacity).groups;
    scene.moments = MODEL.moments_from_columns([&first, &second], scene.capacity).groups;
    let (exact, stats) = scene.run(&gpu, &SETTINGS);
    let (moved, same) = scene.run_in(&gpu, &SETTINGS, compact);
    assert!(stats.split > 0 && stats.cloned > 0 && stats.pruned > 0 && stats == same, "{stats:?} {same:?}");
    for g in MODEL.groups().map(|g| g as usize) {
        for (a, b) in [(&exact.parameters[g], &moved.parameters[g]), (&exact.moments[g], &moved.moments[g])] {
            let same = |(a, b): (&f32, &f32)| a.to_bits() == b.to_bits() || a.is_nan() && b.is_nan();
            assert!(a.len() == b.len() && a.iter().zip(b).all(same), "{}", Group::ALL[g].name());
        }
    }
}

#[test]
fn opacity_reset_clamps_opacities_and_clears_moments() {
    let gpu = Gpu::new();
    let (count, capacity) = (300, 400_u32);
    let mut rng = Pcg::new(2);
    let mut logits: Vec<f32> = (0..capacity).map(|_| (-4.6 + 3.0 * rng.normal()) as f32).collect();
    (logits[0], logits[1], logits[2]) = (f32::NAN, f32::INFINITY, f32::NEG_INFINITY);
    let mut g = Graph::new("opacity_reset");
    let layout = Layout { model: MODEL, capacity, training: true, statistics: false, storage: Storage::Exact };
    let handles = layout.declare(&mut g, true);
    let moments = handles.moments.unwrap();
    opacity_reset(&mut g, gpu.tuning(), &handles, &moments).unwrap();
    let mut random = || -> Vec<f32> { (0..MODEL.column_bytes(capacity) / 4).map(|_| rng.normal() as f32).collect() };
    let before = [handles.parameters, moments.first, moments.second].map(|buffer| (buffer, random()));
    let mut inputs = before.each_ref().map(|(buffer, columns)| (*buffer, bytes(columns)));
    let mut data = MODEL.from_columns(&before[0].1, capacity as usize);
    data.groups[Group::OpacityLogits as usize] = logits.clone();
    inputs[0].1 = bytes(&MODEL.to_columns(&data));
    let mut all = inputs.to_vec();
    all.push((handles.work, bytes(&[work_of(count)])));
    let out = gpu.run(g, &all);
    let after = MODEL.from_columns(&out.get::<f32>(handles.parameters), capacity as usize);
    for group in MODEL.groups().filter(|g| *g != Group::OpacityLogits) {
        assert_eq!(after.group(group), data.group(group), "{}", group.name());
    }
    let limit = (0.01_f32 / 0.99).ln();
    for (i, (&after, &before)) in after.group(Group::OpacityLogits).iter().zip(&logits).enumerate() {
        let expected = if i < count && (before > limit || before.is_nan()) { limit } else { before };
        assert!((after - expected).abs() < 1e-6 || after.to_bits() == expected.to_bits(), "{i}: {before} {after}");
    }
    for (buffer, start) in &before[1..] {
        let (was, is) = [start, &out.get::<f32>(*buffer)].map(|c| MODEL.from_columns(c, capacity as usize)).into();
        for group in MODEL.groups() {
            let kept = if group == Group::OpacityLogits { count } else { 0 };
            assert!(is.group(group)[..kept].iter().all(|m| m.to_bits() == 0), "{}", group.name());
            assert_eq!(is.group(group)[kept..], was.group(group)[kept..], "{}", group.name());
        }
    }
}
