//! Training on smaller photographs in the first steps.

use sgs_config::Settings;
use sgs_passes::pipeline::StepReport;
use sgs_scene::{Camera, Image, Scene, SceneOptions, Splats};
use sgs_tests::rooms::Room;
use sgs_tests::{Gpu, Place};
use sgs_train::{Geometry, Progress};

const STEPS: u32 = 12;

fn settings(coarse: f64) -> Settings {
    let mut s = Settings::default();
    (s.geometry.steps, s.geometry.coarse) = (STEPS, coarse);
    let d = &mut s.geometry.densify;
    (d.from, d.interval, d.grad_threshold) = (4, 4, 1e-5);
    s
}

fn train(training: &mut Geometry, last: u32) -> Vec<StepReport> {
    let mut reports = Vec::new();
    let on_progress = |p: &Progress| {
        if let Progress::Step(report) = p {
            reports.push(*report);
        }
    };
    training.train(last, on_progress, || true).unwrap();
    reports
}

/// Returns the mean of each four pixels, rounded to 8 bits as photographs are.
fn halved(image: &Image) -> Image {
    let [width, height] = [image.width / 2, image.height / 2];
    let at = |x: u32, y: u32, c: u32| (255.0 * image.data[((y * image.width + x) * 3 + c) as usize]).round();
    let mut data = Vec::new();
    for (y, x) in (0..height).flat_map(|y| (0..width).map(move |x| (y, x))) {
        for c in 0..3 {
            let sum: f32 = [(0, 0), (1, 0), (0, 1), (1, 1)].map(|(i, j)| at(2 * x + i, 2 * y + j, c)).iter().sum();
            data.push((0.25 * sum + 0.5).floor() / 255.0);
        }
    }
    Image { width, height, channels: 3, data }
}

fn halved_camera(c: &Camera) -> Camera {
    let (width, height) = (c.width / 2, c.height / 2);
    let [fx, fy, cx, cy] = [c.fx, c.fy, c.cx, c.cy].map(|v| 0.5 * v);
    Camera { width, height, fx, fy, cx, cy, ..c.clone() }
}

#[test]
fn coarse_steps_equal_those_on_halved_photographs() {
    // The last column is left out. A quarter of this size would be too small.
    let place = Place::new(Room { views: 3, size: [135, 128], spacing: 8, ..Room::default() });
    let scene = Scene::open(&place.path("scene"), &SceneOptions::default()).unwrap();
    let start = Splats::from_points(&scene.points, 1).unwrap();
    let gpu = Gpu::new();
    let images: Vec<Image> = scene.split.train.iter().map(|&i| scene.load_image(i).unwrap()).collect();
    let cameras: Vec<Camera> = scene.split.train.iter().map(|&i| scene.views[i].camera.clone()).collect();
    let small: Vec<Camera> = cameras.iter().map(halved_camera).collect();
    let of = |cameras: &[Camera], images: Vec<Image>, coarse| {
        let views: Vec<(&Camera, Image)> = cameras.iter().zip(images).collect();
        let mut s = settings(coarse);
        s.geometry.densify.until = 0.0;
        let mut training = Geometry::on_images(gpu.device(), &views, &s, &start).unwrap();
        (train(&mut training, 6), training.splats().unwrap())
    };
    let (coarse, splats) = of(&cameras, images.clone(), 1.0);
    let (expected, expected_splats) = of(&small, images.iter().map(halved).collect(), 0.0);
    let (full, _) = of(&cameras, images, 0.0);
    for ((a, b), other) in coarse.iter().zip(&expected).zip(&full) {
        let (a, b, other) = (a.losses.total, b.losses.total, other.losses.total);
        assert!((a - b).abs() <= 1e-4 * b, "step on a halved photograph: loss {a}, expected {b}");
        assert!((a - other).abs() > 1e-3 * b, "the loss {a} tells coarse from full photographs");
    }
    let off = splats.means.as_flattened().iter().zip(expected_splats.means.as_flattened());
    let off = off.map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
    assert!(off < 1e-3, "means differ by {off}");
}

#[test]
fn coarse_training_with_priors_resumes_with_the_same_bits() {
    let place = Place::new(Room { views: 4, size: [272, 256], spacing: 16, priors: true, ..Room::default() });
    let scene = Scene::open(&place.path("scene"), &SceneOptions::default()).unwrap();
    let gpu = Gpu::new();
    let new = || Geometry::new(gpu.device(), &scene, &settings(0.75), None).unwrap();
    let mut whole = new();
    let reports = train(&mut whole, STEPS);
    // Small photographs show fewer tiles: a quarter of the size until step 4, half until step 8.
    let most = |steps: std::ops::Range<usize>| reports[steps].iter().map(|r| r.entries).max().unwrap();
    let [quarter, half, full] = [0..4, 4..8, 8..12].map(most);
    assert!(quarter < half && half < full, "entries: {quarter}, {half}, {full}");
    let mut last = new();
    for end in [3, 6, STEPS] {
        let mut next = new();
        if end > 3 {
            next.restore(&place.path("state")).unwrap();
        }
        train(&mut next, end);
        next.save(&place.path("state")).unwrap();
        last = next;
    }
    assert!(last.splats().unwrap() == whole.splats().unwrap(), "resumed training differs");
}
