//! SOG: splats as images, with codebooks for scales, colors and harmonics.
//!
//! A file is a zip archive of `meta.json` and lossless WebP images, or a directory of the same. A pixel of every image
//! belongs to one splat. Positions have 16 bits per axis of a logarithmic range. The format is version 2 of
//! <https://developer.playcanvas.com/user-manual/gaussian-splatting/formats/sog>.

mod clusters;
mod container;
mod meta;
mod palette;
mod read;
mod rotation;
mod write;

pub use read::{is_sog_meta, read_sog};
pub use write::write_sog;

/// Harmonics above band 0 per channel, by number of bands.
const COEFFICIENTS: [usize; 4] = [0, 3, 8, 15];
/// Palette entries per row of their image.
const ROW: usize = 64;
/// Entries of a codebook.
const CODES: usize = 256;

/// Maps a position to its logarithmic range.
fn compress(v: f64) -> f64 {
    v.signum() * v.abs().ln_1p()
}

/// Inverts [`compress`].
fn expand(v: f64) -> f64 {
    v.signum() * v.abs().exp_m1()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn logarithmic_range_is_invertible() {
        for v in [-1e4, -1.0, -1e-6, 0.0, 1e-6, 0.5, 1e4] {
            assert!((expand(compress(v)) - v).abs() <= 1e-12 * v.abs().max(1e-3), "{v}");
        }
    }
}
