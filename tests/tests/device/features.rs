//! Wide features: rendering, gradients, and the Adam update fused with them.

use sgs_engine::graph::Graph;
use sgs_passes::pipeline::Step;
use sgs_passes::reference::adam as reference;
use sgs_passes::reference::blend::{Blended, render};
use sgs_passes::reference::project::Gaussians;
use sgs_passes::scene::{Group, Layout, Model, SEMANTIC_FEATURES, Storage};
use sgs_passes::splat::{FeatureAdam, features_bwd, features_bwd_adam};
use sgs_tests::feature_view::{View, declare, gaussian_inputs, wants};
use sgs_tests::scenes::{self, Rng};
use sgs_tests::{Gpu, Tolerance, assert_close};

const WIDE: usize = SEMANTIC_FEATURES as usize;

fn bytes<T: bytemuck::NoUninit>(data: &[T]) -> Vec<u8> {
    bytemuck::cast_slice(data).to_vec()
}

/// Returns rendered features and the gradients of the Gaussians' features.
fn run(gpu: &Gpu, scene: &Gaussians, view: &View) -> (Vec<f32>, Vec<f32>) {
    let n = scene.len();
    let mut g = Graph::new("features");
    let degree = (0..4).rev().find(|b| !scene.sh[*b].is_empty()).unwrap_or(0) as u32;
    let model = Model { sh_degree: degree, semantics: true, ..Default::default() };
    let handles = Layout { model, capacity: n as u32, training: false, statistics: false, storage: Storage::Exact }
        .declare(&mut g, false);
    let flags = g.external("flags", 4);
    let d = declare(gpu, &mut g, view, &handles, flags, Step::default());
    let into = g.external("grad_semantics", 4 * (WIDE * n) as u64);
    features_bwd(&mut g, &gpu.tuning(), &d.visible, &d.features, into).unwrap();
    let mut inputs = gaussian_inputs(scene, &handles);
    inputs.extend(d.inputs);
    inputs.extend([(flags, vec![0; 4]), (into, vec![0; 4 * WIDE * n])]);
    let out = gpu.run(g, &inputs);
    assert_eq!(out.get::<u32>(flags), [0], "the entries overflowed");
    (out.get(d.image), out.get(into))
}

/// Returns the largest error of required features at pixels that are not doubtful.
fn largest(found: &[f32], blended: &Blended) -> f64 {
    let mut largest = 0.0_f64;
    for (p, pixel) in found.chunks_exact(WIDE).enumerate().filter(|(p, _)| wants(*p) && !blended.doubtful[*p]) {
        let expected = &blended.image[p * (3 + WIDE) + 3..][..WIDE];
        for (x, y) in pixel.iter().zip(expected) {
            let difference = (f64::from(*x) - y).abs();
            largest = if difference.is_nan() { f64::INFINITY } else { largest.max(difference) };
        }
    }
    largest
}

/// Rendered features of hard splats match the reference.
///
/// Splats are anisotropic, huge, tiny and others. Pixels that require no features are not written. The image is linear
/// in the features, so expected gradients are sums of the reference's weights.
#[test]
fn features_of_hard_splats_match_reference() {
    check_hard(&Gpu::new());
}

/// The lanes sum the entries of every splat together.
#[test]
fn features_summed_by_all_lanes_match_reference() {
    check_hard(&Gpu::new().with_large_tiles(0));
}

fn check_hard(gpu: &Gpu) {
    for (seed, size) in [(1, [50, 37]), (2, [64, 48]), (3, [9, 50])] {
        let scene = scenes::with_semantics(scenes::hard(seed), seed + 7);
        let mut view = View::new(size, 0.0, seed + 3);
        let truth = render(&scene, &view.camera, 3, false, [0.0; 3]);
        for (p, weights) in view.weights.chunks_exact_mut(WIDE).enumerate() {
            if truth.doubtful[p] {
                weights.fill(0.0);
            }
        }
        let (image, gradient) = run(gpu, &scene, &view);
        let off = largest(&image, &truth);
        println!("seed {seed}: largest {off:.2e}");
        assert!(off < 2e-3, "seed {seed}: largest difference {off}");
        for (p, pixel) in image.chunks_exact(WIDE).enumerate() {
            let written = pixel.iter().any(|x| x.to_bits() != u32::MAX);
            assert_eq!(written, wants(p), "pixel {p}");
        }
        let mut expected = Vec::new();
        let mut one = scene.clone();
        for i in 0..scene.len() {
            // One Gaussian's first feature is one and all else zero, so the image holds its weights.
            one.semantics.fill(0.0);
            one.semantics[i * WIDE] = 1.0;
            let weights = render(&one, &view.camera, 3, false, [0.0; 3]).image;
            let mut sum = [0.0; WIDE];
            for (p, g) in view.weights.chunks_exact(WIDE).enumerate() {
                let w = weights[p * (3 + WIDE) + 3];
                sum.iter_mut().zip(g).for_each(|(s, g)| *s += w * g);
            }
            expected.extend(sum);
        }
        assert!(expected.iter().filter(|x| **x != 0.0).count() > 20 * WIDE);
        assert_close("gradients of features", &expected, &gradient, Tolerance::new(5e-3, 1e-3));
    }
}

#[test]
fn a_planted_error_is_caught() {
    let scene = scenes::with_semantics(scenes::hard(1), 8);
    let view = View::new([50, 37], 0.0, 4);
    let image = |g: &Gaussians| render(g, &view.camera, 3, false, [0.0; 3]);
    let mut moved = scene.clone();
    moved.semantics.iter_mut().step_by(WIDE).for_each(|x| *x += 0.02);
    let found: Vec<f32> = image(&moved).image.chunks_exact(3 + WIDE).flat_map(|p| &p[3..]).map(|x| *x as f32).collect();
    assert!(largest(&found, &image(&scene)) > 2e-3);
}

/// Initial value of the counter of skipped gradients.
const SKIPPED: u32 = 5;

/// Feature update fused with the sum of the gradients.
struct Fused {
    scene: Gaussians,
    view: View,
    moments: Vec<[f32; 2]>,
    /// Flags of dense Adam; Gaussians with flag 0 are left to another pass.
    seen: Option<Vec<u32>>,
    flag: u32,
}

impl Fused {
    fn new(seed: u64, dense: bool) -> Fused {
        let scene = scenes::with_semantics(scenes::ordinary(90, 0, false, seed), seed);
        let mut view = View::new([23, 30], 0.3, seed);
        // Features 5 and 6 have zero gradients everywhere, and the first 200 pixels have zero gradients.
        let weights = view.weights.iter_mut().enumerate();
        weights.filter(|(i, _)| [5, 6].contains(&(i % WIDE)) || i / WIDE < 200).for_each(|(_, w)| *w = 0.0);
        let n = scene.len();
        let mut r = Rng::new(seed);
        let mut moments: Vec<[f32; 2]> = (0..WIDE * n)
            .map(|_| {
                let (m, v) = (r.between(-0.1, 0.1) as f32, r.between(0.01, 0.2) as f32);
                [m, m * m + v * v]
            })
            .collect();
        moments.iter_mut().step_by(7).for_each(|m| *m = [0.0; 2]);
        let seen = dense.then(|| (0..n as u32).map(|i| i % 4 / 2).collect());
        Fused { scene, view, moments, seen, flag: 0 }
    }

    /// Runs the update and compares it with Adam on the gradients.
    ///
    /// Returns the numbers of scalars that moved, that had a zero gradient, and whose gradient was not finite.
    fn check(&self, gpu: &Gpu, halved: bool) -> [usize; 3] {
        let t = gpu.tuning();
        let n = self.scene.len();
        let rates = reference::Rates::at(2e-3, 4);
        let mut g = Graph::new("fused");
        let model = Model { semantics: true, ..Default::default() };
        let layout =
            Layout { model, capacity: n as u32 + 2, training: true, statistics: false, storage: Storage::Exact };
        let handles = layout.declare(&mut g, true);
        let flags = g.external("flags", 4);
        let values = Step {
            lr_semantics: rates.lr as f32,
            correction1: rates.correction1 as f32,
            correction2: rates.correction2 as f32,
            lr_means: f32::NAN,
            ..Default::default()
        };
        let d = declare(gpu, &mut g, &self.view, &handles, flags, values);
        let into = g.external("grad_semantics", 4 * (WIDE * n) as u64);
        features_bwd(&mut g, &t, &d.visible, &d.features, into).unwrap();
        let raised = g.input("raised", 4);
        let seen = self.seen.as_ref().map(|_| g.input("seen", 4 * n as u64));
        let moments = handles.moments.unwrap().semantics;
        let skipped = g.external("skipped", 4);
        let a = FeatureAdam { step: d.screen.step, flags: raised, moments, skipped, seen };
        features_bwd_adam(&mut g, &t, &handles, &d.visible, &d.features, &a).unwrap();
        let mut inputs = gaussian_inputs(&self.scene, &handles);
        inputs.extend(d.inputs);
        inputs.extend([(flags, vec![0; 4]), (into, vec![0; 4 * WIDE * n]), (raised, bytes(&[self.flag]))]);
        inputs.extend([(moments, bytes(&self.moments)), (skipped, bytes(&[SKIPPED]))]);
        inputs.extend(seen.zip(self.seen.as_ref()).map(|(b, s)| (b, bytes(s))));
        let out = gpu.run(g, &inputs);
        assert_eq!(out.get::<u32>(flags), [0], "the entries overflowed");

        let gradients = out.get::<f32>(into);
        let found = &out.get::<f32>(handles.semantics)[..WIDE * n];
        let found_moments = &out.get::<[f32; 2]>(moments)[..WIDE * n];
        let data = scenes::data(&self.scene);
        let visible = sgs_passes::reference::project::project(&self.scene, &self.view.camera, 0, false);
        let mut is_visible = vec![false; n];
        visible.iter().for_each(|s| is_visible[s.id] = true);
        let (mut counts, mut not_finite) = ([0; 2], 0);
        let (mut expected, mut expected_moments) = (Vec::new(), Vec::new());
        for (j, gradient) in gradients.iter().enumerate() {
            let (p, m) = (data.group(Group::Semantics)[j], self.moments[j]);
            let moves = match &self.seen {
                Some(seen) => is_visible[j / WIDE] && seen[j / WIDE] != 0,
                None => *gradient != 0.0,
            };
            let gradient = f64::from(*gradient) * if halved { 0.5 } else { 1.0 };
            counts[1] += usize::from(gradient == 0.0);
            not_finite += u32::from(self.flag == 0 && moves && !gradient.is_finite());
            if self.flag != 0 || !moves || !gradient.is_finite() {
                assert!((found[j], found_moments[j]) == (p, m), "scalar {j} was touched");
                expected.push(f64::from(p));
                expected_moments.extend(m.map(f64::from));
            } else {
                let (p, m) = reference::adam(f64::from(p), m.map(f64::from), gradient, rates);
                counts[0] += 1;
                expected.push(p);
                expected_moments.extend(m);
            }
        }
        assert_close("moments", &expected_moments, found_moments.as_flattened(), Tolerance::new(1e-7, 1e-5));
        assert_close("features", &expected, found, Tolerance::new(1e-4 * rates.lr, 2e-7));
        assert_eq!(out.get::<u32>(skipped), [SKIPPED + not_finite]);
        [counts[0], counts[1], not_finite as usize]
    }
}

#[test]
fn fused_feature_update_matches_adam() {
    check_fused(&Gpu::new());
}

/// The lanes sum the entries of every splat together.
#[test]
fn feature_update_by_all_lanes_matches_adam() {
    check_fused(&Gpu::new().with_large_tiles(0));
}

fn check_fused(gpu: &Gpu) {
    for dense in [false, true] {
        let [moved, still, bad] = Fused::new(11, dense).check(gpu, false);
        assert!(moved > 300 && still > 300, "{moved} moved, {still} had no gradient");
        assert_eq!(bad, 0);
    }
}

#[test]
fn raised_flag_leaves_features_unchanged() {
    let gpu = Gpu::new();
    for dense in [false, true] {
        Fused { flag: 4, ..Fused::new(12, dense) }.check(&gpu, false);
    }
}

#[test]
fn features_whose_gradients_are_not_finite_stay_as_they_are() {
    let gpu = Gpu::new();
    for dense in [false, true] {
        let mut case = Fused::new(13, dense);
        case.view.weights[400 * WIDE..].iter_mut().step_by(WIDE * 20).for_each(|w| *w = f64::NAN);
        let [moved, _, bad] = case.check(&gpu, false);
        assert!(moved > 300 && bad > 10, "{moved} moved, {bad} were not finite");
    }
}

#[test]
#[should_panic(expected = "moments: element")]
fn lost_half_of_the_gradient_is_detected() {
    Fused::new(11, false).check(&Gpu::new(), true);
}
