//! Cameras, exposures and the lens that training learns: kernels against double precision, and alignment of moved cameras.

use glam::{DMat3, DQuat, DVec3};
use sgs_engine::graph::Graph;
use sgs_passes::optim::{ViewGradients, ViewStatus, view_gain, view_gain_bwd, view_place, view_step};
use sgs_passes::pipeline::{Aligner, LearnedView, Renderer};
use sgs_passes::prim::Records;
use sgs_passes::reference::adam as reference_adam;
use sgs_passes::reference::project::Camera;
use sgs_passes::reference::rng::Pcg;
use sgs_passes::scene::{Gaussians, Model, ViewHandles, ViewKinds};
use sgs_passes::splat::{Channels, Screen};
use sgs_shaders::structs::{Step, Work};
use sgs_tests::{Gpu, Tolerance, assert_close, scenes};

const KINDS: ViewKinds = ViewKinds { cameras: true, gains: true, lens: false };
const WITH_LENS: ViewKinds = ViewKinds { lens: true, ..KINDS };
/// Numbers of the lens: logarithm of the factor on focal lengths, shift of the principal point, vignetting, radial distortion.
const LENS: usize = 5;
const BYTES: u64 = size_of::<LearnedView>() as u64;

fn bytes<T: bytemuck::NoUninit>(data: &[T]) -> Vec<u8> {
    bytemuck::cast_slice(data).to_vec()
}

/// Returns views with random numbers of these sizes, and moments of some steps. The lens follows them.
fn views(count: usize, turn: f64, shift: f64, seed: u32) -> Vec<LearnedView> {
    let mut rng = Pcg::new(seed);
    let size = |i: usize| [turn, shift, 0.2][i / 3];
    let mut view = |steps: u32| {
        let mut view = LearnedView { steps, ..Default::default() };
        for i in 0..9 {
            view.values[i] = (size(i) * rng.normal()) as f32;
            let moment = rng.normal();
            view.moments[i] = if steps == 0 { [0.0; 2] } else { [moment as f32, (moment * moment) as f32] };
        }
        view
    };
    let mut all: Vec<LearnedView> = (0..count).map(|i| view(i as u32 % 5)).collect();
    let mut lens = view(9);
    lens.values = [0.1, -0.02, 0.03, -0.4, -0.0999, 0.0, 0.0, 0.0, 0.0];
    all.push(lens);
    all
}

fn moved(camera: &Camera, view: &LearnedView) -> Camera {
    let vector = |i: usize| DVec3::from([0, 1, 2].map(|k| f64::from(view.values[i + k])));
    let center = -(camera.rotation.transpose() * camera.translation) + vector(3);
    let rotation = camera.rotation * DMat3::from_quat(DQuat::from_scaled_axis(-vector(0)));
    Camera { rotation, translation: -(rotation * center), ..*camera }
}

/// Returns the camera behind the lens.
fn through(camera: &Camera, lens: &LearnedView) -> Camera {
    let number = |i: usize| f64::from(lens.values[i]);
    let center = camera.center + camera.focal * glam::DVec2::new(number(1), number(2));
    let radial = number(4);
    Camera { focal: camera.focal * number(0).exp(), center, radial, ..*camera }
}

#[test]
fn cameras_are_placed_as_in_double_precision() {
    let gpu = Gpu::new();
    let camera = scenes::camera([33, 20]);
    let turns = [(0.0, 0.0), (1e-9, 1e-9), (9e-4, 0.01), (0.01, 0.1), (1.0, 2.0), (3.0, 1e3), (1e-3, 1e6)];
    for (seed, (turn, shift)) in turns.into_iter().enumerate() {
        let all = views(3, turn, shift, seed as u32);
        let kinds = if seed % 2 == 1 { WITH_LENS } else { KINDS };
        let mut g = Graph::new("place");
        let step = g.uniform("step", size_of::<Step>() as u64);
        let handles = ViewHandles { views: g.external("views", 4 * BYTES), count: 3, kinds };
        let placed = view_place(&mut g, step, &handles).unwrap();
        let out = g.external("out", size_of::<Step>() as u64);
        g.copy("copy", placed, out).unwrap();
        let values =
            Step { camera: scenes::gpu_camera(&camera), view: 2, seed: 7, weight_l1: 0.25, ..Default::default() };
        let found = gpu.run(g, &[(step, bytes(&[values])), (handles.views, bytes(&all))]).get::<Step>(out)[0];
        if turn == 0.0 && shift == 0.0 {
            assert_eq!(bytes(&[found]), bytes(&[values]), "zero corrections changed the step");
            continue;
        }
        let mut expected = moved(&camera, &all[2]);
        if kinds.lens {
            expected = through(&expected, &all[3]);
        }
        let expected = scenes::gpu_camera(&expected);
        let numbers = |c: &sgs_passes::pipeline::Camera| -> Vec<f32> {
            let pose = c.world_to_camera.iter().flatten().chain(&c.position);
            pose.chain(&c.focal).chain(&c.center).chain([&c.radial]).copied().collect()
        };
        let wide: Vec<f64> = numbers(&expected).into_iter().map(f64::from).collect();
        assert_close("camera", &wide, &numbers(&found.camera), Tolerance::new(2e-6 * (1.0 + shift), 2e-6));
        let rest = Step { camera: values.camera, ..found };
        assert_eq!(bytes(&[rest]), bytes(&[values]), "the rest of the step changed");
    }
}

#[test]
fn gains_and_their_gradients_match_reference() {
    let gpu = Gpu::new();
    let t = gpu.tuning();
    // Sizes below, at and above a workgroup, with and without other channels; the last image has spare pixels.
    let sizes = [([1, 1], 3, 0), ([16, 16], 3, 0), ([37, 23], 8, 5)];
    for ((size, channels, spare), kinds) in sizes.iter().flat_map(|size| [(*size, KINDS), (*size, WITH_LENS)]) {
        let pixels = size[0] * size[1];
        let mut rng = Pcg::new(size[0] as u32);
        let mut single = |n: usize| -> Vec<f32> { (0..n).map(|_| rng.normal() as f32).collect() };
        let (image, gradient) = (single((pixels + spare) * channels), single((pixels + spare) * channels));
        let all = views(2, 0.1, 0.1, 5);
        let mut g = Graph::new("gain");
        let step = g.uniform("step", size_of::<Step>() as u64);
        let largest = [size[0] as u32, size[1] as u32];
        let screen = Screen { step, largest, tile: t.tile };
        let handles = ViewHandles { views: g.external("views", 3 * BYTES), count: 2, kinds };
        let width = if kinds.lens { 4 } else { 3 };
        let [shown, back] = ["image", "gradient"].map(|name| g.external(name, 4 * image.len() as u64));
        view_gain(&mut g, &t, &screen, &handles, channels as u32, shown).unwrap();
        let (parts, count) = view_gain_bwd(&mut g, &t, &screen, &handles, channels as u32, shown, back).unwrap();
        let out = g.external("out", 4 * width as u64 * u64::from(count));
        g.copy("copy", parts, out).unwrap();
        let mut camera = scenes::gpu_camera(&scenes::camera(largest));
        camera.size = largest;
        let values = Step { camera, view: 1, ..Default::default() };
        let inputs =
            [(step, bytes(&[values])), (handles.views, bytes(&all)), (shown, bytes(&image)), (back, bytes(&gradient))];
        let out_of = gpu.run(g, &inputs);
        let gain: Vec<f64> = (6..9).map(|i| f64::from(all[1].values[i]).exp()).collect();
        // Square of the distance from the center of the image, relative to that of the corners.
        let share = |pixel: usize| {
            let middle = size.map(|n| 0.5 * n as f64);
            let from = [(pixel % size[0]) as f64 + 0.5 - middle[0], (pixel / size[0]) as f64 + 0.5 - middle[1]];
            (from[0].powi(2) + from[1].powi(2)) / (middle[0].powi(2) + middle[1].powi(2))
        };
        let vignetting = if kinds.lens { f64::from(all[2].values[3]) } else { 0.0 };
        let scaled = |data: &[f32]| -> Vec<f64> {
            let factor = |i: usize| match i % channels < 3 && i / channels < pixels {
                true => gain[i % channels] * (vignetting * share(i / channels)).exp(),
                false => 1.0,
            };
            data.iter().enumerate().map(|(i, v)| f64::from(*v) * factor(i)).collect()
        };
        let t = Tolerance::new(1e-6, 1e-6);
        assert_close("image", &scaled(&image), &out_of.get::<f32>(shown), t);
        assert_close("gradient", &scaled(&gradient), &out_of.get::<f32>(back), t);
        let parts = out_of.get::<f32>(out);
        assert!(parts.iter().all(|x| x.is_finite()));
        let shown = scaled(&image);
        for c in 0..width {
            // Finite differences of the loss, the dot product of image and gradient, by a channel or the vignetting.
            let terms = |e: f64| {
                let term = move |p: usize, c: usize| p * channels + c;
                let (shown, gradient, share) = (&shown, &gradient, &share);
                (0..pixels).flat_map(move |p| {
                    let channel = if c < 3 { c..c + 1 } else { 0..3 };
                    let factor = if c < 3 { e } else { e * share(p) }.exp();
                    channel.map(move |c| shown[term(p, c)] * factor * f64::from(gradient[term(p, c)]))
                })
            };
            let loss = |e: f64| terms(e).sum::<f64>();
            let expected = (loss(1e-5) - loss(-1e-5)) / 2e-5;
            let found: f64 = parts.chunks_exact(width).map(|part| f64::from(part[c])).sum();
            let size: f64 = terms(0.0).map(f64::abs).sum();
            assert!((found - expected).abs() < 1e-6 * size + 1e-6, "{found} and not {expected}");
        }
    }
}

#[test]
fn views_follow_adam_with_a_mean_of_zero() {
    let gpu = Gpu::new();
    let t = gpu.tuning();
    let (count, at) = (37, 11);
    for case in ["ordinary", "flag", "not finite", "no rate", "one view", "lens", "lens alone"] {
        let kinds = match case {
            "lens" => WITH_LENS,
            "lens alone" => ViewKinds { lens: true, ..ViewKinds::default() },
            _ => KINDS,
        };
        let (camera_width, gain_width) = if kinds.lens { (10, 4) } else { (6, 3) };
        let count = if case == "one view" { 1 } else { count };
        let at = if case == "one view" { 0 } else { at };
        let all = views(count, 0.01, 0.1, 3);
        let splats = 2 * t.workgroup + 1;
        let (camera_groups, gain_groups) = (3, 5);
        let mut rng = Pcg::new(8);
        let mut part = |n: usize| -> Vec<f32> { (0..n).map(|_| rng.normal() as f32).collect() };
        // Parts past the last workgroup hold what an earlier step left.
        let mut cameras = part(camera_width * camera_groups);
        let gains = part(gain_width * gain_groups);
        if case == "not finite" {
            cameras[6 + 4] = f32::NAN;
        }
        cameras.extend([f32::NAN; 20]);
        let mut g = Graph::new("step");
        let step = g.uniform("step", size_of::<Step>() as u64);
        let handles =
            ViewHandles { views: g.external("views", (count as u64 + 1) * BYTES), count: count as u32, kinds };
        let work = g.input("work", size_of::<Work>() as u64);
        let [camera_parts, gain_parts] =
            [("cameras", cameras.len()), ("gains", gains.len())].map(|(n, len)| g.input(n, 4 * len as u64));
        let (flags, skipped) = (g.input("flags", 4), g.external("skipped", 4));
        let of_gains = kinds.gains.then_some((gain_parts, gain_groups as u32));
        let gradients = ViewGradients { cameras: Some(camera_parts), gains: of_gains };
        let visible = Records::one(work, t.workgroup, splats);
        view_step(&mut g, &t, step, visible, &handles, &gradients, &ViewStatus { flags, skipped }).unwrap();
        let rate = if case == "no rate" { 0.0 } else { 0.01 };
        let values = Step {
            view: at as u32,
            lr_turn: rate,
            lr_shift: 2.0 * rate,
            lr_gain: 3.0 * rate,
            lr_lens: 4.0 * rate,
            lr_radial: 5.0 * rate,
            ..Default::default()
        };
        let inputs = [
            (step, bytes(&[values])),
            (handles.views, bytes(&all)),
            (work, bytes(&[Work { x: 3, y: 1, z: 1, count: splats }])),
            (camera_parts, bytes(&cameras)),
            (gain_parts, bytes(&gains)),
            (flags, bytes(&[u32::from(case == "flag")])),
            (skipped, bytes(&[0_u32])),
        ];
        let out = gpu.run(g, &inputs);
        let found = out.get::<LearnedView>(handles.views);
        assert_eq!(out.get::<u32>(skipped), [u32::from(case == "not finite")]);
        if case == "flag" {
            assert_eq!(bytes(&found), bytes(&all), "a raised flag must leave everything");
            continue;
        }
        let sum = |parts: &[f32], width: usize, i: usize, n: usize| -> f64 {
            parts.chunks_exact(width).take(n).map(|p| f64::from(p[i])).sum()
        };
        let mut expected: Vec<Vec<f64>> = all.iter().map(|v| v.values.map(f64::from).to_vec()).collect();
        let mut moments: Vec<[f64; 2]> = all[at].moments.map(|m| m.map(f64::from)).to_vec();
        for i in 0..9 {
            let gradient = match i < 6 {
                true => sum(&cameras, camera_width, i, camera_groups),
                false => sum(&gains, gain_width, i - 6, gain_groups),
            };
            let learned = if i < 6 { kinds.cameras } else { kinds.gains };
            if !gradient.is_finite() || rate == 0.0 || !learned {
                continue;
            }
            let rates = reference_adam::Rates::at([0.01, 0.02, 0.03][i / 3], all[at].steps + 1);
            (expected[at][i], moments[i]) = reference_adam::adam(expected[at][i], moments[i], gradient, rates);
        }
        let mut lens_moments: Vec<[f64; 2]> = all[count].moments.map(|m| m.map(f64::from)).to_vec();
        for i in (0..LENS).filter(|i| kinds.lens && (*i != 3 || kinds.gains)) {
            let focal = f64::from(all[count].values[0]).exp();
            let gradient = match i {
                0 => sum(&cameras, camera_width, 6, camera_groups),
                // By a shift in given focal lengths.
                1 | 2 => sum(&cameras, camera_width, 6 + i, camera_groups) / focal,
                3 => sum(&gains, gain_width, 3, gain_groups),
                _ => sum(&cameras, camera_width, 9, camera_groups),
            };
            let rate = [0.04, 0.04, 0.04, 0.03, 0.05][i];
            let rates = reference_adam::Rates::at(rate, all[count].steps + 1);
            (expected[count][i], lens_moments[i]) =
                reference_adam::adam(expected[count][i], lens_moments[i], gradient, rates);
            if i == 4 {
                expected[count][i] = expected[count][i].clamp(-0.1, 0.1);
            }
        }
        if count > 1 {
            for i in 0..9 {
                let mean = expected[..count].iter().map(|v| v[i]).sum::<f64>() / count as f64;
                expected[..count].iter_mut().for_each(|v| v[i] -= mean);
            }
        }
        let t = Tolerance::new(2e-7, 2e-5);
        assert_close("values", &expected.concat(), &found.iter().flat_map(|v| v.values).collect::<Vec<f32>>(), t);
        let near = Tolerance::new(1e-7, 1e-5);
        assert_close("moments", &moments.concat(), found[at].moments.as_flattened(), near);
        assert_close("moments of the lens", &lens_moments.concat(), found[count].moments.as_flattened(), near);
        for (i, (new, old)) in found.iter().zip(&all).enumerate() {
            let moves = i == at || i == count && kinds.lens;
            assert_eq!(new.steps, old.steps + u32::from(moves), "steps of view {i}");
            assert!(moves || new.moments == old.moments, "moments of view {i}");
        }
    }
}

/// Tests a view whose camera is off by a degree and whose exposure differs.
#[test]
fn moved_cameras_and_exposures_are_found() {
    let gpu = Gpu::new();
    let size = [64, 48];
    let (splats, camera) = (scenes::ordinary(60, 1, false, 4), scenes::camera(size));
    let model = Model { sh_degree: 1, normals: false, semantics: false, mip: false };
    let gaussians = Gaussians::new(gpu.device(), model, splats.len() as u32, false).unwrap();
    gaussians.upload(gpu.device(), &scenes::data(&splats)).unwrap();
    let truth = scenes::gpu_camera(&camera);
    let mut renderer = Renderer::new(gpu.device(), gpu.tuning(), &gaussians, size, Channels::default()).unwrap();
    let background = [0.3, 0.2, 0.4];
    let image = renderer.render(&gaussians, &truth, 1, background).unwrap().image;
    let gain = [1.1_f32, 0.9, 0.95];
    let byte = |v: f32| (v.clamp(0.0, 1.0) * 255.0).round() as u32;
    let photograph: Vec<u32> = image
        .chunks_exact(3)
        .map(|p| byte(p[0] * gain[0]) | byte(p[1] * gain[1]) << 8 | byte(p[2] * gain[2]) << 16 | 0xff << 24)
        .collect();
    let off = LearnedView { values: [0.017, -0.01, 0.012, 0.02, -0.01, 0.01, 0.0, 0.0, 0.0], ..Default::default() };
    let start = moved(&camera, &off);
    let mut aligner = Aligner::new(gpu.device(), gpu.tuning(), &gaussians, size, KINDS).unwrap();
    let steps: Vec<Step> = (1..=150)
        .map(|step| {
            let decay = 0.01_f32.powf(step as f32 / 150.0);
            Step {
                camera: scenes::gpu_camera(&start),
                background,
                step,
                sh_degree: 1,
                weight_l1: 0.8,
                weight_dssim: 0.2,
                lr_turn: 2e-3 * decay,
                lr_shift: 2e-3 * decay,
                lr_gain: 1e-2 * decay,
                ..Default::default()
            }
        })
        .collect();
    let found = aligner.align(&gaussians, &photograph, &steps).unwrap();
    let again = aligner.align(&gaussians, &photograph, &steps).unwrap();
    assert_eq!(bytes(&[found]), bytes(&[again]), "alignment is not deterministic");
    let back = moved(&start, &found);
    let angle = |c: &Camera| {
        let q = DQuat::from_mat3(&(c.rotation * camera.rotation.transpose()));
        2.0 * q.xyz().length().min(1.0).asin()
    };
    let center = |c: &Camera| -(c.rotation.transpose() * c.translation);
    let distance = |c: &Camera| (center(c) - center(&camera)).length();
    println!("{:.5} -> {:.5} rad, {:.5} -> {:.5}", angle(&start), angle(&back), distance(&start), distance(&back));
    assert!(angle(&back) < 0.1 * angle(&start) && distance(&back) < 0.3 * distance(&start));
    for (c, gain) in gain.into_iter().enumerate() {
        assert!((found.values[6 + c].exp() / gain - 1.0).abs() < 0.02, "{c}: {:?}", found.values);
    }
}
