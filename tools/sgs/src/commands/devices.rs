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
        if let Some(line) = units(&d) {
            println!("   {line}");
        }
        for f in d.fallbacks {
            println!("   {f}");
        }
    }
    Ok(())
}

/// What there is for `accuracy.visibility_operands = 16`; that the device has none is among its fallbacks.
fn units(info: &DeviceInfo) -> Option<String> {
    let shape = |s: &MatrixShape| format!("{}x{}x{}", s.rows, s.columns, s.depth);
    let shapes: Vec<String> = info.matrices.iter().map(shape).collect();
    let shapes = shapes.join(", ");
    match Matrices::for_device(info) {
        Ok(m) => Some(format!("matrix units of 16-bit operands: {shapes}; pieces of {} are used", shape(&m.shape))),
        Err(NoMatrices::Device) if Matrices::compiled() => None,
        Err(NoMatrices::Device) => Some(format!("no kernels for matrix units: {}", NoMatrices::Compiler)),
        Err(why) => Some(format!("matrix units of 16-bit operands: {shapes}, not used: {why}")),
    }
}
