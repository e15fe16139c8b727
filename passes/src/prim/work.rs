//! Element counts of passes, and Work records of counts that only the GPU knows.
//!
//! A Work record (`work.glsl`) holds the arguments of an indirect dispatch and the number of elements. Its arguments
//! fit one group size, so a count that several kernels use has several records. [`work`] writes the records and rejects
//! counts beyond the capacity. Cost: one workgroup, 4 bytes read, 68 written.

use crate::kernel::{groups, stage};
use sgs_engine::graph::{Graph, GraphError, Slice};
use sgs_shaders::structs::Work;
use sgs_shaders::{Kernel, regroup, work as kernel};

const RECORD_BYTES: u64 = size_of::<Work>() as u64;

/// Work records of one count, one after the other.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Records {
    /// Slice of the first record. Kernels that need the count bind it.
    pub slice: Slice,
    /// Elements of a workgroup, by record; 0 for an absent record.
    pub group_sizes: [u32; 4],
    /// Upper bound of the count.
    pub max: u32,
}

impl Records {
    /// Returns a single record.
    pub fn one(slice: impl Into<Slice>, group_size: u32, max: u32) -> Records {
        Records { slice: slice.into(), group_sizes: [group_size, 0, 0, 0], max }
    }

    /// Returns the record's byte offset in the buffer for a group size.
    pub fn offset(&self, group_size: u32) -> Option<u64> {
        let position = self.group_sizes.iter().position(|&size| size == group_size && size > 0)?;
        Some(self.slice.offset + position as u64 * RECORD_BYTES)
    }
}

/// Number of elements.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Count {
    /// Known when the graph is built.
    Host(u32),
    /// Known to the GPU when the pass runs. Primitives without a record for their group size add a pass that creates
    /// it.
    Gpu(Records),
}

impl Count {
    /// Returns the upper bound of the count.
    pub fn max(&self) -> u32 {
        match self {
            Count::Host(count) => *count,
            Count::Gpu(records) => records.max,
        }
    }

    /// Returns the count in blocks of one size. Adds a pass that creates the record if none fits.
    pub(super) fn in_blocks(self, g: &mut Graph, name: &str, block: u32) -> Result<Blocks, GraphError> {
        let record = match self {
            Count::Host(_) => None,
            Count::Gpu(records) => match records.offset(block) {
                Some(offset) => Some((records.slice, offset)),
                None => Some((regroup(g, name, records.slice, block)?, 0)),
            },
        };
        Ok(Blocks { max: self.max(), block, record })
    }
}

/// Adds the pass that creates a record for another group size.
fn regroup(g: &mut Graph, name: &str, work: Slice, group_size: u32) -> Result<Slice, GraphError> {
    let regrouped = Slice::from(g.transient(format!("{name}.work"), RECORD_BYTES));
    let bindings = regroup::Bindings { work, regrouped };
    let push = regroup::Push { group_size };
    stage(g, &format!("{name}.regroup"), &regroup::KERNEL, bindings.entries(), [], bytemuck::bytes_of(&push))
        .dispatch([1, 1, 1])?;
    Ok(regrouped)
}

/// Count in blocks of one size.
#[derive(Clone, Copy)]
pub(super) struct Blocks {
    /// Largest number of elements.
    pub max: u32,
    /// Elements of a block.
    pub block: u32,
    /// Binding with the count, and byte offset of the dispatch arguments in its buffer.
    record: Option<(Slice, u64)>,
}

impl Blocks {
    /// Returns whether kernels read the count from the GPU.
    pub fn on_gpu(&self) -> bool {
        self.record.is_some()
    }

    /// Returns the largest number of blocks, at least one.
    pub fn most(&self) -> u32 {
        self.max.div_ceil(self.block).max(1)
    }

    /// Returns the slice to bind to `work`. `idle` is any memory that the pass does not write.
    pub fn work(&self, idle: Slice) -> Slice {
        self.record.map_or(Slice { bytes: 4, ..idle }, |(slice, _)| slice)
    }

    /// Adds a pass with one workgroup per block, at the requested subgroup size.
    #[expect(clippy::too_many_arguments, reason = "declares a kernel")]
    pub fn stage(
        &self,
        g: &mut Graph,
        name: &str,
        kernel: &'static Kernel,
        bindings: impl IntoIterator<Item = (&'static str, Slice)>,
        specs: impl IntoIterator<Item = (&'static str, u32)>,
        push: &[u8],
        subgroup_size: u32,
    ) -> Result<(), GraphError> {
        let pass = stage(g, name, kernel, bindings, specs, push).subgroup_size(Some(subgroup_size));
        match self.record {
            Some((slice, offset)) => pass.dispatch_indirect(slice.buffer, offset),
            None => pass.dispatch(groups(self.max.into(), self.block)),
        }
    }
}

/// Handling of a count that exceeds the capacity.
#[derive(Clone, Copy, Debug)]
pub struct Overflow {
    /// Largest count that fits.
    pub capacity: u32,
    /// Flag word; the caller clears it.
    pub flags: Slice,
    /// Bits that an overflow sets in the flag word.
    pub flag: u32,
    /// Word that receives the count, even if it exceeds the capacity.
    pub wanted: Slice,
}

/// Adds the pass that converts the word `source` into Work records. Each record has its own group size; unused sizes
/// may be 0, the first may not. `records` has 64 bytes. A count beyond the capacity becomes 0 and sets the flag.
///
/// # Errors
/// If a slice does not belong to the graph, cannot be written, or is too small.
pub fn work(
    g: &mut Graph,
    name: &str,
    source: impl Into<Slice>,
    overflow: Overflow,
    records: impl Into<Slice>,
    group_sizes: [u32; 4],
) -> Result<Records, GraphError> {
    let Overflow { capacity, flags, flag, wanted } = overflow;
    let slice = words(name, records.into(), 16)?;
    let bindings = kernel::Bindings {
        source: words(name, source.into(), 1)?,
        works: slice,
        required: words(name, wanted, 1)?,
        flags: words(name, flags, 1)?,
    };
    // Unused records are written too, so that the whole buffer is defined.
    let push = kernel::Push { group_sizes: group_sizes.map(|size| size.max(1)), capacity, flag };
    stage(g, name, &kernel::KERNEL, bindings.entries(), [], bytemuck::bytes_of(&push)).dispatch([1, 1, 1])?;
    Ok(Records { slice, group_sizes, max: capacity })
}

/// Returns the first `count` words of a slice; at least one, since an empty slice cannot be bound.
pub(super) fn words(pass: &str, slice: Slice, count: u32) -> Result<Slice, GraphError> {
    let bytes = 4 * u64::from(count.max(1));
    if slice.bytes < bytes {
        return Err(GraphError::SliceRange {
            pass: pass.to_owned(),
            buffer: format!("number {}", slice.buffer.index()),
            offset: slice.offset,
            bytes,
            size: slice.offset + slice.bytes,
        });
    }
    // The graph checks whether a slice without its own length lies within its buffer.
    Ok(Slice { bytes, ..slice })
}
