//! Sizes that kernels are specialized with, chosen for a device.

use sgs_engine::DeviceInfo;

/// Kernel sizes for one device.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Tuning {
    /// Subgroup size that pipelines run at.
    pub subgroup_size: u32,
    /// Invocations of an ordinary workgroup.
    pub workgroup: u32,
    /// Columns and rows of a tile; a subgroup is a whole number of its rows.
    pub tile: [u32; 2],
}

impl Tuning {
    /// What suits a device.
    pub fn for_device(info: &DeviceInfo) -> Tuning {
        let subgroup_size = info.subgroup_size;
        // Eight pixels a lane (sixteen on narrow subgroups) keep the state of a tile in registers and share each splat's
        // fetch. On lavapipe tiles of 8 x 16 take the time of 8 x 8 and two thirds of the entries.
        let width = subgroup_size.min(16);
        Tuning { subgroup_size, workgroup: 256, tile: [width, 16] }
    }

    /// Subgroups of an ordinary workgroup.
    pub fn subgroups(&self) -> u32 {
        self.workgroup.div_ceil(self.subgroup_size)
    }
}
