//! Limits of buffers and kernels.
//!
//! Requests beyond a limit are refused before any allocation.

use sgs_config::{Settings, ShDegree};
use sgs_engine::device::Limits;
use sgs_engine::exec::Executor;
use sgs_engine::graph::Graph;
use sgs_engine::{Device, DeviceOptions, Error, Location};
use sgs_passes::pipeline::IntrinsicReport;
use sgs_scene::{Scene, SceneOptions, Splats};
use sgs_shaders::BindingKind;
use sgs_tests::kernels::kernel;
use sgs_tests::meaning::Meaning;
use sgs_tests::place::Place;
use sgs_tests::priors::provider;
use sgs_tests::rooms::Room;
use sgs_tests::turn;
use sgs_train::{Geometry, Intrinsic, Progress, TrainError};
use std::sync::Arc;

fn open(limits: Limits) -> Device {
    let select = std::env::var("SGS_TEST_DEVICE").ok();
    Device::open(&DeviceOptions { select, validation: true, limits, ..Default::default() }).unwrap()
}

/// Fails if anything was allocated or validation reported a message.
fn assert_untouched(device: &Device) {
    assert_eq!((device.memory_use(), device.activity().made), ((0, 0), 0));
    assert_eq!(device.messages().take(), Vec::<String>::new());
}

#[test]
fn every_limit_of_the_device_is_known() {
    let _turn = turn();
    let own = open(Limits::default());
    let info = own.info();
    assert!(info.max_buffer >= 1 << 27 && info.max_allocation >= 1 << 27, "{info:?}");
    assert!(info.max_storage_buffers >= 16 && info.largest_binding() <= info.max_storage_range);
    let limits = Limits { storage_range: 1 << 24, buffer: 1 << 23, allocation: 1 << 22, storage_buffers: 4 };
    let device = open(limits);
    let info = device.info();
    let found = [info.max_storage_range, info.max_buffer, info.max_allocation, info.max_storage_buffers.into()];
    assert_eq!(found, [1 << 24, 1 << 23, 1 << 22, 4]);
    assert_eq!((info.largest_buffer(), info.largest_binding()), (1 << 22, 1 << 22));
}

/// Every device that the engine opens allows as many.
#[test]
fn kernels_bind_at_most_sixteen_storage_buffers() {
    for kernel in sgs_shaders::ALL {
        let count = kernel.bindings.iter().filter(|b| b.kind == BindingKind::Storage).count();
        assert!(count <= 16, "{} binds {count} storage buffers", kernel.name);
    }
}

#[test]
fn buffers_beyond_a_limit_are_refused() {
    let _turn = turn();
    for limits in [Limits { buffer: 4096, ..Default::default() }, Limits { allocation: 4096, ..Default::default() }] {
        let device = open(limits);
        let error = device.buffer("photographs", 4097, Location::Device).unwrap_err();
        let name = &device.info().name;
        let sentence = format!("Buffer \"photographs\" needs 4100 bytes, but {name} allows 4096 in one buffer.");
        assert_eq!(error.to_string(), sentence);
        assert_untouched(&device);
        device.buffer("photographs", 4096, Location::Device).unwrap();
    }
}

#[test]
fn plans_beyond_a_limit_are_refused() {
    let _turn = turn();
    let plan = |bytes: u64| {
        let mut graph = Graph::new("limits");
        let (from, to) = (graph.input("from", bytes), graph.external("to", bytes));
        let between = graph.transient("between", bytes);
        let pass = |graph: &mut Graph, from, to| {
            graph.pass("map", &kernel("map")).push(&[0; 4]).bind("from", from).bind("to", to).dispatch([1, 1, 1])
        };
        pass(&mut graph, from, between).unwrap();
        pass(&mut graph, between, to).unwrap();
        Arc::new(graph.compile(&Default::default()).unwrap())
    };
    let refused = |limits: Limits| {
        let device = open(limits);
        let error = Executor::new(&device, plan(8192), Default::default()).map(|_| ()).unwrap_err();
        assert_untouched(&device);
        (error.to_string().replace(&device.info().name, "NAME"), error)
    };
    let (text, error) = refused(Limits { storage_buffers: 1, ..Default::default() });
    assert_eq!(text, "Pass \"map\" binds 2 storage buffers, but NAME allows 1 in one kernel.");
    assert!(matches!(error, Error::TooManyBuffers { .. }));
    let (text, _) = refused(Limits { storage_range: 4096, ..Default::default() });
    let sentence = "needs 8192 bytes, but one storage binding covers at most 4096 on this device.";
    assert!(text.ends_with(sentence), "{text}");
    let (text, _) = refused(Limits { allocation: 4096, ..Default::default() });
    assert_eq!(text, "Buffer \"arena of limits\" needs 8192 bytes, but NAME allows 4096 in one buffer.");
}

#[test]
fn trainings_beyond_a_limit_are_refused_before_they_allocate() {
    let _turn = turn();
    let place = Place::new(Room { priors: true, ..Room::default() });
    let scene = Scene::open(&place.path("scene"), &SceneOptions::default()).unwrap();
    let mut s = Settings::default();
    s.geometry.steps = 2;
    // Bytes of a training view of 32 x 24 pixels, and of all six.
    let photograph = 4 * 32 * 24;
    let photographs = 6 * photograph;
    for limits in [
        Limits { buffer: photograph - 1, ..Default::default() },
        Limits { allocation: photograph - 1, ..Default::default() },
        Limits { storage_range: photograph - 1, ..Default::default() },
    ] {
        let device = open(limits);
        let error = Geometry::new(&device, &scene, &s, None).err().unwrap();
        assert!(matches!(error, TrainError::Limit(_)), "{error}");
        let name = &device.info().name;
        let sentence = format!(
            "The pixels of a photograph need 3072 bytes in one buffer, but {name} allows 3071 bytes; use --scale 0.75."
        );
        assert_eq!(error.to_string(), sentence);
        assert_untouched(&device);
    }
    let splats = Splats::from_points(&scene.points, 0).unwrap();
    let device = open(Limits { buffer: photograph - 1, ..Default::default() });
    let error = Intrinsic::new(&device, &scene, &s, &splats).err().unwrap();
    assert!(error.to_string().starts_with("The pixels of a photograph need 3072 bytes in one buffer"), "{error}");
    assert_untouched(&device);
    // After the photographs, the intermediate buffers of a step are checked.
    let device = open(Limits { buffer: photographs, ..Default::default() });
    let error = Geometry::new(&device, &scene, &s, None).err().unwrap().to_string();
    assert!(error.starts_with("The intermediate results of a step need "), "{error}");
    assert!(error.ends_with("allows 18.0 KiB; use a smaller --scale or fewer points."), "{error}");
    assert_untouched(&device);
}

/// Limit of a binding that only the photographs of [`many_views`] exceed.
const SPLIT: Limits = Limits { storage_range: 1070 << 10, ..UNLIMITED };
const UNLIMITED: Limits =
    Limits { storage_range: u64::MAX, buffer: u64::MAX, allocation: u64::MAX, storage_buffers: u32::MAX };

/// Room whose 90 training views have photographs of 1080 KiB.
fn many_views() -> Room {
    Room { views: 120, size: [64, 48], spacing: 8, priors: true, ..Room::default() }
}

/// Photographs beyond a binding take several buffers, and train the same bits.
///
/// Each step is recorded once per buffer. Regions of the views, which take one buffer, are still found.
#[test]
fn photographs_in_several_buffers_train_the_same_bits() {
    let _turn = turn();
    // Features and semantic targets take one buffer each: few Gaussians, and few samples of a view, keep within it.
    let room = many_views();
    let place = Place::new(room);
    Meaning { masks: true, stride: 32, ..Meaning::default() }.write(&room, &place.path("scene"));
    let scene = Scene::open(&place.path("scene"), &SceneOptions::default()).unwrap();
    let mut s = Settings::default();
    (s.geometry.steps, s.geometry.densify.until) = (40, 0.0);
    s.geometry.sh_degree = ShDegree::Fixed(0);
    (s.geometry.correspondence_from, s.geometry.pseudo.poses) = (21, 3);
    s.geometry.entry_capacity = 5000;
    let start = Splats::from_points(&scene.points, 0).unwrap().strongest(400);
    let train = |limits: Limits, coarse: f64| {
        let device = open(limits);
        let s = Settings { geometry: sgs_config::GeometrySettings { coarse, ..s.geometry.clone() }, ..s.clone() };
        let mut training = Geometry::new(&device, &scene, &s, Some(&start)).unwrap();
        let mut pairs = Vec::new();
        let on_progress = |p: &Progress| {
            if let Progress::Step(r) = p {
                pairs.push(r.losses.correspondence_pairs);
            }
        };
        training.train(40, on_progress, || true).unwrap();
        let splats = training.splats().unwrap();
        drop(training);
        assert_eq!(device.messages().take(), Vec::<String>::new());
        (splats, pairs)
    };
    let whole = train(UNLIMITED, 0.0);
    assert!(whole.1[20..].iter().filter(|pairs| **pairs > 0).count() > 10, "{:?}", whole.1);
    let split = train(SPLIT, 0.0);
    assert_eq!(split.1, whole.1);
    assert!(split.0 == whole.0, "the parameters differ");
    // Smaller photographs lie between those of full size. Without a step that uses them, they change nothing.
    assert!(train(UNLIMITED, 1e-6) == whole, "smaller photographs change the regions");
}

/// Priors and estimates beyond a binding take several buffers, as photographs do.
///
/// Training of the intrinsic stage has the same bits, and so have checkpoints.
#[test]
fn materials_in_several_buffers_train_the_same_bits() {
    let _turn = turn();
    let (room, steps) = (many_views(), 24);
    let place = Place::new(room);
    room.write_materials(&place.path("scene"));
    let scene = Scene::open(&place.path("scene"), &SceneOptions::default()).unwrap();
    let splats = Splats::from_points(&scene.points, 0).unwrap();
    let mut s = sgs_tests::intrinsic::settings(steps);
    s.intrinsic.relight_from = 1;
    (s.intrinsic.relight.provider, s.intrinsic.relight.roughness) = (provider("misbehave=nothing"), 0.5);
    let train = |limits: Limits, name: &str, from: Option<&str>| {
        let device = open(limits);
        let mut training = Intrinsic::new(&device, &scene, &s, &splats).unwrap();
        // Two buffers of 46 views, or one of 90.
        let views = if limits == SPLIT { 2 * 46 } else { 90 };
        assert_eq!(training.needs().photographs, views * 4 * 64 * 48);
        let mut reports = Vec::new();
        match from {
            Some(from) => training.restore(&place.path(from)).unwrap(),
            None => {
                training.train(steps / 2, |r| reports.push(*r), || true).unwrap();
                training.save(&place.path(name)).unwrap();
            }
        }
        training.train(steps, |r| reports.push(*r), || true).unwrap();
        let splats = training.splats().unwrap();
        // A probed step reads the images of its own view.
        let probe = training.probe().unwrap();
        drop(training);
        assert_eq!(device.messages().take(), Vec::<String>::new());
        (reports, splats, probe.image, probe.gradients)
    };
    let whole = train(UNLIMITED, "whole", None);
    let compared = |of: fn(&IntrinsicReport) -> bool| whole.0.iter().filter(|r| of(r)).count();
    assert!(compared(|r| r.materials.cross_pairs > 0) > 4 && compared(|r| r.materials.relight_count == 2) > 4);
    let split = train(SPLIT, "split", None);
    assert_eq!(split.0, whole.0);
    assert!(split == whole, "the parameters differ");
    assert!(place.read("split") == place.read("whole"), "the checkpoints differ");
    // A checkpoint of one buffer continues in several.
    let resumed = train(SPLIT, "resumed", Some("whole"));
    assert!(resumed.0 == whole.0[steps as usize / 2..] && resumed.1 == whole.1, "the parameters differ after a resume");
}
