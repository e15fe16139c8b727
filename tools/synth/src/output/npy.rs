//! NumPy array files, version 1.0, little-endian, row by row.

/// Returns the bytes of an array file.
///
/// `kind` is NumPy's type string (`<f2`, `<f4`). `data` holds the little-endian bytes of the values.
pub(crate) fn encode(kind: &str, shape: &[usize], data: &[u8]) -> Vec<u8> {
    let dims: Vec<String> = shape.iter().map(ToString::to_string).collect();
    let mut header = format!("{{'descr': '{kind}', 'fortran_order': False, 'shape': ({},), }}", dims.join(", "));
    // The format requires data to begin at a multiple of 64 bytes, after a newline.
    let before = 10;
    let padded = (before + header.len() + 1).next_multiple_of(64);
    header.push_str(&" ".repeat(padded - before - header.len() - 1));
    header.push('\n');
    let mut out = b"\x93NUMPY\x01\x00".to_vec();
    out.extend((header.len() as u16).to_le_bytes());
    out.extend(header.as_bytes());
    out.extend(data);
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn header_is_aligned_and_readable() {
        let bytes = encode("<f4", &[2, 3], &[7; 24]);
        let length = u16::from_le_bytes([bytes[8], bytes[9]]) as usize;
        assert_eq!((10 + length) % 64, 0);
        assert_eq!(bytes.len(), 10 + length + 24);
        let header = std::str::from_utf8(&bytes[10..10 + length]).unwrap();
        assert!(header.contains("'shape': (2, 3,)") && header.ends_with('\n'));
    }
}
