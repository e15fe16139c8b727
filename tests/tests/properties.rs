//! Pictures and training steps of Gaussians whose every number is drawn log-uniformly, against the double-precision twin. What
//! fails is shrunk. The numbers are the same every time; `SGS_TEST_CASES` asks for more of them.

use glam::{DMat3, DVec2, DVec3};
use proptest::prelude::*;
use proptest::strategy::ValueTree;
use proptest::test_runner::{Config, RngAlgorithm, TestCaseError, TestRng, TestRunner};
use sgs_passes::reference::blend::render;
use sgs_passes::reference::project::{Camera, Gaussians};
use sgs_tests::whole::{BACKGROUND, picture, steps};
use sgs_tests::{Gpu, scenes};

/// Largest difference where the twin is sure, of the largest color that there is.
const LARGEST: f64 = 2e-3;

fn runner(cases: u32) -> TestRunner {
    let asked = std::env::var("SGS_TEST_CASES").ok().and_then(|n| n.parse().ok());
    let config = Config { cases: asked.unwrap_or(cases), failure_persistence: None, ..Config::default() };
    TestRunner::new_with_rng(config, TestRng::deterministic_rng(RngAlgorithm::ChaCha))
}

/// A number of either sign whose magnitude is log-uniform between two powers of ten.
fn spread(low: f64, high: f64) -> impl Strategy<Value = f64> {
    (low..high, any::<bool>()).prop_map(|(power, minus)| {
        let size = f64::from(10_f64.powf(power) as f32);
        if minus { -size } else { size }
    })
}

#[derive(Clone, Debug)]
struct One {
    depth: f64,
    across: [f64; 2],
    log_scale: [f64; 3],
    rotation: [f64; 4],
    logit: f64,
    color: [f64; 3],
}

prop_compose! {
    fn gaussian()(
        depth in -2.5..5.0_f64,
        across in [-1.2..1.2_f64, -1.2..1.2_f64],
        log_scale in [-20.0..18.0_f64, -20.0..18.0_f64, -20.0..18.0_f64],
        rotation in [spread(-20.0, 17.0), spread(-20.0, 17.0), spread(-20.0, 17.0), spread(-20.0, 17.0)],
        logit in -30.0..30.0_f64,
        color in [-1.5..1.5_f64, -1.5..1.5_f64, -1.5..1.5_f64],
    ) -> One {
        One { depth: 10_f64.powf(depth), across, log_scale, rotation, logit, color }
    }
}

prop_compose! {
    fn scene()(
        all in prop::collection::vec(gaussian(), 1..12),
        size in [1..40_u32, 1..40_u32],
        width in 1.0..170.0_f64,
        turn in [-3.0..3.0_f64, -1.5..1.5_f64, -3.0..3.0_f64],
        away in [spread(-3.0, 2.0), spread(-3.0, 2.0), spread(-3.0, 2.0)],
    ) -> (Gaussians, Camera) {
        place(&all, size, width, turn, away)
    }
}

/// A camera somewhere, turned somehow, and the Gaussians before it.
fn place(all: &[One], size: [u32; 2], width: f64, turn: [f64; 3], away: [f64; 3]) -> (Gaussians, Camera) {
    let single = |v: f64| f64::from(v as f32);
    let focal = single(0.5 * f64::from(size[0]) / (0.5 * width.to_radians()).tan());
    let rotation = DMat3::from_euler(glam::EulerRot::XYZ, turn[0], turn[1], turn[2]);
    // As the GPU has it.
    let rotation = DMat3::from_cols_array(&rotation.to_cols_array().map(single));
    let half = 0.5 * f64::from(size[0].max(size[1])) / focal;
    let camera = Camera {
        rotation,
        translation: DVec3::from_array(away.map(single)),
        focal: DVec2::splat(focal),
        center: DVec2::new(0.5 * f64::from(size[0]), 0.5 * f64::from(size[1])),
        size,
        near: f64::from(0.01_f32),
    };
    let mut g = Gaussians::default();
    for one in all {
        let seen = DVec3::new(one.across[0] * half * one.depth, one.across[1] * half * one.depth, one.depth);
        let mean = rotation.inverse() * (seen - camera.translation);
        g.means.extend(mean.to_array().map(single));
        g.log_scales.extend(one.log_scale.map(single));
        g.rotations.extend(one.rotation.map(single));
        g.opacity_logits.push(single(one.logit));
        g.sh[0].extend(one.color.map(single));
    }
    (g, camera)
}

/// Whether positions in single precision move a center by more than a thousandth of a pixel: then only double precision
/// knows where it is.
fn blurred(g: &Gaussians, camera: &Camera) -> bool {
    g.means.chunks_exact(3).any(|m| {
        let mean = DVec3::from_slice(m);
        let depth = (camera.rotation * mean + camera.translation).z.max(camera.near);
        let size = mean.length() + camera.translation.length();
        camera.focal.x * f64::from(f32::EPSILON) * size / depth > 1e-3
    })
}

#[test]
fn pictures_agree_with_the_twin() {
    let gpu = Gpu::new();
    let (mut sure, mut all, mut seen, mut clear) = (0, 0, 0, 0);
    let result = runner(96).run(&scene(), |(g, camera)| {
        let (image, transmittance) = picture(&gpu, &g, &camera).map_err(|e| TestCaseError::fail(e.to_string()))?;
        prop_assert!(image.iter().chain(&transmittance).all(|v| v.is_finite()));
        if blurred(&g, &camera) {
            return Ok(());
        }
        let truth = render(&g, &camera, 0, false, BACKGROUND);
        for (p, found) in image.chunks_exact(3).enumerate().filter(|(p, _)| !truth.doubtful[*p]) {
            for (c, found) in found.iter().enumerate() {
                let off = (f64::from(*found) - truth.image[3 * p + c]).abs();
                prop_assert!(off < LARGEST, "pixel {} is off by {}", p, off);
            }
        }
        Ok(())
    });
    result.unwrap_or_else(|e| panic!("{e}"));
    // That there is something to compare.
    let mut look = runner(96);
    for _ in 0..96 {
        let (g, camera) = scene().new_tree(&mut look).unwrap().current();
        let truth = render(&g, &camera, 0, false, BACKGROUND);
        clear += u32::from(!blurred(&g, &camera));
        sure += truth.doubtful.iter().filter(|d| !**d).count();
        seen += truth.transmittance.iter().filter(|t| **t < 1.0).count();
        all += truth.doubtful.len();
    }
    assert!(clear > 48, "{clear} of 96 scenes are compared");
    assert!(sure > all * 9 / 10 && seen > all / 10, "of {all} pixels {sure} are sure and {seen} show anything");
}

#[test]
fn steps_leave_finite_parameters() {
    let gpu = Gpu::new();
    let result = runner(32).run(&scene(), |(g, camera)| {
        let (reports, after) = steps(&gpu, &g, &camera, 2).map_err(|e| TestCaseError::fail(e.to_string()))?;
        prop_assert!(reports.iter().all(|r| r.losses.total.is_finite() && r.skipped == 0), "{:?}", reports);
        let before = scenes::data(&g);
        for (old, new) in before.groups.iter().zip(&after.groups) {
            prop_assert!(new.iter().all(|v| v.is_finite()), "{:?} became {:?}", old, new);
        }
        Ok(())
    });
    result.unwrap_or_else(|e| panic!("{e}"));
}

/// What is wrong is found, and made small: of many Gaussians one that shows is enough.
#[test]
fn failures_are_found_and_shrunk() {
    let result = runner(96).run(&scene(), |(g, camera)| {
        let shown = render(&g, &camera, 0, false, BACKGROUND).transmittance.iter().any(|t| *t < 0.5);
        prop_assert!(!shown);
        Ok(())
    });
    let Err(proptest::test_runner::TestError::Fail(_, (g, _))) = result else { panic!("nothing was found") };
    assert!(g.len() <= 2, "{} Gaussians are left", g.len());
}
