//! The driver's data about compiled kernels, on disk between runs.
//!
//! Promises: the driver gets back what a driver gave, or nothing. Vulkan asks for that: drivers check whether the header is of their
//! device, and may believe the rest, so that a file which was cut off, or in which bits have turned, must not come to them.

use super::DeviceInfo;
use std::path::{Path, PathBuf};

/// What files begin with; their checksum follows, and the data.
const MAGIC: [u8; 8] = *b"SGSPIPE1";

/// The file of a device, its driver and its subgroup size: devices, and widths of one software device, keep theirs apart.
pub fn file(folder: &Path, info: &DeviceInfo) -> PathBuf {
    let clean = |s: &str| s.chars().map(|c| if c.is_ascii_alphanumeric() { c } else { '-' }).collect::<String>();
    folder.join(format!("{}-{}-{}.bin", clean(&info.name), clean(&info.driver), info.subgroup_size))
}

/// The data in a file; none if it is not there, or not whole.
pub fn read(path: &Path) -> Vec<u8> {
    let mut file = std::fs::read(path).unwrap_or_default();
    match opened(&file).map(<[u8]>::len) {
        Some(length) => file.split_off(file.len() - length),
        None => Vec::new(),
    }
}

/// Writes data into a file. Losing it costs time, never a result, so failures are not errors.
pub fn write(path: &Path, data: &[u8]) {
    let temporary = path.with_extension(format!("{}.tmp", std::process::id()));
    let written = path
        .parent()
        .map_or(Ok(()), std::fs::create_dir_all)
        .and_then(|()| std::fs::write(&temporary, sealed(data)))
        .and_then(|()| std::fs::rename(&temporary, path));
    if let Err(error) = written {
        tracing::debug!(%error, "pipeline cache not written");
    }
}

fn sealed(data: &[u8]) -> Vec<u8> {
    [&MAGIC[..], &crc32fast::hash(data).to_le_bytes(), data].concat()
}

fn opened(file: &[u8]) -> Option<&[u8]> {
    let (sum, data) = file.strip_prefix(&MAGIC)?.split_first_chunk()?;
    (crc32fast::hash(data) == u32::from_le_bytes(*sum)).then_some(data)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_not_whole_is_nothing() {
        let data: Vec<u8> = (0..200).collect();
        let whole = sealed(&data);
        assert_eq!(opened(&whole), Some(&data[..]));
        assert_eq!(opened(&sealed(&[])), Some(&[][..]));
        for end in 0..whole.len() {
            assert_eq!(opened(&whole[..end]), None, "cut off at {end}");
        }
        for bit in 0..8 * whole.len() {
            let mut turned = whole.clone();
            turned[bit / 8] ^= 1 << (bit % 8);
            assert_eq!(opened(&turned), None, "bit {bit}");
        }
        assert_eq!(opened(&[&whole[..], &[0]].concat()), None);
        assert_eq!(opened(&data), None, "as it was without a checksum");
    }

    #[test]
    fn what_comes_from_the_disk_is_what_went_there_or_nothing() {
        let path = std::env::temp_dir().join(format!("sgs-cache-{}", std::process::id())).join("device.bin");
        let data: Vec<u8> = (0..200).collect();
        write(&path, &data);
        assert_eq!(read(&path), data);
        let whole = std::fs::read(&path).expect("it is there");
        for damaged in [&[][..], &whole[..whole.len() - 1], &whole[1..], &data] {
            std::fs::write(&path, damaged).expect("it is written");
            assert_eq!(read(&path), [0; 0]);
        }
        write(&path, &data[..7]);
        assert_eq!(read(&path), data[..7]);
        std::fs::remove_dir_all(path.parent().expect("a folder")).expect("it goes");
        assert_eq!(read(&path), [0; 0]);
    }
}
