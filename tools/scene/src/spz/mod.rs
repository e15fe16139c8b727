//! SPZ files: splats of 20 to 65 bytes, compressed.
//!
//! Versions 2 and 3 are one gzip stream. Version 4 has a table of contents and one Zstandard stream per attribute.
//! Both hold positions as 24-bit fixed point, logarithmic scales, opacities, colors and harmonics as bytes, and
//! rotations as 3 bytes (version 2) or 4 (from version 3). docs/reference/exchange.md states the errors.
//!
//! The format is that of <https://github.com/nianticlabs/spz>.

mod read;
mod rotation;
mod write;

pub use read::read_spz;
pub(crate) use read::spz_of_bytes;
pub(crate) use write::spz_to_bytes;
pub use write::write_spz;

/// First word of a file.
const MAGIC: [u8; 4] = *b"NGSP";
/// Bytes of the header up to version 3.
const HEADER: usize = 16;
/// Bytes of the header from version 4 on.
const HEADER_4: usize = 32;
/// Flag of splats that were trained for an anti-aliasing filter.
const ANTIALIASED_FLAG: u8 = 1;
/// Flag of files with extension records.
const EXTENSIONS_FLAG: u8 = 2;
/// Type of the extension record that holds the transform from the scene.
const TRANSFORM: u32 = 0x5347_0001;
/// Factor of colors: a byte is `255 (0.15 f_dc + 0.5)`.
const COLOR: f64 = 0.15;
/// Bytes of harmonics above band 0, by degree.
const HARMONICS: [usize; 5] = [0, 9, 24, 45, 72];

/// Version of an SPZ file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SpzVersion {
    /// Rotations of three bytes, gzip.
    V2,
    /// Rotations of four bytes, gzip.
    V3,
    /// Rotations of four bytes, Zstandard.
    V4,
}

impl SpzVersion {
    fn number(self) -> u32 {
        match self {
            SpzVersion::V2 => 2,
            SpzVersion::V3 => 3,
            SpzVersion::V4 => 4,
        }
    }

    /// Returns the bytes of one rotation.
    fn rotation(self) -> usize {
        if self == SpzVersion::V2 { 3 } else { 4 }
    }

    /// Returns the bytes per splat of all attributes in file order.
    fn sizes(self, degree: usize) -> [usize; 6] {
        [9, 1, 3, 3, self.rotation(), HARMONICS[degree]]
    }
}
