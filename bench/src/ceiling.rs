//! Measured peak rates of a device: `engine-bench ceiling`.

use serde::{Deserialize, Serialize};
use sgs_passes::cost::Cost;

/// Peak rates of a device.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Ceiling {
    /// Bytes read plus bytes written per second.
    ///
    /// Maximum of a large `vkCmdCopyBuffer`, a copy kernel and a fill kernel.
    pub bytes_per_second: f64,
    /// Single-precision operations per second; a multiply-add counts as two.
    pub operations_per_second: f64,
    /// Rate of the copy.
    pub copy_bytes_per_second: f64,
    /// Rate of the fill kernel.
    pub fill_bytes_per_second: f64,
    /// Rate of the copy kernel, 16 bytes per invocation; zero in reports from before it was measured.
    #[serde(default)]
    pub copy_kernel_bytes_per_second: f64,
    /// Seconds of a dispatch of one small workgroup, with the barrier before it; zero in reports from before it was measured.
    #[serde(default)]
    pub dispatch_seconds: f64,
    /// Peak rate of atomic additions per second: to neighboring words, without use of the results. 0 if not measured.
    #[serde(default)]
    pub atomics_per_second: f64,
}

impl Ceiling {
    /// Returns the minimum seconds for a cost, and whether memory is the bound.
    ///
    /// Atomic operations do not count.
    pub fn bound(&self, cost: &Cost) -> (f64, bool) {
        let memory = cost.bytes / self.bytes_per_second;
        let arithmetic = cost.operations / self.operations_per_second;
        (memory.max(arithmetic), memory >= arithmetic)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn larger_bound_determines_the_time() {
        let ceiling = Ceiling { bytes_per_second: 1e9, operations_per_second: 1e10, ..Default::default() };
        assert_eq!(ceiling.bound(&Cost { bytes: 1e9, operations: 1e9, ..Default::default() }), (1.0, true));
        assert_eq!(ceiling.bound(&Cost { bytes: 1e9, operations: 3e10, ..Default::default() }), (3.0, false));
    }
}
