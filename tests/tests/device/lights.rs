//! Shading under lights on a device against the reference and its differences.

use sgs_passes::reference::brdf::unit;
use sgs_passes::reference::lights as reference;
use sgs_passes::shade::lights::{Axes, LightModel, Perturbation, Shape};
use sgs_tests::lit::{BEFORE, Found, Lit, run, run_culled};
use sgs_tests::{Gpu, Tolerance, assert_close};

/// Returns dispatch shapes of other devices.
///
/// They are small, so that CPUs compile them quickly.
fn shapes(gpu: &Gpu) -> [Shape; 2] {
    let own = Shape::for_device(gpu.tuning());
    [Shape { per_lane: 2, spread: false, ..own }, Shape { per_lane: 3, spread: true, ..own }]
}

/// Computes the root mean square.
fn scale(x: &[f64]) -> f64 {
    (x.iter().map(|x| x * x).sum::<f64>() / x.len().max(1) as f64).sqrt()
}

/// Checks radiance and material gradients of a case against the reference.
///
/// Errors are at most `relative` times a value, or 1 % of `relative` times the root mean square of all values.
fn check_pixels(gpu: &Gpu, shapes: &[Shape], case: &Lit, largest: [u32; 2], relative: f64) {
    let lights = case.lights();
    let [diffuse, specular] = reference::lights(&case.pixels, &lights, case.camera, case.normalizer());
    let whole: Vec<f64> = diffuse.iter().zip(&specular).map(|(d, s)| d + s).collect();
    let bwd = reference::lights_materials_bwd(&case.pixels, &lights, case.camera, case.normalizer(), &case.gradient);
    let normals =
        reference::lights_normals_bwd(&case.pixels, &lights, case.camera, case.normalizer(), &case.gradient).concat();
    for &shape in shapes {
        let found = run(gpu, shape, case, largest, None);
        let tolerance = |x: &[f64]| Tolerance::new(1e-2 * relative * scale(x) + 1e-30, relative);
        // Without a normal, the reference's differences include every light that a step faces. The kernel's gradient is
        // zero.
        let bent = |(i, g): (usize, &f64)| if case.pixels[i / 3].normal == [0.0; 3] { 0.0 } else { *g };
        let normals: Vec<f64> = normals.iter().enumerate().map(bent).collect();
        // At the center of the sharpest highlight, the relative error is the rounding of the half vector over its
        // width: 1e-7 over 1e-3.
        let t = Tolerance::new(1e-4 * scale(&normals) + 1e-20, 1e-3);
        assert_close("gradient of normals", &normals, &found.normals, t);
        assert_close("radiance", &whole, &found.direct, tolerance(&whole));
        assert_close("diffuse", &diffuse, &found.split[1], tolerance(&diffuse));
        for i in 0..4 {
            let expected: Vec<f64> = bwd.iter().map(|b| b[i]).collect();
            let gradient: Vec<f32> = (0..bwd.len()).map(|p| found.materials[4 * p + i]).collect();
            check_added(&format!("gradient {i} of materials"), &expected, &gradient, tolerance(&expected));
        }
        if case.metallic {
            let expected: Vec<f64> = bwd.iter().map(|b| b[4]).collect();
            check_added("gradient of metallic", &expected, &found.metallic, tolerance(&expected));
        } else {
            assert!(found.metallic.iter().all(|&x| x == BEFORE));
        }
    }
}

/// Checks light gradients against differences of the reference.
///
/// `relative` is that of [`check_pixels`], applied to each kind of parameter separately.
fn check_lights(gpu: &Gpu, shapes: &[Shape], case: &Lit, largest: [u32; 2], relative: f64) {
    let expected = reference::lights_bwd(&case.raw, &case.pixels, case.camera, case.normalizer(), &case.gradient);
    let row = case.raw.model.row() as usize;
    for &shape in shapes {
        let found = run(gpu, shape, case, largest, None);
        let tolerance = |x: &[f64]| Tolerance::new(1e-2 * relative * scale(x) + 1e-20, relative);
        assert_close("positions", &expected.positions, &found.positions, tolerance(&expected.positions));
        for i in 0..row {
            let e: Vec<f64> = expected.lobes.iter().copied().skip(i).step_by(row).collect();
            let f: Vec<f32> = found.lobes.iter().copied().skip(i).step_by(row).collect();
            assert_close(&format!("number {i} of lobes"), &e, &f, tolerance(&e));
        }
    }
}

#[track_caller]
fn check_added(what: &str, expected: &[f64], found: &[f32], t: Tolerance) {
    let after: Vec<f64> = expected.iter().map(|e| e + f64::from(BEFORE)).collect();
    // Rounding of the previous contents adds to the error.
    let size = expected.iter().fold(f64::from(BEFORE), |m, e| m.max(e.abs()));
    assert_close(what, &after, found, Tolerance::new(t.absolute + 1e-7 * size, t.relative));
}

const SMALL: LightModel = LightModel { lights: 5, lobes: 12, axes: Axes::Grid };

#[test]
fn lights_at_odd_sizes() {
    let gpu = Gpu::new();
    let sizes = [[1, 1], [7, 1], [8, 8], [9, 8], [65, 1], [31, 17]];
    for (i, size) in sizes.into_iter().enumerate() {
        for metallic in [false, true] {
            let case = Lit::random(size, SMALL, metallic, i as u32);
            let [a, b] = shapes(&gpu);
            let own = Shape::for_device(gpu.tuning());
            let shapes = if metallic { vec![a, b] } else { vec![a, own] };
            check_pixels(&gpu, &shapes, &case, size.map(|s| s as u32), 2e-4);
            check_lights(&gpu, &shapes, &case, size.map(|s| s as u32), 1e-3);
        }
    }
}

#[test]
fn lights_of_any_number_of_lobes() {
    let gpu = Gpu::new();
    for (lights, lobes, axes) in [(1, 1, Axes::Free), (9, 5, Axes::Grid), (70, 2, Axes::Free), (3, 32, Axes::Grid)] {
        let case = Lit::random([13, 5], LightModel { lights, lobes, axes }, true, lobes);
        check_pixels(&gpu, &shapes(&gpu), &case, [20, 9], 2e-4);
        check_lights(&gpu, &shapes(&gpu), &case, [20, 9], 1e-3);
    }
}

/// Hard configuration of pixels and lights.
struct Hard {
    name: &'static str,
    change: fn(&mut Lit),
    relative: f64,
}

fn set_all(case: &mut Lit, at: usize, value: f64) {
    let row = case.raw.model.row() as usize;
    case.raw.lobes.chunks_mut(row).for_each(|r| r[at] = sgs_tests::lit::narrow(value));
}

/// Places the lights in a direction from the middle of the pixels.
///
/// All pixels lie at nearly one position.
fn aim(case: &mut Lit, normal: [f64; 3], view: [f64; 3], light: [f64; 3], distance: f64) {
    let narrow = |v: [f64; 3]| v.map(sgs_tests::lit::narrow);
    for (i, p) in case.pixels.iter_mut().enumerate() {
        let jitter = 1e-3 * i as f64;
        p.point = narrow([jitter, 0.7 * jitter, -0.2 * jitter]);
        p.normal = narrow(unit(normal));
    }
    case.camera = narrow(unit(view).map(|x| 3.0 * x));
    for light_at in case.raw.positions.chunks_mut(3) {
        let v = narrow(unit(light).map(|x| distance * x));
        light_at.copy_from_slice(&v);
    }
}

const HARD: &[Hard] = &[
    Hard {
        name: "roughness 0.01",
        change: |c| c.pixels.iter_mut().for_each(|p| p.material.roughness = 0.01),
        relative: 1e-3,
    },
    Hard {
        name: "roughness 0.04 in its highlight",
        change: |c| {
            aim(c, [0.0, 0.0, 1.0], [0.5, 0.0, 1.0], [-0.5, 0.0, 1.0], 2.0);
            c.pixels.iter_mut().for_each(|p| p.material.roughness = sgs_tests::lit::narrow(0.04));
        },
        relative: 1e-3,
    },
    Hard {
        name: "roughness 1",
        change: |c| c.pixels.iter_mut().for_each(|p| p.material.roughness = 1.0),
        relative: 2e-4,
    },
    Hard {
        name: "grazing light",
        change: |c| aim(c, [0.0, 0.0, 1.0], [0.3, 0.1, 1.0], [1.0, 0.4, 4e-3], 2.0),
        relative: 1e-3,
    },
    Hard {
        name: "grazing view",
        change: |c| aim(c, [0.0, 0.0, 1.0], [1.0, 0.2, 3e-3], [0.4, 0.4, 1.0], 2.0),
        relative: 1e-3,
    },
    Hard {
        name: "seen from behind",
        change: |c| aim(c, [0.0, 0.0, 1.0], [0.3, 0.2, -1.0], [0.4, 0.4, 1.0], 2.0),
        relative: 1e-3,
    },
    Hard {
        name: "light against the view",
        change: |c| aim(c, [0.0, 0.0, 1.0], [1.0, 0.0, 2e-2], [-1.0, 0.0, 2e-2], 2.0),
        relative: 1e-3,
    },
    Hard {
        name: "light almost in the surface",
        change: |c| aim(c, [0.1, 0.2, 1.0], [0.3, 0.2, 1.0], [0.4, 0.4, 1.0], 1e-3),
        relative: 1e-3,
    },
    Hard { name: "blunt lobes", change: |c| set_all(c, 2, (1e-3_f64).ln()), relative: 2e-4 },
    Hard { name: "sharp lobes", change: |c| set_all(c, 2, (1e4_f64).ln()), relative: 1e-3 },
    Hard { name: "lobes beyond the sharpest", change: |c| set_all(c, 2, 20.0), relative: 1e-3 },
    Hard { name: "faint lights", change: |c| (3..6).for_each(|i| set_all(c, i, (1e-8_f64).ln())), relative: 2e-4 },
    Hard { name: "fierce lights", change: |c| (3..6).for_each(|i| set_all(c, i, (1e6_f64).ln())), relative: 2e-4 },
    Hard { name: "beyond the fiercest", change: |c| (3..6).for_each(|i| set_all(c, i, 100.0)), relative: 2e-4 },
    Hard { name: "no light at all", change: |c| (3..6).for_each(|i| set_all(c, i, -200.0)), relative: 2e-4 },
    Hard { name: "angles far out", change: |c| (0..2).for_each(|i| set_all(c, i, 30.0)), relative: 2e-4 },
    Hard {
        name: "nearly transparent",
        change: |c| c.pixels.iter_mut().enumerate().for_each(|(i, p)| p.coverage = [1e-6, 1e-3, 9e-4, 0.5][i % 4]),
        relative: 2e-4,
    },
    Hard {
        name: "black metal",
        change: |c| {
            c.pixels.iter_mut().for_each(|p| {
                p.material.albedo = [0.01, 0.0, 0.02].map(sgs_tests::lit::narrow);
                p.material.metallic = sgs_tests::lit::narrow(0.95);
            })
        },
        relative: 1e-3,
    },
    Hard {
        name: "no normals",
        change: |c| c.pixels.iter_mut().step_by(2).for_each(|p| p.normal = [0.0; 3]),
        relative: 2e-4,
    },
];

#[test]
fn lights_at_extremes() {
    let gpu = Gpu::new();
    for (i, hard) in HARD.iter().enumerate() {
        let mut case = Lit::random([9, 4], SMALL, true, 40 + i as u32);
        (hard.change)(&mut case);
        // Coverage and roughness are rounded to 32 bits.
        case.pixels.iter_mut().for_each(|p| p.coverage = sgs_tests::lit::narrow(p.coverage));
        case.pixels.iter_mut().for_each(|p| p.material.roughness = sgs_tests::lit::narrow(p.material.roughness));
        eprintln!("{}", hard.name);
        check_pixels(&gpu, &shapes(&gpu), &case, [9, 4], hard.relative);
        check_lights(&gpu, &shapes(&gpu), &case, [9, 4], 1e-3);
    }
}

/// Camera and light are opposite, so the half vector is zero or tiny.
#[test]
fn a_light_opposite_the_camera_is_finite() {
    let gpu = Gpu::new();
    for off in [0.0, 1e-7, 1e-5] {
        let mut case = Lit::random([9, 4], SMALL, true, 90);
        aim(&mut case, [0.1, 0.2, 1.0], [-0.3, 0.1 + off, -1.0], [0.3, -0.1, 1.0], 3.0);
        case.pixels.iter_mut().for_each(|p| p.point = [0.0; 3]);
        let found = run(&gpu, shapes(&gpu)[0], &case, [9, 4], None);
        let all = [&found.direct, &found.materials, &found.metallic, &found.normals, &found.positions, &found.lobes];
        assert!(all.iter().all(|v| v.iter().all(|x| x.is_finite())), "off by {off}");
        assert!(found.split[1].iter().any(|x| *x > 0.0), "nothing is lit");
    }
}

/// Pixels without a surface are black with zero gradients, whatever they store.
///
/// Also tests a light at the position of a pixel's point.
#[test]
fn lights_skip_pixels_without_surface() {
    let gpu = Gpu::new();
    let mut case = Lit::random([11, 3], SMALL, true, 3);
    for (i, p) in case.pixels.iter_mut().enumerate() {
        if i % 3 == 0 {
            p.coverage = 0.0;
            p.point = [f64::NAN; 3];
            p.normal = [f64::INFINITY; 3];
            p.material.albedo = [f64::NAN; 3];
            p.material.roughness = f64::NAN;
            p.material.metallic = f64::NAN;
        } else if i % 3 == 1 {
            p.point = case.camera;
        }
    }
    case.raw.positions[..3].copy_from_slice(&case.pixels[2].point);
    let found = run(&gpu, shapes(&gpu)[0], &case, [11, 3], None);
    assert!(found.positions.iter().chain(&found.lobes).all(|x| x.is_finite()));
    // The view direction is undefined where the camera is at the point, so those pixels have no surface below.
    let mut seen = case.clone();
    seen.pixels.iter_mut().skip(1).step_by(3).for_each(|p| p.coverage = 0.0);
    check_lights(&gpu, &shapes(&gpu), &seen, [11, 3], 1e-3);
    for i in 0..case.pixels.len() {
        let all =
            [&found.direct[3 * i..3 * i + 3], &found.materials[4 * i..4 * i + 4], &found.metallic[i..=i]].concat();
        assert!(all.iter().all(|x| x.is_finite()), "{i}: {all:?}");
        if i % 3 == 0 {
            assert_eq!(all, [0.0, 0.0, 0.0, BEFORE, BEFORE, BEFORE, BEFORE, BEFORE], "{i}");
        }
    }
}

#[test]
fn disabled_lights_match_reference() {
    let gpu = Gpu::new();
    for on in [&[][..], &[2], &[0, 4], &[0, 1, 2, 3, 4]] {
        let mut case = Lit::random([17, 3], SMALL, false, 5);
        for (i, gain) in case.raw.gains.iter_mut().enumerate() {
            *gain = if on.contains(&i) { 0.5 + i as f64 } else { 0.0 };
        }
        check_pixels(&gpu, &shapes(&gpu), &case, [17, 3], 2e-4);
        check_lights(&gpu, &shapes(&gpu), &case, [17, 3], 1e-3);
    }
}

#[test]
fn perturbed_lights_match_reference() {
    let gpu = Gpu::new();
    let model = LightModel { lights: 40, lobes: 3, axes: Axes::Free };
    let case = Lit::random([13, 7], model, false, 8);
    let mut seen = Vec::new();
    for copy in [0, 1] {
        let p = Perturbation::published(copy, 1.0);
        let moved = Lit { raw: reference::perturb(&case.raw, case.seed, &p), ..case.clone() };
        let off = moved.raw.gains.iter().filter(|g| **g == 0.0).count();
        assert!((4..24).contains(&off), "{off} of 40 lights are off");
        let [diffuse, specular] = reference::lights(&case.pixels, &moved.lights(), case.camera, case.normalizer());
        let whole: Vec<f64> = diffuse.iter().zip(&specular).map(|(d, s)| d + s).collect();
        let found = run(&gpu, shapes(&gpu)[0], &case, [13, 7], Some(&p));
        assert_close("radiance", &whole, &found.direct, Tolerance::new(1e-5 * scale(&whole), 2e-4));
        seen.push(found.direct);
    }
    assert_ne!(seen[0], seen[1]);
}

#[test]
fn lights_are_deterministic() {
    let gpu = Gpu::new();
    let case = Lit::random([31, 9], SMALL, true, 12);
    let once = || {
        let f = run(&gpu, shapes(&gpu)[0], &case, [31, 9], None);
        [f.direct, f.split.concat(), f.materials, f.metallic, f.positions, f.lobes, f.normals]
            .concat()
            .iter()
            .map(|x| x.to_bits())
            .collect::<Vec<_>>()
    };
    let first = once();
    assert!((0..3).all(|_| once() == first));
}

/// Checks that an error of 0.1 % or a missing light fails the checks.
#[test]
fn checks_of_lights_can_fail() {
    let case = Lit::random([9, 4], SMALL, true, 21);
    let sum = |case: &Lit| -> Vec<f64> {
        let [d, s] = reference::lights(&case.pixels, &case.lights(), case.camera, case.normalizer());
        d.iter().zip(&s).map(|(d, s)| d + s).collect()
    };
    let expected = sum(&case);
    let tolerance = Tolerance::new(1e-2 * 2e-4 * scale(&expected), 2e-4);
    let excess = |found: &[f64]| {
        let found: Vec<f32> = found.iter().map(|&x| x as f32).collect();
        sgs_tests::worst(&expected, &found, tolerance).unwrap().3
    };
    assert!(excess(&expected) < 1.0);
    let mut other = case.clone();
    other.raw.gains[3] = 1.01;
    assert!(excess(&sum(&other)) > 1.0);
    let mut other = case.clone();
    other.pixels[7].material.roughness *= 1.05;
    assert!(excess(&sum(&other)) > 1.0);
    let mut other = case.clone();
    other.raw.lobes[8] += 0.1;
    assert!(excess(&sum(&other)) > 1.0);
}

/// Culling of faint lights stays within its error bound.
///
/// Lights that are culled everywhere have zero gradients. A bound of zero changes nothing.
#[test]
fn culling_keeps_within_its_bound() {
    let gpu = Gpu::new();
    let model = LightModel { lights: 30, lobes: 4, axes: Axes::Free };
    let mut case = Lit::random([48, 9], model, false, 15);
    // Pixels of a row are close together and lights far apart. Some lights reach all pixels, some none.
    for (i, p) in case.pixels.iter_mut().enumerate() {
        p.point = [i % 48, i / 48, i % 5].map(|x| sgs_tests::lit::narrow(0.1 * x as f64));
        p.material.roughness = 1.0;
    }
    let row = model.row() as usize;
    for (i, values) in case.raw.lobes.chunks_mut(row).enumerate() {
        let shift = -0.4 * (i / 4) as f64;
        values[row - 3..].iter_mut().for_each(|x| *x = sgs_tests::lit::narrow(*x + shift));
    }
    for shape in shapes(&gpu) {
        let full = run(&gpu, shape, &case, [48, 9], None);
        for missing in [1e-3_f32, 1e-2, 1.0] {
            let less = run_culled(&gpu, shape, &case, [48, 9], None, missing);
            let (mut most, mut by_albedo) = (0.0_f64, 0.0_f64);
            for (i, pixel) in case.pixels.iter().enumerate() {
                for c in 0..3 {
                    let d = f64::from(full.split[1][3 * i + c]) - f64::from(less.split[1][3 * i + c]);
                    let bound =
                        f64::from(missing) * case.normalizer() * pixel.material.albedo[c] / std::f64::consts::PI;
                    assert!(d >= -1e-6 && d <= bound + 1e-6, "{missing}: {d} of {bound}");
                    most = most.max(d / bound);
                    let d = f64::from(full.direct[3 * i + c]) - f64::from(less.direct[3 * i + c]);
                    let shine = f64::from(missing) * case.normalizer() / std::f64::consts::TAU;
                    assert!(d <= bound + shine + 1e-6);
                    // The albedo gradient is the loss gradient times the irradiance over pi, so a white albedo sets the
                    // bound.
                    let at = |f: &Found| f64::from(f.materials[4 * i + c]);
                    let white = f64::from(missing) * case.normalizer() / std::f64::consts::PI;
                    let loss_gradient = case.gradient[3 * i + c].abs();
                    let off = (at(&full) - at(&less)).abs();
                    assert!(
                        off <= loss_gradient * white + 1e-5 * (1.0 + at(&full).abs()),
                        "{missing}: {off} of {white}"
                    );
                    by_albedo = by_albedo.max(off);
                }
            }
            // The sum of log-amplitude gradients changes by at most the loss gradient of each pixel times its missing
            // light.
            let amplitudes = |f: &Found| -> Vec<f64> {
                f.lobes.chunks(row).map(|r| r[row - 3..].iter().map(|x| f64::from(*x)).sum()).collect()
            };
            let off: f64 = amplitudes(&full).iter().zip(amplitudes(&less)).map(|(a, b)| (a - b).abs()).sum();
            let most_of =
                f64::from(missing) * case.normalizer() * (1.0 / std::f64::consts::PI + 1.0 / std::f64::consts::TAU);
            let loss_gradient: f64 = case.gradient.iter().map(|g| g.abs()).sum();
            assert!(off <= 1.001 * loss_gradient * most_of + 1e-4, "{missing}: {off} of {}", loss_gradient * most_of);
            assert!(off > 0.0 && by_albedo > 0.0, "{missing}: gradients are the same");
            let dark = |f: &Found| f.positions.chunks(3).filter(|g| g.iter().all(|x| *x == 0.0)).count();
            assert!(dark(&less) > dark(&full), "{missing} leaves out {} lights", dark(&less));
            // The bound is tight: less than 1000 times the largest error.
            assert!(most > 1e-3, "{missing}: {most}");
        }
        assert_eq!(full.direct, run_culled(&gpu, shape, &case, [48, 9], None, 0.0).direct);
    }
}
