//! Registers, spills and shared memory of every kernel on GPUs that are not here: `engine-bench isa`.

use crate::common::Common;
use crate::isa::check::{check, stored_like};
use crate::isa::compile::Target;
use crate::isa::report::{Family, Report};
use crate::isa::{Job, jobs};
use sgs_engine::{PlannedGpu, driver_files};
use std::path::PathBuf;

/// Options of the command.
#[derive(clap::Args, Clone, Debug)]
pub struct Args {
    /// GPU families, by the names of Mesa's RADV: vega10, navi21, navi31, gfx1201.
    #[arg(long, value_name = "NAMES", value_delimiter = ',', default_values = ["navi21", "vega10"])]
    pub family: Vec<String>,
    /// Subgroup sizes. A family skips those that it does not have.
    #[arg(long, value_name = "LANES", value_delimiter = ',', default_values_t = [32, 64], value_parser = clap::value_parser!(u32).range(8..=128))]
    pub lanes: Vec<u32>,
    /// Driver file of RADV for the Vulkan loader; by default the installed one.
    #[arg(long, value_name = "FILE.json")]
    pub driver: Option<PathBuf>,
    /// Only kernels whose names contain one of these.
    #[arg(long, value_name = "NAMES", value_delimiter = ',')]
    pub kernel: Vec<String>,
    /// Write the report as JSON.
    #[arg(short, long, value_name = "FILE.json")]
    pub output: Option<PathBuf>,
    /// Fail if a kernel is worse than in this file or folder of reports.
    ///
    /// Worse: new spills, more than 10 % more vector registers, or no longer compiled.
    #[arg(long, value_name = "PATH")]
    pub check: Option<PathBuf>,
}

/// Runs the command.
///
/// # Errors
/// If the driver is missing, a graph cannot be built, or a kernel is worse than stored.
pub fn run(common: &Common, a: &Args) -> anyhow::Result<()> {
    let stored = a.check.as_deref().map(Report::read).transpose()?;
    let driver = match &a.driver {
        Some(file) => {
            anyhow::ensure!(file.is_file(), "\"{}\" is no driver file of the Vulkan loader.", file.display());
            std::path::absolute(file)?
        }
        None => installed()?,
    };
    let mut report = Report::default();
    let mut planned: Vec<(PlannedGpu, Vec<Job>)> = Vec::new();
    for family in &a.family {
        let target = Target { family: family.clone(), driver: driver.clone() };
        let gpu = target.gpu()?;
        if let Some(stored) = &stored {
            stored_like(stored, family, &gpu)?;
        }
        let (low, high) = gpu.subgroup_sizes;
        let mut all = Vec::new();
        for &lanes in a.lanes.iter().filter(|lanes| (low..=high).contains(lanes)) {
            let like = PlannedGpu { subgroup_size: lanes, float_atomics: gpu.float_atomics, matrices: gpu.shapes() };
            if !planned.iter().any(|(other, _)| *other == like) {
                let jobs = jobs(common.device.as_deref(), like.clone())?;
                planned.push((like.clone(), jobs));
            }
            let jobs = planned.iter().filter(|(other, _)| *other == like).flat_map(|(_, jobs)| jobs);
            all.extend(jobs.filter(|j| a.kernel.is_empty() || a.kernel.iter().any(|k| j.kernel.contains(k))).cloned());
        }
        anyhow::ensure!(!all.is_empty(), "No kernel is left for {family}, which has {low} to {high} lanes.");
        all.sort();
        let rows = target.compile(&all)?;
        report.families.push(Family { family: family.clone(), gpu, rows });
    }
    print!("{}", report.table());
    if let Some(path) = &a.output {
        let text = report.json()?;
        sgs_scene::atomic_write(path, |f| std::io::Write::write_all(f, text.as_bytes()))?;
    }
    let Some(stored) = stored else { return Ok(()) };
    let outcome = check(&stored, &report)?;
    for sentence in &outcome.worse {
        eprintln!("{sentence}");
    }
    let (count, all) = (outcome.worse.len(), outcome.compared);
    anyhow::ensure!(count == 0, "{count} of {all} kernels are worse than stored.");
    Ok(())
}

/// Returns the installed driver file of RADV.
fn installed() -> anyhow::Result<PathBuf> {
    // Variables that select drivers may hide it.
    let variable = |name: &str| if name.starts_with("VK_") { None } else { std::env::var(name).ok() };
    let is_radv = |library: &str| library.contains("libvulkan_radeon");
    let files = driver_files(&variable).into_iter();
    let mut radv = files.filter(|f| f.problem.is_none() && f.library.as_deref().is_some_and(is_radv));
    radv.next().map(|f| f.path).ok_or_else(|| {
        anyhow::anyhow!("Mesa's RADV is not installed (mesa-vulkan-drivers on Debian); install it, or name its driver file with --driver.")
    })
}
