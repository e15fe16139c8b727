//! `show`: display of an image in a window, with overlaid marks and letters.
//!
//! Cost: a pixel reads 8 bytes and writes 4, and tests every mark.

use super::TexelFormat;
use crate::kernel::stage_with;
use sgs_engine::graph::{Buffer, Graph, GraphError, Image};
use sgs_shaders::show as kernel;

pub use sgs_shaders::structs::{Mark, ShowStep};

/// Content of a displayed image.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum ShownKind {
    /// Display-referred color. A gain applies to its linear light.
    Encoded,
    /// Linear light.
    Linear,
    /// Values from 0 to 1 after the gain.
    Values,
    /// Directions; the gain does not apply.
    Directions,
}

impl ShownKind {
    /// Returns the number of the kind in kernels.
    pub fn number(self) -> u32 {
        self as u32
    }
}

/// Flag of a mark with a ring.
pub const MARK_RINGED: u32 = 1;
/// Flag of a mark that shows only its edge.
pub const MARK_HOLLOW: u32 = 2;

/// Letters of a bitmap font.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Letters {
    /// Columns and rows of a letter.
    pub cell: [u32; 2],
    /// Code of the first letter. It is not 0; code 0 leaves the image unchanged.
    pub first: u32,
    /// Number of letters.
    pub count: u32,
}

impl Letters {
    /// Returns the bytes of the font: letter by letter, one byte per pixel, padded to whole words.
    pub fn bytes(&self) -> u64 {
        (u64::from(self.count) * u64::from(self.cell[0]) * u64::from(self.cell[1])).next_multiple_of(4)
    }
}

/// Buffers of [`show`].
#[derive(Clone, Copy, Debug)]
pub struct Show {
    /// Uniform [`ShowStep`].
    pub step: Buffer,
    /// Displayed image, in [`sgs_engine::ImageFormat::Rgba16Float`].
    pub image: Image,
    /// Columns and rows of the image. If they differ from the window's, the image is interpolated bilinearly.
    pub render_size: [u32; 2],
    /// Capacity for [`Mark`]s, at least as many as a step contains.
    pub marks: Buffer,
    /// One byte per cell, line by line: code of a letter, 0 for none.
    pub text: Buffer,
    /// Font of [`Letters::bytes`] bytes.
    pub font: Buffer,
    /// Texels of 4 bytes, row by row without gaps.
    pub texels: Buffer,
}

/// Converts an image to `size` texels of an 8-bit format, with marks and letters.
///
/// # Errors
/// If the graph rejects the pass.
pub fn show(
    g: &mut Graph,
    size: [u32; 2],
    what: &Show,
    letters: Letters,
    format: TexelFormat,
) -> Result<(), GraphError> {
    let specs = kernel::Specs {
        texel: u32::from(matches!(format, TexelFormat::Bgra8Unorm | TexelFormat::Bgra8Srgb)),
        cell_width: letters.cell[0],
        cell_height: letters.cell[1],
        first_letter: letters.first,
        letters: letters.count,
    };
    let push = kernel::Push { size, image_size: what.render_size };
    stage_with(g, "show", &kernel::KERNEL, specs.entries(), bytemuck::bytes_of(&push))
        .bind("params", what.step)
        .bind_image("image", what.image)
        .bind("marks", what.marks)
        .bind("text", what.text)
        .bind("font", what.font)
        .bind("texels", what.texels)
        .dispatch([size[0].div_ceil(8), size[1].div_ceil(8), 1])
}
