//! Devices that run nothing: one plans graphs for another GPU, one compiles only.

use sgs_engine::device::Objects;
use sgs_engine::exec::{ExecOptions, Executor};
use sgs_engine::graph::{CompileOptions, Graph, PassKind};
use sgs_engine::{CompileOnlyDevice, Device, DeviceOptions, Error, Location, PlannedGpu};
use sgs_passes::Tuning;
use sgs_tests::kernels::kernel;
use sgs_tests::turn;
use std::sync::Arc;

fn planning(subgroup_size: u32, objects: &Objects) -> Device {
    let gpu = PlannedGpu { subgroup_size, float_atomics: true, matrices: Vec::new() };
    let select = std::env::var("SGS_TEST_DEVICE").ok();
    let objects = objects.clone();
    Device::open(&DeviceOptions { select, validation: true, plan_for: Some(gpu), objects, ..Default::default() })
        .unwrap()
}

#[test]
fn planning_device_collects_graphs_and_runs_none() {
    let _turn = turn();
    let objects = Objects::default();
    for lanes in [32, 64] {
        let device = planning(lanes, &objects);
        let info = device.info();
        assert_eq!((info.subgroup_size, info.subgroup_sizes, info.kind), (lanes, (lanes, lanes), "discrete"));
        assert_eq!(Tuning::for_device(info), Tuning::for_subgroups(lanes));
        assert!(device.plans().is_empty());
        let mut g = Graph::new("lanes");
        let to = g.external("to", 4 * 4 * 128);
        g.pass("lanes", &kernel("lanes")).bind("to", to).dispatch([1, 1, 1]).unwrap();
        let plan = Arc::new(g.compile(&CompileOptions::default()).unwrap());
        let mut exec = Executor::new(&device, plan, ExecOptions::default()).unwrap();
        let memory = device.buffer("to", 4 * 4 * 128, Location::Device).unwrap();
        exec.bind(to, &memory).unwrap();
        // The stand-in has no subgroups of this size: the kernel could not run on it.
        for _ in 0..3 {
            let ticket = exec.submit(&[]).unwrap();
            device.wait(ticket, "lanes").unwrap();
        }
        exec.finish().unwrap();
        assert_eq!(device.download(&memory, 0, 4 * 4 * 128).unwrap(), vec![0; 4 * 4 * 128]);
        assert!(device.pipelines().is_empty());
        let plans = device.plans();
        assert_eq!(plans.len(), 1);
        assert!(matches!(&plans[0].passes[0].kind, PassKind::Compute { shader, .. } if shader.name == "lanes"));
        // Copies of the host run.
        device.upload(&memory, 0, &[7; 8]).unwrap();
        assert_eq!(device.download(&memory, 0, 12).unwrap(), [7, 7, 7, 7, 7, 7, 7, 7, 0, 0, 0, 0]);
        assert_eq!(device.messages().take(), Vec::<String>::new());
    }
    assert_eq!(objects.alive(), []);
}

#[test]
fn ordinary_device_collects_no_graphs() {
    let _turn = turn();
    let select = std::env::var("SGS_TEST_DEVICE").ok();
    let device = Device::open(&DeviceOptions { select, ..Default::default() }).unwrap();
    let plan = Arc::new(Graph::new("empty").compile(&CompileOptions::default()).unwrap());
    Executor::new(&device, plan, ExecOptions::default()).unwrap();
    assert!(device.plans().is_empty());
}

#[test]
fn compile_only_device_compiles_or_names_what_is_missing() {
    let _turn = turn();
    let objects = Objects::default();
    match CompileOnlyDevice::open(std::env::var("SGS_TEST_DEVICE").ok().as_deref(), objects.clone()) {
        Ok(device) => {
            let shader = kernel("lanes");
            let found = device.compile(&shader, &[], None).unwrap();
            assert_eq!((found.pipeline.kernel.as_str(), found.pipeline.workgroup), ("lanes", [128, 1, 1]));
            let (_, high) = device.info().subgroup_sizes;
            let error = device.compile(&shader, &[], Some(2 * high)).unwrap_err();
            assert!(matches!(error, Error::SubgroupSize { .. }), "{error}");
        }
        Err(error) => {
            assert!(matches!(error, Error::MissingFeatures { .. }), "{error}");
            assert!(error.to_string().ends_with("lacks VK_KHR_pipeline_executable_properties."), "{error}");
        }
    }
    assert_eq!(objects.alive(), []);
    let error = CompileOnlyDevice::open(Some("no such device"), objects.clone()).err().unwrap();
    assert!(error.to_string().starts_with("No Vulkan device matches \"no such device\"; found: "), "{error}");
    assert_eq!(objects.alive(), []);
}
