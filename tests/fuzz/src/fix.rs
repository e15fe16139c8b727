//! Repairs of lengths and checksums after a mutation.
//!
//! Readers check these first. The repairs let mutated inputs reach the code after the checks.

#![allow(clippy::ptr_arg, reason = "repairs are of one type, and some change the length")]

/// Repair of an input in place.
pub(crate) type Fix = fn(&mut Vec<u8>);

/// Repairs a safetensors file.
///
/// Corrects the length of the JSON header, and resizes the data to the offsets of the header, up to 16 MiB.
pub(crate) fn safetensors(bytes: &mut Vec<u8>) {
    let Some(end) = bytes.get(8..).and_then(object_end).map(|n| n + 8) else { return };
    bytes[..8].copy_from_slice(&(end as u64 - 8).to_le_bytes());
    let header: Option<serde_json::Value> = serde_json::from_slice(&bytes[8..end]).ok();
    let ends = header.iter().filter_map(|h| h.as_object()).flatten().filter_map(|(_, t)| t["data_offsets"][1].as_u64());
    if let Some(most) = ends.max().and_then(|n| usize::try_from(n).ok()).filter(|n| *n <= 16 << 20) {
        bytes.resize(end + most, 0);
    }
}

/// Returns the end of a JSON object that begins at the start.
fn object_end(bytes: &[u8]) -> Option<usize> {
    let mut all = serde_json::Deserializer::from_slice(bytes).into_iter::<serde::de::IgnoredAny>();
    all.next()?.ok()?;
    Some(all.byte_offset())
}

/// Repairs the checksums of a PNG file's chunks.
pub(crate) fn png(bytes: &mut Vec<u8>) {
    let mut at = 8;
    while let Some(length) = bytes.get(at..at + 4).map(|b| u32::from_be_bytes([b[0], b[1], b[2], b[3]]) as usize) {
        let end = at.saturating_add(8).saturating_add(length);
        if end.checked_add(4).is_none_or(|end| end > bytes.len()) {
            return;
        }
        let sum = crc(&bytes[at + 4..end]);
        bytes[end..end + 4].copy_from_slice(&sum.to_be_bytes());
        at = end + 4;
    }
}

fn crc(bytes: &[u8]) -> u32 {
    !bytes.iter().fold(!0_u32, |crc, byte| {
        (0..8).fold(crc ^ u32::from(*byte), |c, _| if c & 1 == 1 { 0xedb8_8320 ^ (c >> 1) } else { c >> 1 })
    })
}

/// Repairs the lengths in a binary glTF file: of the file, its JSON and the next chunk.
pub(crate) fn glb(bytes: &mut Vec<u8>) {
    if !bytes.starts_with(b"glTF") || bytes.len() < 20 {
        return;
    }
    if let Some(mut end) = object_end(&bytes[20..]).map(|n| n + 20) {
        while end % 4 != 0 && bytes.get(end) == Some(&b' ') {
            end += 1;
        }
        while end % 4 != 0 {
            bytes.insert(end, b' ');
            end += 1;
        }
        bytes[12..16].copy_from_slice(&(end as u32 - 20).to_le_bytes());
        if bytes.len() >= end + 8 {
            let rest = (bytes.len() - end - 8) as u32;
            bytes[end..end + 4].copy_from_slice(&rest.to_le_bytes());
        }
    }
    let length = bytes.len() as u32;
    bytes[8..12].copy_from_slice(&length.to_le_bytes());
}

/// Repairs the length of a NumPy file's header.
pub(crate) fn npy(bytes: &mut Vec<u8>) {
    let Some(end) = bytes.iter().take(4096).position(|b| *b == b'\n') else { return };
    if bytes.starts_with(b"\x93NUMPY\x01") && end >= 10 {
        bytes[8..10].copy_from_slice(&(end as u16 + 1 - 10).to_le_bytes());
    }
}

/// Repairs the lengths of a provider's messages.
///
/// Each message is a safetensors file after four letters and a length. The first byte of the input is not part of a
/// message.
pub(crate) fn talk(bytes: &mut Vec<u8>) {
    let Some((first, rest)) = bytes.split_first() else { return };
    let mut out = vec![*first];
    let mut parts: Vec<Vec<u8>> = vec![Vec::new()];
    let mut i = 0;
    while i < rest.len() {
        if rest[i..].starts_with(b"SGSP") {
            parts.push(Vec::new());
        }
        parts.last_mut().expect("there is one").push(rest[i]);
        i += 1;
    }
    for mut part in parts {
        if part.len() > 12 && part.starts_with(b"SGSP") {
            let mut payload = part.split_off(12);
            safetensors(&mut payload);
            part[4..12].copy_from_slice(&(payload.len() as u64).to_le_bytes());
            part.extend(payload);
        }
        out.extend(part);
    }
    *bytes = out;
}
