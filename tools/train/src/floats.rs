//! 32-bit numbers of a shape, as they go into safetensors files.

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

/// 32-bit numbers, floats or not.
pub(crate) enum Numbers<'a> {
    Floats(Floats<'a>),
    Words(&'a [u32], Vec<usize>),
}

impl View for Numbers<'_> {
    fn dtype(&self) -> Dtype {
        match self {
            Numbers::Floats(f) => f.dtype(),
            Numbers::Words(..) => Dtype::U32,
        }
    }
    fn shape(&self) -> &[usize] {
        match self {
            Numbers::Floats(f) => f.shape(),
            Numbers::Words(_, shape) => shape,
        }
    }
    fn data(&self) -> Cow<'_, [u8]> {
        match self {
            Numbers::Floats(f) => Cow::Borrowed(bytemuck::cast_slice(f.0)),
            Numbers::Words(words, _) => Cow::Borrowed(bytemuck::cast_slice(words)),
        }
    }
    fn data_len(&self) -> usize {
        4 * match self {
            Numbers::Floats(f) => f.0.len(),
            Numbers::Words(words, _) => words.len(),
        }
    }
}
