//! Traced visibility on the device against the product over all Gaussians.

use proptest::prelude::*;
use sgs_engine::graph::Graph;
use sgs_passes::reference::rng::Pcg;
use sgs_passes::reference::traced::{self as reference, Splat, V3};
use sgs_passes::shade::lights::{Axes, LightModel, Lights, Shape, lights, lights_prepare};
use sgs_passes::shade::traced::{TracedTree, lights_traced, visibility_traced};
use sgs_tests::drawn::{runner, signed};
use sgs_tests::lit::{Lit, SPARE, narrow};
use sgs_tests::splats::{doubt, random_splats, splat_data};
use sgs_tests::{Gpu, Tolerance, assert_close, worst};

/// Distance of ray origins above surfaces; exact in 32 bits.
const OFFSET: f32 = 0.015625;

struct Found {
    visibility: Vec<f32>,
    traced: Vec<f32>,
    plain: Vec<f32>,
}

fn run(gpu: &Gpu, case: &Lit, splats: &[Splat]) -> Found {
    let tuning = gpu.tuning();
    let tree = TracedTree::new(&splat_data(splats)).unwrap();
    let mut g = Graph::new("traced");
    let size = case.size.map(|s| s as u32);
    let mut bound = case.bind(&mut g, size);
    let pixels = bound.pixels;
    let n = case.pixels.len() as u64;
    let traced = tree.declare(&mut g, OFFSET);
    bound.inputs.extend(tree.contents(&traced));
    let count = case.raw.model.lights;
    let visibility = g.external("visibility", 4 * n * u64::from(count));
    let places = (bound.parameters.positions, count);
    visibility_traced(&mut g, &tuning, &pixels.screen, &pixels.surfaces, &traced, places, visibility).unwrap();
    let step = pixels.screen.step;
    let model = case.raw.model;
    let prepared = lights_prepare(&mut g, tuning, "prepare", step, model, &bound.parameters, None).unwrap();
    let shape = Shape::for_device(tuning);
    let what = Lights { pixels, prepared, normalizer: case.normalizer() as f32, shape };
    let room = n + SPARE as u64;
    let [direct, plain] = ["direct", "plain"].map(|name| g.external(name, 12 * room));
    lights_traced(&mut g, &what, &traced, direct).unwrap();
    lights(&mut g, &what, plain).unwrap();
    let out = gpu.run(g, &bound.inputs);
    let cut = |buffer| out.get::<f32>(buffer)[..3 * n as usize].to_vec();
    Found { visibility: out.get(visibility), traced: cut(direct), plain: cut(plain) }
}

fn case(size: [usize; 2], lights: u32, seed: u32) -> Lit {
    Lit::random(size, LightModel { lights, lobes: 3, axes: Axes::default() }, false, seed)
}

#[test]
fn visibility_is_the_product_over_all_gaussians() {
    let gpu = Gpu::new();
    for (count, seed) in [(0, 1), (1, 2), (7, 3), (60, 4), (3000, 5)] {
        let mut c = case([9, 5], 4, seed);
        c.pixels[3].coverage = 0.0;
        let splats = random_splats(count, seed);
        let found = run(&gpu, &c, &splats);
        let (mut hidden, mut doubtful) = (0, 0);
        for (i, p) in c.pixels.iter().enumerate() {
            for l in 0..4 {
                let is = f64::from(found.visibility[l * c.pixels.len() + i]);
                if p.coverage == 0.0 {
                    assert_eq!(is, 0.0);
                    continue;
                }
                let from = std::array::from_fn(|k| p.point[k] + f64::from(OFFSET) * p.normal[k]);
                let to = std::array::from_fn(|k| c.raw.positions[3 * l + k]);
                let (right, doubt) = (reference::transmittance(&splats, from, to), doubt(&splats, from, to));
                assert!((is - right).abs() < 3e-4 + doubt, "{count}: pixel {i}, light {l}: {right} {is} ({doubt})");
                hidden += usize::from(right < 0.9);
                doubtful += usize::from(doubt > 0.0);
            }
        }
        assert!(doubtful < 40, "{doubtful}");
        assert!(count < 60 || hidden > 20, "{hidden}");
        if count == 0 {
            assert_eq!(found.traced, found.plain);
        }
    }
}

#[test]
fn occluders_attenuate_lights() {
    let gpu = Gpu::new();
    // Radiance under a single light is unoccluded radiance times visibility.
    let c = case([8, 7], 1, 11);
    let found = run(&gpu, &c, &random_splats(200, 12));
    let right: Vec<f64> =
        found.plain.iter().enumerate().map(|(i, x)| f64::from(*x) * f64::from(found.visibility[i / 3])).collect();
    assert_close("direct", &right, &found.traced, Tolerance::new(1e-7, 1e-5));
    // Some pixels are dimmed, and a comparison with unoccluded radiance fails.
    let plain: Vec<f64> = found.plain.iter().map(|x| f64::from(*x)).collect();
    assert!(worst(&plain, &found.traced, Tolerance::new(1e-7, 1e-5)).unwrap().3 > 1.0);
}

#[test]
fn a_surface_does_not_shadow_itself_but_a_wall_does() {
    let gpu = Gpu::new();
    let mut c = case([8, 8], 2, 21);
    // Points lie on a floor of sheets that is thicker than the offset. One light is above, and one is behind a wall.
    for (i, p) in c.pixels.iter_mut().enumerate() {
        p.point = [0.1 * (i % 8) as f64 - 0.35, 0.1 * (i / 8) as f64 - 0.35, 0.0].map(narrow);
        p.normal = [0.0, 0.0, 1.0];
    }
    c.raw.positions = [0.1, 0.0, 1.0, 3.0, 0.0, 0.5].map(narrow).to_vec();
    let sheet = |mean: V3, log_scale: V3| Splat {
        mean: mean.map(narrow),
        log_scale: log_scale.map(narrow),
        rotation: [1.0, 0.0, 0.0, 0.0],
        opacity_logit: 3.0,
    };
    let mut splats = Vec::new();
    for x in -12..13 {
        for y in -12..13 {
            splats.push(sheet([0.05 * f64::from(x), 0.05 * f64::from(y), 0.0], [-3.0, -3.0, -4.0]));
            splats.push(sheet([1.2, 0.05 * f64::from(x), 0.05 * f64::from(y)], [-5.0, -3.0, -3.0]));
        }
    }
    let found = run(&gpu, &c, &splats);
    let (above, beyond) = found.visibility.split_at(64);
    assert!(above.iter().all(|v| *v > 0.995), "{above:?}");
    assert!(beyond.iter().all(|v| *v < 0.02), "{beyond:?}");
}

#[test]
fn invisible_gaussians_are_not_in_the_bvh() {
    let mut splats = random_splats(50, 31);
    let visible = |s: &&Splat| 1.0 / (1.0 + (-s.opacity_logit).exp()) >= 1.0 / 255.0;
    assert_eq!(TracedTree::new(&splat_data(&splats)).unwrap().splats(), splats.iter().filter(visible).count());
    splats[0].mean[1] = f64::NAN;
    splats[1].log_scale[2] = f64::NAN;
    splats[2].opacity_logit = f64::NAN;
    splats[3].log_scale[0] = f64::NEG_INFINITY;
    splats[4].log_scale[1] = f64::INFINITY;
    splats[5].opacity_logit = f64::INFINITY;
    assert_eq!(TracedTree::new(&splat_data(&splats)).unwrap().splats(), splats[6..].iter().filter(visible).count());
    // Many coincident Gaussians still form a tree.
    let heap = vec![Splat { opacity_logit: 1.0, ..random_splats(1, 1)[0] }; 5000];
    assert_eq!(TracedTree::new(&splat_data(&heap)).unwrap().splats(), 5000);
}

/// Perturbs values by up to a few units in the last place of `size`.
fn jitter(rng: &mut Pcg, v: &mut [f64], size: f64) {
    v.iter_mut().for_each(|x| *x += 4e-7 * size * rng.range(-1.0, 1.0));
}

/// Returns four times the reference's largest change under perturbed inputs.
fn slack(splats: &[Splat], from: V3, to: V3, right: f64) -> f64 {
    let mut rng = Pcg::new(9);
    let length = |v: &[f64]| v.iter().map(|x| x * x).sum::<f64>().sqrt();
    let moved = (0..8).map(|_| {
        let (mut from, mut to) = (from, to);
        let size = length(&from) + length(&to);
        jitter(&mut rng, &mut from, size);
        jitter(&mut rng, &mut to, size);
        let other = |s: &Splat| {
            let mut s = *s;
            let sizes = [length(&s.rotation), length(&s.mean)];
            jitter(&mut rng, &mut s.rotation, sizes[0]);
            jitter(&mut rng, &mut s.mean, sizes[1]);
            jitter(&mut rng, &mut s.log_scale, 4.0);
            s
        };
        let splats: Vec<Splat> = splats.iter().map(other).collect();
        (reference::transmittance(&splats, from, to) - right).abs()
    });
    4.0 * moved.fold(0.0, f64::max)
}

/// Draws Gaussians over a wide range. Scales are e^-17 to e^9, quaternions have any length, and positions are near and
/// far.
fn drawn() -> impl Strategy<Value = Splat> {
    let axis = || prop_oneof![4 => signed(-3.0, 0.3), 1 => signed(0.3, 4.0)];
    (
        [axis(), axis(), axis()],
        [-17.0..9.0_f64, -17.0..9.0_f64, -17.0..9.0_f64],
        [signed(-18.0, 16.0), signed(-18.0, 16.0), signed(-18.0, 16.0), signed(-18.0, 16.0)],
        -12.0..30.0_f64,
    )
        .prop_map(|(mean, log_scale, rotation, opacity_logit)| Splat {
            mean: mean.map(narrow),
            log_scale: log_scale.map(narrow),
            rotation: rotation.map(narrow),
            opacity_logit: narrow(opacity_logit),
        })
}

/// Tests random Gaussians. Draws are the same in every run; `SGS_TEST_CASES` sets their number.
#[test]
fn rays_through_random_gaussians_match_reference() {
    let gpu = Gpu::new();
    let c = case([6, 3], 3, 31);
    let counts = std::cell::Cell::new([0, 0, 0]);
    let result = runner(64).run(&prop::collection::vec(drawn(), 1..40), |splats| {
        let found = run(&gpu, &c, &splats);
        for (i, p) in c.pixels.iter().enumerate() {
            for l in 0..3 {
                let is = f64::from(found.visibility[l * c.pixels.len() + i]);
                let from = std::array::from_fn(|k| p.point[k] + f64::from(OFFSET) * p.normal[k]);
                let to = std::array::from_fn(|k| c.raw.positions[3 * l + k]);
                let right = reference::transmittance(&splats, from, to);
                let slack = 3e-4 + doubt(&splats, from, to) + slack(&splats, from, to, right);
                prop_assert!((is - right).abs() <= slack, "pixel {}, light {}: {} is {} to {}", i, l, right, is, slack);
                let [all, hidden, sure] = counts.get();
                counts.set([all + 1, hidden + u32::from(right < 0.9), sure + u32::from(slack < 1e-2)]);
            }
        }
        Ok(())
    });
    result.unwrap_or_else(|e| panic!("{e}"));
    let [all, hidden, sure] = counts.get();
    assert!(hidden > all / 20 && sure > all / 2, "of {all} rays {hidden} are hidden and {sure} are sure");
}
