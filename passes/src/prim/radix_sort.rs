//! Stable radix sort of 32-bit keys with 32-bit values by a range of bits.
//!
//! The sort processes digits from the lowest. Three passes per digit (reduce, then scan):
//!
//! * `radix_histogram`: counts each digit in each block. Reads 4 bytes per element.
//! * `scan_spine`: prefix sums over the blocks, one workgroup per digit. Reads and writes 4 bytes per digit and
//!   *block*.
//! * `radix_scatter`: moves every element to its position. Reads 8 bytes per element, writes 8. Without input values
//!   the first pass reads 4; the last pass writes 4 if the caller does not need the keys. On devices with subgroups of
//!   at most 8 (CPUs) `radix_scatter_direct` does the same without shared memory for whole blocks.
//!
//! The total is 20 bytes per element and digit, and 16 per value of the digit and *block*: about 1 byte per element at 8
//! bits.
//!
//! The range is split into as few digits as possible, of nearly equal width: 9 bits become 5 + 4, not 8 + 1.

use super::scan::{ScanShape, spine};
use super::work::{Count, words};
use crate::Tuning;
use bytemuck::bytes_of;
use sgs_engine::graph::{Graph, GraphError, Slice};
use sgs_shaders::{radix_histogram, radix_scatter, radix_scatter_direct};
use std::ops::Range;

/// Bits of the widest digit.
const MAX_DIGIT_BITS: u32 = 8;

/// Elements of a block that leave 1 KiB of 16 KiB for the places of 256 digits.
const SHARED_ELEMENTS: u32 = 3840;

/// Largest number of subgroups whose counters fit in shared memory.
const MAX_SUBGROUPS: u32 = 32;

/// Block and digit sizes of a sort.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SortShape {
    /// Subgroup size that the pipelines run at.
    pub subgroup_size: u32,
    /// Invocations per workgroup: a multiple of the subgroup size, at most 32 subgroups.
    pub workgroup: u32,
    /// Elements per invocation. `workgroup * items` is at most 4096, or 65535 if `direct`.
    pub items: u32,
    /// Largest number of bits of a digit, 1 to 8.
    pub digit_bits: u32,
    /// Counters per digit in `radix_histogram`. Divides `workgroup`; `copies << digit_bits` is at most 8192.
    pub copies: u32,
    /// Whether elements move to their positions without shared memory. The workgroup is one subgroup then.
    pub direct: bool,
}

impl SortShape {
    /// Returns the elements of a workgroup. A [`Count::Gpu`] with a record of this group size needs no extra pass.
    pub fn block(&self) -> u32 {
        self.workgroup * self.items
    }

    /// Returns whether the sizes meet the limits that the fields document.
    fn is_valid(&self) -> bool {
        let SortShape { subgroup_size, workgroup, digit_bits, copies, direct, .. } = *self;
        let subgroups = if direct { workgroup == subgroup_size } else { workgroup <= MAX_SUBGROUPS * subgroup_size };
        subgroups
            && workgroup.is_multiple_of(subgroup_size)
            && self.block() <= if direct { u32::from(u16::MAX) } else { 4096 }
            && (1..=MAX_DIGIT_BITS).contains(&digit_bits)
            && workgroup.is_multiple_of(copies)
            && copies << digit_bits <= 8192
    }
}

impl From<Tuning> for SortShape {
    fn from(tuning: Tuning) -> Self {
        let Tuning { subgroup_size, workgroup, .. } = tuning;
        let digit_bits = MAX_DIGIT_BITS;
        if subgroup_size <= 8 {
            let items = 4096 / subgroup_size;
            SortShape {
                subgroup_size,
                workgroup: subgroup_size,
                items,
                digit_bits,
                copies: subgroup_size,
                direct: true,
            }
        } else {
            let workgroup = workgroup.min(MAX_SUBGROUPS * subgroup_size);
            // Elements and the places of digits then take 16 KiB of shared memory.
            let items = (SHARED_ELEMENTS / workgroup).max(1);
            let copies = (workgroup / subgroup_size).min(8);
            SortShape { subgroup_size, workgroup, items, digit_bits, copies, direct: false }
        }
    }
}

/// Part of a key that one round sorts by.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Digit {
    /// Lowest bit of the digit.
    pub shift: u32,
    /// Number of bits.
    pub bits: u32,
}

/// Splits a range of bits into digits, the lowest first. Bits above 31 are zero in every key and omitted. An empty
/// range gives one digit of no bits, which preserves the order.
pub fn digits(bits: Range<u32>, digit_bits: u32) -> Vec<Digit> {
    let low = bits.start.min(31);
    let width = bits.end.min(32).saturating_sub(bits.start);
    let rounds = width.div_ceil(digit_bits.clamp(1, MAX_DIGIT_BITS)).max(1);
    let begin = |round: u32| low + round * (width / rounds) + round.min(width % rounds);
    (0..rounds).map(|round| Digit { shift: begin(round), bits: begin(round + 1) - begin(round) }).collect()
}

/// Result of a sort: transients of the graph, sized for the count's maximum.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sorted {
    /// Sorted keys, if requested.
    pub keys: Option<Slice>,
    /// Sorted values.
    pub values: Slice,
}

/// Adds the passes that sort pairs stably by the bits `bits` of their keys. Without `values` the values are the
/// positions 0, 1, 2… The input is not changed. `want_keys = false` saves 4 bytes per element.
///
/// # Errors
/// If a slice does not belong to the graph or is too small.
#[expect(clippy::too_many_arguments, reason = "declares a kernel")]
pub fn radix_sort(
    g: &mut Graph,
    shape: impl Into<SortShape>,
    name: &str,
    keys: impl Into<Slice>,
    values: Option<Slice>,
    bits: Range<u32>,
    want_keys: bool,
    count: Count,
) -> Result<Sorted, GraphError> {
    let shape = shape.into();
    debug_assert!(shape.is_valid(), "{shape:?}");
    let SortShape { subgroup_size: subgroup, workgroup, items, copies, direct, .. } = shape;
    let count = count.in_blocks(g, name, shape.block())?;
    let (limit, gpu_count, stride) = (count.max, count.on_gpu(), count.most());
    let mut keys = words(name, keys.into(), limit)?;
    let mut values = values.map(|slice| words(name, slice, limit)).transpose()?;
    let digits = digits(bits, shape.digit_bits);
    let mut sorted = Sorted { keys: None, values: keys };
    let bytes = 4 * u64::from(limit.max(1));
    for (round, &Digit { shift, bits }) in digits.iter().enumerate() {
        let rows = 1 << bits;
        let counts = Slice::from(g.transient(format!("{name}.counts{round}"), 4 * u64::from(rows) * u64::from(stride)));
        let totals = Slice::from(g.transient(format!("{name}.totals{round}"), 4 * u64::from(rows)));

        let pass = format!("{name}.radix_histogram{round}");
        let bindings = radix_histogram::Bindings { work: count.work(keys), keys, counts }.entries();
        let specs = radix_histogram::Specs { workgroup, items, bits, copies, gpu_count }.entries();
        let push = radix_histogram::Push { limit, shift, stride };
        count.stage(g, &pass, &radix_histogram::KERNEL, bindings, specs, bytes_of(&push), subgroup)?;

        let scan = ScanShape { subgroup_size: subgroup, workgroup, items };
        spine(g, &format!("{name}.radix_spine{round}"), scan, count, counts, totals, rows, keys)?;

        // Each round declares its own buffers; the plan reuses the memory of finished rounds.
        let keys_sorted = Slice::from(g.transient(format!("{name}.keys{round}"), bytes));
        let values_sorted = Slice::from(g.transient(format!("{name}.values{round}"), bytes));
        let pass = format!("{name}.radix_scatter{round}");
        let iota = values.is_none();
        let write_keys = want_keys || round + 1 < digits.len();
        let (work, payload) = (count.work(keys), values.unwrap_or(keys));
        if direct {
            use radix_scatter_direct::{Bindings, KERNEL, Push, Specs};
            let bindings =
                Bindings { work, totals, counts, keys, values: payload, keys_sorted, values_sorted }.entries();
            let specs = Specs { subgroup, items, bits, iota, write_keys, gpu_count }.entries();
            count.stage(g, &pass, &KERNEL, bindings, specs, bytes_of(&Push { limit, shift, stride }), subgroup)?;
        } else {
            use radix_scatter::{Bindings, KERNEL, Push, Specs};
            let bindings =
                Bindings { work, totals, counts, keys, values: payload, keys_sorted, values_sorted }.entries();
            let specs = Specs { workgroup, subgroup, items, bits, iota, write_keys, gpu_count }.entries();
            count.stage(g, &pass, &KERNEL, bindings, specs, bytes_of(&Push { limit, shift, stride }), subgroup)?;
        }
        (keys, values) = (keys_sorted, Some(values_sorted));
        sorted = Sorted { keys: want_keys.then_some(keys), values: values_sorted };
    }
    Ok(sorted)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn digits_cover_range_evenly() {
        let widths = |range, most| digits(range, most).iter().map(|d| d.bits).collect::<Vec<_>>();
        assert_eq!(widths(0..32, 8), [8, 8, 8, 8]);
        assert_eq!(widths(0..9, 8), [5, 4]);
        assert_eq!(widths(3..16, 8), [7, 6]);
        assert_eq!(widths(0..1, 8), [1]);
        assert_eq!(widths(0..8, 3), [3, 3, 2]);
        assert_eq!(widths(5..5, 8), [0]);
        for low in 0..34 {
            for high in low..36 {
                let cut = digits(low..high, 8);
                let mut at = low.min(31);
                for d in &cut {
                    assert_eq!(d.shift.min(31), at.min(31), "{low}..{high}: {cut:?}");
                    assert!(d.bits <= 8);
                    at += d.bits;
                }
                assert_eq!(at - low.min(31), high.min(32).saturating_sub(low), "{low}..{high}: {cut:?}");
            }
        }
    }
}
