//! 32-bit floats of a shape, as they go into safetensors files.

use safetensors::{Dtype, View};
use std::borrow::Cow;

/// Numbers and their shape.
pub(crate) struct Floats<'a>(pub &'a [f32], pub Vec<usize>);

impl View for Floats<'_> {
    fn dtype(&self) -> Dtype {
        Dtype::F32
    }
    fn shape(&self) -> &[usize] {
        &self.1
    }
    fn data(&self) -> Cow<'_, [u8]> {
        Cow::Borrowed(bytemuck::cast_slice(self.0))
    }
    fn data_len(&self) -> usize {
        size_of_val(self.0)
    }
}
