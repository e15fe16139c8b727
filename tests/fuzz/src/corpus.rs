//! Corpus of each target: one safetensors file with an array of bytes per input.

use crate::target::Target;
use safetensors::{Dtype, SafeTensors, tensor::TensorView};
use std::collections::BTreeMap;
use std::io::Write;
use std::path::{Path, PathBuf};

/// Inputs by name.
pub type Inputs = BTreeMap<String, Vec<u8>>;

/// Returns the packed corpus file of a target, in a directory of corpora.
pub fn packed(folder: &Path, target: &str) -> PathBuf {
    folder.join(format!("{target}.safetensors"))
}

/// Returns the directory of the corpora.
pub fn folder() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("corpus")
}

/// Returns the corpus of a target.
///
/// # Panics
/// If the file is damaged.
pub fn corpus(target: &Target) -> Inputs {
    let path = packed(&folder(), target.name);
    read(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()))
}

/// Reads a packed corpus; an absent file has no inputs.
///
/// # Errors
/// If the file cannot be read.
pub fn read(path: &Path) -> std::io::Result<Inputs> {
    let bytes = match std::fs::read(path) {
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(Inputs::new()),
        read => read?,
    };
    let packed = SafeTensors::deserialize(&bytes).map_err(std::io::Error::other)?;
    Ok(packed.iter().map(|(name, view)| (name.to_owned(), view.data().to_vec())).collect())
}

/// Adds inputs to a packed corpus. Replaces inputs of the same names.
///
/// # Errors
/// If the file cannot be read or written.
pub fn add(path: &Path, inputs: impl IntoIterator<Item = (String, Vec<u8>)>) -> std::io::Result<()> {
    let mut all = read(path)?;
    all.extend(inputs);
    let view = |bytes| TensorView::new(Dtype::U8, vec![<[u8]>::len(bytes)], bytes);
    let views: Result<Vec<_>, _> = all.iter().map(|(name, bytes)| view(bytes).map(|v| (name, v))).collect();
    let packed = safetensors::serialize(views.map_err(std::io::Error::other)?, None).map_err(std::io::Error::other)?;
    sgs_scene::atomic_write(path, |out| out.write_all(&packed)).map_err(std::io::Error::other)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn added_inputs_are_read_back() {
        let place = tempfile::tempdir().expect("a folder");
        let path = packed(place.path(), "target");
        assert!(read(&path).expect("an absent file").is_empty());
        let input = |name: &str, bytes: &[u8]| (name.to_owned(), bytes.to_vec());
        add(&path, [input("empty", b""), input("one", b"1")]).expect("written");
        add(&path, [input("one", b"new"), input("two", b"\xff\0")]).expect("written");
        let found: Vec<_> = read(&path).expect("read").into_iter().collect();
        assert_eq!(found, [input("empty", b""), input("one", b"new"), input("two", b"\xff\0")]);
        std::fs::write(&path, b"damaged").expect("written");
        assert!(read(&path).is_err());
    }
}
