//! Exclusive prefix sums of any number of words.
//!
//! Three passes (reduce, then scan):
//!
//! * `scan_reduce`: sums each block. Reads 4 bytes per element. With an index, `scan_gather`: reads 8, writes 4.
//! * `scan_spine`: prefix sums of the block sums, by one workgroup, and the total. Reads and writes 4 bytes per
//!   *block*.
//! * `scan_down` (`scan_down_in_place`): prefix sums within each block. Reads 4 bytes per element, writes 4.
//!
//! The total is 12 bytes per element, 20 with an index.
//!
//! Guarantees: sums saturate at 0xFFFFFFFF, so an overflow never gives a small wrong total. This holds if the sum over
//! a block does not wrap. Blocks have at most 8192 elements, so it holds for elements below 2^19. Nothing after the
//! last element is written.

use super::work::{Blocks, Count, words};
use crate::Tuning;
use crate::kernel::stage;
use bytemuck::bytes_of;
use sgs_engine::graph::{Graph, GraphError, Slice};
use sgs_shaders::{scan_down, scan_down_in_place, scan_gather, scan_reduce, scan_spine};

/// Block sizes of a scan.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ScanShape {
    /// Subgroup size that the pipelines run at.
    pub subgroup_size: u32,
    /// Invocations per workgroup, a multiple of the subgroup size.
    pub workgroup: u32,
    /// Elements per invocation. `workgroup * items` is at most 8192.
    pub items: u32,
}

impl ScanShape {
    /// Returns the elements of a workgroup. A [`Count::Gpu`] with a record of this group size needs no extra pass.
    pub fn block(&self) -> u32 {
        self.workgroup * self.items
    }
}

impl From<Tuning> for ScanShape {
    fn from(tuning: Tuning) -> Self {
        let Tuning { subgroup_size, workgroup, .. } = tuning;
        if subgroup_size <= 8 {
            // On a CPU, barriers between subgroups cost more than they hide.
            ScanShape { subgroup_size, workgroup: subgroup_size, items: 4096 / subgroup_size }
        } else {
            ScanShape { subgroup_size, workgroup, items: (4096 / workgroup).max(1) }
        }
    }
}

/// Adds the passes that write the exclusive prefix sums of `input` to `output`. With an index they sum
/// `input[index[i]]`. The word `total` receives the sum of all elements. Input and output may be the same slice, unless
/// an index is present.
///
/// # Errors
/// If a slice does not belong to the graph, cannot be written, is too small, or overlaps another.
#[expect(clippy::too_many_arguments, reason = "declares a kernel")]
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
    // With an index the required length of the input depends on the index, which only the caller knows.
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

/// Adds the pass that scans `rows` rows of block sums in place. It writes the total of each row to `totals`. `idle` is
/// any memory that the pass does not write.
#[expect(clippy::too_many_arguments, reason = "declares a kernel")]
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
    // Up to 16 sums per invocation allow one round. Most scans are short, so the workgroup is no larger than necessary.
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
