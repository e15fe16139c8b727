//! Long trainings of a tiny room with every loss and learned cameras.
//!
//! Values stay finite, losses do not increase, and memory does not grow.
//!
//! `SGS_TEST_LONG=1` requests 100 000 steps of each stage, `SGS_TEST_LONG=N` requests N.

use sgs_config::{Metallic, Settings};
use sgs_scene::{Scene, SceneOptions};
use sgs_tests::meaning::Meaning;
use sgs_tests::rooms::Room;
use sgs_tests::{Gpu, Place};
use sgs_train::{Geometry, Intrinsic, Progress};
use std::sync::{Mutex, PoisonError};

/// Returns the number of steps of a stage.
///
/// The number is `usual`, unless `SGS_TEST_LONG` sets another.
fn steps(usual: u32) -> u32 {
    match std::env::var("SGS_TEST_LONG").ok().and_then(|n| n.parse().ok()) {
        None => usual,
        Some(1) => 100_000,
        Some(n) => n,
    }
}

fn place() -> Place {
    let room = Room { size: [24, 16], priors: true, ..Room::default() };
    let place = Place::new(room);
    room.write_materials(&place.path("scene"));
    Meaning::default().write(&room, &place.path("scene"));
    place
}

fn settings() -> Settings {
    let mut s = Settings::default();
    let g = &mut s.geometry;
    g.correspondence_from = 1;
    g.pseudo.poses = 3;
    g.rates.views = [1e-5, 1e-4, 1e-4, 1e-4].into();
    (g.densify.max_gaussians, g.entry_capacity) = (1000, 1 << 14);
    let i = &mut s.intrinsic;
    i.metallic = Metallic::On;
    i.environment.resolution = 16;
    i.lights.grid = 2;
    i.relight_from = 1;
    i.rates.normals = 1e-3;
    (i.visibility.levels, i.visibility.log2_table) = (4, 10);
    (i.visibility.coarsest, i.visibility.finest) = (4, 32);
    s
}

/// Lock for one training at a time, since both tests measure this process's memory.
static ALONE: Mutex<()> = Mutex::new(());

/// Returns the resident memory of this process, in bytes.
fn resident() -> Option<u64> {
    let text = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = text.lines().find(|l| l.starts_with("VmRSS:"))?;
    line.split_whitespace().nth(1)?.parse::<u64>().ok().map(|kib| kib << 10)
}

/// Number of losses that must not increase.
///
/// These are the first losses of a course.
const HELD: usize = 4;

/// Record of a long training.
///
/// Holds the losses of each tenth of the steps, and the resident memory at the middle and the end.
#[derive(Default)]
struct Course {
    steps: u32,
    sums: [[f64; 10]; 10],
    counts: [u32; 10],
    resident: [Option<u64>; 2],
}

impl Course {
    fn see(&mut self, step: u32, losses: &[f32]) {
        assert!(losses.iter().all(|l| l.is_finite()), "step {step}: {losses:?}");
        let tenth = ((step - 1) as u64 * 10 / u64::from(self.steps)) as usize;
        self.counts[tenth] += 1;
        self.sums[tenth].iter_mut().zip(losses).for_each(|(s, l)| *s += f64::from(*l));
        // By the middle, the driver has compiled all kernels, and the number of Gaussians is at its cap.
        if step == self.steps / 2 || step == self.steps {
            self.resident[usize::from(step == self.steps)] = resident();
        }
    }

    /// Fails if losses or memory grew, or a loss was zero in a tenth.
    ///
    /// `names` are the names of the recorded losses.
    fn check(&self, what: &str, names: &[&str], device: &sgs_engine::Device) {
        let mean = |tenth: usize| self.sums[tenth].map(|s| s / f64::from(self.counts[tenth]));
        for tenth in 0..10 {
            println!("{what} {tenth}: {:.5?}", &mean(tenth)[..names.len()]);
            for (name, loss) in names.iter().zip(mean(tenth)) {
                assert!(loss > 0.0, "{what}: {name} was off in the tenth number {tenth}");
            }
        }
        println!("resident {:?}, device {:?}", self.resident, device.memory_use());
        for ((name, second), last) in names.iter().zip(mean(1)).zip(mean(9)).take(HELD) {
            assert!(last <= 1.05 * second + 1e-4, "{what}: {name} went from {second} to {last}");
        }
        if let [Some(then), Some(now)] = self.resident {
            assert!(now < then + (16 << 20), "{what}: {then} bytes in memory became {now}");
        }
    }
}

#[test]
fn geometry_with_every_loss() {
    let _alone = ALONE.lock().unwrap_or_else(PoisonError::into_inner);
    let place = place();
    let gpu = Gpu::fresh();
    let scene = Scene::open(&place.path("scene"), &SceneOptions::default()).unwrap();
    let mut s = settings();
    s.geometry.steps = steps(500);
    let mut course = Course { steps: s.geometry.steps, ..Course::default() };
    let mut training = Geometry::new(gpu.device(), &scene, &s, None).unwrap();
    let (mut compared, mut skipped) = (0, 0);
    let progress = |p: &Progress| {
        if let Progress::Step(r) = p {
            let l = &r.losses;
            assert!(l.total.is_finite() && l.depth_variance.is_finite() && l.correspondence.is_finite());
            let held = [0.8 * l.l1 + 0.2 * (1.0 - l.ssim), l.normal, l.semantic, l.semantic_class];
            let others = [l.normal_smooth, l.depth_smooth, l.depth_variance, l.correspondence, l.correspondence_class];
            course.see(r.step, &[&held[..], &others].concat());
            compared += l.correspondence_pairs;
            skipped = r.skipped;
        }
    };
    training.train(s.geometry.steps, progress, || true).unwrap();
    let names = ["photographs", "normals", "features", "classes", "smoothness of normals", "smoothness of depth"];
    let others = ["spread of depth", "correspondence", "correspondence of classes"];
    course.check("geometry", &[&names[..], &others].concat(), gpu.device());
    assert!(compared > 0 && skipped == 0, "{compared} regions were compared, {skipped} gradients were skipped");
    let splats = training.splats().unwrap();
    let all = [splats.means.as_flattened(), splats.log_scales.as_flattened(), splats.rotations.as_flattened()];
    assert!(all.into_iter().flatten().chain(&splats.opacity_logits).all(|v| v.is_finite()));
}

#[test]
fn materials_with_every_loss() {
    let _alone = ALONE.lock().unwrap_or_else(PoisonError::into_inner);
    let place = place();
    let gpu = Gpu::fresh();
    let scene = Scene::open(&place.path("scene"), &SceneOptions::default()).unwrap();
    let mut s = settings();
    (s.geometry.steps, s.intrinsic.steps) = (100, steps(300));
    // Reports do not include these losses.
    let l = &s.intrinsic.losses;
    let unreported = [l.environment_smooth, l.light_position, l.light_value, l.visibility_jitter];
    assert!(unreported.iter().all(|weight| *weight > 0.0), "{unreported:?}");
    if s.intrinsic.steps > 10_000 {
        // Filtering the map takes three quarters of a step with this few pixels.
        s.intrinsic.environment.every = 8;
    }
    let mut geometry = Geometry::new(gpu.device(), &scene, &s, None).unwrap();
    geometry.train(100, |_| {}, || true).unwrap();
    let splats = geometry.splats().unwrap();
    drop(geometry);
    let mut course = Course { steps: s.intrinsic.steps, ..Course::default() };
    let mut training = Intrinsic::new(gpu.device(), &scene, &s, &splats).unwrap();
    let (mut crossed, mut relit, mut skipped) = (0, 0, 0);
    let progress = |r: &sgs_passes::pipeline::IntrinsicReport| {
        let m = &r.materials;
        let others = [m.albedo_msg, m.roughness_msg, m.albedo_edge, m.roughness_edge, m.cross_view, m.own_prior];
        course.see(r.step, &[&[r.shaded, r.albedo, r.roughness, r.metallic][..], &others].concat());
        (crossed, relit, skipped) = (crossed + r.materials.cross_pairs, relit + r.materials.own_count, r.skipped);
    };
    training.train(s.intrinsic.steps, progress, || true).unwrap();
    let names = ["photographs", "albedo", "roughness", "metallic", "gradients of albedo", "gradients of roughness"];
    let others = ["edges of albedo", "edges of roughness", "cross-view", "own prior"];
    course.check("materials", &[&names[..], &others].concat(), gpu.device());
    assert!(crossed > 0 && relit > 0 && skipped == 0, "{crossed} {relit} {skipped}");
    let trained = training.splats().unwrap();
    let all = [trained.albedo.as_ref().unwrap().as_flattened(), trained.roughness.as_ref().unwrap()];
    assert!(all.into_iter().flatten().chain(trained.metallic.as_ref().unwrap()).all(|v| v.is_finite()));
    let lights = training.lights().unwrap().unwrap();
    assert!(lights.lights.iter().flat_map(|l| &l.lobes).all(|l| l.amplitude.iter().all(|a| a.is_finite())));
}
