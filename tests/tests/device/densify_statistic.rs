//! Losses whose gradients enter the densification statistic.

use sgs_config::{Backward, DensifyRule, Settings};
use sgs_passes::reference::rng::Pcg;
use sgs_scene::{Scene, SceneOptions, Splats};
use sgs_tests::meaning::Meaning;
use sgs_tests::rooms::Room;
use sgs_tests::{Gpu, Place, Tolerance, assert_close};
use sgs_train::Geometry;

struct Bench {
    gpu: Gpu,
    scene: Scene,
    splats: Splats,
    _place: Place,
}

impl Bench {
    /// Builds a room with all priors, and splats with nonzero features and normals.
    fn new() -> Bench {
        let room = Room { size: [24, 20], views: 4, spacing: 3, priors: true, ..Room::default() };
        let place = Place::new(room);
        Meaning::default().write(&room, &place.path("scene"));
        let scene = Scene::open(&place.path("scene"), &SceneOptions::default()).unwrap();
        let mut splats = Splats::from_points(&scene.points, 0).unwrap();
        let mut rng = Pcg::new(3);
        splats.semantic = Some((32, (0..32 * splats.len()).map(|_| rng.normal() as f32).collect()));
        splats.normals = Some((0..splats.len()).map(|_| [0; 3].map(|_| rng.normal() as f32)).collect());
        Bench { gpu: Gpu::new(), scene, splats, _place: place }
    }

    /// Returns the gathered statistics of all Gaussians.
    ///
    /// The arrays hold screen gradients, counts, weights, and gradients by the raw normals.
    fn gather(&self, statistic: DensifyRule, change: impl Fn(&mut Settings)) -> [Vec<f32>; 4] {
        let mut s = Settings::default();
        s.geometry.steps = 1000;
        s.geometry.losses.correspondence = 0.0;
        s.geometry.backward = Backward::Pixel;
        s.geometry.densify.rule = statistic;
        change(&mut s);
        let mut training = Geometry::new(self.gpu.device(), &self.scene, &s, Some(&self.splats)).unwrap();
        training.train(1, |_| {}, || true).unwrap();
        let (_, flat) = training.gaussians().download_optimizer(self.gpu.device()).unwrap();
        let rows = flat.as_chunks::<4>().0;
        assert_eq!(rows.len(), self.splats.len());
        [0, 1, 2, 3].map(|k| rows.iter().map(|r| r[k]).collect())
    }
}

/// Disables every loss except color.
fn photometric_alone(s: &mut Settings) {
    let g = &mut s.geometry;
    (g.normals, g.semantics) = (false, false);
    (g.losses.depth_smooth, g.losses.depth_variance) = (0.0, 0.0);
}

/// Disables every loss except those of normals and depth.
fn geometric_alone(s: &mut Settings) {
    (s.geometry.losses.l1, s.geometry.losses.dssim, s.geometry.semantics) = (0.0, 0.0, false);
}

fn near(name: &str, expected: &[f32], found: &[f32]) {
    let most = expected.iter().fold(0.0, |a: f32, b| a.max(b.abs()));
    assert!(most > 0.0, "{name}: nothing was gathered");
    let expected: Vec<f64> = expected.iter().map(|v| f64::from(*v)).collect();
    assert_close(name, &expected, found, Tolerance::new(2e-5 * f64::from(most), 2e-3));
}

/// Each statistic equals the total of a step that has only its losses.
///
/// The steps that gather the statistics have all losses. Every backward kernel is tested.
#[test]
fn a_statistic_holds_the_gradients_of_the_named_losses_alone() {
    let bench = Bench::new();
    let total = DensifyRule::Total;
    let photometric = bench.gather(total, photometric_alone);
    let geometric = bench.gather(total, geometric_alone);
    let all = bench.gather(total, |_| {});
    for backward in [Backward::Pixel, Backward::Splat, Backward::Bucket] {
        let on = |s: &mut Settings| s.geometry.backward = backward;
        let of_color = bench.gather(DensifyRule::Photometric, on);
        near("photometric", &photometric[0], &of_color[0]);
        let of_geometry = bench.gather(DensifyRule::Geometric, on);
        near("geometric", &geometric[0], &of_geometry[0]);
        // Counts and weights are the same for every statistic.
        for found in [&of_color, &of_geometry] {
            assert_eq!(found[1], all[1]);
            near("weights", &all[2], &found[2]);
        }
        // Only the statistic that uses gradients by normals gathers them.
        assert!(of_color[3].iter().all(|v| *v == 0.0) && of_geometry[3].iter().any(|v| *v > 0.0));
        let apart = |a: &[f32], b: &[f32]| a.iter().zip(b).filter(|(a, b)| (*a - *b).abs() > 0.05 * a.abs()).count();
        assert!(apart(&all[0], &of_color[0]) > 20 && apart(&all[0], &of_geometry[0]) > 20);
    }
}

/// Semantic gradients leave photometric and geometric statistics bit-identical.
///
/// They still move geometry.
#[test]
fn semantic_gradients_enter_the_total_alone() {
    let bench = Bench::new();
    let of = |statistic, semantics: bool| bench.gather(statistic, |s| s.geometry.semantics = semantics);
    for statistic in [DensifyRule::Photometric, DensifyRule::Geometric] {
        assert!(of(statistic, true) == of(statistic, false), "{statistic:?}");
    }
    assert!(of(DensifyRule::Total, true)[0] != of(DensifyRule::Total, false)[0]);
    // Without normals and depth, kernels blend only colors.
    let colors = |statistic, semantics: bool| {
        bench.gather(statistic, |s| {
            photometric_alone(s);
            s.geometry.semantics = semantics;
        })
    };
    // These are other kernels; their compiler may contract other sums.
    let (with, without) = (colors(DensifyRule::Photometric, true), colors(DensifyRule::Photometric, false));
    near("gradients", &without[0], &with[0]);
    near("weights", &without[2], &with[2]);
    assert_eq!((&with[1], &with[3]), (&without[1], &without[3]));
    assert!(colors(DensifyRule::Total, true)[0] != colors(DensifyRule::Total, false)[0]);
}

#[test]
fn a_geometric_statistic_without_geometric_losses_is_refused() {
    let bench = Bench::new();
    let mut s = Settings::default();
    photometric_alone(&mut s);
    s.geometry.densify.rule = DensifyRule::Geometric;
    let new = |s: &Settings| Geometry::new(bench.gpu.device(), &bench.scene, s, Some(&bench.splats)).map(|_| ());
    let error = new(&s).unwrap_err().to_string();
    assert!(error.contains("geometric") && error.contains("requires a loss of normals or depth"), "{error}");
    s.geometry.densify.until = 0.0;
    new(&s).unwrap();
}
