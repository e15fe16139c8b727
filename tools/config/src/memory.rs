//! Limit on the device memory of training.

use serde::{Deserialize, Serialize};

/// Device memory.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct MemorySettings {
    /// Device memory of training, in bytes at most; 0 uses the limit of the device or driver.
    pub budget: u64,
}

/// Parses a size such as `500000000`, `512M`, `4G` or `1.5GiB` to bytes.
///
/// Units are powers of 1024.
///
/// # Errors
/// A sentence that describes the expected format.
pub fn parse_bytes(text: &str) -> std::result::Result<u64, String> {
    let wrong = || format!("\"{text}\" is no size; write bytes or a number with K, M or G, as 4G");
    let upper = text.trim().to_ascii_uppercase();
    let short = upper.strip_suffix("IB").or(upper.strip_suffix('B')).unwrap_or(&upper);
    let (number, unit) = match short.strip_suffix(['K', 'M', 'G', 'T']) {
        Some(number) => (number, 10 * (1 + "KMGT".find(&short[short.len() - 1..]).unwrap_or(0) as u32)),
        None => (short, 0),
    };
    let value: f64 = number.trim().parse().map_err(|_| wrong())?;
    let bytes = value * (1_u64 << unit) as f64;
    // TOML integers end below 2^63; the cast rounds `i64::MAX` up to 2^63.
    if !(bytes >= 1.0 && bytes < i64::MAX as f64) {
        return Err(wrong());
    }
    Ok(bytes as u64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_with_units_are_parsed() {
        for (text, bytes) in [
            ("500", 500),
            ("4G", 4 << 30),
            ("512m", 512 << 20),
            ("1.5GiB", 3 << 29),
            ("64 KB", 64 << 10),
            ("1T", 1 << 40),
        ] {
            assert_eq!(parse_bytes(text), Ok(bytes), "{text}");
        }
        for text in ["", "G", "-1", "0", "4X", "nan", "1e30", "4GG", "9223372036854775807", "8388608T"] {
            assert!(parse_bytes(text).is_err(), "{text}");
        }
    }
}
