//! Counts of calls, in a file that other processes can read.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// Variable with the path of the file of counts. Without it, counts stay in the driver.
pub const FILE_VARIABLE: &str = "SGS_NULL_DRIVER_COUNTS";

/// Counted calls. Values are positions in the file, in units of eight bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(usize)]
pub enum Counter {
    /// Submissions to a queue.
    Submits,
    /// Command buffers whose recording began.
    Recordings,
    /// Recorded commands.
    Commands,
    /// Descriptors that were written.
    Descriptors,
    /// Allocations of device memory.
    Allocations,
    /// Created buffers, images, pools, pipelines, and other objects.
    Objects,
    /// Waits for semaphores.
    Waits,
    /// Bytes that transfers copied or filled.
    TransferBytes,
    /// Submissions to the queue that only transfers.
    TransferSubmits,
}

impl Counter {
    /// All counters, in the order of the file.
    pub const ALL: [Counter; 9] = [
        Counter::Submits,
        Counter::Recordings,
        Counter::Commands,
        Counter::Descriptors,
        Counter::Allocations,
        Counter::Objects,
        Counter::Waits,
        Counter::TransferBytes,
        Counter::TransferSubmits,
    ];
}

/// Size of the file.
pub const BYTES: usize = 4096;

/// Reads the counts of a file, in the order of [`Counter::ALL`].
///
/// # Errors
/// If the file cannot be read.
pub fn read(file: &Path) -> std::io::Result<[u64; Counter::ALL.len()]> {
    let bytes = std::fs::read(file)?;
    let mut counts = [0; Counter::ALL.len()];
    for (count, bytes) in counts.iter_mut().zip(bytes.chunks_exact(8)) {
        *count = u64::from_ne_bytes(bytes.try_into().unwrap_or_default());
    }
    Ok(counts)
}

/// Counters of an instance.
#[derive(Clone)]
pub(crate) struct Counters(Place);

#[derive(Clone)]
enum Place {
    Own(Arc<[AtomicU64; Counter::ALL.len()]>),
    Mapped(&'static [AtomicU64; Counter::ALL.len()]),
}

impl Counters {
    /// Maps the file that the environment names, if there is one.
    pub fn open() -> Counters {
        let mapped = std::env::var_os(FILE_VARIABLE).and_then(|file| map(Path::new(&file)));
        Counters(mapped.map_or_else(|| Place::Own(Arc::default()), Place::Mapped))
    }

    pub fn add(&self, counter: Counter, count: u64) {
        let all: &[AtomicU64] = match &self.0 {
            Place::Own(all) => all.as_slice(),
            Place::Mapped(all) => all.as_slice(),
        };
        all[counter as usize].fetch_add(count, Ordering::Relaxed);
    }
}

/// Maps a file of [`BYTES`] bytes for the rest of the process.
fn map(file: &Path) -> Option<&'static [AtomicU64; Counter::ALL.len()]> {
    use rustix::mm::{MapFlags, ProtFlags, mmap};
    let file = std::fs::OpenOptions::new().read(true).write(true).open(file).ok()?;
    file.set_len(BYTES as u64).ok()?;
    let access = ProtFlags::READ | ProtFlags::WRITE;
    // SAFETY: a new mapping at an address that the kernel chooses replaces no other memory.
    let pointer = unsafe { mmap(std::ptr::null_mut(), BYTES, access, MapFlags::SHARED, &file, 0) }.ok()?;
    // SAFETY: the mapping is never removed, is aligned to a page, and is larger than the array. Atomics allow other
    // threads and processes to access it at the same time.
    Some(unsafe { &*pointer.cast() })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counters_are_numbered_in_order() {
        for (i, counter) in Counter::ALL.into_iter().enumerate() {
            assert_eq!(counter as usize, i);
        }
    }

    #[test]
    fn mapped_counts_are_read_from_the_file() {
        let path = std::env::temp_dir().join(format!("sgs-null-driver-{}", std::process::id()));
        std::fs::write(&path, []).unwrap();
        let counters = Counters(Place::Mapped(map(&path).unwrap()));
        counters.add(Counter::Recordings, 3);
        counters.clone().add(Counter::Recordings, 4);
        counters.add(Counter::TransferSubmits, 1);
        let counts = read(&path).unwrap();
        assert_eq!((counts[Counter::Recordings as usize], counts[Counter::TransferSubmits as usize]), (7, 1));
        assert_eq!(counts.iter().sum::<u64>(), 8);
        std::fs::remove_file(path).unwrap();
    }
}
