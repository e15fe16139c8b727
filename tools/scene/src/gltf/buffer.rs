//! Bytes of a glTF file: its container, its buffers and accessors. Allocations are bounded by the bytes that are
//! present.

use super::document::{Accessor, Buffer, Document};
use crate::error::io_error;
use base64::alphabet;
use base64::engine::{DecodePaddingMode, Engine as _, GeneralPurpose, GeneralPurposeConfig};
use std::path::Path;

/// Result whose error is a description of the problem.
type Found<T> = std::result::Result<T, String>;

/// Splits a file into its JSON and its binary chunk.
pub(super) fn chunks(bytes: &[u8]) -> Found<(&[u8], Option<&[u8]>)> {
    if !bytes.starts_with(b"glTF") {
        return Ok((bytes, None));
    }
    let word = |at: usize| bytes.get(at..at + 4).map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]) as usize);
    let (Some(version), Some(length)) = (word(4), word(8)) else { return Err("its header is cut off".into()) };
    if version != 2 {
        return Err(format!("it is of version {version} of the container, not 2"));
    }
    if length > bytes.len() {
        return Err(format!("it promises {length} bytes, but has {}; copy or export it again", bytes.len()));
    }
    let chunk = |at: usize, kind: &[u8; 4]| {
        let size = word(at)?;
        (bytes.get(at + 4..at + 8)? == kind).then_some(())?;
        bytes.get(at + 8..(at + 8).checked_add(size)?)
    };
    let Some(json) = chunk(12, b"JSON") else { return Err("its first chunk is no whole JSON".into()) };
    let next = 20 + json.len().next_multiple_of(4);
    let binary = chunk(next, b"BIN\0");
    if binary.is_none() && next < length {
        return Err("its second chunk is no whole binary one".into());
    }
    Ok((json, binary))
}

/// Loads the bytes of every buffer of the document.
pub(super) fn buffers(path: &Path, document: &Document, binary: Option<&[u8]>) -> Found<Vec<Vec<u8>>> {
    let one = |(i, buffer): (usize, &Buffer)| {
        let bytes = match &buffer.uri {
            None => binary.filter(|_| i == 0).ok_or_else(|| format!("buffer {i} is nowhere"))?.to_vec(),
            Some(uri) if uri.starts_with("data:") => {
                let text = uri.split_once(";base64,").map(|(_, text)| text);
                text.and_then(|text| BASE64.decode(text).ok()).ok_or_else(|| format!("buffer {i} is no base64"))?
            }
            Some(uri) => {
                let inside = !uri.is_empty() && !uri.contains([':', '\\']) && !uri.starts_with('/');
                if !inside || uri.split('/').any(|part| part == "..") {
                    return Err(format!("buffer {i} is at \"{uri}\", which is not beside the file"));
                }
                let file = path.with_file_name(uri.replace("%20", " "));
                std::fs::read(&file).map_err(|e| io_error("read", &file)(e).to_string())?
            }
        };
        if bytes.len() < buffer.byte_length {
            return Err(format!("buffer {i} promises {} bytes, but has {}", buffer.byte_length, bytes.len()));
        }
        Ok(bytes)
    };
    document.buffers.iter().enumerate().map(one).collect()
}

/// Decoder of base64. Some programs write no padding, and bits after the last byte do not matter.
const BASE64: GeneralPurpose = GeneralPurpose::new(
    &alphabet::STANDARD,
    GeneralPurposeConfig::new()
        .with_decode_padding_mode(DecodePaddingMode::Indifferent)
        .with_decode_allow_trailing_bits(true),
);

/// Returns the number of components of an accessor type.
fn width(kind: &str) -> Option<usize> {
    ["SCALAR", "VEC2", "VEC3", "VEC4"].iter().position(|k| *k == kind).map(|at| at + 1)
}

/// Returns the bytes of a buffer view.
pub(super) fn view<'a>(document: &Document, buffers: &'a [Vec<u8>], index: usize) -> Found<&'a [u8]> {
    let view = document.buffer_views.get(index).ok_or_else(|| format!("its buffer view {index} is not there"))?;
    let buffer = buffers.get(view.buffer).ok_or_else(|| format!("its buffer {} is not there", view.buffer))?;
    let end = view.byte_offset.checked_add(view.byte_length);
    end.and_then(|end| buffer.get(view.byte_offset..end)).ok_or_else(|| "its buffer view leaves the buffer".into())
}

/// Returns all numbers of an accessor, element by element.
pub(super) fn numbers(document: &Document, buffers: &[Vec<u8>], accessor: &Accessor, wide: usize) -> Found<Vec<f32>> {
    if width(&accessor.kind) != Some(wide) {
        return Err(format!("it is {}, but must have {wide} components", accessor.kind));
    }
    if accessor.sparse.is_some() {
        return Err("it is sparse, which is not read; export it dense".into());
    }
    let size = match accessor.component_type {
        5120 | 5121 => 1,
        5122 | 5123 => 2,
        5126 => 4,
        other => return Err(format!("its components are of type {other}, which is not read")),
    };
    let index = accessor.buffer_view.ok_or("it has no buffer view, and no extension that is read has its numbers")?;
    let bytes = view(document, buffers, index)?;
    let element = wide * size;
    let stride = document.buffer_views[index].byte_stride.unwrap_or(element);
    let last = accessor.count.checked_sub(1).ok_or("it is empty")?;
    let need =
        last.checked_mul(stride).and_then(|n| n.checked_add(element)).and_then(|n| n.checked_add(accessor.byte_offset));
    // A stride smaller than an element would let few bytes describe many elements.
    if stride < element || need.is_none_or(|need| need > bytes.len()) {
        return Err(format!("its {} elements leave the buffer view of {} bytes", accessor.count, bytes.len()));
    }
    let mut out = Vec::with_capacity(accessor.count * wide);
    for i in 0..accessor.count {
        let at = accessor.byte_offset + i * stride;
        for c in bytes[at..at + element].chunks_exact(size) {
            let whole = |value: f32, most: f32| if accessor.normalized { (value / most).max(-1.0) } else { value };
            out.push(match accessor.component_type {
                5120 => whole(f32::from(c[0] as i8), 127.0),
                5121 => whole(f32::from(c[0]), 255.0),
                5122 => whole(f32::from(i16::from_le_bytes([c[0], c[1]])), 32767.0),
                5123 => whole(f32::from(u16::from_le_bytes([c[0], c[1]])), 65535.0),
                _ => f32::from_le_bytes([c[0], c[1], c[2], c[3]]),
            });
        }
    }
    match out.iter().position(|v| !v.is_finite()) {
        Some(at) => Err(format!("element {} holds {}", at / wide, out[at])),
        None => Ok(out),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn base64_needs_no_padding() {
        for text in ["/+8=", "/+8", "/+9"] {
            assert_eq!(BASE64.decode(text).unwrap(), [0xff, 0xef], "{text}");
        }
        for text in ["T*==", "T", "=TQ=", "TW Fu", "TWFu="] {
            assert!(BASE64.decode(text).is_err(), "{text}");
        }
    }

    #[test]
    fn containers_are_complete_or_rejected() {
        assert_eq!(chunks(b"{}").unwrap(), (&b"{}"[..], None));
        let glb = b"glTF\x02\0\0\0\x20\0\0\0\x04\0\0\0JSON{}  \0\0\0\0BIN\0";
        assert_eq!(chunks(glb).unwrap(), (&b"{}  "[..], Some(&[][..])));
        for length in 4..glb.len() {
            assert!(chunks(&glb[..length]).is_err(), "{length}");
        }
        let mut bad = *glb;
        bad[4] = 1;
        assert!(chunks(&bad).unwrap_err().contains("version 1"));
    }
}
