//! On-disk pipeline cache of the driver.
//!
//! Promises: the driver receives either data that a driver wrote, or nothing. Drivers validate only the header, so a
//! checksum rejects truncated and corrupted files.

use super::DeviceInfo;
use std::path::{Path, PathBuf};

/// Magic bytes at the start of a file, followed by the checksum and the data.
const MAGIC: [u8; 8] = *b"SGSPIPE1";

/// Returns the cache file of a device, driver and subgroup size.
///
/// Each subgroup size of a software device has its own file.
pub fn file(folder: &Path, info: &DeviceInfo) -> PathBuf {
    let clean = |s: &str| s.chars().map(|c| if c.is_ascii_alphanumeric() { c } else { '-' }).collect::<String>();
    folder.join(format!("{}-{}-{}.bin", clean(&info.name), clean(&info.driver), info.subgroup_size))
}

/// Reads the data of a file. Returns an empty vector if the file is missing or damaged.
pub fn read(path: &Path) -> Vec<u8> {
    let mut file = std::fs::read(path).unwrap_or_default();
    match decode(&file).map(<[u8]>::len) {
        Some(length) => file.split_off(file.len() - length),
        None => Vec::new(),
    }
}

/// Writes data to a file. Failures are logged, not returned: a lost cache costs only time.
pub fn write(path: &Path, data: &[u8]) {
    let temporary = path.with_extension(format!("{}.tmp", std::process::id()));
    let written = path
        .parent()
        .map_or(Ok(()), std::fs::create_dir_all)
        .and_then(|()| std::fs::write(&temporary, encode(data)))
        .and_then(|()| std::fs::rename(&temporary, path));
    if let Err(error) = written {
        tracing::debug!(%error, "pipeline cache not written");
    }
}

fn encode(data: &[u8]) -> Vec<u8> {
    [&MAGIC[..], &crc32fast::hash(data).to_le_bytes(), data].concat()
}

fn decode(file: &[u8]) -> Option<&[u8]> {
    let (sum, data) = file.strip_prefix(&MAGIC)?.split_first_chunk()?;
    (crc32fast::hash(data) == u32::from_le_bytes(*sum)).then_some(data)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn damaged_data_is_rejected() {
        let data: Vec<u8> = (0..200).collect();
        let whole = encode(&data);
        assert_eq!(decode(&whole), Some(&data[..]));
        assert_eq!(decode(&encode(&[])), Some(&[][..]));
        for end in 0..whole.len() {
            assert_eq!(decode(&whole[..end]), None, "cut off at {end}");
        }
        for bit in 0..8 * whole.len() {
            let mut flipped = whole.clone();
            flipped[bit / 8] ^= 1 << (bit % 8);
            assert_eq!(decode(&flipped), None, "bit {bit}");
        }
        assert_eq!(decode(&[&whole[..], &[0]].concat()), None);
        assert_eq!(decode(&data), None, "data without a checksum");
    }

    #[test]
    fn read_returns_written_data_or_nothing() {
        let path = std::env::temp_dir().join(format!("sgs-cache-{}", std::process::id())).join("device.bin");
        let data: Vec<u8> = (0..200).collect();
        write(&path, &data);
        assert_eq!(read(&path), data);
        let whole = std::fs::read(&path).expect("the cache file is readable");
        for damaged in [&[][..], &whole[..whole.len() - 1], &whole[1..], &data] {
            std::fs::write(&path, damaged).expect("the damaged file is written");
            assert_eq!(read(&path), [0; 0]);
        }
        write(&path, &data[..7]);
        assert_eq!(read(&path), data[..7]);
        std::fs::remove_dir_all(path.parent().expect("the file has a folder")).expect("the folder is removed");
        assert_eq!(read(&path), [0; 0]);
    }
}
