//! Where SanitizerCoverage hands over its counters. In the program alone: libFuzzer has such a function of its own.

use std::sync::atomic::AtomicU64;

/// Takes counters in one piece from `start` to `stop`. Called before `main`, once for each part of the program, always with the same piece.
///
/// # Safety
/// What lies between is the program's own, as long as it runs, and nothing but counters.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn __sanitizer_cov_8bit_counters_init(start: *mut u8, stop: *mut u8) {
    let width = size_of::<AtomicU64>();
    let (from, to) = (start.addr().next_multiple_of(width), stop.addr() / width * width);
    // Some seven counters at both ends are left out, where others may share a number with them.
    if let Some(bytes) = to.checked_sub(from).filter(|n| *n > 0) {
        let first = start.with_addr(from).cast::<AtomicU64>();
        // SAFETY: `first` and the length are within what the caller hands over, for good, and aligned; any bits are a number. The counting
        // is plain additions of bytes that the compiler puts in after Rust's rules are through: they can be lost beside ours, not torn.
        sgs_fuzz::enlist(unsafe { std::slice::from_raw_parts(first, bytes / width) });
    }
}
