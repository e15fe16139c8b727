//! How many elements a pass works on, and the Work records behind counts that only the GPU knows.
//!
//! A Work record (`work.glsl`) is the arguments of an indirect dispatch with the number of elements. Its arguments fit
//! one group size, so a count that several kernels follow has several records; [`work`] writes them, and refuses counts
//! beyond the capacity. Cost: one workgroup, 4 bytes read, 68 written.

use crate::kernel::{groups, stage};
use sgs_engine::graph::{Graph, GraphError, Slice};
use sgs_shaders::structs::Work;
use sgs_shaders::{Kernel, regroup, work as kernel};

const RECORD_BYTES: u64 = size_of::<Work>() as u64;

/// Work records of one count, one behind the other.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Records {
    /// Where the first one begins; kernels that need the count are bound to this.
    pub slice: Slice,
    /// Elements of a workgroup, by record; 0 where there is no record.
    pub group_sizes: [u32; 4],
    /// The count is never larger.
    pub max: u32,
}

impl Records {
    /// A single record.
    pub fn one(slice: impl Into<Slice>, group_size: u32, max: u32) -> Records {
        Records { slice: slice.into(), group_sizes: [group_size, 0, 0, 0], max }
    }

    /// Byte offset, in the buffer, of the record for a group size.
    pub fn offset(&self, group_size: u32) -> Option<u64> {
        let position = self.group_sizes.iter().position(|&size| size == group_size && size > 0)?;
        Some(self.slice.offset + position as u64 * RECORD_BYTES)
    }
}

/// A number of elements.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Count {
    /// Known now.
    Host(u32),
    /// Known to the GPU when the pass runs. Primitives that find no record for their group size add a pass that makes
    /// one.
    Gpu(Records),
}

impl Count {
    /// The largest that it can be.
    pub fn max(&self) -> u32 {
        match self {
            Count::Host(count) => *count,
            Count::Gpu(records) => records.max,
        }
    }

    /// What dispatches of one group size need, by a pass of its own if need be.
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

/// Adds the pass that makes a record for another group size.
fn regroup(g: &mut Graph, name: &str, work: Slice, group_size: u32) -> Result<Slice, GraphError> {
    let regrouped = Slice::from(g.transient(format!("{name}.work"), RECORD_BYTES));
    let bindings = regroup::Bindings { work, regrouped };
    let push = regroup::Push { group_size };
    stage(g, &format!("{name}.regroup"), &regroup::KERNEL, bindings.entries(), [], bytemuck::bytes_of(&push))
        .dispatch([1, 1, 1])?;
    Ok(regrouped)
}

/// A count in blocks of one size.
#[derive(Clone, Copy)]
pub(super) struct Blocks {
    /// Elements at most.
    pub max: u32,
    /// Elements of a block.
    pub block: u32,
    /// A binding that holds the count, and where in its buffer the arguments of the dispatch are.
    record: Option<(Slice, u64)>,
}

impl Blocks {
    /// Whether kernels have to ask for the count.
    pub fn on_gpu(&self) -> bool {
        self.record.is_some()
    }

    /// Blocks at most, and at least one.
    pub fn most(&self) -> u32 {
        self.max.div_ceil(self.block).max(1)
    }

    /// What the binding `work` is bound to; `idle` is anything that the pass does not write.
    pub fn work(&self, idle: Slice) -> Slice {
        self.record.map_or(Slice { bytes: 4, ..idle }, |(slice, _)| slice)
    }

    /// Adds a pass with a workgroup for each block, at a given subgroup size.
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

/// What happens to a count that exceeds the capacity.
#[derive(Clone, Copy, Debug)]
pub struct Overflow {
    /// The largest count that there is room for.
    pub capacity: u32,
    /// A word of flags; clearing it is up to the caller.
    pub flags: Slice,
    /// What is set in it.
    pub flag: u32,
    /// A word that receives the count before it is refused.
    pub wanted: Slice,
}

/// Adds the pass that turns the word `source` into Work records for several group sizes (unused ones may be 0, the
/// first may not), 64 bytes in `records`. A count beyond the capacity becomes 0 and raises the flag.
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
    // Unused records are written, too, so that nothing in the buffer is undefined.
    let push = kernel::Push { group_sizes: group_sizes.map(|size| size.max(1)), capacity, flag };
    stage(g, name, &kernel::KERNEL, bindings.entries(), [], bytemuck::bytes_of(&push)).dispatch([1, 1, 1])?;
    Ok(Records { slice, group_sizes, max: capacity })
}

/// The first `count` words of a slice (at least one, since nothing cannot be bound).
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
    // Whether a slice without a length of its own lies in its buffer is for the graph to say.
    Ok(Slice { bytes, ..slice })
}
