//! An allocator that counts, so that memory out of proportion is seen before it is gone.

use std::alloc::{GlobalAlloc, Layout, System};
use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};

/// Bytes in use.
static LIVE: AtomicUsize = AtomicUsize::new(0);
/// Most bytes in use since [`begin`].
static PEAK: AtomicUsize = AtomicUsize::new(0);
/// Largest request that was refused since [`begin`].
static REFUSED: AtomicUsize = AtomicUsize::new(0);

/// What nobody is given: the machine has other users.
const MOST: usize = 3 << 30;

/// The system's allocator, counted. Give it to a program with `#[global_allocator]`; without, nothing is counted and nothing found.
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

/// Counts a request; false if it is to be refused.
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

/// Begins to measure; gives what is in use.
pub(crate) fn begin() -> usize {
    let live = LIVE.load(Relaxed);
    PEAK.store(live, Relaxed);
    REFUSED.store(0, Relaxed);
    live
}

/// The most that was in use beyond what was at the beginning, or a larger request that was refused.
pub(crate) fn most(begun: usize) -> usize {
    PEAK.load(Relaxed).saturating_sub(begun).max(REFUSED.load(Relaxed))
}
