//! Kernels as drivers compile them for GPUs that are not here.
//!
//! A planning device builds the graphs of all pipelines ([`graphs`]). A driver compiles each of their kernels, with its
//! specialization constants, in a process of its own ([`worker`]): a compiler may crash. [`report`] holds the result,
//! [`check`] compares it with a stored one.

pub mod check;
pub mod compile;
pub mod graphs;
pub mod report;
pub mod worker;

use serde::{Deserialize, Serialize};
use sgs_engine::graph::{PassKind, Plan};
use sgs_engine::{Device, DeviceOptions, PlannedGpu};
use std::collections::BTreeSet;

/// Kernel with its specialization constants and subgroup size.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct Job {
    /// Name of the kernel.
    pub kernel: String,
    /// Lanes of a subgroup.
    pub lanes: u32,
    /// Specialization constants: id and bits, by ascending id.
    pub specs: Vec<(u32, u32)>,
}

/// Returns the kernels of the graphs of all pipelines on a GPU, each once.
///
/// `select` names the device that stands in for it.
///
/// # Errors
/// If there is no device, or a graph cannot be built.
pub fn jobs(select: Option<&str>, gpu: PlannedGpu) -> anyhow::Result<Vec<Job>> {
    let lanes = gpu.subgroup_size;
    let options = DeviceOptions { select: select.map(str::to_owned), plan_for: Some(gpu), ..Default::default() };
    let device = Device::open(&options)?;
    graphs::build(&device)?;
    let plans = device.plans();
    let jobs: BTreeSet<Job> = plans.iter().flat_map(|plan| jobs_of(plan, lanes)).collect();
    Ok(jobs.into_iter().collect())
}

/// Returns the kernels of the passes of a plan that run.
fn jobs_of(plan: &Plan, lanes: u32) -> impl Iterator<Item = Job> + '_ {
    plan.groups.iter().flat_map(|group| &group.passes).filter_map(move |pass| {
        let PassKind::Compute { shader, specs, subgroup_size, .. } = &plan.passes[*pass].kind else { return None };
        let lanes = subgroup_size.unwrap_or(lanes);
        Some(Job { kernel: shader.name.to_string(), lanes, specs: specs.clone() })
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Kernels that no pipeline runs at 32 lanes without matrix units.
    const ABSENT: [&str; 18] = [
        // Measured by benchmarks only.
        "atomic_probe",
        "copy_probe",
        "fill",
        "fma_probe",
        "image_probe",
        "lights_savings",
        "visibility_bwd",
        "visibility_traced",
        // Narrow subgroups, and loops that a CPU device cuts off.
        "long_tiles",
        "visibility_bwd_lanes",
        "visibility_lights_bwd_lanes",
        "radix_scatter_direct",
        // Matrix units, and their stand-in of tests.
        "lights_field_halves",
        "lights_split_field_halves",
        "lights_train_field_halves",
        "visibility_bwd_halves",
        "visibility_halves",
        "visibility_lights_bwd_halves",
    ];

    #[test]
    fn graphs_cover_every_kernel_and_depend_on_no_run() {
        let gpu = || PlannedGpu { subgroup_size: 32, float_atomics: true, matrices: Vec::new() };
        let select = std::env::var("SGS_TEST_DEVICE").ok();
        let all = jobs(select.as_deref(), gpu()).unwrap();
        let planned: BTreeSet<&str> = all.iter().map(|j| j.kernel.as_str()).collect();
        let missing: Vec<&str> = sgs_shaders::ALL.iter().map(|k| k.name).filter(|k| !planned.contains(k)).collect();
        let unexpected: Vec<&&str> =
            missing.iter().filter(|k| !ABSENT.contains(k) && !k.contains("cooperative")).collect();
        assert!(unexpected.is_empty(), "no pipeline of bench/src/isa/graphs runs {unexpected:?}");
        let stale: Vec<&str> = ABSENT.into_iter().filter(|k| planned.contains(k)).collect();
        assert!(stale.is_empty(), "{stale:?}");
        assert!(all.iter().all(|j| j.lanes == 32), "a pass requests another subgroup size");
        assert_eq!(jobs(select.as_deref(), gpu()).unwrap(), all);
    }
}
