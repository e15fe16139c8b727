//! Single stages, each with inputs made for it, timed by the device's clock, and checked against the CPU reference or an
//! identity that only a right result satisfies. The check reads what the timed replays left.

mod adam;
mod blend;
mod blend_bwd;
pub mod densify;
mod environment;
pub mod lights;
mod masks;
mod materials;
mod photometric;
mod primitives;
mod semantic;
mod traced;
pub mod view;
mod visibility;

use crate::ceiling::Ceiling;
use crate::report::Report;
use crate::workload::Workload;
use sgs_engine::Device;
use sgs_passes::Tuning;
use std::path::Path;

/// Shared inputs of every stage.
pub struct Context<'c> {
    /// The device.
    pub device: &'c Device,
    /// Kernel sizes for it.
    pub tuning: Tuning,
    /// Repetitions before the measured ones.
    pub warmup: u32,
    /// Measured repetitions.
    pub repeats: u32,
    /// Peak rates of the device.
    pub ceiling: Ceiling,
    /// Elements of the primitives.
    pub elements: u32,
    /// Gaussians and views of the other stages.
    pub workload: &'c Workload,
    /// Where cases go that other programs are to be measured on.
    pub dump: Option<&'c Path>,
}

/// Measures a stage and adds what it finds.
type Stage = fn(&Context<'_>, &mut Report) -> anyhow::Result<()>;

/// The stages by what `--filter` finds them by.
pub const STAGES: [(&str, Stage); 15] = [
    ("scan", primitives::scan),
    ("radix_sort", primitives::sort),
    ("project intersect blend", blend::forward),
    ("blend_bwd", blend_bwd::all),
    ("photometric", photometric::both),
    ("semantic", semantic::loss),
    ("correspondence", semantic::correspondence),
    ("masks", masks::both),
    ("lights", lights::all),
    ("materials", materials::all),
    ("adam", adam::one),
    ("densify", densify::one),
    ("environment", environment::all),
    ("traced", traced::one),
    ("visibility", visibility::all),
];
