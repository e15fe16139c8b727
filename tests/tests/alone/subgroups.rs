//! Subgroup sizes: every pipeline requests its own. Kernels run at the size that they are specialized for.

use sgs_engine::Error;
use sgs_engine::device::PipelineInfo;
use sgs_engine::graph::Graph;
use sgs_passes::kernel::shader;
use sgs_tests::Gpu;
use sgs_tests::gpu::subgroup_faults;
use sgs_tests::kernels::kernel;

/// Tests every kernel, compiled for the device's subgroup size.
#[test]
fn every_kernel_requests_its_subgroup_size() {
    let gpu = Gpu::fresh();
    let size = gpu.subgroup_size();
    for kernel in sgs_shaders::ALL {
        let specs = [("SUBGROUP", size), ("WORKGROUP", size.max(64))];
        gpu.device().compile(&shader(kernel), &specs, None).unwrap_or_else(|e| panic!("{e}"));
    }
    let made = gpu.device().pipelines();
    assert_eq!(made.len(), sgs_shaders::ALL.len());
    assert!(made.iter().filter(|p| p.uses_subgroups).count() > 60, "kernels that use subgroups are recognized");
    let control = gpu.device().info().optional.subgroup_size_control;
    for pipeline in &made {
        assert_eq!((pipeline.requested, pipeline.subgroup_size), (control, size), "{pipeline:?}");
    }
    // `Gpu` checks every pipeline of every other test the same way.
    assert_eq!(subgroup_faults(gpu.device()), [""; 0]);
}

#[test]
fn kernels_see_the_size_that_their_pipeline_requests() {
    let gpu = Gpu::fresh();
    let (low, high) = gpu.device().info().subgroup_sizes;
    let sizes = (3..8).map(|bits| 1 << bits).filter(|size| (low..=high).contains(size));
    for requested in sizes.map(Some).chain([None]) {
        let mut graph = Graph::new("lanes");
        let to = graph.external("to", 4 * 4 * 128);
        let pass = graph.pass("lanes", &kernel("lanes")).bind("to", to).subgroup_size(requested);
        pass.dispatch([1, 1, 1]).unwrap();
        let words = gpu.run(graph, &[]).get::<u32>(to);
        let size = requested.unwrap_or(gpu.subgroup_size());
        let expected: Vec<u32> = (0..128).flat_map(|i| [size, 128 / size, i, size]).collect();
        assert_eq!(words, expected, "{requested:?}");
    }
    let info = |p: &PipelineInfo| (p.kernel.clone(), p.workgroup, p.full_subgroups);
    let full = gpu.device().info().optional.full_subgroups;
    let made = gpu.device().pipelines();
    assert!(made.iter().all(|p| info(p) == ("lanes".to_owned(), [128, 1, 1], full)), "{made:?}");
}

#[test]
fn sizes_that_the_device_does_not_run_are_refused() {
    let gpu = Gpu::fresh();
    let (low, high) = gpu.device().info().subgroup_sizes;
    let error = gpu.device().compile(&kernel("lanes"), &[], Some(2 * high)).unwrap_err();
    assert!(matches!(error, Error::SubgroupSize { .. }));
    let sentence =
        format!("Kernel \"lanes\" requests {} lanes a subgroup, but the device runs {low} to {high}.", 2 * high);
    assert_eq!(error.to_string(), sentence);
    assert!(gpu.device().pipelines().is_empty());
}
