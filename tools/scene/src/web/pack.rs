//! Bytes of a chunk of splats in a page.
//!
//! All numbers are little-endian. First come 28 bytes per splat, then the harmonics of all splats, then those of each light.
//!
//! | bytes | holds | error |
//! |---|---|---|
//! | 12 | center, three 32-bit floats | none |
//! | 6 | logarithms of the scales from -16 to 8, in parts of 65535 | 1.9e-4 |
//! | 2 | opacity from 0 to 1, in parts of 65535 | 7.7e-6 |
//! | 8 | unit quaternion w, x, y, z, in parts of 32767 | 1.6e-5 |
//! | 2 each | harmonics and responses as halves, 65504 at most | 2^-11 of the number, or 3e-8 |

use super::Page;
use crate::activation::{logistic, unit};
use crate::splats::Splats;
use half::f16;

/// Maximum number of splats of a chunk. Its texels fill whole rows of the viewer's textures.
pub const CHUNK: usize = 16384;

/// Bytes of a splat without harmonics.
const ROW: usize = 28;

/// Range of the logarithms of scales; the renderer clamps them to it.
const LOG_SCALES: [f64; 2] = [-16.0, 8.0];

fn part(value: f64) -> [u8; 2] {
    ((value.clamp(0.0, 1.0) * 65535.0).round() as u16).to_le_bytes()
}

fn halves(value: f32) -> [u8; 2] {
    let finite = if value.is_nan() { 0.0 } else { value };
    f16::from_f32(finite.clamp(-65504.0, 65504.0)).to_le_bytes()
}

/// Returns the bytes of some splats.
pub(super) fn chunk(page: &Page<'_>, kept: &[usize]) -> Vec<u8> {
    let s = page.splats;
    let mut bytes = Vec::with_capacity(kept.len() * (ROW + 6 * (s.sh_degree() + 1).pow(2)));
    for &i in kept {
        s.means[i].iter().for_each(|v| bytes.extend(v.to_le_bytes()));
        let [low, high] = LOG_SCALES;
        s.log_scales[i].iter().for_each(|v| bytes.extend(part((f64::from(*v) - low) / (high - low))));
        bytes.extend(part(logistic(s.opacity_logits[i])));
        let signed = |v: f64| ((v * 32767.0).round() as i16).to_le_bytes();
        unit(s.rotations[i]).iter().for_each(|v| bytes.extend(signed(*v)));
    }
    for &i in kept {
        for band in 0..=s.sh_degree() {
            let width = 3 * (2 * band + 1);
            s.sh[band][i * width..(i + 1) * width].iter().for_each(|v| bytes.extend(halves(*v)));
        }
    }
    let numbers = 3 * (page.light_degree + 1).pow(2);
    for light in page.lights {
        for &i in kept {
            light.response[i * numbers..(i + 1) * numbers].iter().for_each(|v| bytes.extend(halves(*v)));
        }
    }
    bytes
}

/// Chunk of a page, read back.
#[derive(Clone, Debug, PartialEq)]
pub struct PageChunk {
    /// Splats without normals and materials.
    pub splats: Splats,
    /// Response to each light.
    pub responses: Vec<Vec<f32>>,
}

impl PageChunk {
    /// Reads the bytes of a chunk. Returns `None` if their number does not fit the degrees and the lights.
    pub fn read(bytes: &[u8], degree: usize, light_degree: usize, lights: usize) -> Option<PageChunk> {
        let numbers = [degree, light_degree].map(|d| 3 * (d + 1).pow(2));
        let each = ROW + 2 * (numbers[0] + lights * numbers[1]);
        let count = bytes.len() / each;
        if bytes.len() != count * each || degree > 3 {
            return None;
        }
        let (rows, rest) = bytes.split_at(ROW * count);
        let words: Vec<u16> = rest.as_chunks::<2>().0.iter().map(|w| u16::from_le_bytes(*w)).collect();
        let values: Vec<f32> = words.iter().map(|w| f16::from_bits(*w).to_f32()).collect();
        let (colors, rest) = values.split_at(numbers[0] * count);
        let mut splats = Splats::default();
        for row in rows.as_chunks::<ROW>().0 {
            let word = |at: usize| u16::from_le_bytes([row[at], row[at + 1]]);
            let part = |at: usize| f64::from(word(at)) / 65535.0;
            let float = |at: usize| f32::from_le_bytes([row[at], row[at + 1], row[at + 2], row[at + 3]]);
            let [low, high] = LOG_SCALES;
            splats.means.push([0, 4, 8].map(float));
            splats.log_scales.push([12, 14, 16].map(|at| (low + (high - low) * part(at)) as f32));
            splats.opacity_logits.push((part(18) / (1.0 - part(18))).ln() as f32);
            splats.rotations.push([20, 22, 24, 26].map(|at| (f64::from(word(at) as i16) / 32767.0) as f32));
        }
        for color in colors.chunks_exact(numbers[0]) {
            for band in 0..=degree {
                splats.sh[band].extend(&color[3 * band * band..3 * (band + 1) * (band + 1)]);
            }
        }
        let responses = rest.chunks_exact((numbers[1] * count).max(1)).map(<[f32]>::to_vec).collect();
        Some(PageChunk { splats, responses })
    }
}
