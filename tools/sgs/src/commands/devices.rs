//! `sgs devices`: what can run here, and what each device lacks.

use crate::common::Common;
use sgs_engine::{DeviceInfo, MatrixShape};
use sgs_passes::{Matrices, NoMatrices};

pub fn run(common: &Common) -> anyhow::Result<()> {
    let devices = sgs_engine::devices()?;
    if common.answer(&devices)? {
        return Ok(());
    }
    if devices.is_empty() {
        anyhow::bail!("There is no Vulkan device; install a driver (mesa-vulkan-drivers on Debian has lavapipe).");
    }
    for d in devices {
        println!("{}: {} ({}), Vulkan {}, {}", d.index, d.name, d.kind, d.api, d.driver);
        let (low, high) = d.subgroup_sizes;
        println!(
            "   subgroup {} ({low} to {high}), {} MiB of device memory, {} MiB a storage binding",
            d.subgroup_size,
            d.memory_bytes >> 20,
            d.max_storage_range >> 20
        );
        if d.missing.is_empty() {
            println!("   can run");
        } else {
            println!("   cannot run: lacks {}", d.missing.join(", "));
        }
        println!("   {}", units(&d));
        for f in d.fallbacks {
            println!("   {f}");
        }
    }
    Ok(())
}

/// What there is for `accuracy.visibility_operands = 16`.
fn units(info: &DeviceInfo) -> String {
    let shape = |s: &MatrixShape| format!("{}x{}x{}", s.rows, s.columns, s.depth);
    let shapes: Vec<String> = info.matrices.iter().map(shape).collect();
    match Matrices::for_device(info) {
        Ok(m) => {
            format!("matrix units of 16-bit operands: {}; pieces of {} are used", shapes.join(", "), shape(&m.shape))
        }
        Err(NoMatrices::Device) => "matrix units of 16-bit operands: none".to_owned(),
        Err(why) => format!("matrix units of 16-bit operands: {}, not used: {why}", shapes.join(", ")),
    }
}
