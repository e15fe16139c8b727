//! Primitives: prefix sums, sorting, and how much work there is.
//!
//! Counts may come from the host or from the GPU ([`Count`]); in the second case dispatches are indirect and nothing is
//! read back. All of them are built from passes that only need the end of the pass before (reduce, then scan): nothing
//! waits for another workgroup within a pass, which Vulkan does not promise to work.

mod radix_sort;
mod scan;
mod work;

pub use radix_sort::{Digit, SortShape, Sorted, digits, radix_sort};
pub use scan::{ScanShape, exclusive_scan};
pub use work::{Count, Overflow, Records, work};
