//! Host cost of a large plan: compilation, verification and replay.

use crate::harness::Rig;
use crate::report::Report;
use crate::stats::Summary;
use sgs_engine::Device;
use sgs_engine::graph::{CompileOptions, Graph, GraphError, verify};
use sgs_passes::kernel::stage;
use sgs_shaders::fill;
use std::time::Instant;

/// Number of passes of the plan.
const PASSES: u32 = 1000;

/// Builds a step of [`PASSES`] small passes, none of which can be culled.
///
/// They are kernels, and copies of recent or old results.
fn large() -> Result<Graph, GraphError> {
    let mut g = Graph::new("thousand");
    let (bytes, kinds) = (256, 24);
    let stored: Vec<_> =
        (0..kinds).map(|i| g.external(format!("kept{i}"), bytes * (PASSES as u64 / kinds + 1))).collect();
    let transients: Vec<_> = (0..PASSES / 4).map(|i| g.transient(format!("transient{i}"), bytes)).collect();
    // Every pass except each fourth stores its result in a range of its own.
    let own = |pass: u64| stored[(pass % kinds) as usize].slice(pass / kinds * bytes, bytes);
    for i in 0..u64::from(PASSES) {
        let (made, name) = (transients[i as usize / 4], format!("pass{i}"));
        match i % 4 {
            0 => {
                let push = fill::Push { count: bytes as u32 / 4, value: i as u32 };
                let bindings = fill::Bindings { target: made.into() };
                let specs = fill::Specs { workgroup: 64 };
                stage(&mut g, &name, &fill::KERNEL, bindings.entries(), specs.entries(), bytemuck::bytes_of(&push))
                    .dispatch([1, 1, 1])?;
            }
            1 => g.copy(name, made, own(i))?,
            _ => {
                let earlier = i - 1 - (i * 7 % 40).min(i - 2);
                g.copy(name, own(if earlier.is_multiple_of(4) { earlier + 1 } else { earlier }), own(i))?;
            }
        }
    }
    Ok(g)
}

/// Adds compilation, verification and replay of such a plan to the report.
///
/// # Errors
/// If the device fails.
pub fn measure(device: &Device, report: &mut Report, repeats: u32) -> anyhow::Result<()> {
    let options = CompileOptions { verify: false, ..Default::default() };
    let (mut compiling, mut proving) = (Vec::new(), Vec::new());
    for _ in 0..repeats.max(5) {
        let graph = large()?;
        let begin = Instant::now();
        let plan = graph.compile(&options)?;
        compiling.push(begin.elapsed().as_secs_f64() * 1e3);
        anyhow::ensure!(plan.culled.is_empty(), "{} of {PASSES} passes were dropped.", plan.culled.len());
        let begin = Instant::now();
        verify(&plan)?;
        proving.push(begin.elapsed().as_secs_f64() * 1e3);
    }
    report.value(&format!("compiling a plan of {PASSES} passes"), "ms", Summary::of(&compiling));
    report.value(&format!("proving a plan of {PASSES} passes"), "ms", Summary::of(&proving));
    let mut rig = Rig::new(device, large()?, vec![], false)?;
    rig.measure(2, 1)?;
    let before = rig.host_times();
    rig.measure(1, repeats.max(5))?;
    let (rest, submitting) = rig.host_times().since(&before);
    report.fact(&format!("host, a replay of {PASSES} passes without its submission, us"), rest * 1e6);
    report.fact(&format!("host, submitting {PASSES} passes, us"), submitting * 1e6);
    Ok(())
}
