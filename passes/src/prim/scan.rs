//! Exclusive prefix sums of any number of words, in three passes (reduce, then scan).
//!
//! * `scan_reduce`: the sum of each block. Reads 4 bytes an element. With an index, `scan_gather`: reads 8, writes 4.
//! * `scan_spine`: prefix sums of the block sums, by one workgroup, and the total. Reads and writes 4 bytes a *block*.
//! * `scan_down` (`scan_down_in_place`): prefix sums within each block. Reads 4 bytes an element, writes 4.
//!
//! Together 12 bytes an element, 20 with an index.
//!
//! Promises: sums that would pass 0xFFFFFFFF stay there, so a total that large says "too many" and never a small wrong
//! number. That holds as long as the sum over a block does not wrap: blocks have 8192 elements at most, so for elements
//! below 2^19. Nothing behind the last element is written.

use super::work::{Blocks, Count, words};
use crate::Tuning;
use crate::kernel::stage;
use bytemuck::bytes_of;
use sgs_engine::graph::{Graph, GraphError, Slice};
use sgs_shaders::{scan_down, scan_down_in_place, scan_gather, scan_reduce, scan_spine};

/// How a scan is cut into pieces.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ScanShape {
    /// Subgroup size that the pipelines run at.
    pub subgroup_size: u32,
    /// Invocations of a workgroup, a multiple of the subgroup size.
    pub workgroup: u32,
    /// Elements of an invocation; `workgroup * items` is at most 8192.
    pub items: u32,
}

impl ScanShape {
    /// Elements of a workgroup: at this group size a [`Count::Gpu`] needs no pass of its own.
    pub fn block(&self) -> u32 {
        self.workgroup * self.items
    }
}

impl From<Tuning> for ScanShape {
    fn from(tuning: Tuning) -> Self {
        let Tuning { subgroup_size, workgroup, .. } = tuning;
        if subgroup_size <= 8 {
            // A processor: barriers between subgroups cost more than they hide.
            ScanShape { subgroup_size, workgroup: subgroup_size, items: 4096 / subgroup_size }
        } else {
            ScanShape { subgroup_size, workgroup, items: (4096 / workgroup).max(1) }
        }
    }
}

/// Adds the passes that write the exclusive prefix sums of `input` (of `input[index[i]]` with an index) to `output` and
/// the sum of all to the word `total`. Input and output may be the same slice, unless there is an index.
///
/// # Errors
/// If a slice does not belong to the graph, cannot be written, is too small, or overlaps another.
pub fn exclusive_scan(
    g: &mut Graph,
    shape: impl Into<ScanShape>,
    name: &str,
    input: impl Into<Slice>,
    index: Option<Slice>,
    output: impl Into<Slice>,
    total: impl Into<Slice>,
    count: Count,
) -> Result<(), GraphError> {
    let shape = shape.into();
    let ScanShape { subgroup_size: subgroup, workgroup, items } = shape;
    debug_assert!(shape.workgroup.is_multiple_of(shape.subgroup_size) && shape.block() <= 8192, "{shape:?}");
    let (input, output, total) = (input.into(), output.into(), total.into());
    let count = count.in_blocks(g, name, shape.block())?;
    let elements = |slice| words(name, slice, count.max);
    // With an index the input is as long as the index says, which only its author knows.
    let source = if index.is_some() { input } else { elements(input)? };
    let target = elements(output)?;
    let sums = Slice::from(g.transient(format!("{name}.sums"), 4 * u64::from(count.most())));
    let (limit, gpu_count) = (count.max, count.on_gpu());

    let pass = format!("{name}.scan_reduce");
    let idle = if let Some(index) = index {
        let index = elements(index)?;
        use scan_gather::{Bindings, KERNEL, Push, Specs};
        let bindings = Bindings { work: count.work(index), source, index, target, sums }.entries();
        let specs = Specs { workgroup, subgroup, items, gpu_count }.entries();
        count.stage(g, &pass, &KERNEL, bindings, specs, bytes_of(&Push { limit }), subgroup)?;
        index
    } else {
        use scan_reduce::{Bindings, KERNEL, Push, Specs};
        let bindings = Bindings { work: count.work(source), source, sums }.entries();
        let specs = Specs { workgroup, subgroup, items, gpu_count }.entries();
        count.stage(g, &pass, &KERNEL, bindings, specs, bytes_of(&Push { limit }), subgroup)?;
        source
    };

    spine(g, &format!("{name}.scan_spine"), shape, count, sums, total, 1, idle)?;

    let pass = format!("{name}.scan_down");
    if index.is_some() || source == target {
        use scan_down_in_place::{Bindings, KERNEL, Push, Specs};
        let bindings = Bindings { work: count.work(sums), sums, target }.entries();
        let specs = Specs { workgroup, subgroup, items, gpu_count }.entries();
        count.stage(g, &pass, &KERNEL, bindings, specs, bytes_of(&Push { limit }), subgroup)
    } else {
        use scan_down::{Bindings, KERNEL, Push, Specs};
        let bindings = Bindings { work: count.work(sums), sums, source, target }.entries();
        let specs = Specs { workgroup, subgroup, items, gpu_count }.entries();
        count.stage(g, &pass, &KERNEL, bindings, specs, bytes_of(&Push { limit }), subgroup)
    }
}

/// Adds the pass that scans `rows` rows of block sums in place and writes the total of each. `idle` is any memory that
/// it does not write.
pub(super) fn spine(
    g: &mut Graph,
    name: &str,
    shape: ScanShape,
    count: Blocks,
    sums: Slice,
    totals: Slice,
    rows: u32,
    idle: Slice,
) -> Result<(), GraphError> {
    // One round if 16 sums an invocation are enough, and no larger than what there is to do: most scans are short.
    let items = count.most().div_ceil(shape.workgroup).clamp(1, 16);
    let workgroup = count.most().div_ceil(items).next_multiple_of(shape.subgroup_size).min(shape.workgroup);
    let totals = words(name, totals, rows)?;
    let bindings = scan_spine::Bindings { work: count.work(idle), sums, totals };
    let specs = scan_spine::Specs { workgroup, subgroup: shape.subgroup_size, items, gpu_count: count.on_gpu() };
    let push = scan_spine::Push { limit: count.max, block: count.block, stride: count.most() };
    stage(g, name, &scan_spine::KERNEL, bindings.entries(), specs.entries(), bytes_of(&push))
        .subgroup_size(Some(shape.subgroup_size))
        .dispatch([rows, 1, 1])
}
