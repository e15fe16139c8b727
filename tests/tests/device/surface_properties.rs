//! Surfaces, weight matrices and materials of random Gaussians. They are tested against the reference in double
//! precision. Every number is drawn log-uniformly, and failures are shrunk. Draws are the same in every run;
//! `SGS_TEST_CASES` sets their number.
//!
//! The tolerance for single precision is measured. Gaussians are perturbed by some units in the last place, and the
//! change of the reference is the tolerance.

use glam::DVec3;
use proptest::prelude::*;
use sgs_passes::reference::blend::render;
use sgs_passes::reference::gbuffer::{Materials, gbuffer, stored_rows, weights};
use sgs_passes::reference::project::{Camera, Gaussians, project};
use sgs_passes::reference::rng::Pcg;
use sgs_tests::drawn::scenes::{blurred, rounded, scene};
use sgs_tests::drawn::{log_uniform, runner};
use sgs_tests::gbuffer::{Case, Found, ROOM, run};
use sgs_tests::lit::narrow;
use sgs_tests::{Gpu, scenes};

/// Tolerance of a pixel's coverage, besides the effect of rounding of Gaussians.
const COVERAGE: f64 = 3e-6;
/// Tolerance of a sum of a few terms in 32 bits, relative to its magnitude.
const SUM: f64 = 1e-6;

prop_compose! {
    /// Draws normals, raw materials and gradients of either sign and any magnitude.
    fn case()(
        (scene, camera) in scene(),
        seed in any::<u32>(),
        metals in any::<bool>(),
        bits in prop_oneof![Just(32_u32), Just(16)],
    ) -> Case {
        let mut rng = Pcg::new(seed);
        let mut many = |count: usize, powers: [f64; 2]| -> Vec<f64> {
            let mut one = || {
                let size = log_uniform(&mut rng, powers);
                narrow(if rng.uniform() < 0.5 { -size } else { size })
            };
            (0..count).map(|_| one()).collect()
        };
        let (n, pixels) = (scene.len(), (camera.size[0] * camera.size[1]) as usize);
        let normals = many(3 * n, [-9.0, 9.0]);
        // Beyond 80 in either direction, a sigmoid equals its limit.
        let raw = [-3.0, 1.9];
        let metallic = if metals { many(n, raw) } else { vec![] };
        let raw = Materials { albedo: many(3 * n, raw), roughness: many(n, raw), metallic, albedo_range: [0.01, 0.98] };
        let gradient = many(5 * pixels, [-8.0, 8.0]).chunks(5).map(|g| [g[0], g[1], g[2], g[3], g[4]]).collect();
        // Distortion is removed from photographs before surfaces are made.
        let camera = Camera { radial: 0.0, ..camera };
        Case { scene: Gaussians { normals, ..scene }, camera, raw, gradient, room: ROOM, bits }
    }
}

/// The reference's results for every pixel.
struct Truth {
    points: Vec<DVec3>,
    normals: Vec<DVec3>,
    coverage: Vec<f64>,
    rows: Vec<Vec<(usize, f64)>>,
    materials: Vec<[f64; 5]>,
    doubtful: Vec<bool>,
}

fn truth(case: &Case, scene: &Gaussians) -> Truth {
    let blended = render(scene, &case.camera, 0, true, [0.0; 3]);
    let surfaces = gbuffer(&case.camera, &blended, 8);
    let rows = weights(&project(scene, &case.camera, 0, true), case.camera.size);
    let materials = case.raw.blend(&rows);
    Truth {
        points: surfaces.points,
        normals: surfaces.normals,
        coverage: surfaces.coverage,
        rows,
        materials,
        doubtful: blended.doubtful,
    }
}

/// Returns each Gaussian's weighted gradients, before slopes. Each comes with the sum of magnitudes.
fn gathered(case: &Case, rows: &[Vec<(usize, f64)>]) -> Vec<[[f64; 2]; 5]> {
    let mut sums = vec![[[0.0; 2]; 5]; case.scene.len()];
    for (row, gradient) in rows.iter().zip(&case.gradient) {
        for (i, w) in row {
            for (sum, g) in sums[*i].iter_mut().zip(gradient) {
                sum[0] += w * g;
                sum[1] += w * g.abs();
            }
        }
    }
    sums
}

/// Returns the derivatives of materials with respect to raw ones. The derivative of the sigmoid avoids differences of
/// nearly equal numbers.
fn slopes(raw: &Materials, i: usize) -> [f64; 5] {
    let slope = |x: f64| 1.0 / ((1.0 + (-x).exp()) * (1.0 + x.exp()));
    let [r, g, b] = [0, 1, 2].map(|c| raw.albedo_range[1] * slope(raw.albedo[3 * i + c]));
    [r, g, b, 0.9 * slope(raw.roughness[i]), raw.metallic.get(i).map_or(0.0, |x| slope(*x))]
}

/// Zeroes the gradients of inconclusive pixels. Returns the case, the reference's results, and those after simulated
/// rounding.
fn prepared(mut case: Case) -> (Case, Truth, Vec<Truth>) {
    let mut sure = truth(&case, &case.scene);
    let others: Vec<Truth> = (0..4).map(|way| truth(&case, &rounded(&case.scene, &case.camera, way))).collect();
    let seen = |row: &[(usize, f64)]| row.iter().map(|e| e.0).collect::<Vec<_>>();
    for p in 0..sure.rows.len() {
        sure.doubtful[p] |= others.iter().any(|o| o.doubtful[p] || seen(&o.rows[p]) != seen(&sure.rows[p]));
        if sure.doubtful[p] {
            case.gradient[p] = [0.0; 5];
        }
    }
    (case, sure, others)
}

/// Returns the quantization step of weights, zero for 32 bits.
fn part(case: &Case) -> f64 {
    if case.bits == 16 { 1.0 / 65535.0 } else { 0.0 }
}

/// Compares points, normals, the matrix and materials. Returns the number of compared pixels.
fn check_pixels(case: &Case, sure: &Truth, others: &[Truth], found: &Found) -> Result<usize, TestCaseError> {
    prop_assert_eq!(found.flags, 0);
    let origin = case.camera.rotation.transpose() * case.camera.translation;
    let normal = |i: usize| {
        let n = DVec3::from_slice(&case.scene.normals[3 * i..]);
        n / n.length().max(1e-3)
    };
    let mut compared = 0;
    for (p, row) in sure.rows.iter().enumerate() {
        let range = found.row(p);
        let all = found.points[p].iter().chain(&found.normals[p]).chain(&found.materials[p]);
        prop_assert!(all.chain(&found.weights[range.clone()]).all(|v| v.is_finite()), "pixel {}", p);
        let sum: f64 = found.weights[range.clone()].iter().map(|w| f64::from(*w)).sum();
        prop_assert!(range.is_empty() || (sum - 1.0).abs() < 1e-4, "weights of pixel {} add up to {}", p, sum);
        if sure.doubtful[p] {
            continue;
        }
        compared += 1;
        let columns: Vec<usize> = found.columns[range.clone()].iter().map(|c| *c as usize).collect();
        prop_assert_eq!(columns, row.iter().map(|e| e.0).collect::<Vec<_>>(), "pixel {}", p);
        let near = |what: &str, found: f32, of: &dyn Fn(&Truth) -> f64, slack: f64| {
            let expected = of(sure);
            let slack = slack + 4.0 * others.iter().map(|o| (of(o) - expected).abs()).fold(0.0, f64::max);
            let off = (f64::from(found) - expected).abs();
            prop_assert!(off <= slack, "{} of pixel {} is {} and not {}, to {}", what, p, found, expected, slack);
            Ok(())
        };
        near("coverage", found.coverage[p], &|t| t.coverage[p], COVERAGE)?;
        if row.is_empty() {
            prop_assert_eq!((found.points[p], found.normals[p]), ([0.0; 3], [0.0; 3]));
            prop_assert_eq!(found.materials[p], [0.0; 4]);
            continue;
        }
        let share = COVERAGE / sure.coverage[p];
        for (k, w) in found.weights[range].iter().enumerate() {
            near("a weight", *w, &|t| t.rows[p][k].1, share + part(case))?;
        }
        let away = (sure.points[p] + origin).length();
        let beside = 3.0 * share * away + 1e-6 * (origin.length() + sure.points[p].length());
        // Opposing normals may nearly cancel.
        let sum: DVec3 = row.iter().map(|(i, w)| *w * normal(*i)).sum();
        let size: f64 = row.iter().map(|(i, w)| w * normal(*i).length()).sum();
        let turned = (3.0 * share + SUM) * size / sum.length().max(1e-30);
        for c in 0..3 {
            near("the point", found.points[p][c], &|t| t.points[p][c], beside)?;
            near("the normal", found.normals[p][c], &|t| t.normals[p][c], turned)?;
        }
        let parts = part(case) * (row.len() as f64 + 1.0);
        let metallic = found.metallic.get(p);
        for (c, found) in found.materials[p].iter().chain(metallic).enumerate() {
            near("a material", *found, &|t| t.materials[p][c], share + SUM + parts)?;
        }
    }
    Ok(compared)
}

/// Compares the gradients of raw materials.
fn check_gradients(case: &Case, sure: &Truth, others: &[Truth], found: &Found) -> Result<(), TestCaseError> {
    let retained = |t: &Truth| if case.bits == 16 { stored_rows(&t.rows) } else { t.rows.clone() };
    let here = gathered(case, &retained(sure));
    let moved: Vec<_> = others.iter().map(|t| gathered(case, &retained(t))).collect();
    // The tolerance is each weight's error, relative to its pixel, times the pixel's gradient.
    let mut slack = vec![[0.0; 5]; here.len()];
    let mut most = 1.0_f64;
    for ((row, coverage), gradient) in sure.rows.iter().zip(&sure.coverage).zip(&case.gradient) {
        for (i, _) in row {
            for (slack, g) in slack[*i].iter_mut().zip(gradient) {
                *slack += (COVERAGE / coverage + part(case)) * g.abs();
                most = most.max(g.abs());
            }
        }
    }
    for (i, sums) in here.iter().enumerate() {
        let metallic = found.grad_metallic.get(i);
        let found = found.grad_albedo[3 * i..][..3].iter().chain(&found.grad_roughness[i..][..1]).chain(metallic);
        for (c, (found, slope)) in found.zip(slopes(&case.raw, i)).enumerate() {
            let [sum, size] = sums[c];
            let rounding = moved.iter().map(|m| (m[i][c][0] - sum).abs()).fold(0.0, f64::max);
            // The sigmoid's exponential adds an error, and tiny results underflow in 32 bits.
            let slack = slope * (slack[i][c] + 4.0 * rounding + SUM * size + 1e-4 * sum.abs()) + 1e-37 * most;
            let (found, expected) = (f64::from(*found), slope * sum);
            let off = (found - expected).abs();
            prop_assert!(off <= slack, "gradient {} of {} is {} and not {}, to {}", c, i, found, expected, slack);
        }
    }
    Ok(())
}

fn check(case: &Case, sure: &Truth, others: &[Truth], found: &Found) -> Result<usize, TestCaseError> {
    prop_assert!(found.metallic.is_empty() == case.raw.metallic.is_empty());
    prop_assert!(found.grad_metallic.is_empty() == case.raw.metallic.is_empty());
    check_gradients(case, sure, others, found)?;
    check_pixels(case, sure, others, found)
}

#[test]
fn surfaces_weights_and_materials_match_reference() {
    let gpu = Gpu::new();
    let counts = std::cell::Cell::new([0; 4]);
    let result = runner(96).run(&case(), |case| {
        if blurred(&case.scene, &case.camera) {
            return Ok(());
        }
        let (case, sure, others) = prepared(case);
        let compared = check(&case, &sure, &others, &run(&gpu, &case))?;
        let seen = sure.rows.iter().zip(&sure.doubtful).filter(|(r, d)| !r.is_empty() && !**d).count();
        let [cases, all, sure_, visible] = counts.get();
        counts.set([cases + 1, all + sure.rows.len(), sure_ + compared, visible + seen]);
        Ok(())
    });
    result.unwrap_or_else(|e| panic!("{e}"));
    let [cases, all, compared, visible] = counts.get();
    println!("{cases} scenes; of {all} pixels {compared} were compared, {visible} of which show something");
    assert!(cases > 48 && compared > all / 2 && visible > all / 10, "{:?}", counts.get());
}

/// Tests that an error of 1 % in each kind of number is detected.
#[test]
fn checks_of_surfaces_can_fail() {
    let gpu = Gpu::new();
    let case = Case::new(scenes::ordinary(20, 0, true, 7), scenes::camera([24, 18]), true, 2.0);
    let (case, sure, others) = prepared(case);
    let fresh = || run(&gpu, &case);
    assert!(check(&case, &sure, &others, &fresh()).is_ok_and(|n| n > 200));
    let p = (0..sure.rows.len()).find(|p| !sure.doubtful[*p] && sure.coverage[*p] > 0.5).unwrap();
    let largest = |v: &[f32]| (0..v.len()).fold(0, |m, i| if v[i].abs() > v[m].abs() { i } else { m });
    let up = |v: &mut [f32]| v[largest(v)] *= 1.01;
    let change = |f: &mut Found, name: &str| match name {
        "points" => up(&mut f.points[p]),
        "normals" => up(&mut f.normals[p]),
        "coverage" => f.coverage[p] *= 1.01,
        "weights" => {
            let row = f.row(p);
            up(&mut f.weights[row])
        }
        "materials" => up(&mut f.materials[p]),
        "metallic" => f.metallic[p] *= 1.01,
        "albedo" => up(&mut f.grad_albedo),
        "roughness" => up(&mut f.grad_roughness),
        _ => up(&mut f.grad_metallic),
    };
    let names =
        ["points", "normals", "coverage", "weights", "materials", "metallic", "albedo", "roughness", "by metallic"];
    for name in names {
        let mut wrong = fresh();
        change(&mut wrong, name);
        assert!(check(&case, &sure, &others, &wrong).is_err(), "{name}");
    }
}
