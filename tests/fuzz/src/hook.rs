//! Callback that receives SanitizerCoverage's counters.
//!
//! Only the program has this callback, since libFuzzer defines its own.

use std::sync::atomic::AtomicU64;

/// Receives the counters from `start` to `stop`.
///
/// The runtime calls this function before `main`, once for each part of the program, always with the same range.
///
/// # Safety
/// The range is the program's own, lives as long as the program, and contains nothing but counters.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn __sanitizer_cov_8bit_counters_init(start: *mut u8, stop: *mut u8) {
    let width = size_of::<AtomicU64>();
    let (from, to) = (start.addr().next_multiple_of(width), stop.addr() / width * width);
    // Up to seven counters at each end are left out, where other data may share a word with them.
    if let Some(bytes) = to.checked_sub(from).filter(|n| *n > 0) {
        let first = start.with_addr(from).cast::<AtomicU64>();
        // SAFETY: `first` and the length are within the caller's range, for good, and aligned; any bits are a valid
        // number. The counting is plain additions of bytes, inserted by the compiler after Rust's rules have been
        // applied: an addition can be lost next to our accesses, but not torn.
        sgs_fuzz::enlist(unsafe { std::slice::from_raw_parts(first, bytes / width) });
    }
}
