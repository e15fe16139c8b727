//! Whether a layer of a network is multiplied on matrix units, and in pieces of which shape.
//!
//! Matrix units (`VK_KHR_cooperative_matrix`) take operands of 16 bits and sum in 32. They are used where three things come together:
//! [`Accuracy::visibility_operands`](crate::Accuracy::visibility_operands) allows 16 bits, the device has a shape that fits, and the compiler that
//! this program was built with knew the extension of GLSL. Everywhere else the portable kernels run, in 32 bits; [`Matrices::for_device`] says why.

use sgs_engine::{DeviceInfo, MatrixShape};

/// Rows and columns of the layers that are multiplied so.
const WIDTH: u32 = crate::shade::visibility::FIELD_WIDTH as u32;

/// The extension of GLSL that the kernels need.
const EXTENSION: &str = "GL_KHR_cooperative_matrix";

/// How layers are cut.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Matrices {
    /// Of the pieces.
    pub shape: MatrixShape,
    /// Whether on the device's units; if not, the same pieces are multiplied by ordinary instructions with the same rounding, which
    /// is only of use to tests.
    pub units: bool,
}

/// Why matrix units are not used.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum NoMatrices {
    /// The device has none.
    #[error("the device has no cooperative matrices of 16-bit operands and 32-bit sums")]
    Device,
    /// It has shapes, but none fits.
    #[error("none of the device's shapes of cooperative matrices divides a layer of 32 and a subgroup")]
    Shape,
    /// The device is good, but the kernels are not there.
    #[error("this program was built with a GLSL compiler that does not know GL_KHR_cooperative_matrix")]
    Compiler,
}

impl Matrices {
    /// What suits a device.
    ///
    /// # Errors
    /// If the portable kernels have to do.
    pub fn for_device(info: &DeviceInfo) -> Result<Matrices, NoMatrices> {
        if info.matrices.is_empty() {
            return Err(NoMatrices::Device);
        }
        let shape = best(&info.matrices, info.subgroup_size).ok_or(NoMatrices::Shape)?;
        if Matrices::compiled() { Ok(Matrices { shape, units: true }) } else { Err(NoMatrices::Compiler) }
    }

    /// Whether this program has kernels for matrix units: whether it was built with a compiler that knew the extension.
    pub fn compiled() -> bool {
        sgs_shaders::compiled_with(EXTENSION)
    }

    /// The specialization constants of kernels that multiply so.
    pub(crate) fn specs(&self) -> [(&'static str, u32); 3] {
        let MatrixShape { rows, columns, depth } = self.shape;
        [("ROWS", rows), ("COLUMNS", columns), ("DEPTH", depth)]
    }
}

/// The shape with the most products a piece; of equal ones the first that the device names. A subgroup's pixels are a whole number of
/// pieces.
fn best(shapes: &[MatrixShape], subgroup: u32) -> Option<MatrixShape> {
    let divides = |n: u32, of: u32| n > 0 && of.is_multiple_of(n);
    let fits = |s: &&MatrixShape| divides(s.rows, WIDTH) && divides(s.depth, WIDTH) && divides(s.columns, subgroup);
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
    fn the_largest_shape_that_fits_is_taken() {
        let all = [shape(16, 8, 8), shape(16, 8, 16), shape(16, 16, 16), shape(8, 32, 16), shape(64, 16, 16)];
        // Equal ones: the first; 64 rows are more than there are.
        assert_eq!(best(&all, 32), Some(shape(16, 16, 16)));
        assert_eq!(best(&all, 64), Some(shape(16, 16, 16)));
        assert_eq!(best(&all, 8), Some(shape(16, 8, 16)));
        assert_eq!(best(&all[3..], 16), None);
        assert_eq!(best(&[shape(0, 0, 0), shape(8, 8, 64)], 32), None);
    }
}
