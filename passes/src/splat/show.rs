//! `show`: a picture as a window shows it, with marks and letters over it.
//!
//! Cost: a pixel reads 8 bytes and writes 4, and looks at every mark.

use super::TexelFormat;
use crate::kernel::stage_with;
use sgs_engine::graph::{Buffer, Graph, GraphError, Image};
use sgs_shaders::show as kernel;

pub use sgs_shaders::structs::{Mark, ShowStep};

/// What a picture holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum ShownKind {
    /// Color as screens take it. A gain applies to the light that it stands for.
    Encoded,
    /// Linear light.
    Linear,
    /// Numbers from 0 to 1 once the gain is on them.
    Values,
    /// Directions; the gain does not change them.
    Directions,
}

impl ShownKind {
    /// The number that kernels know it by.
    pub fn number(self) -> u32 {
        self as u32
    }
}

/// A ring around a mark.
pub const MARK_RINGED: u32 = 1;
/// A mark that is only its edge.
pub const MARK_HOLLOW: u32 = 2;

/// The letters that there are, as pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Letters {
    /// Columns and rows of each.
    pub cell: [u32; 2],
    /// Code of the first; it is not 0, which leaves the picture as it is.
    pub first: u32,
    /// How many there are.
    pub count: u32,
}

impl Letters {
    /// Bytes of their pixels, letter by letter, one byte each, in whole words.
    pub fn bytes(&self) -> u64 {
        (u64::from(self.count) * u64::from(self.cell[0]) * u64::from(self.cell[1])).next_multiple_of(4)
    }
}

/// What [`show`] reads and writes.
#[derive(Clone, Copy, Debug)]
pub struct Show {
    /// Uniform [`ShowStep`].
    pub step: Buffer,
    /// What is shown, in [`sgs_engine::ImageFormat::Rgba16Float`].
    pub picture: Image,
    /// Columns and rows of the picture. Where they differ from the window's, the picture is interpolated bilinearly.
    pub picture_size: [u32; 2],
    /// Room for [`Mark`]s, at least as many as a step says.
    pub marks: Buffer,
    /// A byte a cell, line by line: the code of a letter, 0 for none.
    pub text: Buffer,
    /// [`Letters::bytes`]
    pub font: Buffer,
    /// Texels of 4 bytes, row by row without gaps.
    pub texels: Buffer,
}

/// Shows a picture of `size` pixels as texels of an 8-bit format.
///
/// # Errors
/// If the graph refuses the pass.
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
    let push = kernel::Push { size, image_size: what.picture_size };
    stage_with(g, "show", &kernel::KERNEL, specs.entries(), bytemuck::bytes_of(&push))
        .bind("params", what.step)
        .bind_image("image", what.picture)
        .bind("marks", what.marks)
        .bind("text", what.text)
        .bind("font", what.font)
        .bind("texels", what.texels)
        .dispatch([size[0].div_ceil(8), size[1].div_ceil(8), 1])
}
