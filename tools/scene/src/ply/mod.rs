//! PLY files, as far as point clouds and splats need them: one element `vertex` with numbers.
//!
//! [`VertexTable`] reads the wanted properties row by row as `f32`, whatever their order, type, and the file's format
//! (ASCII, binary of either byte order). Other elements after the vertices are ignored. The number of rows is checked
//! against the size of the file before anyone reserves memory for them. What properties mean is left to the callers.

mod header;
mod table;

pub(crate) use header::Scalar;
pub(crate) use table::VertexTable;
