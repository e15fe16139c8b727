//! Single stages at stated sizes: `engine-bench passes`.

use super::ceiling::measure_ceiling;
use super::step::Args as StepArgs;
use crate::common::{Common, parse_size};
use crate::micro::{Context, STAGES};
use crate::workload::{Synthetic, synthetic};
use sgs_passes::Tuning;

/// Options of the command.
#[derive(clap::Args, Clone, Debug)]
pub struct Args {
    /// Measure only stages whose names contain S.
    #[arg(long, value_name = "S")]
    pub filter: Option<String>,
    /// Number of elements of the primitives.
    #[arg(long, value_name = "N", default_value_t = 1 << 20, value_parser = clap::value_parser!(u32).range(1..=1 << 28))]
    pub elements: u32,
    /// Number of Gaussians of the other stages; 20000 on a CPU, 1000000 elsewhere.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(100..=50_000_000))]
    pub gaussians: Option<u32>,
    /// View size of the other stages; 320x240 on a CPU, 1920x1080 elsewhere.
    #[arg(long, value_name = "WxH", value_parser = parse_size)]
    pub size: Option<[u32; 2]>,
    /// Include normals and depth.
    #[arg(long)]
    pub normals: bool,
    /// Write the test case of `lights` and its results to a folder, for `bench/peers`.
    #[arg(long, value_name = "FOLDER")]
    pub dump: Option<std::path::PathBuf>,
}

/// Runs the command.
///
/// # Errors
/// If the device fails, or a stage's result is wrong.
pub fn run(common: &Common, a: &Args) -> anyhow::Result<()> {
    let selected = |name: &str| a.filter.as_ref().is_none_or(|f| name.contains(f.as_str()));
    let stages: Vec<_> = STAGES.iter().filter(|(name, _)| selected(name)).collect();
    if stages.is_empty() {
        let names: Vec<&str> = STAGES.iter().map(|(name, _)| *name).collect();
        anyhow::bail!("No stage is called \"{}\"; there are {}.", a.filter.as_deref().unwrap_or(""), names.join(", "));
    }
    let device = common.open_device()?;
    let mut report = common.report("passes", &device);
    let (gaussians, size) = StepArgs::sizes(&device, a.gaussians, a.size);
    let room = Synthetic { gaussians, size, normals: a.normals, densify: false, sh_degree: 3 };
    report.setting("elements", a.elements);
    report.setting("gaussians", room.gaussians);
    report.setting("size", format!("{}x{}", room.size[0], room.size[1]));
    report.setting("normals", a.normals);
    let ceiling = measure_ceiling(&device)?;
    report.ceiling = Some(ceiling);
    let workload = synthetic(&device, &room)?;
    let context = Context {
        device: &device,
        tuning: Tuning::for_device(device.info()),
        warmup: common.warmup,
        repeats: common.repeats,
        ceiling,
        elements: a.elements,
        workload: &workload,
        dump: a.dump.as_deref(),
    };
    for (_, stage) in stages {
        stage(&context, &mut report)?;
    }
    common.finish(&report, &device)
}
