//! Compact storage of Gaussians in training: kernels against the exact ones, rounded by the reference, and against double
//! precision.

use sgs_config::Settings;
use sgs_engine::Location;
use sgs_engine::graph::{Buffer, Graph};
use sgs_passes::optim::{AdamUnseen, adam_unseen, opacity_reset};
use sgs_passes::pipeline::{GeometryOptions, GeometryStep, Inputs, Status};
use sgs_passes::reference::adam::{Rates, adam};
use sgs_passes::reference::project::Gaussians as ReferenceGaussians;
use sgs_passes::reference::rng::Pcg;
use sgs_passes::reference::rounding;
use sgs_passes::scene::{GaussianData, Gaussians, Group, Layout, Model, Storage};
use sgs_passes::splat::Channels;
use sgs_shaders::structs::{Step, Work};
use sgs_tests::whole::step_options;
use sgs_tests::{Gpu, scenes};
use sgs_train::Schedule;

fn bytes<T: bytemuck::NoUninit>(data: &[T]) -> Vec<u8> {
    bytemuck::cast_slice(data).to_vec()
}

/// Returns column and component of a number of a group.
fn place(model: &Model, group: Group, number: u32) -> (u32, u32) {
    let harmonic = |first: u32| (3 + (first + number) / 4, (first + number) % 4);
    match group {
        Group::Means => (0, number),
        Group::OpacityLogits => (0, 3),
        Group::LogScales => (1, number),
        Group::Rotations => (2, number),
        Group::Sh0 => harmonic(0),
        Group::Sh1 => harmonic(3),
        Group::Sh2 => harmonic(12),
        Group::Sh3 => harmonic(27),
        Group::Normals => (model.columns() - 1, number),
        Group::Semantics => unreachable!(),
    }
}

fn is_harmonic(group: Group) -> bool {
    matches!(group, Group::Sh0 | Group::Sh1 | Group::Sh2 | Group::Sh3)
}

/// Parameters and pairs of moments.
#[derive(Clone, Debug, PartialEq)]
struct State {
    parameters: GaussianData,
    moments: GaussianData,
}

impl State {
    fn random(model: &Model, count: usize, seed: u32) -> State {
        let mut rng = Pcg::new(seed);
        let (mut parameters, mut moments) = (GaussianData::default(), GaussianData::default());
        for group in model.groups() {
            let n = count * group.width() as usize;
            parameters.groups[group as usize] = (0..n).map(|_| (0.3 * rng.normal()) as f32).collect();
            // A mean of squares is at least the square of the mean.
            let pairs = (0..n).flat_map(|_| {
                let (m, v) = ((1e-3 * rng.normal()) as f32, (1e-3 * rng.normal()) as f32);
                [m, m * m + v * v]
            });
            moments.groups[group as usize] = pairs.collect();
        }
        State { parameters, moments }
    }

    /// Returns the numbers that compact storage holds, rounded to nearest.
    fn stored(&self, model: &Model) -> State {
        let count = self.parameters.len();
        let words = Storage::Compact.store(model, &model.to_columns(&self.parameters));
        let [first, second] = model.moments_to_columns(&self.moments);
        let [first, second] = Storage::Compact.store_moments([&first, &second]);
        let [first, second] = Storage::Compact.load_moments([&first, &second]);
        State {
            parameters: model.from_columns(&Storage::Compact.load(model, &words), count),
            moments: model.moments_from_columns([&first, &second], count),
        }
    }

    /// Returns the numbers after rounding at random in the step of a seed.
    fn rounded(&self, model: &Model, seed: u32) -> State {
        let mut state = self.clone();
        for group in model.groups() {
            let width = group.width();
            for (i, pair) in state.moments.groups[group as usize].as_chunks_mut::<2>().0.iter_mut().enumerate() {
                let (column, number) = place(model, group, i as u32 % width);
                let key = rounding::key(seed, i as u32 / width);
                *pair = rounding::moments(pair.map(f64::from), key, column, number).map(|x| x as f32);
            }
            for (i, x) in state.parameters.groups[group as usize].iter_mut().enumerate() {
                let (column, number) = place(model, group, i as u32 % width);
                if is_harmonic(group) {
                    *x = rounding::half(f64::from(*x), rounding::key(seed, i as u32 / width), column, number) as f32;
                }
            }
        }
        state
    }

    /// Compares bit for bit. Zeros of moments may differ in their sign.
    fn assert_same(&self, other: &State, model: &Model) {
        let bits = |data: &GaussianData, group: Group| -> Vec<u32> {
            data.group(group).iter().map(|x| if *x == 0.0 { 0 } else { x.to_bits() }).collect()
        };
        for group in model.groups() {
            for (what, a, b) in
                [("parameters", &self.parameters, &other.parameters), ("moments", &self.moments, &other.moments)]
            {
                let (a, b) = (bits(a, group), bits(b, group));
                let first = a.iter().zip(&b).position(|(a, b)| a != b);
                assert!(a.len() == b.len(), "{} of {}", a.len(), b.len());
                if let Some(i) = first {
                    panic!("{what} {}: {i}: {} {}", group.name(), f32::from_bits(a[i]), f32::from_bits(b[i]));
                }
            }
        }
    }
}

/// Trains one step from a state.
///
/// Returns the state after it, the report's numbers and the seed of the step.
fn step_of(gpu: &Gpu, g: &ReferenceGaussians, start: &State, storage: Storage, dense: bool) -> (State, Vec<f32>, u32) {
    let device = gpu.device();
    let degree = (0..4).rev().find(|b| !g.sh[*b].is_empty()).unwrap_or(0) as u32;
    let model = Model { sh_degree: degree, normals: !g.normals.is_empty(), semantics: false, mip: false };
    let layout = Layout { model, capacity: g.len() as u32 + 7, training: true, statistics: true, storage };
    let gaussians = Gaussians::of(device, &layout).unwrap();
    gaussians.upload(device, &start.parameters).unwrap();
    let statistics = vec![0.0; 4 * g.len()];
    gaussians.upload_optimizer(device, &start.moments, &statistics).unwrap();
    let camera = scenes::camera([40, 30]);
    let pixels = camera.size[0] as usize * camera.size[1] as usize;
    let targets = device.buffer("targets", 4 * pixels as u64, Location::Device).unwrap();
    device.upload(&targets, 0, bytemuck::cast_slice(&vec![0xff80_8080_u32; pixels])).unwrap();
    let inputs = Inputs::of(&targets);
    let channels = Channels { colors: true, normals: model.normals, depth: false };
    let options = GeometryOptions { dense_adam: dense, ..step_options(camera.size, channels) };
    let status = Status::new(device).unwrap();
    let mut exec = GeometryStep::new(device, &gpu.tuning(), &gaussians, &inputs, &status, options).unwrap();
    let mut values = Schedule::new(&Settings::default(), 1.0, 1).step(1, &scenes::gpu_camera(&camera), 0);
    values.sh_degree = degree;
    exec.submit(&values).unwrap();
    exec.finish().unwrap();
    let report = status.report(1).unwrap();
    assert_eq!((report.flags, report.skipped), (0, 0));
    let (moments, _) = gaussians.download_optimizer(device).unwrap();
    let state = State { parameters: gaussians.download(device).unwrap(), moments };
    (state, vec![report.losses.l1, report.losses.ssim], values.seed)
}

/// A step of compact Gaussians is that of exact ones, rounded at random.
///
/// Every kernel reads the right numbers, and rounds what it writes as the reference does.
#[test]
fn step_is_the_exact_step_rounded() {
    let gpu = Gpu::new();
    for (degree, normals, dense) in [(3, false, false), (0, true, false), (1, false, true), (2, true, true)] {
        let g = scenes::ordinary(90, degree, normals, 3);
        let model = Model { sh_degree: degree as u32, normals, semantics: false, mip: false };
        let moments = State::random(&model, g.len(), 8).moments;
        let start = State { parameters: scenes::data(&g), moments }.stored(&model);
        let (exact, losses, seed) = step_of(&gpu, &g, &start, Storage::Exact, dense);
        let (compact, same, _) = step_of(&gpu, &g, &start, Storage::Compact, dense);
        assert_eq!(losses, same);
        exact.rounded(&model, seed).assert_same(&compact, &model);
        // Many numbers moved, and rounding changed many.
        let moved = |a: &State, b: &State| {
            let pairs = a.parameters.group(Group::Sh0).iter().zip(b.parameters.group(Group::Sh0));
            pairs.filter(|(a, b)| a != b).count()
        };
        assert!(moved(&start, &exact) > 60 && moved(&exact, &compact) > 60);
        // Another seed rounds otherwise.
        assert_ne!(exact.rounded(&model, seed), exact.rounded(&model, seed + 1));
    }
}

/// Inputs of `adam_unseen`.
struct Unseen {
    model: Model,
    start: State,
    /// Gradients of other views: rows of 11.
    extra: Vec<f32>,
    seed: u32,
}

impl Unseen {
    fn rates(&self) -> Rates {
        Rates::at(1e-3, 7)
    }

    fn run(&self, gpu: &Gpu, storage: Storage) -> State {
        let count = self.start.parameters.len();
        let mut g = Graph::new("adam_unseen");
        let (model, capacity) = (self.model, count as u32 + 5);
        let handles = Layout { model, capacity, training: true, statistics: false, storage }.declare(&mut g, true);
        let moments = handles.moments.unwrap();
        let extra = sgs_passes::splat::ExtraGradients { buffer: g.input("extra", 44 * u64::from(capacity)) };
        let a = AdamUnseen {
            step: g.uniform("step", size_of::<Step>() as u64),
            flags: g.input("flags", 4),
            seen: g.input("seen", 4 * u64::from(capacity)),
            extra: Some(extra),
            sparse: false,
            regularize: false,
            skipped: g.external("skipped", 4),
        };
        adam_unseen(&mut g, &gpu.tuning(), &handles, &moments, &a).unwrap();
        let Rates { lr, correction1, correction2 } = self.rates();
        let lr = lr as f32;
        let step = Step {
            seed: self.seed,
            lr_means: lr,
            lr_scales: lr,
            lr_rotations: lr,
            lr_opacities: lr,
            lr_sh0: lr,
            lr_sh_rest: lr,
            lr_normals: lr,
            correction1: correction1 as f32,
            correction2: correction2 as f32,
            ..Default::default()
        };
        let mut rows = self.extra.clone();
        rows.resize(11 * capacity as usize, f32::NAN);
        let mut inputs = handles.contents(&self.start.parameters);
        let [first, second] = model.moments_to_columns(&self.start.moments);
        let [first, second] = storage.store_moments([&first, &second]);
        let work = Work { x: (count as u32).div_ceil(256), y: 1, z: 1, count: count as u32 };
        inputs.retain(|(buffer, _)| *buffer != handles.work);
        inputs.extend([
            (handles.work, bytes(&[work])),
            (moments.first, bytes(&first)),
            (moments.second, bytes(&second)),
            (extra.buffer, bytes(&rows)),
            (a.step, bytes(&[step])),
            (a.flags, bytes(&[0_u32])),
            (a.seen, bytes(&vec![0_u32; capacity as usize])),
        ]);
        let out = gpu.run(g, &inputs);
        let words = |buffer: Buffer| out.get::<u32>(buffer);
        let [first, second] = storage.load_moments([&words(moments.first), &words(moments.second)]);
        State {
            parameters: model.from_columns(&storage.load(&model, &words(handles.parameters)), count),
            moments: model.moments_from_columns([&first, &second], count),
        }
    }

    /// Returns the gradient of a number.
    fn gradient(&self, group: Group, i: usize) -> f32 {
        let width = group.width() as usize;
        let row = &self.extra[11 * (i / width)..];
        match group {
            Group::Means => row[i % width],
            Group::LogScales => row[3 + i % width],
            Group::Rotations => row[6 + i % width],
            Group::OpacityLogits => row[10],
            _ => 0.0,
        }
    }
}

/// Adam on numbers of 16 bits agrees with double precision over many decades.
///
/// The bound is a unit of their last place.
#[test]
fn adam_matches_reference_within_a_unit_of_the_last_place() {
    let gpu = Gpu::new();
    let model = Model { sh_degree: 3, normals: true, semantics: false, mip: false };
    let decades: Vec<f32> = (-30..=10).map(|e| 10.0_f32.powi(e)).collect();
    let count = decades.len();
    let mut start = State::random(&model, count, 4);
    for group in model.groups() {
        for (i, pair) in start.moments.groups[group as usize].as_chunks_mut::<2>().0.iter_mut().enumerate() {
            let v = decades[i / group.width() as usize];
            *pair = [if i % 3 == 0 { -0.4 } else { 0.7 } * v.sqrt(), v];
        }
    }
    // The largest half, and numbers below the normal ones.
    let sh0 = &mut start.parameters.groups[Group::Sh0 as usize];
    sh0[..6].copy_from_slice(&[65504.0, -65504.0, 1e-7, -3e-6, 5e-5, 0.0]);
    let start = start.stored(&model);
    let mut rng = Pcg::new(9);
    // Gradients of the size of the moments, and extreme ones.
    let mut extra: Vec<f32> = (0..11 * count).map(|i| rng.normal() as f32 * decades[i / 11].sqrt()).collect();
    for (i, x) in [1e30, -1e15, 1e-30, 0.0, 1e-38, -f32::MAX].into_iter().enumerate() {
        extra[11 * (5 * i + 1) + i] = x;
    }
    let case = Unseen { model, start, extra, seed: 0 };
    let after = case.run(&gpu, Storage::Compact);
    let rates = case.rates();
    let mut tried = 0;
    for group in model.groups() {
        let pairs = case.start.moments.group(group).as_chunks::<2>().0;
        let found = after.moments.group(group).as_chunks::<2>().0;
        for (i, (pair, found)) in pairs.iter().zip(found).enumerate() {
            let x = case.start.parameters.group(group)[i];
            let now = f64::from(after.parameters.group(group)[i]);
            let (p, [m, v]) = adam(f64::from(x), pair.map(f64::from), case.gradient(group, i).into(), rates);
            let [a, b] = found.map(f64::from);
            let name = format!("{} {i}: {x} {pair:?} to {now} {found:?}, {p} [{m}, {v}]", group.name());
            // A unit of the last place, and the bounds of the exact kernel.
            assert!((a - m).abs() <= (2.0_f64.powi(-7) + 1e-5) * m.abs() + 1e-6 * f64::from(pair[0].abs()), "{name}");
            assert!((b - v).abs() <= (2.0_f64.powi(-8) + 1e-5) * v, "{name}");
            let p = if is_harmonic(group) { p.clamp(-65504.0, 65504.0) } else { p };
            let unit = if is_harmonic(group) { (p.abs() * 2.0_f64.powi(-10)).max(2.0_f64.powi(-24)) } else { 0.0 };
            assert!((now - p).abs() <= unit + 2e-7 * p.abs() + 1e-5 * rates.lr, "{name}");
            assert!(now.is_finite() && a.is_finite() && b.is_finite(), "{name}");
            tried += 1;
        }
    }
    assert_eq!(tried, count * model.width() as usize);
    case.run(&gpu, Storage::Exact).rounded(&model, 0).assert_same(&after, &model);
}

/// The mean of many roundings is the number itself. Rounding to nearest would leave second moments and harmonics still.
#[test]
fn rounding_is_unbiased() {
    let gpu = Gpu::new();
    let model = Model { sh_degree: 3, normals: false, semantics: false, mip: false };
    let count = 3000;
    let mut start = State::random(&model, count, 1);
    for group in model.groups() {
        start.parameters.groups[group as usize].fill(0.3);
        start.moments.groups[group as usize].as_chunks_mut::<2>().0.fill([1e-3, 3e-6]);
    }
    let start = start.stored(&model);
    let case = |seed| Unseen { model, start: start.clone(), extra: vec![0.0; 11 * count], seed };
    let after = case(5).run(&gpu, Storage::Compact);
    let [m, v] = [0, 1].map(|k| f64::from(start.moments.group(Group::Sh1)[k]));
    let x = f64::from(start.parameters.group(Group::Sh1)[0]);
    let (x1, [m1, v1]) = adam(x, [m, v], 0.0, case(5).rates());
    let mean = |values: &mut dyn Iterator<Item = f32>| {
        let all: Vec<f64> = values.map(f64::from).collect();
        (all.iter().sum::<f64>() / all.len() as f64, (all.len() as f64).sqrt())
    };
    let harmonics = || model.groups().filter(|g| is_harmonic(*g));
    let pairs = || model.groups().flat_map(|g| after.moments.group(g).as_chunks::<2>().0);
    // Five deviations of a mean of numbers that are half a unit of the last place off.
    let checked = |what: &str, (mean, root): (f64, f64), expected: f64, unit: f64, nearest: f64| {
        let bound = 2.5 * unit / root + 2e-6 * expected;
        assert!((mean - expected).abs() <= bound, "{what}: {mean}, expected {expected}, within {bound}");
        // The test can fail: what nearest would give is far off.
        assert!((nearest - expected).abs() > 10.0 * bound, "{what}");
    };
    let unit = |x: f64, digits: i32| 2.0_f64.powi(x.log2().floor() as i32 - digits);
    let nearest = (m1 / unit(m1, 7)).round() * unit(m1, 7);
    checked("first moments", mean(&mut pairs().map(|p| p[0])), m1, unit(m1, 7), nearest);
    checked("second moments", mean(&mut pairs().map(|p| p[1])), v1, unit(v1, 8), v);
    let halves = &mut harmonics().flat_map(|g| after.parameters.group(g)).copied();
    let nearest = (x1 / unit(x1, 10)).round() * unit(x1, 10);
    checked("harmonics", mean(halves), x1, unit(x1, 10), nearest);
    // The same seed rounds alike, another one does not.
    assert_eq!(case(5).run(&gpu, Storage::Compact), after);
    assert_ne!(case(6).run(&gpu, Storage::Compact), after);
}

#[test]
fn opacity_reset_clears_compact_moments() {
    let gpu = Gpu::new();
    let model = Model { sh_degree: 1, normals: true, semantics: false, mip: false };
    let (count, capacity) = (70, 99);
    let start = State::random(&model, capacity, 3).stored(&model);
    let run = |storage: Storage| {
        let mut g = Graph::new("opacity_reset");
        let capacity = capacity as u32;
        let handles = Layout { model, capacity, training: true, statistics: false, storage }.declare(&mut g, true);
        let moments = handles.moments.unwrap();
        opacity_reset(&mut g, gpu.tuning(), &handles, &moments).unwrap();
        let [first, second] = model.moments_to_columns(&start.moments);
        let [first, second] = storage.store_moments([&first, &second]);
        let mut inputs = handles.contents(&start.parameters);
        inputs.retain(|(buffer, _)| *buffer != handles.work);
        inputs.extend([
            (handles.work, bytes(&[Work { x: 1, y: 1, z: 1, count }])),
            (moments.first, bytes(&first)),
            (moments.second, bytes(&second)),
        ]);
        let out = gpu.run(g, &inputs);
        let words = |buffer: Buffer| out.get::<u32>(buffer);
        let [first, second] = storage.load_moments([&words(moments.first), &words(moments.second)]);
        State {
            parameters: model.from_columns(&storage.load(&model, &words(handles.parameters)), capacity as usize),
            moments: model.moments_from_columns([&first, &second], capacity as usize),
        }
    };
    let exact = run(Storage::Exact);
    assert_ne!(exact.moments, start.moments);
    exact.assert_same(&run(Storage::Compact), &model);
}

/// Uploads, downloads, growth and bands keep the numbers that 16 bits hold.
#[test]
fn buffers_keep_stored_numbers() {
    let gpu = Gpu::new();
    let device = gpu.device();
    let model = Model { sh_degree: 2, normals: true, semantics: false, mip: false };
    let layout = Layout { model, capacity: 100, training: true, statistics: true, storage: Storage::Compact };
    let mut gaussians = Gaussians::of(device, &layout).unwrap();
    assert_eq!(gaussians.bytes(), layout.parameter_bytes() + layout.moment_bytes() + layout.statistics_bytes());
    let start = State::random(&model, 77, 2);
    let stored = start.stored(&model);
    assert_ne!(start, stored);
    let statistics: Vec<f32> = (0..4 * 77).map(|i| i as f32).collect();
    gaussians.upload(device, &start.parameters).unwrap();
    gaussians.upload_optimizer(device, &start.moments, &statistics).unwrap();
    let state = |g: &Gaussians| {
        let (moments, found) = g.download_optimizer(device).unwrap();
        assert_eq!(found, statistics);
        State { parameters: g.download(device).unwrap(), moments }
    };
    state(&gaussians).assert_same(&stored, &model);
    gaussians.grow(device, 333).unwrap();
    state(&gaussians).assert_same(&stored, &model);
    gaussians.set_degree(device, 3).unwrap();
    let larger = Model { sh_degree: 3, ..model };
    assert_eq!(gaussians.layout(), Layout { model: larger, capacity: 333, ..layout });
    let grown = state(&gaussians);
    assert!(grown.parameters.group(Group::Sh3).iter().all(|x| *x == 0.0));
    grown.assert_same(&stored, &model);
    gaussians.set_degree(device, 0).unwrap();
    state(&gaussians).assert_same(&stored, &Model { sh_degree: 0, ..model });
}
