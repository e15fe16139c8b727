//! Steps of training with Markov chain Monte Carlo: regularizers and noise, against their references.

use sgs_engine::Location;
use sgs_passes::pipeline::{GeometryOptions, GeometryStep, Inputs, Status};
use sgs_passes::reference::project::rotation;
use sgs_passes::reference::relocate as reference;
use sgs_passes::scene::{GaussianData, Gaussians, Group, Layout, Model, Storage};
use sgs_passes::splat::Channels;
use sgs_shaders::structs::Step;
use sgs_tests::whole::step_options;
use sgs_tests::{Gpu, Tolerance, assert_close, scenes};

/// Gaussians and moments after one step of training from zero moments.
fn step_of(gpu: &Gpu, data: &GaussianData, model: Model, mcmc: bool, values: &Step) -> [GaussianData; 2] {
    let device = gpu.device();
    let layout =
        Layout { model, capacity: data.len() as u32 + 7, training: true, statistics: false, storage: Storage::Exact };
    let gaussians = Gaussians::of(device, &layout).unwrap();
    gaussians.upload(device, data).unwrap();
    let size = values.camera.size;
    let pixels = size[0] as usize * size[1] as usize;
    let targets = device.buffer("targets", 4 * pixels as u64, Location::Device).unwrap();
    device.upload(&targets, 0, bytemuck::cast_slice(&vec![0xff80_8080_u32; pixels])).unwrap();
    let inputs = Inputs::of(&targets);
    let channels = Channels { colors: true, normals: false, depth: false };
    let options = GeometryOptions { mcmc, ..step_options(size, channels) };
    let status = Status::new(device).unwrap();
    let mut exec = GeometryStep::new(device, &gpu.tuning(), &gaussians, &inputs, &status, options).unwrap();
    exec.submit(values).unwrap();
    exec.finish().unwrap();
    let report = status.report(values.step).unwrap();
    assert_eq!((report.flags, report.skipped), (0, 0));
    let (moments, _) = gaussians.download_optimizer(device).unwrap();
    [gaussians.download(device).unwrap(), moments]
}

/// A step adds gradients of regularizers and noise to every Gaussian, seen or not.
#[test]
fn step_regularizes_all_gaussians_and_adds_noise() {
    let gpu = Gpu::new();
    let g = scenes::ordinary(120, 0, false, 3);
    let mut data = scenes::data(&g);
    // A fifth lies behind the camera, and a fifth is faint.
    for i in 0..24 {
        data.groups[Group::Means as usize][3 * (5 * i) + 2] = -4.0;
        data.groups[Group::OpacityLogits as usize][5 * i + 1] = -5.0;
    }
    data.groups[Group::LogScales as usize][0] = -17.0;
    data.groups[Group::LogScales as usize][4] = 8.5;
    let model = Model::default();
    let camera = scenes::camera([40, 30]);
    let settings = sgs_config::Settings::default();
    let mut values = sgs_train::Schedule::new(&settings, 1.0, 1).step(1, &scenes::gpu_camera(&camera), 0);
    values.sh_degree = 0;
    let [plain, plain_moments] = step_of(&gpu, &data, model, false, &values);
    (values.weight_opacity, values.weight_scale, values.noise) = (20.0, 40.0, 80.0);
    let [mcmc, mcmc_moments] = step_of(&gpu, &data, model, true, &values);
    let weights = [20.0, 40.0];
    let pairs = |data: &GaussianData, group: Group, k: usize| f64::from(data.group(group)[2 * k]);
    let (mut unseen, mut noisy) = (0, 0);
    for i in 0..120 {
        let logit = f64::from(data.group(Group::OpacityLogits)[i]);
        for k in 0..3 {
            let log_scale = f64::from(data.group(Group::LogScales)[3 * i + k]);
            let [by_logit, by_scale] = reference::regularizer_gradient(weights, logit, log_scale, 120);
            for (group, at, gradient) in [(Group::OpacityLogits, i, by_logit), (Group::LogScales, 3 * i + k, by_scale)]
            {
                let (was, is) = (pairs(&plain_moments, group, at), pairs(&mcmc_moments, group, at));
                let expected = 0.1 * gradient;
                let error = (is - was - expected).abs();
                assert!(
                    error < 1e-5 * (expected.abs() + was.abs()) + 1e-9,
                    "{} {at}: {was} {is} {expected}",
                    group.name()
                );
            }
        }
        unseen += usize::from(pairs(&plain_moments, Group::OpacityLogits, i) == 0.0);
        let after = |group: Group, k: usize| f64::from(mcmc.group(group)[i * group.width() as usize + k]);
        let q: Vec<f64> = (0..4).map(|k| after(Group::Rotations, k)).collect();
        let rows = [0, 1, 2].map(|r| rotation(&q).row(r).to_array());
        let scale = [0, 1, 2].map(|k| after(Group::LogScales, k).clamp(-16.0, 8.0).exp());
        let noise = reference::noise(after(Group::OpacityLogits, 0), scale, rows, 80.0, values.seed, i as u32);
        let size = noise.iter().fold(0.0, |a: f64, b| a.max(b.abs()));
        noisy += usize::from(size > 1e-4);
        let expected: Vec<f64> = (0..3).map(|k| f64::from(plain.group(Group::Means)[3 * i + k]) + noise[k]).collect();
        let found = &mcmc.group(Group::Means)[3 * i..][..3];
        // Adam's first step divides gradients by their size, so other scales change nothing in it.
        assert_close("mean", &expected, found, Tolerance::new(1e-4 * size + 1e-6, 1e-6));
    }
    assert!((24..100).contains(&unseen) && noisy >= 12, "{unseen} {noisy}");
}
