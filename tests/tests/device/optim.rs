//! Adam on the device against its reference.

use sgs_engine::graph::Graph;
use sgs_passes::optim::{Adam, EPSILON, Rate, adam};
use sgs_passes::reference::adam as reference;
use sgs_passes::reference::rng::Pcg;
use sgs_passes::scene::{GaussianData, Group as Columns, Layout, Model, Storage};
use sgs_shaders::structs::{Step, Work};
use sgs_tests::{Gpu, Tolerance, assert_close};

fn bytes<T: bytemuck::NoUninit>(data: &[T]) -> Vec<u8> {
    bytemuck::cast_slice(data).to_vec()
}

/// Parameter group of `width` scalars per element. Its capacity exceeds the number of live elements.
struct Group {
    width: usize,
    live: usize,
    capacity: usize,
    parameters: Vec<f32>,
    moments: Vec<[f32; 2]>,
    gradients: Vec<f32>,
}

impl Group {
    fn random(width: usize, live: usize, capacity: usize, seed: u32) -> Group {
        let mut rng = Pcg::new(seed);
        let n = width * capacity;
        let mut normal = |scale: f64| (0..n).map(|_| (scale * rng.normal()) as f32).collect::<Vec<f32>>();
        let (parameters, gradients, m, v) = (normal(1.0), normal(1e-3), normal(1e-3), normal(1e-3));
        // A mean of squares is at least the square of the mean.
        let moments = m.into_iter().zip(v).map(|(m, v)| [m, m * m + v * v]).collect();
        Group { width, live, capacity, parameters, moments, gradients }
    }

    /// Returns parameters, moments and the number of skipped gradients after one pass.
    fn run(&self, gpu: &Gpu, t: u32, skip_zero: bool, flags: &[u32]) -> (Vec<f32>, Vec<[f32; 2]>, u32) {
        let mut g = Graph::new("adam");
        let words = 4 * (self.width * self.capacity) as u64;
        let step = g.uniform("step", size_of::<Step>() as u64);
        let live = g.input("live", size_of::<Work>() as u64);
        let flag_buffer = g.input("flags", 4 * flags.len() as u64);
        let gradients = g.input("gradients", words);
        let parameters = g.external("parameters", words);
        let moments = g.external("moments", 2 * words);
        let skipped = g.external("skipped", 4);
        let a = Adam {
            step,
            live,
            flags: flag_buffer,
            flag_words: flags.len() as u32,
            width: self.width as u32,
            capacity: self.capacity as u64,
            rate: Rate::Rotations,
            skip_zero,
            epsilon: EPSILON,
            gradients,
            parameters,
            moments,
            skipped,
        };
        adam(&mut g, gpu.tuning(), "adam", &a).unwrap();
        let rates = rates(t);
        let values = Step {
            lr_rotations: rates.lr as f32,
            correction1: rates.correction1 as f32,
            correction2: rates.correction2 as f32,
            lr_means: f32::NAN,
            ..Default::default()
        };
        let inputs = [
            (step, bytes(&[values])),
            (live, bytes(&[Work { x: 1, y: 1, z: 1, count: self.live as u32 }])),
            (flag_buffer, bytes(flags)),
            (gradients, bytes(&self.gradients)),
            (parameters, bytes(&self.parameters)),
            (moments, bytes(&self.moments)),
            (skipped, bytes(&[0_u32])),
        ];
        let out = gpu.run(g, &inputs);
        (out.get(parameters), out.get(moments), out.get::<u32>(skipped)[0])
    }

    /// Compares with the reference. Values that must not change are compared bit for bit. Returns the number of skipped
    /// gradients.
    fn check(&self, gpu: &Gpu, t: u32, skip_zero: bool) -> u32 {
        let (parameters, moments, skipped) = self.run(gpu, t, skip_zero, &[0, 0]);
        let rates = rates(t);
        let (mut expected, mut expected_m, mut expected_v) = (vec![], vec![], vec![]);
        for i in 0..self.width * self.capacity {
            let (p, [m, v], g) = (self.parameters[i], self.moments[i], self.gradients[i]);
            let untouched = i >= self.width * self.live || skip_zero && g == 0.0 || !g.is_finite();
            if untouched {
                assert_eq!((p.to_bits(), bytes(&[m, v])), (parameters[i].to_bits(), bytes(&moments[i])), "scalar {i}");
            }
            let (p, [m, v]) = match untouched {
                true => (f64::from(p), [f64::from(m), f64::from(v)]),
                false => reference::adam(f64::from(p), [f64::from(m), f64::from(v)], f64::from(g), rates),
            };
            expected.push(p);
            expected_m.push(m);
            expected_v.push(v);
        }
        // A step is at most a few learning rates. Its relative error is that of a square root and a division.
        assert_close("parameters", &expected, &parameters, Tolerance::new(1e-5 * rates.lr, 2e-7));
        let (m, v): (Vec<f32>, Vec<f32>) = moments.iter().map(|m| (m[0], m[1])).unzip();
        // First moments cancel. Numbers below the normal range may be flushed to zero.
        assert_close("first moments", &expected_m, &m, Tolerance::new(1e-9, 1e-5));
        assert_close("second moments", &expected_v, &v, Tolerance::new(1e-37, 1e-5));
        skipped
    }
}

fn rates(t: u32) -> reference::Rates {
    reference::Rates::at(1e-3, t)
}

#[test]
fn adam_matches_reference() {
    let gpu = Gpu::new();
    for (i, width) in [1, 3, 4, 21].into_iter().enumerate() {
        for (live, capacity) in [(0, 3), (1, 1), (300, 300), (777, 1000)] {
            for t in [1, 1000] {
                let mut group = Group::random(width, live, capacity, i as u32);
                group.gradients.iter_mut().step_by(5).for_each(|g| *g = 0.0);
                assert_eq!(group.check(&gpu, t, true), 0);
                assert_eq!(group.check(&gpu, t, false), 0);
            }
        }
    }
}

#[test]
fn adam_survives_extreme_gradients() {
    let gpu = Gpu::new();
    for moments in [[0.0, 0.0], [1e-3, 1e-6], [0.0, 1e-30]] {
        let mut group = Group::random(1, 12, 12, 1);
        group.moments.fill(moments);
        group.gradients = vec![
            0.0,
            1e-38,
            -1e-30,
            1e-15,
            1e12,
            1e30,
            -f32::MAX,
            f32::NAN,
            f32::INFINITY,
            f32::NEG_INFINITY,
            -0.0,
            f32::from_bits(0x7fff_ffff),
        ];
        assert_eq!(group.check(&gpu, 1, true), 4);
        assert_eq!(group.check(&gpu, 1, false), 4);
        let (parameters, moments, _) = group.run(&gpu, 1, false, &[0]);
        assert!(parameters.iter().chain(moments.as_flattened()).all(|x| x.is_finite()));
    }
}

#[test]
fn adam_skips_flagged_steps() {
    let gpu = Gpu::new();
    let group = Group::random(3, 100, 100, 4);
    for flags in [&[1_u32][..], &[0, 0, 0x8000_0000]] {
        let (parameters, moments, skipped) = group.run(&gpu, 3, false, flags);
        assert!(bytes(&parameters) == bytes(&group.parameters) && bytes(&moments) == bytes(&group.moments));
        assert_eq!(skipped, 0);
    }
}

/// Tests that the comparison detects an update with the wrong bias correction.
#[test]
#[should_panic(expected = "parameters: element")]
fn adam_check_can_fail() {
    let gpu = Gpu::new();
    let group = Group::random(3, 100, 100, 4);
    let (parameters, _, _) = group.run(&gpu, 2, false, &[0]);
    let expected: Vec<f64> = (0..300)
        .map(|i| {
            let [m, v] = group.moments[i].map(f64::from);
            reference::adam(f64::from(group.parameters[i]), [m, v], f64::from(group.gradients[i]), rates(3)).0
        })
        .collect();
    assert_close("parameters", &expected, &parameters, Tolerance::new(1e-8, 2e-7));
}

/// Learning rates of unseen Gaussians; each group has its own.
fn rate(group: Columns) -> f64 {
    0.1 * (1.0 + f64::from(group as u32))
}

/// Tests dense Adam's passes over unseen Gaussians. Seen Gaussians stay unchanged, unseen ones decay like the reference,
/// and those with zero moments do not move. A raised flag stops every update. So does sparse Adam without gradients.
#[test]
fn unseen_gaussians_decay_as_in_reference() {
    use sgs_passes::optim::{AdamUnseen, adam_unseen, adam_unseen_features};
    let gpu = Gpu::new();
    for (degree, normals, live, flag, sparse) in
        [(0, true, 700, 0, false), (1, false, 333, 0, false), (2, true, 5, 0, false), (3, true, 300, 8, false)]
            .into_iter()
            .chain([(3, false, 65, 0, false), (3, true, 64, 0, true)])
    {
        let model = Model { sh_degree: degree, normals, semantics: true, mip: false };
        let capacity = live + 9;
        let group = |g: Columns| Group::random(g.width() as usize, live, capacity, 5 + g as u32);
        let mut groups: Vec<_> = model.groups().map(|g| (g, group(g))).collect();
        groups.iter_mut().for_each(|(_, group)| group.moments[..group.width].fill([0.0; 2]));
        let seen: Vec<u32> = (0..capacity as u32).map(|i| i % 3 / 2).collect();
        let mut g = Graph::new("adam_unseen");
        let layout =
            Layout { model, capacity: capacity as u32, training: true, statistics: false, storage: Storage::Exact };
        let handles = layout.declare(&mut g, true);
        let moments = handles.moments.unwrap();
        let a = AdamUnseen {
            step: g.uniform("step", size_of::<Step>() as u64),
            flags: g.input("flags", 4),
            seen: g.input("seen", 4 * capacity as u64),
            extra: None,
            sparse,
            regularize: false,
            skipped: g.external("skipped", 4),
        };
        adam_unseen(&mut g, &gpu.tuning(), &handles, &moments, &a).unwrap();
        if !sparse {
            adam_unseen_features(&mut g, &gpu.tuning(), &handles, &moments, &a).unwrap();
        }
        let rates = reference::Rates::at(1.0, 4);
        let step = Step {
            lr_means: rate(Columns::Means) as f32,
            lr_scales: rate(Columns::LogScales) as f32,
            lr_rotations: rate(Columns::Rotations) as f32,
            lr_opacities: rate(Columns::OpacityLogits) as f32,
            lr_sh0: rate(Columns::Sh0) as f32,
            lr_sh_rest: rate(Columns::Sh1) as f32,
            lr_normals: rate(Columns::Normals) as f32,
            lr_semantics: rate(Columns::Semantics) as f32,
            correction1: rates.correction1 as f32,
            correction2: rates.correction2 as f32,
            ..Default::default()
        };
        let work = Work { x: (live as u32).div_ceil(256), y: 1, z: 1, count: live as u32 };
        let mut data = GaussianData::default();
        let mut pairs = GaussianData::default();
        for (g, group) in &groups {
            data.groups[*g as usize] = group.parameters.clone();
            pairs.groups[*g as usize] = group.moments.as_flattened().to_vec();
        }
        let [first, second] = model.moments_to_columns(&pairs);
        let mut inputs = handles.contents(&data);
        inputs.retain(|(buffer, _)| *buffer != handles.work);
        inputs.extend([
            (handles.work, bytes(&[work])),
            (moments.first, bytes(&first)),
            (moments.second, bytes(&second)),
            (moments.semantics, bytes(pairs.group(Columns::Semantics))),
            (a.step, bytes(&[step])),
            (a.flags, bytes(&[flag])),
            (a.seen, bytes(&seen)),
        ]);
        let out = gpu.run(g, &inputs);
        let mut after = model.from_columns(&out.get::<f32>(handles.parameters), capacity);
        after.groups[Columns::Semantics as usize] = out.get(handles.semantics);
        let columns = [moments.first, moments.second].map(|buffer| out.get::<f32>(buffer));
        let mut after_pairs = model.moments_from_columns([&columns[0], &columns[1]], capacity);
        after_pairs.groups[Columns::Semantics as usize] = out.get(moments.semantics);
        for (which, group) in &groups {
            let parameters = after.group(*which);
            let moments = after_pairs.group(*which).as_chunks::<2>().0;
            let shared = if matches!(which, Columns::Sh2 | Columns::Sh3) { Columns::Sh1 } else { *which };
            let rates = reference::Rates { lr: f64::from(rate(shared) as f32), ..rates };
            let mut expected = Vec::new();
            for (j, (p, m)) in group.parameters.iter().zip(&group.moments).enumerate() {
                let i = j / group.width;
                if flag != 0 || sparse || i >= live || seen[i] != 0 || *m == [0.0; 2] {
                    let same = (parameters[j].to_bits(), moments[j]) == (p.to_bits(), *m);
                    assert!(same, "{} {j} was touched", which.name());
                    expected.push(f64::from(*p));
                } else {
                    let (p, m) = reference::adam(f64::from(*p), m.map(f64::from), 0.0, rates);
                    assert_close("moments", &m, &moments[j], Tolerance::new(1e-12, 1e-6));
                    expected.push(p);
                }
            }
            assert_close(which.name(), &expected, parameters, Tolerance::new(1e-6, 1e-5));
        }
    }
}
