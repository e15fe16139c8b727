//! What kernels are specialized with: sizes that suit a device, and how accurate they are.

use crate::{Accuracy, Matrices};
use sgs_engine::DeviceInfo;

/// Kernel sizes for one device, and accuracy.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tuning {
    /// Subgroup size that pipelines run at.
    pub subgroup_size: u32,
    /// Invocations of an ordinary workgroup.
    pub workgroup: u32,
    /// Columns and rows of a tile; a subgroup is a whole number of its rows.
    pub tile: [u32; 2],
    /// Workgroups of one subgroup that keep the device busy. Where work can be cut finer at the price of sums that
    /// somebody must add up, it is cut into about so many pieces.
    pub workers: u32,
    /// Rounds of all loops of an invocation together: llvmpipe leaves loops silently after 65535.
    pub rounds: u32,
    /// How layers of networks would be multiplied on the device's matrix units, where there are any; see [`Tuning::field_matrices`].
    pub matrices: Option<Matrices>,
    /// What is traded for speed.
    pub accuracy: Accuracy,
}

impl Tuning {
    /// What suits a device.
    pub fn for_device(info: &DeviceInfo) -> Tuning {
        let matrices = Matrices::for_device(info).ok();
        let gpu = Tuning { matrices, ..Tuning::for_subgroups(info.subgroup_size) };
        if info.kind == "cpu" { Tuning { workers: 8, rounds: u16::MAX.into(), ..gpu } } else { gpu }
    }

    /// What suits a GPU of which only the subgroup size is known.
    pub fn for_subgroups(subgroup_size: u32) -> Tuning {
        // Eight pixels a lane (sixteen on narrow subgroups) keep the state of a tile in registers and share each splat's
        // fetch. On lavapipe tiles of 8 x 16 take the time of 8 x 8 and two thirds of the entries.
        let width = subgroup_size.min(16);
        Tuning {
            subgroup_size,
            workgroup: 256,
            tile: [width, 16],
            workers: 512,
            rounds: u32::MAX,
            matrices: None,
            accuracy: Accuracy::EXACT,
        }
    }

    /// The same with another accuracy.
    pub fn with(self, accuracy: Accuracy) -> Tuning {
        Tuning { accuracy, ..self }
    }

    /// How the visibility field's second layer is multiplied forward, if not by the portable kernels.
    pub fn field_matrices(&self) -> Option<Matrices> {
        self.matrices.filter(|m| self.accuracy.visibility_operands == 16 && (Matrices::compiled() || !m.units))
    }

    /// Whether subgroups are narrow, as those of processors are, whose memory operations go lane by lane.
    pub fn narrow(&self) -> bool {
        self.subgroup_size <= 8
    }

    /// Items of a lane where features lie over the lanes, so that what all share is fetched less often.
    pub fn tiles(&self) -> u32 {
        (16 / self.subgroup_size).max(1)
    }
}
