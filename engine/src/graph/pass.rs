//! Declared pass: its operation and every byte range that it accesses, with access type and pipeline use.
//!
//! Built only by [`super::builder`], which promises that the accesses cover everything the kind implies.

use std::sync::Arc;

use super::resource::{Buffer, Image, Slice};
use crate::shader::{Access, Shader};

/// Pipeline use of an access.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug, serde::Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Use {
    /// Storage buffer or storage image of a kernel.
    Compute,
    /// Group counts of an indirect dispatch.
    Indirect,
    /// Fill, clear or copy.
    Transfer,
    /// Uniform buffer of a kernel.
    Uniform,
}

/// Number of workgroups.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub enum Dispatch {
    /// Constant counts.
    Groups([u32; 3]),
    /// Three 32-bit counts in a buffer, read when the pass starts.
    Indirect {
        /// Buffer of the counts.
        buffer: Buffer,
        /// Byte offset of the counts.
        offset: u64,
    },
}

/// Size of indirect dispatch arguments in bytes.
pub const INDIRECT_BYTES: u64 = 12;

/// Operation of a pass.
#[derive(Clone, PartialEq, Debug)]
pub enum PassKind {
    /// Runs a kernel.
    Compute {
        /// Kernel.
        shader: Arc<Shader>,
        /// Specialization constants: id and raw bits, by ascending id.
        specs: Vec<(u32, u32)>,
        /// Push constants, exactly as long as the kernel declares.
        push: Vec<u8>,
        /// All bindings of the kernel: number and slice, by ascending number.
        bindings: Vec<(u32, Slice)>,
        /// Required subgroup size, if any.
        subgroup_size: Option<u32>,
        /// Workgroup counts.
        dispatch: Dispatch,
    },
    /// Fills a range with one 32-bit value.
    Fill {
        /// Range to fill.
        target: Slice,
        /// Value.
        value: u32,
    },
    /// Copies bytes.
    Copy {
        /// Source range.
        source: Slice,
        /// Target range, as long as the source.
        target: Slice,
    },
    /// Copies tightly packed texels to an image.
    CopyToImage {
        /// Source range.
        source: Slice,
        /// Target image.
        target: Image,
    },
    /// Copies an image's texels to a buffer, tightly packed.
    CopyFromImage {
        /// Source image.
        source: Image,
        /// Target range.
        target: Slice,
    },
    /// Sets every texel of an image to one value.
    ClearImage {
        /// Target image.
        target: Image,
        /// Bits of the components: floats, or integers for integer formats.
        value: [u32; 4],
    },
}

/// Declared pass.
#[derive(Clone, PartialEq, Debug)]
pub struct Pass {
    /// Name in dumps, traces and errors.
    pub name: String,
    /// Operation.
    pub kind: PassKind,
    /// All accessed ranges.
    pub accesses: Vec<(Slice, Access, Use)>,
    /// Ranges whose earlier contents are not needed: the pass overwrites everything that is read later.
    pub discards: Vec<Slice>,
}

impl Pass {
    /// Returns whether the pass discards the contents of this range.
    pub fn discards(&self, slice: &Slice) -> bool {
        self.discards.contains(slice)
    }

    /// Returns whether the pass is a fill, a clear or a copy.
    pub fn is_transfer(&self) -> bool {
        !matches!(self.kind, PassKind::Compute { .. })
    }
}

/// Returns whether an access writes memory.
pub(crate) fn writes(access: Access) -> bool {
    access != Access::Read
}
