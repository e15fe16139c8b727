//! Specialization parameters of kernels: sizes for the device, and accuracy.

use crate::{Accuracy, Matrices};
use sgs_engine::DeviceInfo;

/// Kernel sizes for one device, and accuracy.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tuning {
    /// Subgroup size that pipelines run at.
    pub subgroup_size: u32,
    /// Invocations of an ordinary workgroup.
    pub workgroup: u32,
    /// Columns and rows of a tile. A subgroup covers a whole number of its rows.
    pub tile: [u32; 2],
    /// Largest number of tiles of a splat that one lane processes alone. The subgroup processes larger splats one after
    /// the other, with all lanes. `u32::MAX` leaves every splat to one lane.
    pub large_tiles: u32,
    /// Columns of a slot: the pixels of a tile that the lanes blend at a time. Divides the tile's columns.
    pub slot_width: u32,
    /// Whether blending tries a splat only in the slots that it can touch.
    pub sub_tiles: bool,
    /// Margin of the exponent of these slots, far more than rounding. A huge one leaves every slot in, for comparison.
    pub slot_margin: f32,
    /// Subgroups that blend a tile in the forward pass, each a part of it: a power of two. `None` chooses by the tiles of
    /// the view and the units of the device.
    pub tile_parts: Option<u32>,
    /// Workgroups of one subgroup that occupy the device. Work whose split requires an additional sum is split into
    /// about this many parts.
    pub workers: u32,
    /// Compute units of the device. Work whose parts keep sums in registers is split by them, see [`Tuning::parts`].
    pub units: u32,
    /// Limit on the iterations of all loops of an invocation together. llvmpipe leaves loops silently after 65535.
    pub rounds: u32,
    /// Whether the device is a CPU. Its memory operations run lane by lane, except on an invocation's own arrays.
    pub cpu: bool,
    /// Tiling for matrix units, if the device supports them; see [`Tuning::field_matrices`].
    pub matrices: Option<Matrices>,
    /// Whether cameras may have radial distortion. Kernels ignore it otherwise.
    pub distorted: bool,
    /// Accuracy of the kernels.
    pub accuracy: Accuracy,
}

impl Tuning {
    /// Returns the tuning for a device.
    pub fn for_device(info: &DeviceInfo) -> Tuning {
        let matrices = Matrices::for_device(info).ok();
        let gpu = Tuning::for_subgroups(info.subgroup_size);
        let gpu = Tuning { matrices, units: info.compute_units.unwrap_or(gpu.units), ..gpu };
        // CPUs run both sides of a branch for lanes in lockstep, so that sub-tiles save nothing. On llvmpipe blending takes
        // 1.1 times as long with them, and its backward pass 1.5 to 2 times with 8 lanes and 1.2 times with 16
        // (`engine-bench passes --filter sub_tiles`).
        let cpu = Tuning { workers: 8, rounds: u16::MAX.into(), cpu: true, sub_tiles: false, ..gpu };
        if info.kind == "cpu" { cpu } else { gpu }
    }

    /// Returns the tuning for a GPU of which only the subgroup size is known.
    pub fn for_subgroups(subgroup_size: u32) -> Tuning {
        // Eight pixels a lane (sixteen on narrow subgroups) hold the state of a tile in registers and share the fetch
        // of each splat. On lavapipe, tiles of 8 x 16 take as long as 8 x 8 with two thirds of the entries.
        let width = subgroup_size.min(16);
        Tuning {
            subgroup_size,
            workgroup: 256,
            tile: [width, 16],
            // A lane needs longer for its tiles than the subgroup for the same splat from a few per lane on. Fewer would
            // cost more where all lanes have such splats, since the subgroup then processes as many one by one.
            large_tiles: 4 * subgroup_size,
            // Sub-tiles leave half of the pairs of entry and slot, with slots about as wide as high.
            slot_width: match subgroup_size {
                ..16 => width,
                16 => 4,
                17..=64 => 8,
                _ => 16,
            },
            sub_tiles: subgroup_size >= 16,
            slot_margin: 0.05,
            tile_parts: None,
            workers: 512,
            // A mid-range GPU. Intel's and software drivers report no units.
            units: 48,
            rounds: u32::MAX,
            cpu: false,
            matrices: None,
            distorted: false,
            accuracy: Accuracy::EXACT,
        }
    }

    /// Returns the columns and rows of a slot of a tile.
    pub fn slot(&self) -> [u32; 2] {
        [self.slot_width, self.subgroup_size / self.slot_width]
    }

    /// Returns the same tuning with another accuracy.
    pub fn with(self, accuracy: Accuracy) -> Tuning {
        Tuning { accuracy, ..self }
    }

    /// Returns the tiling of the visibility field's second layer. `None` selects the portable kernels.
    pub fn field_matrices(&self) -> Option<Matrices> {
        self.matrices.filter(|m| self.accuracy.visibility_bits == 16 && (Matrices::compiled() || !m.units))
    }

    /// Returns the number of single-subgroup workgroups that run at once.
    ///
    /// `per_unit`: those of a compute unit.
    pub fn parts(&self, per_unit: u32) -> u32 {
        if self.cpu { self.workers } else { self.units * per_unit }
    }

    /// Returns whether subgroups are narrow, as on CPUs. Their memory operations run lane by lane.
    pub fn narrow(&self) -> bool {
        self.subgroup_size <= 8
    }

    /// Returns the items of a lane in kernels that spread features over lanes. More items share each fetch.
    pub fn tiles(&self) -> u32 {
        (16 / self.subgroup_size).max(1)
    }

    /// Returns how many pixels of a mask a lane lists at once: 4 to 32.
    ///
    /// A workgroup processes its list alone, and pixels of a mask lie together. So GPUs split small views into shorter
    /// lists, until the workgroups occupy the device.
    pub fn lane_pixels(&self, pixels: u64) -> u32 {
        // The list stays below 8 KiB with 64 lanes.
        let most = if self.subgroup_size >= 64 { 16 } else { 32 };
        let occupies = |count: &u32| pixels.div_ceil(u64::from(count * self.subgroup_size)) >= u64::from(self.workers);
        if self.cpu { most } else { [32, 16, 8].into_iter().filter(|n| *n <= most).find(occupies).unwrap_or(4) }
    }
}
