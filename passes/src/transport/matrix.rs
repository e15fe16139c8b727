//! Transport matrix: its rows as bounces read them, and its columns for the adjoint.
//!
//! `transport_rows` packs targets into 16 bits where their numbers fit. Cost: 4 bytes read and 2 or 4 written per ray,
//! once per geometry.

use crate::Tuning;
use crate::kernel::{groups, stage};
use sgs_engine::graph::{Buffer, Graph, GraphError};
use sgs_shaders::transport_rows as kernel;

/// Size of a transport matrix.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MatrixShape {
    /// Number of receivers: surfels and patches.
    pub receivers: u32,
    /// Number of rays of a receiver.
    pub rays: u32,
}

impl MatrixShape {
    /// Returns the bits of a target. The number after the last receiver's stands for no target.
    pub fn bits(&self) -> u32 {
        if self.receivers <= 0xffff { 16 } else { 32 }
    }

    /// Returns the words of 16 bytes of a row.
    pub fn width(&self) -> u32 {
        self.rays.div_ceil(128 / self.bits())
    }

    /// Returns the bytes of all rows.
    pub fn bytes(&self) -> u64 {
        16 * u64::from(self.width()) * u64::from(self.receivers)
    }
}

/// Rows of a transport matrix on the device.
#[derive(Clone, Copy, Debug)]
pub struct MatrixRows {
    /// Size of the matrix.
    pub shape: MatrixShape,
    /// Packed targets, [`MatrixShape::bytes`].
    pub rows: Buffer,
}

/// Columns of a transport matrix on the device.
#[derive(Clone, Copy, Debug)]
pub struct MatrixColumns {
    /// Size of the matrix.
    pub shape: MatrixShape,
    /// Start of each receiver's column, `[receivers + 1]` words.
    pub starts: Buffer,
    /// Receivers whose rays meet the column's, one word per ray that meets a receiver.
    pub rows: Buffer,
}

/// Columns of a transport matrix on the host.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Transposed {
    /// Start of each receiver's column, `[receivers + 1]`.
    pub starts: Vec<u32>,
    /// Receivers whose rays meet the column's, in increasing order; never empty, so that it can be uploaded.
    pub rows: Vec<u32>,
}

/// Packs the targets of all rays into rows.
///
/// # Errors
/// If a buffer does not belong to the graph or is too small to be bound.
pub fn transport_rows(g: &mut Graph, t: &Tuning, targets: Buffer, into: &MatrixRows) -> Result<(), GraphError> {
    let shape = into.shape;
    let bindings = kernel::Bindings { targets: targets.into(), matrix_rows: into.rows.into() };
    let specs = kernel::Specs { workgroup: t.workgroup, bits: shape.bits() };
    let push = kernel::Push { receivers: shape.receivers, rays: shape.rays, width: 4 * shape.width() };
    stage(g, "transport_rows", &kernel::KERNEL, bindings.entries(), specs.entries(), bytemuck::bytes_of(&push))
        .dispatch(groups(u64::from(push.width) * u64::from(shape.receivers), t.workgroup))
}

/// Transposes the targets of all rays. Leaves out rays that meet no receiver.
pub fn transposed(targets: &[u32], receivers: u32) -> Transposed {
    let count = receivers as usize;
    let rays = targets.len() / count.max(1);
    let mut starts = vec![0_u32; count + 1];
    let real = |met: &u32| *met < receivers;
    targets.iter().filter(|met| real(met)).for_each(|&met| starts[met as usize + 1] += 1);
    for i in 0..count {
        starts[i + 1] += starts[i];
    }
    let mut next = starts.clone();
    let mut rows = vec![0; (starts[count] as usize).max(1)];
    for (at, &met) in targets.iter().enumerate().filter(|(_, met)| real(met)) {
        let slot = &mut next[met as usize];
        rows[*slot as usize] = (at / rays) as u32;
        *slot += 1;
    }
    Transposed { starts, rows }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn transposed_lists_rays_by_target() {
        let t = transposed(&[1, 1, 0, u32::MAX, 1, 2], 3);
        assert_eq!(t, Transposed { starts: vec![0, 1, 4, 5], rows: vec![1, 0, 0, 2, 2] });
        assert_eq!(transposed(&[u32::MAX; 4], 2), Transposed { starts: vec![0; 3], rows: vec![0] });
        assert_eq!(transposed(&[], 0), Transposed { starts: vec![0], rows: vec![0] });
    }

    #[test]
    fn rows_are_whole_words() {
        let width = |receivers, rays| MatrixShape { receivers, rays }.width();
        assert_eq!([width(65535, 64), width(65536, 64), width(9, 1), width(9, 9)], [8, 16, 1, 2]);
    }
}
