//! Device list: `sgs devices` shows which devices can run SGS, what the others lack, and which is used by default.

mod doctor;

use crate::common::Common;
use serde::Serialize;
use sgs_engine::{DeviceInfo, Environment, MatrixShape, select_auto};
use sgs_passes::{Matrices, NoMatrices};

/// Subgroup sizes of the project's tests on Mesa's lavapipe.
const TESTED_LANES: [u32; 2] = [8, 16];

/// Driver, subgroup size and name of GPUs on which the device tests have run.
///
/// See `bench/results/nvidia-h100`.
const TESTED_GPUS: [(&str, u32, &str); 1] = [("NVIDIA 580.159.04", 32, "NVIDIA H100 80GB HBM3")];

/// Device in the output of `--json`.
#[derive(Serialize)]
struct Listed<'a> {
    #[serde(flatten)]
    info: &'a DeviceInfo,
    /// `tested` or `not tested`.
    tests: &'static str,
    /// Subgroup sizes at which this kind of device is tested.
    tested_lanes: &'static [u32],
    /// Reason why this device is used unless another is selected; absent for all others.
    #[serde(skip_serializing_if = "Option::is_none")]
    auto: Option<String>,
}

#[derive(clap::Args)]
pub struct Args {
    /// Show the driver files of Vulkan, why some are rejected, and what to install.
    #[arg(long)]
    doctor: bool,
}

pub fn run(common: &Common, a: &Args) -> anyhow::Result<()> {
    if a.doctor {
        return doctor::run(common);
    }
    let devices = sgs_engine::devices()?;
    let chosen = select_auto(&devices, &Environment::current());
    let listed: Vec<Listed<'_>> = devices
        .iter()
        .map(|info| Listed {
            info,
            tests: if tested(&info.name, &info.driver, info.subgroup_size) { "tested" } else { "not tested" },
            tested_lanes: tested_lanes(&info.name, &info.driver),
            auto: chosen.as_ref().ok().filter(|c| c.index == info.index).map(|c| c.reason.clone()),
        })
        .collect();
    if common.answer(&listed)? {
        return Ok(());
    }
    if devices.is_empty() {
        anyhow::bail!("There is no Vulkan device; install a driver (mesa-vulkan-drivers on Debian has lavapipe).");
    }
    for d in devices {
        println!("{}: {} ({}), Vulkan {}, {}", d.index, d.name, d.kind, d.api, d.driver);
        let pci = d.pci.as_ref().map(|pci| format!(", pci:{pci}")).unwrap_or_default();
        println!("   uuid:{}{pci}", d.uuid);
        let (low, high) = d.subgroup_sizes;
        println!(
            "   subgroup {} ({low} to {high}), {} MiB of device memory, {} MiB a storage binding",
            d.subgroup_size,
            d.memory_bytes >> 20,
            d.max_storage_range >> 20
        );
        println!("   {} MiB a buffer, {} storage buffers a kernel", d.largest_buffer() >> 20, d.max_storage_buffers);
        if d.missing.is_empty() {
            println!("   can run");
        } else {
            println!("   cannot run: lacks {}", d.missing.join(", "));
        }
        println!("   {}", tests(&d));
        if let Some(line) = units(&d) {
            println!("   {line}");
        }
        for f in d.fallbacks {
            println!("   {f}");
        }
    }
    match chosen {
        Ok(chosen) => println!("used by default: {}, because {}", chosen.index, chosen.reason),
        Err(error) => println!("used by default: none; {error}"),
    }
    Ok(())
}

fn is_lavapipe(driver: &str) -> bool {
    driver.starts_with("llvmpipe")
}

fn is_tested_gpu(name: &str, driver: &str, lanes: u32) -> bool {
    TESTED_GPUS.contains(&(driver.trim(), lanes, name))
}

/// Returns the subgroup sizes at which the tests have run on a kind of device.
fn tested_lanes(name: &str, driver: &str) -> &'static [u32] {
    if is_lavapipe(driver) {
        &TESTED_LANES
    } else if is_tested_gpu(name, driver, 32) {
        &[32]
    } else {
        &[]
    }
}

/// Returns whether the project's tests have run on such a device.
fn tested(name: &str, driver: &str, lanes: u32) -> bool {
    tested_lanes(name, driver).contains(&lanes)
}

/// Describes which tests have run on a device.
fn tests(info: &DeviceInfo) -> String {
    let lanes = TESTED_LANES.map(|lanes| lanes.to_string()).join(" and ");
    let size = info.subgroup_size;
    if is_tested_gpu(&info.name, &info.driver, size) {
        format!("tested: the device tests have run on it with {size} lanes")
    } else if tested(&info.name, &info.driver, size) {
        format!("tested: lavapipe with {lanes} lanes")
    } else {
        format!("not tested: the tests run on lavapipe with {lanes} lanes")
    }
}

/// Describes the cooperative matrices for `accuracy.visibility_bits = 16`.
///
/// A device without them lists this among its fallbacks.
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

#[cfg(test)]
mod tests {
    #[test]
    fn devices_of_the_tests_are_tested_at_their_subgroup_sizes() {
        let tested = |driver: &str, lanes: u32| super::tested("a device", driver, lanes);
        assert!(tested("llvmpipe Mesa 22.3.6 (LLVM 15.0.6)", 8) && tested("llvmpipe Mesa 25.0.7", 16));
        assert!(!tested("llvmpipe Mesa 22.3.6 (LLVM 15.0.6)", 32));
        assert!(!tested("radv Mesa 25.0.7", 8) && !tested("NVIDIA 550.54", 32) && !tested("", 8));
        let h100 = |driver: &str, lanes: u32| super::tested("NVIDIA H100 80GB HBM3", driver, lanes);
        assert!(h100("NVIDIA 580.159.04", 32) && !h100("NVIDIA 580.159.04", 64) && !h100("NVIDIA 550.54", 32));
    }
}
