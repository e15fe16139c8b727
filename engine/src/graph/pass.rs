//! A declared pass: what runs, and every byte range it touches, how, and from where in the pipeline.
//!
//! Built only by [`super::builder`], which promises that the accesses say all that the kind implies.

use std::sync::Arc;

use super::resource::{Buffer, Image, Slice};
use crate::shader::{Access, Shader};

/// Through which part of the device a pass touches memory.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug, serde::Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Use {
    /// A storage buffer or a storage image of a kernel.
    Compute,
    /// The group counts of an indirect dispatch.
    Indirect,
    /// A fill, a clear or a copy.
    Transfer,
    /// A uniform buffer of a kernel.
    Uniform,
}

/// How many work groups run.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub enum Dispatch {
    /// As many as stated.
    Groups([u32; 3]),
    /// As many as three 32-bit numbers in a buffer say when the pass starts.
    Indirect {
        /// Where the numbers are.
        buffer: Buffer,
        /// At which byte.
        offset: u64,
    },
}

/// Bytes that an indirect dispatch reads.
pub const INDIRECT_BYTES: u64 = 12;

/// What a pass does.
#[derive(Clone, PartialEq, Debug)]
pub enum PassKind {
    /// Runs a kernel.
    Compute {
        /// The kernel.
        shader: Arc<Shader>,
        /// Specialization constants that were given: id and raw bits, by ascending id.
        specs: Vec<(u32, u32)>,
        /// Push constants, exactly as many bytes as the kernel has.
        push: Vec<u8>,
        /// Every binding of the kernel: number and what is bound, by ascending number.
        bindings: Vec<(u32, Slice)>,
        /// The subgroup size that the kernel must run with, if any.
        subgroup_size: Option<u32>,
        /// How much of it runs.
        dispatch: Dispatch,
    },
    /// Writes one 32-bit value over a range.
    Fill {
        /// What is overwritten.
        target: Slice,
        /// With what.
        value: u32,
    },
    /// Copies bytes.
    Copy {
        /// From where.
        source: Slice,
        /// To where; as long as the source.
        target: Slice,
    },
    /// Copies tightly packed texels over an image.
    CopyToImage {
        /// From where.
        source: Slice,
        /// To where.
        target: Image,
    },
    /// Copies an image's texels, tightly packed.
    CopyFromImage {
        /// From where.
        source: Image,
        /// To where.
        target: Slice,
    },
    /// Gives every texel of an image one value.
    ClearImage {
        /// Which image.
        target: Image,
        /// The components' bits: of floats, or of an integer for integer formats.
        value: [u32; 4],
    },
}

/// A declared pass.
#[derive(Clone, PartialEq, Debug)]
pub struct Pass {
    /// Its name in dumps, traces and errors.
    pub name: String,
    /// What it does.
    pub kind: PassKind,
    /// Every range it touches.
    pub accesses: Vec<(Slice, Access, Use)>,
    /// The word that says whether it runs at all: not if it is zero. Whoever does not run leaves everything as it was.
    pub condition: Option<Slice>,
    /// Those of its ranges whose earlier contents do not matter to it: it overwrites all of what anyone will read.
    pub discards: Vec<Slice>,
}

impl Pass {
    /// Whether the pass has promised not to depend on what this range held.
    pub fn discards(&self, slice: &Slice) -> bool {
        self.discards.contains(slice)
    }

    /// Whether it is a fill, a clear or a copy.
    pub fn is_transfer(&self) -> bool {
        !matches!(self.kind, PassKind::Compute { .. })
    }
}

/// Whether an access changes memory.
pub(crate) fn writes(access: Access) -> bool {
    access != Access::Read
}
