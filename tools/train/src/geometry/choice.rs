//! Cache of the choice of the backward kernel, beside the pipeline cache.
//!
//! Each key has a file: device, driver, subgroup size, and classes of image sizes and counts of Gaussians.
//! A file that cannot be read, or that holds another key, is ignored and replaced. Files are renamed into place,
//! so that several processes can write at once.

use serde::{Deserialize, Serialize};
use sgs_config::Backward;
use std::io::{ErrorKind, Write};
use std::path::Path;

/// Conditions under which a choice holds.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Key {
    pub device: String,
    /// Driver and its version.
    pub driver: String,
    pub subgroup_size: u32,
    /// Number of the kernels' code.
    pub code: u64,
    /// Class of the pixels of the largest view.
    pub pixels: u32,
    /// Class of the number of Gaussians.
    pub gaussians: u32,
    /// Blended channels.
    pub channels: u32,
    /// Whether the backward pass gathers a statistic of densification.
    pub statistics: bool,
}

/// Content of a file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Choice {
    pub key: Key,
    /// Whether buckets were timed. They are not if they would leave memory for fewer Gaussians.
    pub buckets: bool,
    pub kernel: Backward,
}

/// Returns the class of a size: the exponent of the next power of two.
pub(super) fn class(size: u64) -> u32 {
    size.max(1).next_power_of_two().ilog2()
}

impl Key {
    /// Returns the part of the file name that tells apart the keys of one device.
    pub fn file(&self) -> String {
        let Key { pixels, gaussians, channels, statistics, .. } = self;
        format!("backward-{pixels}-{gaussians}-{channels}-{}.json", u32::from(*statistics))
    }
}

/// Reads the choice for a key. Returns `None` if there is none.
pub(super) fn read(file: &Path, key: &Key) -> Option<Choice> {
    let ignored = |reason: &str| {
        tracing::warn!("{}: {reason}; the backward kernel is chosen again and the file replaced", file.display());
        None
    };
    let text = match std::fs::read(file) {
        Ok(text) => text,
        Err(error) if error.kind() == ErrorKind::NotFound => return None,
        Err(error) => return ignored(&error.to_string()),
    };
    match serde_json::from_slice::<Choice>(&text) {
        Err(error) => ignored(&format!("not a choice of the backward kernel: {error}")),
        // Another version of the program wrote it, which is no fault.
        Ok(choice) if choice.key.code != key.code => None,
        Ok(choice) if choice.key != *key => ignored("describes another device or other sizes"),
        Ok(
            Choice { kernel: Backward::Auto | Backward::Atomic, .. }
            | Choice { buckets: false, kernel: Backward::Bucket, .. },
        ) => ignored("names a kernel that was not timed"),
        Ok(choice) => Some(choice),
    }
}

/// Writes a choice. A failure is logged, not returned: a lost choice costs only time.
pub(super) fn write(file: &Path, choice: &Choice) {
    let text = serde_json::to_string_pretty(choice).unwrap_or_default();
    let written = file
        .parent()
        .map_or(Ok(()), std::fs::create_dir_all)
        .map_err(|error| error.to_string())
        .and_then(|()| sgs_scene::atomic_write(file, |f| f.write_all(text.as_bytes())).map_err(|e| e.to_string()));
    if let Err(error) = written {
        tracing::debug!(error, "the choice of the backward kernel was not cached");
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn choice() -> Choice {
        let key = Key {
            device: "a GPU".into(),
            driver: "driver 1.2".into(),
            subgroup_size: 32,
            code: u64::MAX - 5,
            pixels: 17,
            gaussians: 20,
            channels: 8,
            statistics: true,
        };
        Choice { key, buckets: true, kernel: Backward::Bucket }
    }

    #[test]
    fn classes_are_powers_of_two() {
        assert_eq!([0, 1, 2, 3, 4, 5, 1 << 20, (1 << 20) + 1].map(class), [0, 0, 1, 2, 2, 3, 20, 21]);
    }

    #[test]
    fn damaged_and_foreign_files_are_ignored() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("new").join(choice().key.file());
        assert_eq!(read(&file, &choice().key), None);
        write(&file, &choice());
        assert_eq!(read(&file, &choice().key), Some(choice()));
        let whole = std::fs::read(&file).unwrap();
        for end in 0..whole.len() {
            std::fs::write(&file, &whole[..end]).unwrap();
            assert_eq!(read(&file, &choice().key), None, "cut off at {end}");
        }
        let of = |change: fn(&mut Choice)| {
            let mut other = choice();
            change(&mut other);
            write(&file, &other);
            read(&file, &choice().key)
        };
        assert_eq!(of(|c| c.key.device.push('2')), None);
        assert_eq!(of(|c| c.key.driver.push('3')), None);
        assert_eq!(of(|c| c.key.subgroup_size = 64), None);
        assert_eq!(of(|c| c.key.code -= 1), None);
        assert_eq!(of(|c| c.key.pixels += 1), None);
        assert_eq!(of(|c| c.kernel = Backward::Auto), None);
        assert_eq!(of(|c| c.kernel = Backward::Atomic), None);
        assert_eq!(of(|c| c.buckets = false), None);
        assert_eq!(of(|c| c.kernel = Backward::Splat).map(|c| c.kernel), Some(Backward::Splat));
        // A folder in place of the file cannot be read and not be replaced.
        std::fs::remove_file(&file).unwrap();
        std::fs::create_dir(&file).unwrap();
        write(&file, &choice());
        assert_eq!(read(&file, &choice().key), None);
    }

    /// Tests that a reader sees a whole file or none while others write.
    #[test]
    fn writers_do_not_disturb_readers() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("choice.json");
        let kernels = [Backward::Pixel, Backward::Splat];
        write(&file, &choice());
        std::thread::scope(|scope| {
            for kernel in kernels {
                let file = &file;
                scope.spawn(move || (0..20).for_each(|_| write(file, &Choice { kernel, ..choice() })));
            }
            for _ in 0..200 {
                assert!(read(&file, &choice().key).is_some());
            }
        });
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1, "temporary files are left");
    }
}
