//! Executor on a real device: fills, kernels, copies, replay.

use sgs_engine::graph::Graph;
use sgs_passes::kernel::{groups, stage};
use sgs_shaders::fill;
use sgs_tests::Gpu;

#[test]
fn fill_kernel_writes_only_its_words() {
    let gpu = Gpu::new();
    let mut g = Graph::new("fill");
    let out = g.external("out", 4 * 1000);
    let bindings = fill::Bindings { target: out.into() }.entries();
    let push = fill::Push { count: 777, value: 42 };
    stage(&mut g, "fill", &fill::KERNEL, bindings, fill::Specs::default().entries(), bytemuck::bytes_of(&push))
        .dispatch(groups(777, 256))
        .unwrap();
    let words: Vec<u32> = gpu.run(g, &[]).get(out);
    assert!(words[..777].iter().all(|&w| w == 42));
    assert!(words[777..].iter().all(|&w| w == u32::MAX));
}
