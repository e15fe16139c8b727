//! Selection of cooperative matrices for the layers of networks.
//!
//! Matrix units (`VK_KHR_cooperative_matrix`) multiply 16-bit operands and sum in 32 bits. They run if three conditions
//! hold: [`Accuracy::visibility_bits`](crate::Accuracy::visibility_bits) is 16, the device has a suitable
//! shape, and the GLSL compiler of this build supports the extension. Otherwise the portable kernels run, in 32 bits;
//! [`Matrices::for_device`] returns the reason.

use sgs_engine::{DeviceInfo, MatrixShape};

/// Rows and columns of the layers that matrix units multiply: those of the visibility field.
pub(crate) const WIDTH: u32 = 32;

/// GLSL extension that the kernels require.
const EXTENSION: &str = "GL_KHR_cooperative_matrix";

/// Tiling of layers for matrix multiplication.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Matrices {
    /// Shape of a tile.
    pub shape: MatrixShape,
    /// Whether matrix units multiply the tiles. Otherwise ordinary instructions do, with the same tiles and rounding;
    /// only tests use this.
    pub units: bool,
}

/// Reason why matrix units are not used.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum NoMatrices {
    /// The device has no matrix units.
    #[error("the device has no cooperative matrices of 16-bit operands and 32-bit sums")]
    Device,
    /// None of the device's shapes is suitable.
    #[error("none of the device's shapes of cooperative matrices divides a layer of 32 and a subgroup")]
    Shape,
    /// The GLSL compiler of this build does not support the extension.
    #[error("this program was built with a GLSL compiler that does not know GL_KHR_cooperative_matrix")]
    Compiler,
}

impl Matrices {
    /// Selects the tiling for a device.
    ///
    /// # Errors
    /// If the device, its shapes or this build do not support matrix units; the portable kernels run then.
    pub fn for_device(info: &DeviceInfo) -> Result<Matrices, NoMatrices> {
        if info.matrices.is_empty() {
            return Err(NoMatrices::Device);
        }
        let shape = best(&info.matrices, info.subgroup_size).ok_or(NoMatrices::Shape)?;
        if Matrices::compiled() { Ok(Matrices { shape, units: true }) } else { Err(NoMatrices::Compiler) }
    }

    /// Returns whether this build contains kernels for matrix units. They require a GLSL compiler that supports the
    /// extension.
    pub fn compiled() -> bool {
        sgs_shaders::compiled_with(EXTENSION)
    }

    /// Returns the specialization constants of kernels that multiply matrices.
    pub(crate) fn specs(&self) -> [(&'static str, u32); 3] {
        let MatrixShape { rows, columns, depth } = self.shape;
        [("ROWS", rows), ("COLUMNS", columns), ("DEPTH", depth)]
    }
}

/// Returns the suitable shape with the most products per tile; the first of equal ones. A shape is suitable if it
/// divides a layer, and its columns divide a subgroup.
fn best(shapes: &[MatrixShape], subgroup: u32) -> Option<MatrixShape> {
    let divides = |n: u32, of: u32| n > 0 && of.is_multiple_of(n);
    let layer = |s: &MatrixShape| [s.rows, s.columns, s.depth].iter().all(|n| divides(*n, WIDTH));
    let fits = |s: &&MatrixShape| layer(s) && divides(s.columns, subgroup);
    let products = |s: &MatrixShape| s.rows * s.columns * s.depth;
    shapes.iter().filter(fits).fold(None, |best: Option<MatrixShape>, s| match best {
        Some(b) if products(&b) >= products(s) => Some(b),
        _ => Some(*s),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn shape(rows: u32, columns: u32, depth: u32) -> MatrixShape {
        MatrixShape { rows, columns, depth }
    }

    #[test]
    fn largest_suitable_shape_is_selected() {
        let all = [shape(16, 8, 8), shape(16, 8, 16), shape(16, 16, 16), shape(8, 32, 16), shape(64, 16, 16)];
        // Among equal shapes the first is selected. 64 rows exceed a layer.
        assert_eq!(best(&all, 32), Some(shape(16, 16, 16)));
        assert_eq!(best(&all, 64), Some(shape(16, 16, 16)));
        assert_eq!(best(&all, 8), Some(shape(16, 8, 16)));
        assert_eq!(best(&all[3..], 16), None);
        assert_eq!(best(&[shape(0, 0, 0), shape(8, 8, 64)], 32), None);
    }
}
