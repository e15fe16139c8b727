//! Gradients of two views in one Adam step.
//!
//! Features are rendered in both views, and geometry receives gradients from both.

use sgs_engine::graph::{Buffer, Graph};
use sgs_passes::optim::{Adam, AdamUnseen, EPSILON, Rate, adam, adam_unseen};
use sgs_passes::pipeline::Step;
use sgs_passes::reference::adam as reference;
use sgs_passes::reference::project::Gaussians;
use sgs_passes::scene::{GaussianData, Group, Layout, Model, SEMANTIC_FEATURES, Storage};
use sgs_passes::splat::{
    BackwardKernel, Blended, Channels, ExtraGradients, FusedAdam, Gradients, blend, blend_bwd, blend_debt,
    features_bwd, project, project_bwd, project_bwd_adam, project_bwd_features,
};
use sgs_tests::feature_view::{View, declare, gaussian_inputs};
use sgs_tests::scenes::{self, Rng};
use sgs_tests::{Gpu, Tolerance, assert_close, finite_difference};

const WIDE: usize = SEMANTIC_FEATURES as usize;
/// Parameter groups that feature gradients of other views move.
const MOVED: [Group; 4] = [Group::Means, Group::LogScales, Group::Rotations, Group::OpacityLogits];

fn bytes<T: bytemuck::NoUninit>(data: &[T]) -> Vec<u8> {
    bytemuck::cast_slice(data).to_vec()
}

/// The summed feature gradient of both views matches differences of the losses.
///
/// The tested passes add to existing gradients.
#[test]
fn feature_gradients_of_two_views_match_reference() {
    check_gradients(&Gpu::new());
}

/// The lanes sum the entries of every splat together.
#[test]
fn feature_gradients_summed_by_all_lanes_match_reference() {
    check_gradients(&Gpu::new().with_large_tiles(0));
}

fn check_gradients(gpu: &Gpu) {
    let t = gpu.tuning();
    let scene = scenes::with_semantics(scenes::ordinary(10, 0, false, 21), 22);
    let views = [View::new([19, 17], 0.0, 1), View::new([14, 20], 0.6, 2)];
    let n = scene.len();
    let mut g = Graph::new("two_views");
    let model = Model { semantics: true, ..Default::default() };
    let layout = Layout { model, capacity: n as u32, training: false, statistics: false, storage: Storage::Exact };
    let handles = layout.declare(&mut g, false);
    let flags = g.external("flags", 4);
    let extra = ExtraGradients { buffer: g.external("extra", 4 * u64::from(ExtraGradients::WIDTH) * n as u64) };
    let semantics = g.external("grad_semantics", 4 * (WIDE * n) as u64);
    let mut inputs = gaussian_inputs(&scene, &handles);
    for view in &views {
        let d = declare(gpu, &mut g, view, &handles, flags, Step::default());
        project_bwd_features(&mut g, &t, &d.screen, &handles, &d.visible, &d.features, &extra).unwrap();
        features_bwd(&mut g, &t, &d.visible, &d.features, semantics).unwrap();
        inputs.extend(d.inputs);
    }
    inputs.push((flags, vec![0; 4]));
    inputs.push((extra.buffer, bytes(&vec![0.0_f32; 11 * n])));
    inputs.push((semantics, bytes(&vec![0.0_f32; WIDE * n])));
    let out = gpu.run(g, &inputs);
    assert_eq!(out.get::<u32>(flags), [0], "the entries overflowed");
    let rows = out.get::<f32>(extra.buffer);
    let (mut compared, mut skipped) = (0, 0);
    for group in MOVED.into_iter().chain([Group::Semantics]) {
        let width = group.width() as usize;
        let first = MOVED.iter().take_while(|x| **x != group).map(|x| x.width() as usize).sum::<usize>();
        let found: Vec<f32> = match group {
            Group::Semantics => out.get(semantics),
            _ => rows.chunks_exact(11).flat_map(|row| &row[first..][..width]).copied().collect(),
        };
        let scale = found.iter().fold(0.0_f64, |m, v| m.max(f64::from(v.abs())));
        assert!(scale > 0.0, "{} have no gradient", group.name());
        for (i, value) in found.iter().enumerate() {
            let at = |h: f64| {
                finite_difference(&mut [parameters(&scene, group)[i]], 0, h, |x| {
                    let mut moved = scene.clone();
                    parameters_mut(&mut moved, group)[i] = x[0];
                    views.iter().map(|view| view.loss(&moved)).sum()
                })
            };
            let (coarse, fine) = (at(2e-6), at(5e-7));
            // Both differences disagree if a blending threshold lies between.
            if (coarse - fine).abs() > 1e-3 * (1.0 + fine.abs()) {
                skipped += 1;
                continue;
            }
            compared += 1;
            let tolerance = 2e-3 * fine.abs() + 2e-4 * scale + 1e-5;
            let error = (f64::from(*value) - fine).abs();
            assert!(error <= tolerance, "{}[{i}]: {value} instead of {fine}, largest {scale}", group.name());
        }
    }
    assert!(skipped * 5 < compared, "{skipped} of {compared} lie at thresholds");
}

fn parameters(g: &Gaussians, group: Group) -> &[f64] {
    match group {
        Group::Means => &g.means,
        Group::LogScales => &g.log_scales,
        Group::Rotations => &g.rotations,
        Group::OpacityLogits => &g.opacity_logits,
        _ => &g.semantics,
    }
}

fn parameters_mut(g: &mut Gaussians, group: Group) -> &mut [f64] {
    match group {
        Group::Means => &mut g.means,
        Group::LogScales => &mut g.log_scales,
        Group::Rotations => &mut g.rotations,
        Group::OpacityLogits => &mut g.opacity_logits,
        _ => &mut g.semantics,
    }
}

/// Step with a training view (color and features) and one other view (features).
struct Case {
    scene: Gaussians,
    training: View,
    other: View,
    /// Loss gradient of the training view's image.
    image: Vec<f32>,
    moments: Vec<Vec<[f32; 2]>>,
    dense: bool,
    flag: u32,
}

/// Results of a step by group, and the gradients that it used.
struct Left {
    parameters: Vec<Vec<f32>>,
    moments: Vec<Vec<[f32; 2]>>,
    /// Gradients of the training view alone.
    training: Vec<Vec<f32>>,
    extra: Vec<f32>,
    semantics: Vec<f32>,
    /// Numbers of gradients skipped by the three updates: fused, unseen Gaussians, features.
    skipped: [u32; 3],
}

const RATES: [(Group, f64); 8] = [
    (Group::Means, 1e-3),
    (Group::LogScales, 2e-3),
    (Group::Rotations, 3e-3),
    (Group::OpacityLogits, 4e-3),
    (Group::Sh0, 5e-3),
    (Group::Sh1, 6e-3),
    (Group::Normals, 7e-3),
    (Group::Semantics, 8e-3),
];

fn rates(group: Group) -> reference::Rates {
    reference::Rates::at(RATES.iter().find(|r| r.0 == group).unwrap().1, 3)
}

const MODEL: Model = Model { sh_degree: 1, normals: true, semantics: true, mip: false };

impl Case {
    fn new(dense: bool) -> Case {
        let mut scene = scenes::with_semantics(scenes::ordinary(110, 1, true, 31), 32);
        // Every fourth Gaussian lies behind both cameras.
        scene.means.chunks_exact_mut(3).step_by(4).for_each(|m| m[2] = -m[2]);
        let training = View::new([24, 18], 0.0, 3);
        let other = View::new([17, 21], -0.4, 4);
        let mut r = Rng::new(5);
        // The left half of the training view has zero gradients. Gaussians visible only there have none.
        let silent = |pixel: usize| pixel % 24 < 12;
        let image = (0..24 * 18 * 6).map(|i| if silent(i / 6) { 0.0 } else { r.between(-1.0, 1.0) as f32 }).collect();
        let mut case = Case { scene, training, other, image, moments: Vec::new(), dense, flag: 0 };
        let weights = case.training.weights.iter_mut().enumerate();
        weights.filter(|(i, _)| silent(i / WIDE)).for_each(|(_, w)| *w = 0.0);
        let n = case.scene.len();
        for group in Group::ALL {
            let scalars = if MODEL.has(group) { n * group.width() as usize } else { 0 };
            let mut moments: Vec<[f32; 2]> = (0..scalars)
                .map(|_| {
                    let (m, v) = (r.between(-0.1, 0.1) as f32, r.between(0.01, 0.2) as f32);
                    [m, m * m + v * v]
                })
                .collect();
            // Some parameters never had a gradient.
            moments.iter_mut().step_by(7).for_each(|m| *m = [0.0; 2]);
            case.moments.push(moments);
        }
        case
    }

    fn run(&self, gpu: &Gpu) -> Left {
        let t = gpu.tuning();
        let n = self.scene.len();
        let mut g = Graph::new("step");
        let layout =
            Layout { model: MODEL, capacity: n as u32 + 3, training: true, statistics: false, storage: Storage::Exact };
        let handles = layout.declare(&mut g, true);
        let flags = g.external("flags", 4);
        let skipped = ["skipped", "skipped_unseen", "skipped_features"].map(|name| g.external(name, 4));
        let values = step_values();
        let capacity = u64::from(layout.capacity);

        let mut inputs = gaussian_inputs(&self.scene, &handles);
        let extra = ExtraGradients { buffer: g.external("extra", 4 * 11 * capacity) };
        let semantics = g.external("grad_semantics", 4 * WIDE as u64 * capacity);
        g.fill("clear", extra.buffer, 0).unwrap();
        g.fill("clear_semantics", semantics, 0).unwrap();
        let other = declare(gpu, &mut g, &self.other, &handles, flags, values);
        project_bwd_features(&mut g, &t, &other.screen, &handles, &other.visible, &other.features, &extra).unwrap();
        features_bwd(&mut g, &t, &other.visible, &other.features, semantics).unwrap();

        let train = declare(gpu, &mut g, &self.training, &handles, flags, values);
        features_bwd(&mut g, &t, &train.visible, &train.features, semantics).unwrap();
        // Project again for colors and normals.
        let channels = Channels { colors: true, normals: true, depth: false };
        let visible = project(&mut g, &t, &train.screen, &handles, channels).unwrap();
        let pixels = train.screen.pixels();
        let blended = Blended {
            image: g.transient("image", 4 * 6 * pixels),
            transmittance: g.transient("transmittance", 4 * pixels),
        };
        blend(&mut g, &t, &train.screen, &visible, &train.entries, &blended).unwrap();
        let gradient = Blended {
            image: g.input("grad_image", 4 * 6 * pixels),
            transmittance: g.input("grad_transmittance", 4 * pixels),
        };
        let owed = blend_debt(&mut g, &t, &train.screen, 6, &blended, &gradient).unwrap();
        let pixel = BackwardKernel::Pixel;
        let mut sums = blend_bwd(&mut g, &t, &train.screen, &visible, &train.entries, &owed, pixel, false).unwrap();
        sums.features = Some(train.features);
        let training = g.external("grad_parameters", MODEL.column_bytes(n as u32));
        let into = Gradients { parameters: training, means2d: g.external("means2d", 8 * n as u64), pose: None };
        project_bwd(&mut g, &t, &train.screen, &handles, &visible, &sums, &into).unwrap();

        let seen = g.transient("seen", 4 * capacity);
        g.fill("clear_seen", seen, 0).unwrap();
        let raised = g.input("raised", 4);
        let fused = FusedAdam {
            flags: raised,
            skipped: skipped[0],
            statistics: false,
            seen: Some(seen),
            extra: Some(extra),
            regularize: false,
        };
        project_bwd_adam(&mut g, &t, &train.screen, &handles, &visible, &sums, &fused).unwrap();
        let moments = handles.moments.unwrap();
        let step = train.screen.step;
        let rest = AdamUnseen {
            step,
            flags: raised,
            seen,
            extra: Some(extra),
            sparse: !self.dense,
            regularize: false,
            skipped: skipped[1],
        };
        adam_unseen(&mut g, &t, &handles, &moments, &rest).unwrap();
        let of_features = Adam {
            step,
            live: handles.work,
            flags: raised,
            flag_words: 1,
            width: SEMANTIC_FEATURES,
            capacity,
            rate: Rate::Semantics,
            skip_zero: !self.dense,
            epsilon: EPSILON,
            gradients: semantics,
            parameters: handles.semantics,
            moments: moments.semantics,
            skipped: skipped[2],
        };
        adam(&mut g, t, "adam.semantics", &of_features).unwrap();

        inputs.extend(train.inputs);
        inputs.extend(other.inputs);
        inputs.extend([(flags, vec![0; 4]), (raised, bytes(&[self.flag]))]);
        inputs.extend([(gradient.image, bytes(&self.image)), (gradient.transmittance, vec![0; 4 * pixels as usize])]);
        inputs.extend(skipped.map(|b| (b, vec![0; 4])));
        inputs.push((training, vec![0; MODEL.column_bytes(n as u32) as usize]));
        let pairs = std::array::from_fn(|group| self.moments[group].as_flattened().to_vec());
        let [first, second] = MODEL.moments_to_columns(&GaussianData { groups: pairs });
        inputs.extend([(moments.first, bytes(&first)), (moments.second, bytes(&second))]);
        inputs.push((moments.semantics, bytes(&self.moments[Group::Semantics as usize])));
        let out = gpu.run(g, &inputs);
        assert_eq!(out.get::<u32>(flags), [0], "the entries overflowed");
        let groups = |buffer, features: Option<Buffer>| {
            let mut data = MODEL.from_columns(&out.get::<f32>(buffer), n);
            if let Some(features) = features {
                data.groups[Group::Semantics as usize] = out.get::<f32>(features)[..WIDE * n].to_vec();
            }
            data.groups.to_vec()
        };
        let columns = [moments.first, moments.second].map(|buffer| out.get::<f32>(buffer));
        let mut pairs = MODEL.moments_from_columns([&columns[0], &columns[1]], n);
        pairs.groups[Group::Semantics as usize] = out.get::<f32>(moments.semantics)[..2 * WIDE * n].to_vec();
        Left {
            parameters: groups(handles.parameters, Some(handles.semantics)),
            moments: pairs.groups.map(|pairs| pairs.as_chunks::<2>().0.to_vec()).to_vec(),
            training: groups(training, None),
            extra: out.get::<f32>(extra.buffer)[..11 * n].to_vec(),
            semantics: out.get::<f32>(semantics)[..WIDE * n].to_vec(),
            skipped: skipped.map(|b| out.get::<u32>(b)[0]),
        }
    }

    /// Compares the step with Adam on the sum of the gradients.
    ///
    /// Returns five numbers of Gaussians. The first two are moved by both views and by the training view alone. The next
    /// two are moved by the other view alone, with the training view seeing or not seeing them. The last are not moved.
    /// Without `whole`, the expected gradients lack the other view.
    fn check(&self, left: &Left, whole: bool) -> [usize; 5] {
        let n = self.scene.len();
        let data = scenes::data(&self.scene);
        let geometry: Vec<Group> = MODEL.groups().filter(|x| *x != Group::Semantics).collect();
        let row = |group: Group, i: usize| {
            let width = group.width() as usize;
            &left.training[group as usize][width * i..width * (i + 1)]
        };
        let extra = |i: usize| &left.extra[11 * i..11 * (i + 1)];
        let any = |v: &[f32]| v.iter().any(|x| *x != 0.0);
        let bad = |v: &[f32]| v.iter().any(|x| !x.is_finite());
        let seen = self.seen();
        let mut classes = [0; 5];
        for i in 0..n {
            let by_training = geometry.iter().any(|x| any(row(*x, i)));
            classes[match (by_training, any(extra(i))) {
                (true, true) => 0,
                (true, false) => 1,
                (false, true) if seen[i] => 2,
                (false, true) => 3,
                (false, false) => 4,
            }] += 1;
        }
        for group in MODEL.groups() {
            let (width, r) = (group.width() as usize, rates(group));
            let first = MOVED.iter().take_while(|x| **x != group).map(|x| x.width() as usize).sum::<usize>();
            let (mut expected, mut expected_m, mut expected_v) = (Vec::new(), Vec::new(), Vec::new());
            for j in 0..n * width {
                let (i, k) = (j / width, j % width);
                let touched = geometry.iter().any(|x| any(row(*x, i))) || seen[i] && any(extra(i));
                let more = if MOVED.contains(&group) && whole { f64::from(extra(i)[first + k]) } else { 0.0 };
                let gradient = match group {
                    Group::Semantics => f64::from(left.semantics[j]),
                    _ => f64::from(row(group, i)[k]) + more,
                };
                let skipped = match group {
                    Group::Semantics => !gradient.is_finite(),
                    // Unseen Gaussians are skipped group by group. Without a gradient, a group's moments only decay.
                    _ if !seen[i] && !MOVED.contains(&group) => false,
                    _ => geometry.iter().any(|x| bad(row(*x, i))) || bad(extra(i)),
                };
                let (p, m) = (data.group(group)[j], self.moments[group as usize][j]);
                let sparse = gradient == 0.0 && !self.dense && (group == Group::Semantics || !touched);
                let never = gradient == 0.0 && m == [0.0; 2];
                if skipped || sparse || never || self.flag != 0 {
                    let found = (left.parameters[group as usize][j], left.moments[group as usize][j]);
                    assert!(found == (p, m), "{}[{j}] of Gaussian {i} was touched", group.name());
                    expected.push(f64::from(p));
                    expected_m.push(f64::from(m[0]));
                    expected_v.push(f64::from(m[1]));
                } else {
                    let (p, [m, v]) = reference::adam(f64::from(p), m.map(f64::from), gradient, r);
                    expected.push(p);
                    expected_m.push(m);
                    expected_v.push(v);
                }
            }
            let (m, v): (Vec<f32>, Vec<f32>) = left.moments[group as usize].iter().map(|m| (m[0], m[1])).unzip();
            let name = group.name();
            assert_close(&format!("moments of {name}"), &expected_m, &m, Tolerance::new(1e-6, 1e-5));
            assert_close(&format!("second moments of {name}"), &expected_v, &v, Tolerance::new(1e-7, 1e-5));
            let found = &left.parameters[group as usize];
            assert_close(name, &expected, found, Tolerance::new(1e-3 * r.lr, 1e-6));
        }
        classes
    }

    /// Returns which Gaussians the training view sees, by the reference.
    fn seen(&self) -> Vec<bool> {
        let mut seen = vec![false; self.scene.len()];
        let visible = sgs_passes::reference::project::project(&self.scene, &self.training.camera, 1, false);
        visible.iter().for_each(|s| seen[s.id] = true);
        seen
    }
}

fn step_values() -> Step {
    let lr = |group: Group| rates(group).lr as f32;
    let r = rates(Group::Means);
    Step {
        step: 3,
        sh_degree: 1,
        lr_means: lr(Group::Means),
        lr_scales: lr(Group::LogScales),
        lr_rotations: lr(Group::Rotations),
        lr_opacities: lr(Group::OpacityLogits),
        lr_sh0: lr(Group::Sh0),
        lr_sh_rest: lr(Group::Sh1),
        lr_normals: lr(Group::Normals),
        lr_semantics: lr(Group::Semantics),
        correction1: r.correction1 as f32,
        correction2: r.correction2 as f32,
        ..Default::default()
    }
}

#[test]
fn two_view_step_matches_adam_on_summed_gradients() {
    check_step(&Gpu::new());
}

/// The lanes sum the entries of every splat together.
#[test]
fn two_view_step_by_all_lanes_matches_adam_on_summed_gradients() {
    check_step(&Gpu::new().with_large_tiles(0));
}

fn check_step(gpu: &Gpu) {
    for dense in [false, true] {
        let case = Case::new(dense);
        let left = case.run(gpu);
        let classes = case.check(&left, true);
        assert!(classes.iter().all(|c| *c > 3), "{classes:?}");
        assert_eq!(left.skipped, [0; 3]);
    }
}

#[test]
#[should_panic(expected = "was touched")]
fn lost_view_is_detected() {
    let case = Case::new(false);
    let left = case.run(&Gpu::new());
    case.check(&left, false);
}

#[test]
fn a_raised_flag_leaves_a_step_of_two_views_without_effect() {
    let gpu = Gpu::new();
    for dense in [false, true] {
        let case = Case { flag: 8, ..Case::new(dense) };
        let left = case.run(&gpu);
        case.check(&left, true);
        assert_eq!(left.skipped, [0; 3]);
    }
}

/// Non-finite gradients of either view move nothing and are counted.
///
/// All groups of the affected Gaussians stay unchanged.
#[test]
fn gradients_that_are_not_finite_move_nothing_and_are_counted() {
    let gpu = Gpu::new();
    for (dense, in_other) in [(false, false), (true, false), (false, true), (true, true)] {
        let mut case = Case::new(dense);
        let view = if in_other { &mut case.other } else { &mut case.training };
        let bad = if dense { f64::INFINITY } else { f64::NAN };
        view.weights.iter_mut().step_by(WIDE * if in_other { 8 } else { 29 }).for_each(|w| *w = bad);
        let left = case.run(&gpu);
        case.check(&left, true);
        let bad = |v: &[f32]| v.iter().any(|x| !x.is_finite());
        let n = case.scene.len();
        let mut expected = [0, 0, left.semantics.iter().filter(|x| !x.is_finite()).count() as u32];
        let seen = case.seen();
        for i in 0..n {
            let training = MODEL.groups().filter(|x| *x != Group::Semantics).any(|x| {
                let width = x.width() as usize;
                bad(&left.training[x as usize][width * i..width * (i + 1)])
            });
            let extra = bad(&left.extra[11 * i..11 * (i + 1)]);
            if extra {
                assert!(left.extra[11 * i..11 * (i + 1)].iter().all(|x| !x.is_finite()), "Gaussian {i} in part");
            }
            match seen[i] {
                true => expected[0] += u32::from(training || extra),
                false => expected[1] += u32::from(extra),
            }
        }
        assert!(expected[0] > 0 && expected[2] > 0 && (!in_other || expected[1] > 0), "{expected:?}");
        assert_eq!(left.skipped, expected);
    }
}
