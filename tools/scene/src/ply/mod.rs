//! PLY files with point clouds and splats: one element `vertex` with numbers.
//!
//! [`VertexTable`] reads the requested properties row by row as `f32`, for any order, type and format (ASCII, binary of
//! either byte order). Other elements after the vertices are ignored. The number of rows is checked against the file
//! size before memory is allocated for them. Callers interpret the properties.

mod header;
mod table;

pub(crate) use header::Scalar;
pub(crate) use table::VertexTable;
