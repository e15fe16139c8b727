//! `sgs devices`: what can run here, and what each device lacks.

use crate::common::Common;

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
        for f in d.fallbacks {
            println!("   {f}");
        }
    }
    Ok(())
}
