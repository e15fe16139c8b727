//! Environment map on a device against its reference.
//!
//! Covers the filters and their adjoints, light on surfaces, gradients, and smoothness.

use sgs_engine::graph::Graph;
use sgs_passes::Tuning;
use sgs_passes::reference::environment as reference;
use sgs_passes::reference::environment::{Cube, Filter, Pixel};
use sgs_passes::reference::rng::Pcg;
use sgs_passes::shade::environment::{
    Environment, EnvironmentSums, EnvironmentView, StoredFilter, environment_background, environment_bwd,
    environment_clamp, environment_filter, environment_filter_bwd, environment_filter_stored,
    environment_filter_stored_bwd,
};
use sgs_scene::{Scene, SceneOptions, Splats};
use sgs_shaders::structs::Step;
use sgs_tests::environment::{BEFORE, CAMERA, Case, MAP, WEIGHT, bytes, made, pixel, room, run, surfaces, unit};
use sgs_tests::intrinsic::{place, settings};
use sgs_tests::{Gpu, Tolerance, assert_close, finite_difference, worst};
use sgs_train::Intrinsic;

fn levels_of(e: &Environment, texels: &[f32]) -> Vec<Cube> {
    let cube = Cube::from_floats(e.size() as usize, texels);
    e.levels().iter().map(|l| reference::prefilter(&cube, l)).collect()
}

fn flat(levels: &[Cube]) -> Vec<f64> {
    levels.iter().flat_map(Cube::flat).collect()
}

fn dot(a: &[f32], b: &[f32]) -> f64 {
    a.iter().zip(b).map(|(x, y)| f64::from(*x) * f64::from(*y)).sum()
}

fn camera() -> [f64; 3] {
    CAMERA.map(f64::from)
}

/// Computes the gradient of each level from the reference's pixels.
fn level_gradients(e: &Environment, pixels: &[Pixel], gradient: &[f32]) -> Vec<Cube> {
    let mut made: Vec<Cube> = e.levels().iter().map(|l| Cube::black(l.size as usize)).collect();
    for (p, g) in pixels.iter().zip(gradient.chunks(3)) {
        reference::shade_bwd(&mut made, e.split_sum(), camera(), p, [g[0], g[1], g[2]].map(f64::from));
    }
    made
}

/// Training clamps negative texels to zero, also at update intervals above 1.
#[test]
fn training_leaves_no_texel_below_zero() {
    let (place, _) = place();
    let gpu = Gpu::new();
    let scene = Scene::open(&place.path("scene"), &SceneOptions::default()).unwrap();
    let splats = Splats::from_points(&scene.points, 1).unwrap();
    for every in [1, 2] {
        let mut s = settings(4);
        s.intrinsic.environment.every = every;
        // The start is far too bright. Adam's first step has the length of the learning rate, which exceeds any texel.
        s.intrinsic.environment.start = 20.0;
        s.intrinsic.rates.environment = 1e3;
        let mut training = Intrinsic::new(gpu.device(), &scene, &s, &splats).unwrap();
        let texels = |t: &Intrinsic| t.light().unwrap().environment.unwrap().data;
        let before = texels(&training);
        assert!(before.iter().all(|t| *t > 0.0));
        training.train(every, |_| {}, || true).unwrap();
        let after = texels(&training);
        assert!(after.iter().all(|t| *t >= 0.0 && t.is_finite()), "every {every}");
        let black = after.iter().filter(|t| **t == 0.0).count();
        assert!(black > after.len() / 10, "every {every}: {black} of {}", after.len());
    }
}

/// Returns the device's own tuning, and the same with workgroups of 64.
fn tunings(gpu: &Gpu) -> Vec<Tuning> {
    let own = gpu.tuning();
    vec![own, Tuning { workgroup: 64, ..own }]
}

#[test]
fn environment_light_and_gradients_match_reference() {
    let gpu = Gpu::new();
    for size in [16, 32] {
        let e = made(size);
        let texels = room(&e, size);
        let mut pixels = surfaces(size);
        let mut rng = Pcg::new(7);
        let gradient: Vec<f32> = (0..3 * pixels.len()).map(|_| rng.normal() as f32).collect();
        let levels = levels_of(&e, &texels);
        for (metallic, t) in [true, false].into_iter().zip(tunings(&gpu)) {
            if !metallic {
                pixels.iter_mut().for_each(|p| p.metallic = 0.0);
            }
            let case = Case {
                e: &e,
                texels: &texels,
                pixels: &pixels,
                gradient: &gradient,
                smooth: false,
                metallic,
                merge: false,
            };
            let found = run(&gpu, &t, &case);
            assert_close("radiance", &flat(&levels), &found.radiance, Tolerance::new(1e-5, 2e-5));
            let shade = |p: &Pixel| reference::shade(&levels, e.split_sum(), camera(), p);
            let expected: Vec<f64> = pixels.iter().flat_map(shade).collect();
            assert_close("ambient", &expected, &found.ambient, Tolerance::new(1e-4, 1e-4));

            let expected: Vec<f64> = pixels.iter().flat_map(|p| reference::shade_diffuse(&levels, p)).collect();
            assert_close("diffuse", &expected, &found.diffuse, Tolerance::new(1e-4, 1e-4));

            // Expected material gradients are central differences of the reference.
            for (i, p) in pixels.iter().enumerate() {
                let g = &gradient[3 * i..3 * i + 3];
                let mut x = [p.albedo[0], p.albedo[1], p.albedo[2], p.roughness, p.metallic];
                for k in 0..5 {
                    let loss = |x: &[f64]| -> f64 {
                        let moved = Pixel { albedo: [x[0], x[1], x[2]], roughness: x[3], metallic: x[4], ..*p };
                        (0..3).map(|c| f64::from(g[c]) * shade(&moved)[c]).sum()
                    };
                    let slope = finite_difference(&mut x, k, 1e-6, loss);
                    let is = if k < 4 {
                        found.materials[4 * i + k] - BEFORE
                    } else if metallic {
                        found.metallic[i] - BEFORE
                    } else {
                        assert_eq!(found.metallic[i], BEFORE);
                        continue;
                    };
                    let bound = 1e-3 * slope.abs() + 2e-3;
                    assert!((slope - f64::from(is)).abs() < bound, "pixel {i} {p:?}, {k}: {slope} {is}");
                }
            }

            // Expected texel gradients come from the reference's adjoint.
            let by_level = level_gradients(&e, &pixels, &gradient);
            let mut expected = vec![0.0; texels.len()];
            for (g, level) in by_level.iter().zip(e.levels()) {
                let part = reference::prefilter_bwd(g, level, size as usize).flat();
                expected.iter_mut().zip(part).for_each(|(e, p)| *e += p);
            }
            let largest = expected.iter().fold(0.0_f64, |a, b| a.max(b.abs()));
            assert_close("texels", &expected, &found.texels, Tolerance::new(1e-6 * largest, 1e-4));
        }
    }
}

/// Level gradients gathered over two steps are propagated to the texels together.
#[test]
fn gathered_gradients_equal_the_gradient_of_the_mean() {
    let gpu = Gpu::new();
    let (e, t) = (made(32), gpu.tuning());
    let (texels, pixels) = (room(&e, 3), surfaces(5));
    let count = pixels.len() as u64;
    let mut rng = Pcg::new(11);
    // The second gradient is a thousand times as large. Each has its own fixed-point scale.
    let gradients =
        [1.0, 1000.0].map(|f| (0..3 * pixels.len()).map(|_| (f * rng.normal()) as f32).collect::<Vec<f32>>());
    let mut g = Graph::new("gathered");
    let tables = e.declare(&mut g);
    let step = g.uniform("step", size_of::<Step>() as u64);
    let parameters = g.input("texels", 4 * u64::from(e.floats()));
    let filter = StoredFilter::declare(&mut g, &e, true);
    let [points, normals] = ["points", "normals"].map(|n| g.input(n, 12 * count));
    let (coverage, materials) = (g.input("coverage", 4 * count), g.input("materials", 16 * count));
    let view = EnvironmentView { step, points, normals, coverage, materials, metallic: None, pixels: count };
    environment_filter_stored(&mut g, &t, &e, &tables, parameters, &filter).unwrap();
    let mut contents = vec![(filter.gathered, bytes(&vec![0.0_f32; 3 * e.filtered_texels() as usize]))];
    for (i, loss_gradient) in gradients.iter().enumerate() {
        g.set_prefix(format!("{i}."));
        let gradient = g.input("gradient", 12 * count);
        let by_materials = g.external("materials_gradient", 16 * count);
        contents.extend([(gradient, bytes(loss_gradient)), (by_materials, bytes(&vec![0.0_f32; 4 * pixels.len()]))]);
        let sums = environment_bwd(&mut g, &t, &e, &tables, &view, &filter.filtered(), gradient, by_materials, None);
        filter.gather(&mut g, &t, &e, &sums.unwrap(), 0.5).unwrap();
    }
    g.set_prefix("");
    let by_texels = g.external("texel_gradient", 4 * u64::from(e.floats()));
    environment_filter_stored_bwd(&mut g, &t, &e, &tables, &filter, None, by_texels).unwrap();
    let mut values = Step::default();
    values.camera.size = [count as u32, 1];
    values.camera.position = CAMERA;
    let floats = |f: &dyn Fn(&Pixel) -> Vec<f64>| -> Vec<u8> {
        bytes(&pixels.iter().flat_map(f).map(|x| x as f32).collect::<Vec<f32>>())
    };
    contents.extend([
        (step, bytes(&[values])),
        (parameters, bytes(&texels)),
        (points, floats(&|p| p.point.to_vec())),
        (normals, floats(&|p| p.normal.to_vec())),
        (coverage, floats(&|p| vec![p.coverage])),
        (materials, floats(&|p| [&p.albedo[..], &[p.roughness]].concat())),
    ]);
    contents.extend(e.contents(&tables));
    let out = gpu.run(g, &contents);
    assert_close("radiance", &flat(&levels_of(&e, &texels)), &out.get(filter.radiance), Tolerance::new(1e-5, 2e-5));
    let plain: Vec<Pixel> = pixels.iter().map(|p| Pixel { metallic: 0.0, ..*p }).collect();
    let mean: Vec<f32> = gradients[0].iter().zip(&gradients[1]).map(|(a, b)| 0.5 * (a + b)).collect();
    let mut expected = vec![0.0; texels.len()];
    for (g, level) in level_gradients(&e, &plain, &mean).iter().zip(e.levels()) {
        let part = reference::prefilter_bwd(g, level, e.size() as usize).flat();
        expected.iter_mut().zip(part).for_each(|(e, p)| *e += p);
    }
    let largest = expected.iter().fold(0.0_f64, |a, b| a.max(b.abs()));
    assert_close("texels", &expected, &out.get(by_texels), Tolerance::new(1e-6 * largest, 1e-4));
}

#[test]
fn reference_texel_gradient_matches_difference() {
    // Shading is linear in the texels, so the difference along a direction is the dot product of gradient and
    // direction.
    let e = made(16);
    let (texels, pixels) = (room(&e, 1), surfaces(2));
    let mut rng = Pcg::new(3);
    let gradient: Vec<f32> = (0..3 * pixels.len()).map(|_| rng.normal() as f32).collect();
    let other: Vec<f32> = (0..texels.len()).map(|_| rng.normal() as f32).collect();
    let loss = |texels: &[f32]| -> f64 {
        let levels = levels_of(&e, texels);
        let shade = |p: &Pixel| reference::shade(&levels, e.split_sum(), camera(), p);
        pixels.iter().flat_map(shade).zip(&gradient).map(|(x, g)| x * f64::from(*g)).sum()
    };
    let mut slope = 0.0;
    for (g, level) in level_gradients(&e, &pixels, &gradient).iter().zip(e.levels()) {
        let part = reference::prefilter_bwd(g, level, 16).flat();
        slope += part.iter().zip(&other).map(|(p, x)| p * f64::from(*x)).sum::<f64>();
    }
    let moved: Vec<f32> = texels.iter().zip(&other).map(|(x, d)| x + d).collect();
    // The texels are rounded to 32 bits, so the actual step differs from the direction.
    let step: Vec<f64> = moved.iter().zip(&texels).map(|(m, x)| f64::from(*m) - f64::from(*x)).collect();
    let rounding: f64 = step.iter().zip(&other).map(|(s, o)| (s - f64::from(*o)).abs()).sum();
    let difference = loss(&moved) - loss(&texels);
    assert!((difference - slope).abs() < 1e-6 * slope.abs() + 10.0 * rounding, "{difference} {slope}");
}

#[test]
fn filter_matches_its_adjoint_and_the_reference() {
    let gpu = Gpu::new();
    for (size, backward) in [(16, true), (64, true), (512, false)] {
        let e = made(size);
        let x = room(&e, 5);
        let mut rng = Pcg::new(6);
        let y: Vec<i64> = (0..3 * e.filtered_texels()).map(|_| (rng.normal() * 2f64.powi(28)).round() as i64).collect();
        let mut g = Graph::new("adjoint");
        let t = gpu.tuning();
        let tables = e.declare(&mut g);
        let texels = g.input("texels", 4 * u64::from(e.floats()));
        let (texel_sums, largest) = (g.input("sums", 8 * y.len() as u64), g.input("largest", 4));
        let radiance = g.external("radiance", 4 * y.len() as u64);
        let inverse_sums = g.external("inverse_sums", 4 * u64::from(e.filtered_texels()));
        let filtered = environment_filter(&mut g, &t, &e, &tables, texels).unwrap();
        g.copy("radiance", filtered.radiance, radiance).unwrap();
        g.copy("inverse_sums", filtered.inverse_sums, inverse_sums).unwrap();
        // With 30 bits and a largest number just below 1, the fixed-point unit is 2^-30.
        let sums = EnvironmentSums { texel_sums, largest, bits: 30 };
        let gradient = g.external("gradient", 4 * u64::from(e.floats()));
        if backward {
            environment_filter_bwd(&mut g, &t, &e, &tables, &filtered, &sums, None, gradient).unwrap();
        } else {
            g.fill("none", gradient, 0).unwrap();
        }
        let mut inputs = vec![(texels, bytes(&x)), (texel_sums, bytes(&y)), (largest, bytes(&[0.99_f32]))];
        inputs.extend(e.contents(&tables));
        let out = gpu.run(g, &inputs);
        let radiance: Vec<f32> = out.get(radiance);
        if backward {
            let y: Vec<f32> = y.iter().map(|y| *y as f32 * 2f32.powi(-30)).collect();
            let (forward, back) = (dot(&radiance, &y), dot(&x, &out.get::<f32>(gradient)));
            let size_of = dot(&radiance, &radiance).sqrt() * dot(&y, &y).sqrt();
            assert!((forward - back).abs() < 1e-6 * size_of, "{size}: {forward} {back} of {size_of}");
        }
        // Compare sampled texels, including corners of faces, with the reference's sums over all texels.
        let cube = Cube::from_floats(size as usize, &x);
        for level in e.levels() {
            let mip = reference::mip(&cube, level.size as usize);
            let filter = Filter::new(level);
            let n = level.size * level.size;
            for k in 0..24 {
                let texel = match k {
                    0..6 => k * n,
                    6..12 => (k - 5) * n - 1,
                    _ => rng.next_u32() % (6 * n),
                };
                let expected = reference::prefilter_texel(&mip, &filter, texel as usize);
                let at = 3 * (level.first + texel) as usize;
                assert_close("texel", &expected, &radiance[at..at + 3], Tolerance::new(1e-6, 3e-5));
            }
        }
    }
}

#[test]
fn wrong_lobe_is_detected() {
    let e = made(16);
    let cube = Cube::from_floats(16, &room(&e, 8));
    let right = reference::prefilter(&cube, &e.levels()[2]);
    for planted in [
        reference::prefilter(
            &cube,
            &sgs_passes::shade::environment::levels::Level { roughness: 0.362, ..e.levels()[2] },
        ),
        reference::prefilter(&cube, &sgs_passes::shade::environment::levels::Level { cutoff: 1.7, ..e.levels()[2] }),
    ] {
        let found: Vec<f32> = planted.flat().iter().map(|x| *x as f32).collect();
        assert!(worst(&right.flat(), &found, Tolerance::new(1e-5, 2e-5)).unwrap().3 > 1.0);
    }
}

#[test]
fn white_is_white_and_nothing_is_created() {
    let gpu = Gpu::new();
    for size in [16, 64] {
        let e = made(size);
        let texels = vec![1.0_f32; e.floats() as usize];
        let pixels: Vec<Pixel> = surfaces(4).into_iter().map(|p| Pixel { albedo: [1.0; 3], ..p }).collect();
        let gradient = vec![0.0; 3 * pixels.len()];
        let case = Case {
            e: &e,
            texels: &texels,
            pixels: &pixels,
            gradient: &gradient,
            smooth: true,
            metallic: true,
            merge: false,
        };
        let found = run(&gpu, &gpu.tuning(), &case);
        assert!(found.radiance.iter().all(|r| (r - 1.0).abs() < 1e-5));
        for (p, c) in
            pixels.iter().zip(found.ambient.chunks(3)).filter(|(p, _)| p.coverage > 1e-3 && p.normal != [0.0; 3])
        {
            let view = unit(std::array::from_fn(|k| f64::from(CAMERA[k]) - p.point[k]));
            let facing: f64 = (0..3).map(|k| p.normal[k] * view[k]).sum();
            let [a, b] = reference::split_sum(e.split_sum(), p.roughness, facing.clamp(1e-4, 1.0));
            let specular = (0.04 + 0.96 * p.metallic) * a + b;
            assert!((f64::from(c[0]) - (1.0 - p.metallic) - specular).abs() < 2e-3 * (1.0 - p.metallic) + 1e-5);
            assert!(specular <= 1.0005, "{p:?}");
        }
        // A uniform map is smooth, and the loss gradient is zero.
        assert_eq!(found.smoothness, 0.0);
        assert!(found.texels.iter().all(|g| *g == 0.0));
        assert!(found.materials.iter().all(|g| *g == BEFORE));
    }
}

#[test]
fn extremes_stay_finite_and_right() {
    let gpu = Gpu::new();
    let e = made(16);
    let pixels = surfaces(11);
    let mut rng = Pcg::new(12);
    for (bright, steep) in [(0.0, 1.0), (1e6, 1e-12), (1e6, 1e9), (1e-8, 1e-20), (1.0, 1e25)] {
        let texels: Vec<f32> = room(&e, 13).iter().map(|x| x * bright).collect();
        let gradient: Vec<f32> = (0..3 * pixels.len()).map(|_| (rng.normal() * steep) as f32).collect();
        let case = Case {
            e: &e,
            texels: &texels,
            pixels: &pixels,
            gradient: &gradient,
            smooth: false,
            metallic: true,
            merge: false,
        };
        let found = run(&gpu, &gpu.tuning(), &case);
        assert!(
            [&found.ambient, &found.materials, &found.metallic, &found.texels]
                .iter()
                .all(|v| v.iter().all(|x| x.is_finite()))
        );
        let levels = levels_of(&e, &texels);
        let shade = |p: &Pixel| reference::shade(&levels, e.split_sum(), camera(), p);
        let expected: Vec<f64> = pixels.iter().flat_map(shade).collect();
        assert_close("ambient", &expected, &found.ambient, Tolerance::new(1e-4 * f64::from(bright), 1e-4));
        let mut expected = vec![0.0; texels.len()];
        for (g, level) in level_gradients(&e, &pixels, &gradient).iter().zip(e.levels()) {
            expected.iter_mut().zip(reference::prefilter_bwd(g, level, 16).flat()).for_each(|(e, p)| *e += p);
        }
        let largest = expected.iter().fold(0.0_f64, |a, b| a.max(b.abs()));
        assert_close("texels", &expected, &found.texels, Tolerance::new(1e-6 * largest, 1e-4));
    }
    // A pixel with non-finite values affects its own materials only, not the environment map.
    let texels = room(&e, 14);
    let mut gradient: Vec<f32> = (0..3 * pixels.len()).map(|_| rng.normal() as f32).collect();
    let at = 3 * 7;
    gradient[at] = f32::NAN;
    gradient[at + 3] = f32::INFINITY;
    let case = Case {
        e: &e,
        texels: &texels,
        pixels: &pixels,
        gradient: &gradient,
        smooth: false,
        metallic: true,
        merge: false,
    };
    let mut broken = pixels.clone();
    broken[11].roughness = f64::NAN;
    broken[12].point[1] = f64::NAN;
    broken[13].normal[0] = f64::INFINITY;
    broken[14].albedo[2] = f64::NAN;
    let found = run(&gpu, &gpu.tuning(), &Case { pixels: &broken, ..case });
    assert!(found.materials[4 * 7].is_nan());
    gradient[at..at + 6].fill(0.0);
    gradient[3 * 11..3 * 15].fill(0.0);
    let case = Case {
        e: &e,
        texels: &texels,
        pixels: &pixels,
        gradient: &gradient,
        smooth: false,
        metallic: true,
        merge: false,
    };
    let without = run(&gpu, &gpu.tuning(), &case);
    let right: Vec<f64> = without.texels.iter().map(|x| f64::from(*x)).collect();
    let largest = right.iter().fold(0.0_f64, |a, b| a.max(b.abs()));
    assert_close("texels", &right, &found.texels, Tolerance::new(1e-7 * largest, 1e-6));
}

#[test]
fn sums_do_not_depend_on_order_or_groups() {
    let gpu = Gpu::new();
    let e = made(32);
    let (texels, pixels) = (room(&e, 3), surfaces(5));
    // Each pixel occurs twice, so texels are shared between workgroups.
    let pixels = [pixels.clone(), pixels].concat();
    let mut rng = Pcg::new(6);
    let gradient: Vec<f32> = (0..3 * pixels.len()).map(|_| rng.normal() as f32).collect();
    let case = Case {
        e: &e,
        texels: &texels,
        pixels: &pixels,
        gradient: &gradient,
        smooth: true,
        metallic: true,
        merge: false,
    };
    let [a, b] = [256, 64].map(|workgroup| run(&gpu, &Tuning { workgroup, ..gpu.tuning() }, &case));
    assert!(a.texel_sums == b.texel_sums);
    assert!(a.texels == b.texels);
    let backwards: Vec<Pixel> = pixels.iter().rev().copied().collect();
    let reversed: Vec<f32> = gradient.chunks(3).rev().flatten().copied().collect();
    let case = Case { pixels: &backwards, gradient: &reversed, ..case };
    assert!(run(&gpu, &gpu.tuning(), &case).texel_sums == a.texel_sums);
    // Merging lanes first does not change the sums. The first 64 pixels form a wall and share their texels.
    let mut wall = backwards.clone();
    let (point, normal) = (wall[8].point, wall[8].normal);
    wall[..64].iter_mut().for_each(|p| (p.point, p.normal) = (point, normal));
    let case = Case { pixels: &wall, ..case };
    let apart = run(&gpu, &gpu.tuning(), &case).texel_sums;
    assert!(apart != a.texel_sums);
    assert!(run(&gpu, &gpu.tuning(), &Case { merge: true, ..case }).texel_sums == apart);
}

/// Returns a case with a smoothness term and without gradients of pixels.
fn smooth<'a>(e: &'a Environment, texels: &'a [f32], pixels: &'a [Pixel]) -> Case<'a> {
    Case { e, texels, pixels, gradient: &[0.0; 3], smooth: true, metallic: false, merge: false }
}

#[test]
fn smoothness_is_the_mean_over_the_map_with_its_gradient() {
    let gpu = Gpu::new();
    let e = made(16);
    let texels = room(&e, 21);
    let pixels = [Pixel { coverage: 0.0, ..pixel(&mut Pcg::new(1), 0.5, 0.5) }];
    let case = smooth(&e, &texels, &pixels);
    let found = run(&gpu, &gpu.tuning(), &case);
    let value = |x: &[f64]| {
        let texels = x.chunks(3).map(|c| [c[0], c[1], c[2]]).collect();
        reference::smoothness(&Cube { size: 16, texels }, MAP)
    };
    let mut x: Vec<f64> = texels.iter().map(|t| f64::from(*t)).collect();
    assert!((found.smoothness / value(&x) - 1.0).abs() < 1e-5);
    let largest = found.texels.iter().fold(0.0_f32, |a, b| a.max(b.abs()));
    for i in (0..x.len()).step_by(97) {
        let slope = f64::from(WEIGHT) * finite_difference(&mut x, i, 0.5, &value);
        let is = f64::from(found.texels[i]);
        assert!((slope - is).abs() < 1e-4 * slope.abs() + 1e-5 * f64::from(largest), "{i}: {slope} {is}");
    }
}

/// Tests the finest cubes: smoothness is measured at their own resolution, and every texel of the map gets a gradient.
#[test]
fn smoothness_of_the_finest_cubes_has_their_resolution() {
    let gpu = Gpu::new();
    let e = made(512);
    let texels = room(&e, 22);
    let pixels = [Pixel { coverage: 0.0, ..pixel(&mut Pcg::new(1), 0.5, 0.5) }];
    let case = smooth(&e, &texels, &pixels);
    let found = run(&gpu, &gpu.tuning(), &case);
    let cube = Cube::from_floats(512, &texels);
    let whole = reference::smoothness(&cube, MAP);
    assert!((found.smoothness / whole - 1.0).abs() < 1e-5);
    let coarse = reference::smoothness(&reference::mip(&cube, 256), MAP);
    assert!((coarse / whole - 1.0).abs() > 1e-3, "the mip would do as well: {coarse} {whole}");
    let mut x: Vec<f64> = texels.iter().map(|t| f64::from(*t)).collect();
    let value = |x: &[f64]| {
        let texels = x.chunks(3).map(|c| [c[0], c[1], c[2]]).collect();
        reference::smoothness(&Cube { size: 512, texels }, MAP)
    };
    let largest = found.texels.iter().fold(0.0_f32, |a, b| a.max(b.abs()));
    let shown: Vec<usize> = (0..x.len()).filter(|i| found.texels[*i].abs() > 0.05 * largest).step_by(11).collect();
    assert!(shown.len() > 3, "{}", shown.len());
    for i in shown.into_iter().take(4) {
        let slope = f64::from(WEIGHT) * finite_difference(&mut x, i, 0.5, &value);
        let is = f64::from(found.texels[i]);
        assert!((slope - is).abs() < 1e-4 * slope.abs() + 1e-5 * f64::from(largest), "{i}: {slope} {is}");
    }
    // Adding a constant changes nothing, so gradients sum to zero.
    let sum: f64 = found.texels.iter().map(|g| f64::from(*g)).sum();
    let all: f64 = found.texels.iter().map(|g| f64::from(g.abs())).sum();
    assert!(sum.abs() < 1e-5 * all, "{sum} of {all}");
}

#[test]
fn the_background_is_the_cube_along_rays_and_negative_texels_become_black() {
    let gpu = Gpu::new();
    let e = made(64);
    let mut texels = room(&e, 31);
    let size = [24_u32, 16];
    let count = u64::from(size[0] * size[1]);
    let mut step = Step::default();
    step.camera.size = size;
    step.camera.focal = [9.0, 8.0];
    step.camera.center = [11.3, 8.4];
    let (s, c) = (0.6_f32.sin(), 0.6_f32.cos());
    step.camera.world_to_camera = [[c, 0.0, -s, 0.3], [0.0, 1.0, 0.0, -1.0], [s, 0.0, c, 2.0]];
    texels[5] = -1.0;
    let mut g = Graph::new("background");
    let uniform = g.uniform("step", size_of::<Step>() as u64);
    let texel_buffer = g.external("texels", 4 * texels.len() as u64);
    let background = g.external("background", 12 * count);
    environment_clamp(&mut g, &gpu.tuning(), &e, texel_buffer).unwrap();
    environment_background(&mut g, &gpu.tuning(), &e, uniform, count, texel_buffer, background).unwrap();
    let out = gpu.run(g, &[(uniform, bytes(&[step])), (texel_buffer, bytes(&texels))]);
    texels[5] = 0.0;
    assert_eq!(out.get::<f32>(texel_buffer), texels);
    let cube = Cube::from_floats(64, &texels);
    let camera = &step.camera;
    let expected: Vec<f64> = (0..count as u32)
        .flat_map(|i| {
            let pixel = [i % size[0], i / size[0]];
            reference::lookup(&cube, reference::ray(&camera.world_to_camera, camera.focal, camera.center, pixel))
        })
        .collect();
    assert_close("background", &expected, &out.get::<f32>(background), Tolerance::new(2e-4, 2e-4));
}
