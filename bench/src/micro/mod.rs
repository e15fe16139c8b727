//! Benchmarks of single stages, timed by the device's clock.
//!
//! Each stage has its own inputs. It is checked against the CPU reference, or by an identity that only a correct
//! result satisfies. The check reads the results of the timed replays.

mod adam;
mod area_lights;
mod blend;
mod blend_bwd;
pub mod densify;
mod environment;
mod large_splats;
pub mod lights;
mod masks;
mod materials;
mod outside;
mod photometric;
mod primitives;
mod semantic;
mod sub_tiles;
mod tile_parts;
mod traced;
mod transport;
pub mod view;
mod visibility;

use crate::ceiling::Ceiling;
use crate::report::Report;
use crate::workload::Workload;
use sgs_engine::Device;
use sgs_passes::Tuning;
use std::path::Path;

/// Inputs shared by every stage.
pub struct Context<'c> {
    /// Device that is measured.
    pub device: &'c Device,
    /// Kernel sizes for the device.
    pub tuning: Tuning,
    /// Number of repetitions before the measured ones.
    pub warmup: u32,
    /// Number of measured repetitions.
    pub repeats: u32,
    /// Peak rates of the device.
    pub ceiling: Ceiling,
    /// Number of elements of the primitives.
    pub elements: u32,
    /// Gaussians and views of the other stages.
    pub workload: &'c Workload,
    /// Directory for cases that are exported to other programs.
    pub dump: Option<&'c Path>,
}

/// Function that measures a stage and adds its results.
type Stage = fn(&Context<'_>, &mut Report) -> anyhow::Result<()>;

/// Stages by the names that `--filter` matches.
pub const STAGES: [(&str, Stage); 20] = [
    ("scan", primitives::scan),
    ("radix_sort", primitives::sort),
    ("project intersect blend", blend::forward),
    ("blend_bwd", blend_bwd::all),
    ("large_splats", large_splats::one),
    ("sub_tiles", sub_tiles::all),
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
    ("area_lights", area_lights::all),
    ("outside", outside::all),
    ("transport", transport::all),
    ("visibility", visibility::all),
];
