//! Limits of buffers and kernels.
//!
//! Requests beyond a limit are refused before any allocation.

use sgs_config::{Settings, ShDegree};
use sgs_engine::device::Limits;
use sgs_engine::exec::Executor;
use sgs_engine::graph::Graph;
use sgs_engine::{Device, DeviceOptions, Error, Location};
use sgs_scene::{Scene, SceneOptions, Splats};
use sgs_shaders::BindingKind;
use sgs_tests::kernels::kernel;
use sgs_tests::place::Place;
use sgs_tests::rooms::Room;
use sgs_tests::turn;
use sgs_train::{Geometry, Intrinsic, TrainError};
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
    let device = open(Limits { buffer: photographs - 1, ..Default::default() });
    let error = Intrinsic::new(&device, &scene, &s, &splats).err().unwrap();
    assert!(error.to_string().starts_with("The photographs need 18432 bytes in one buffer"), "{error}");
    assert_untouched(&device);
    // After the photographs, the intermediate buffers of a step are checked.
    let device = open(Limits { buffer: photographs, ..Default::default() });
    let error = Geometry::new(&device, &scene, &s, None).err().unwrap().to_string();
    assert!(error.starts_with("The intermediate results of a step need "), "{error}");
    assert!(error.ends_with("allows 18.0 KiB; use a smaller --scale or fewer points."), "{error}");
    assert_untouched(&device);
}

/// Photographs beyond a binding take several buffers. Training has the same bits, and records each step once per buffer.
#[test]
fn photographs_in_several_buffers_train_the_same_bits() {
    let _turn = turn();
    let place = Place::new(Room { views: 120, size: [64, 48], spacing: 8, priors: true, ..Room::default() });
    let scene = Scene::open(&place.path("scene"), &SceneOptions::default()).unwrap();
    let mut s = Settings::default();
    (s.geometry.steps, s.geometry.densify.until) = (40, 0.0);
    s.geometry.sh_degree = ShDegree::Fixed(0);
    let train = |limits: Limits| {
        let device = open(limits);
        let mut training = Geometry::new(&device, &scene, &s, None).unwrap();
        training.train(40, |_| {}, || true).unwrap();
        let splats = training.splats().unwrap();
        drop(training);
        assert_eq!(device.messages().take(), Vec::<String>::new());
        splats
    };
    // The photographs of all 90 training views take 1080 KiB.
    let split = train(Limits { storage_range: 1000 << 10, ..Default::default() });
    assert!(split == train(Limits::default()), "the parameters differ");
}
