//! Tensors for safetensors files, and byte-identical files for equal tensors.

use safetensors::{Dtype, SafeTensorError, View};
use std::borrow::Cow;
use std::collections::{BTreeMap, HashMap};

/// Serializes tensors to the safetensors format with sorted metadata.
///
/// The `safetensors` crate writes metadata in the random order of a hash map. Sorted keys give equal runs equal
/// files.
///
/// # Errors
/// If names repeat, or shapes do not match the data.
/// If names repeat, or shapes do not fit their numbers.
pub fn serialize<N: AsRef<str> + Ord + std::fmt::Display, V: View>(
    tensors: impl IntoIterator<Item = (N, V)>,
    meta: HashMap<String, String>,
) -> Result<Vec<u8>, SafeTensorError> {
    let sorted: BTreeMap<String, String> = meta.clone().into_iter().collect();
    let mut bytes = safetensors::serialize(tensors, Some(meta))?;
    let (length, rest) = bytes.split_first_chunk_mut::<8>().ok_or(SafeTensorError::HeaderTooSmall)?;
    let length = usize::try_from(u64::from_le_bytes(*length)).map_err(|_| SafeTensorError::HeaderTooLarge)?;
    let header = rest.get_mut(..length).ok_or(SafeTensorError::InvalidHeaderLength)?;
    let mut fields: BTreeMap<String, serde_json::Value> = serde_json::from_slice(header)?;
    fields.insert(METADATA.to_owned(), serde_json::to_value(sorted)?);
    let text = serde_json::to_vec(&fields)?;
    // Sorting keys does not change the length of the header, except for its padding.
    let (to, padding) = header.split_at_mut_checked(text.len()).ok_or(SafeTensorError::InvalidHeaderLength)?;
    to.copy_from_slice(&text);
    padding.fill(b' ');
    Ok(bytes)
}

/// Header key of the metadata.
const METADATA: &str = "__metadata__";

/// 32-bit floats and their shape.
pub struct Floats<'a>(pub &'a [f32], pub Vec<usize>);

impl View for Floats<'_> {
    fn dtype(&self) -> Dtype {
        Dtype::F32
    }
    fn shape(&self) -> &[usize] {
        &self.1
    }
    fn data(&self) -> Cow<'_, [u8]> {
        Cow::Borrowed(bytemuck::cast_slice(self.0))
    }
    fn data_len(&self) -> usize {
        size_of_val(self.0)
    }
}

/// 32-bit tensor of floats or words.
pub enum Numbers<'a> {
    /// 32-bit floats and their shape.
    Floats(Floats<'a>),
    /// 32-bit words and their shape.
    Words(&'a [u32], Vec<usize>),
}

impl View for Numbers<'_> {
    fn dtype(&self) -> Dtype {
        match self {
            Numbers::Floats(f) => f.dtype(),
            Numbers::Words(..) => Dtype::U32,
        }
    }
    fn shape(&self) -> &[usize] {
        match self {
            Numbers::Floats(f) => f.shape(),
            Numbers::Words(_, shape) => shape,
        }
    }
    fn data(&self) -> Cow<'_, [u8]> {
        match self {
            Numbers::Floats(f) => Cow::Borrowed(bytemuck::cast_slice(f.0)),
            Numbers::Words(words, _) => Cow::Borrowed(bytemuck::cast_slice(words)),
        }
    }
    fn data_len(&self) -> usize {
        4 * match self {
            Numbers::Floats(f) => f.0.len(),
            Numbers::Words(words, _) => words.len(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use safetensors::SafeTensors;

    #[test]
    fn equal_tensors_give_identical_valid_files() {
        let numbers = [1.0, -2.5, 3.0];
        let write = |a: f32| {
            let meta = (0..20).map(|i| (format!("key{i}"), format!("value \"{i}\""))).collect();
            let tensors = ["z", "a", "m\u{e9}"].map(|n| (n.to_owned(), Floats(&numbers, vec![3])));
            let mut tensors = Vec::from(tensors);
            let one = [a];
            tensors.push(("one".into(), Floats(&one, vec![1])));
            serialize(tensors, meta).unwrap()
        };
        let bytes = write(1.0);
        assert!((0..8).all(|_| write(1.0) == bytes) && write(2.0) != bytes);
        let (_, header) = SafeTensors::read_metadata(&bytes).unwrap();
        let meta = header.metadata().as_ref().unwrap();
        assert!(meta.len() == 20 && (0..20).all(|i| meta[&format!("key{i}")] == format!("value \"{i}\"")));
        let read = SafeTensors::deserialize(&bytes).unwrap();
        for name in ["z", "a", "m\u{e9}"] {
            assert_eq!(read.tensor(name).unwrap().data(), bytemuck::cast_slice::<f32, u8>(&numbers), "{name}");
        }
        assert_eq!(read.tensor("one").unwrap().data(), 1f32.to_le_bytes());
    }
}
