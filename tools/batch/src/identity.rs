//! Identities: hashes of what determines the result of a run.
//!
//! The hash is FNV-1a with 128 bits. It is no protection against an attacker.

use crate::error::{Result, failed};
use std::fmt;
use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

const BASIS: u128 = 0x6c62_272e_07bb_0142_62b8_2175_6295_c58d;
const PRIME: u128 = 0x0000_0000_0100_0000_0000_0000_0000_013b;

/// Deepest nesting of folders in a scene. A deeper one is a cycle of symbolic links.
const DEEPEST: usize = 32;

/// Hash of 128 bits: FNV-1a.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Digest(u128);

impl Digest {
    /// Returns the hash of no bytes.
    pub fn new() -> Digest {
        Digest(BASIS)
    }

    /// Parses the text of a hash.
    pub(crate) fn parse(text: &str) -> Option<Digest> {
        (text.len() == 32).then(|| u128::from_str_radix(text, 16).ok().map(Digest)).flatten()
    }

    /// Adds bytes.
    pub fn add(&mut self, bytes: &[u8]) {
        for byte in bytes {
            self.0 = (self.0 ^ u128::from(*byte)).wrapping_mul(PRIME);
        }
    }

    /// Adds a field. The length keeps neighboring fields apart.
    pub fn field(&mut self, bytes: &[u8]) {
        self.add(&(bytes.len() as u64).to_le_bytes());
        self.add(bytes);
    }
}

impl Default for Digest {
    fn default() -> Self {
        Digest::new()
    }
}

impl fmt::Display for Digest {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:032x}", self.0)
    }
}

/// Hashes the relative paths, sizes and bytes of a scene's files.
///
/// Hidden files and the ground truth in `gt` do not count: training does not read them. Times do not count either.
///
/// # Errors
/// If a file cannot be read.
pub fn scene_digest(root: &Path) -> Result<Digest> {
    let mut files = Vec::new();
    list(root, &PathBuf::new(), 0, &mut files)?;
    files.sort();
    let mut digest = Digest::new();
    let mut buffer = vec![0; 1 << 16];
    for relative in files {
        let path = root.join(&relative);
        digest.field(relative.to_string_lossy().as_bytes());
        let mut file = File::open(&path).map_err(failed("read", &path))?;
        let size = file.metadata().map_err(failed("read", &path))?.len();
        digest.add(&size.to_le_bytes());
        loop {
            let count = file.read(&mut buffer).map_err(failed("read", &path))?;
            if count == 0 {
                break;
            }
            digest.add(&buffer[..count]);
        }
    }
    Ok(digest)
}

fn list(root: &Path, folder: &Path, depth: usize, into: &mut Vec<PathBuf>) -> Result<()> {
    let at = root.join(folder);
    if depth > DEEPEST {
        let cause = std::io::Error::other(format!("it lies more than {DEEPEST} folders deep"));
        return Err(failed("read", &at)(cause));
    }
    for entry in std::fs::read_dir(&at).map_err(failed("read", &at))? {
        let name = entry.map_err(failed("read", &at))?.file_name();
        let hidden = name.to_string_lossy().starts_with('.');
        if hidden || depth == 0 && name == "gt" {
            continue;
        }
        let relative = folder.join(&name);
        let path = root.join(&relative);
        // Follows symbolic links: data sets link folders of images.
        if std::fs::metadata(&path).map_err(failed("read", &path))?.is_dir() {
            list(root, &relative, depth + 1, into)?;
        } else {
            into.push(relative);
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn hash(text: &str) -> String {
        let mut digest = Digest::new();
        digest.add(text.as_bytes());
        digest.to_string()
    }

    #[test]
    fn hash_matches_published_values() {
        assert_eq!(hash(""), "6c62272e07bb014262b821756295c58d");
        assert_eq!(hash("a"), "d228cb696f1a8caf78912b704e4a8964");
    }

    #[test]
    fn digest_depends_on_names_and_bytes_alone() {
        let folder = tempfile::tempdir().unwrap();
        let root = folder.path();
        std::fs::create_dir_all(root.join("images")).unwrap();
        std::fs::create_dir_all(root.join("gt")).unwrap();
        let put = |name: &str, bytes: &[u8]| std::fs::write(root.join(name), bytes).unwrap();
        put("images/0.png", &[7; 100_000]);
        put("cameras.txt", b"one");
        let first = scene_digest(root).unwrap();
        let old = std::time::SystemTime::UNIX_EPOCH;
        File::options().write(true).open(root.join("cameras.txt")).unwrap().set_modified(old).unwrap();
        put("gt/0.png", b"truth");
        put(".note", b"hidden");
        assert_eq!(scene_digest(root).unwrap(), first);
        let mut bytes = vec![7; 100_000];
        bytes[99_999] = 8;
        put("images/0.png", &bytes);
        let changed = scene_digest(root).unwrap();
        assert_ne!(changed, first);
        put("images/0.png", &[7; 100_000]);
        assert_eq!(scene_digest(root).unwrap(), first);
        std::fs::rename(root.join("images/0.png"), root.join("images/1.png")).unwrap();
        assert_ne!(scene_digest(root).unwrap(), first);
        assert!(scene_digest(&root.join("none")).is_err());
    }
}
