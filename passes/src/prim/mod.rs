//! Primitives: prefix sums, sorting, and counts of work.
//!
//! Counts come from the host or from the GPU ([`Count`]). With GPU counts dispatches are indirect and nothing is read
//! back. Primitives consist of passes that depend only on the end of the previous pass (reduce, then scan). No
//! workgroup waits for another within a pass, since Vulkan does not guarantee progress there.

mod radix_sort;
mod scan;
mod work;

pub use radix_sort::{Digit, SortShape, Sorted, digits, radix_sort};
pub use scan::{ScanShape, exclusive_scan};
pub use work::{Count, Overflow, Records, work};
