//! Counting allocator, which detects excessive memory before it is exhausted.

use std::alloc::{GlobalAlloc, Layout, System};
use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};

/// Number of bytes in use.
static LIVE: AtomicUsize = AtomicUsize::new(0);
/// Largest number of bytes in use since [`begin`].
static PEAK: AtomicUsize = AtomicUsize::new(0);
/// Size of the largest request that was refused since [`begin`].
static REFUSED: AtomicUsize = AtomicUsize::new(0);

/// Maximum number of bytes in use; the machine has other users.
const MOST: usize = 3 << 30;

/// System allocator with counters.
///
/// Install the allocator with `#[global_allocator]`. Otherwise nothing is counted, and no excess of memory is found.
pub struct Counting;

// SAFETY: every call is passed on to the system's allocator, or refused as an allocator may.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        if !more(layout.size()) {
            return std::ptr::null_mut();
        }
        // SAFETY: as the caller promises.
        unsafe { System.alloc(layout) }
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        if !more(layout.size()) {
            return std::ptr::null_mut();
        }
        // SAFETY: as the caller promises.
        unsafe { System.alloc_zeroed(layout) }
    }

    unsafe fn dealloc(&self, at: *mut u8, layout: Layout) {
        LIVE.fetch_sub(layout.size(), Relaxed);
        // SAFETY: as the caller promises.
        unsafe { System.dealloc(at, layout) }
    }

    unsafe fn realloc(&self, at: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        if !more(size) {
            return std::ptr::null_mut();
        }
        LIVE.fetch_sub(layout.size(), Relaxed);
        // SAFETY: as the caller promises.
        unsafe { System.realloc(at, layout, size) }
    }
}

/// Counts a request. Returns false if the request must be refused.
fn more(size: usize) -> bool {
    let live = LIVE.fetch_add(size, Relaxed).saturating_add(size);
    if live > MOST {
        LIVE.fetch_sub(size, Relaxed);
        REFUSED.fetch_max(size, Relaxed);
        return false;
    }
    PEAK.fetch_max(live, Relaxed);
    true
}

/// Starts a measurement. Returns the number of bytes in use.
pub(crate) fn begin() -> usize {
    let live = LIVE.load(Relaxed);
    PEAK.store(live, Relaxed);
    REFUSED.store(0, Relaxed);
    live
}

/// Returns the peak since [`begin`] beyond `begun`, or a larger refused request.
pub(crate) fn most(begun: usize) -> usize {
    PEAK.load(Relaxed).saturating_sub(begun).max(REFUSED.load(Relaxed))
}
