//! `.splat` files: splats of 32 bytes, without a header.
//!
//! Position and lengths of the axes are 32-bit floats. Color with opacity, and the quaternion (w, x, y, z) are four bytes
//! each. The format is that of <https://github.com/antimatter15/splat>. It has no harmonics above band 0.

use crate::activation::{byte, log_length, logistic, unit, unlogistic};
use crate::atomic::atomic_write;
use crate::error::{Result, SceneError, io_error};
use crate::splats::{SH_C0, SplatFile, Splats};
use std::io::Write;
use std::path::Path;

/// Bytes per splat.
const ROW: usize = 32;

/// Reads a `.splat` file.
///
/// # Errors
/// Fails if the size is no multiple of 32 bytes, or a number is not finite.
pub fn read_splat(path: &Path) -> Result<SplatFile> {
    let bytes = std::fs::read(path).map_err(io_error("read", path))?;
    let (rows, rest) = bytes.as_chunks::<ROW>();
    if !rest.is_empty() {
        let problem = format!("it has {} bytes, but .splat files have 32 per splat; copy it again", bytes.len());
        return Err(SceneError::points(path, "", problem));
    }
    let mut splats = Splats::default();
    for (i, row) in rows.iter().enumerate() {
        let numbers: [f32; 6] = std::array::from_fn(|k| {
            let at = 4 * k;
            f32::from_le_bytes([row[at], row[at + 1], row[at + 2], row[at + 3]])
        });
        if let Some(bad) = numbers.iter().find(|v| !v.is_finite()) {
            return Err(SceneError::points(path, format!("splat {i}"), format!("it holds {bad}; export it again")));
        }
        let [x, y, z, a, b, c] = numbers;
        splats.means.push([x, y, z]);
        splats.log_scales.push([a, b, c].map(log_length));
        splats.sh[0].extend(row[24..27].iter().map(|b| color(*b)));
        splats.opacity_logits.push(unlogistic(f64::from(row[27]) / 255.0));
        let q = [row[28], row[29], row[30], row[31]].map(|b| (f32::from(b) - 128.0) / 128.0);
        splats.rotations.push(if q == [0.0; 4] { [1.0, 0.0, 0.0, 0.0] } else { q });
    }
    Ok(SplatFile { splats, ..SplatFile::default() })
}

/// Returns band 0 of a color byte.
pub(crate) fn color(byte: u8) -> f32 {
    (f32::from(byte) / 255.0 - 0.5) / SH_C0
}

/// Writes splats as a `.splat` file.
///
/// # Errors
/// Fails if writing fails.
pub fn write_splat(path: &Path, splats: &Splats) -> Result<()> {
    splats.check()?;
    let row = |i: usize| {
        let mut row = [0; ROW];
        let lengths = splats.log_scales[i].map(|v| v.exp().min(f32::MAX));
        for (place, v) in row.chunks_exact_mut(4).zip(splats.means[i].into_iter().chain(lengths)) {
            place.copy_from_slice(&v.to_le_bytes());
        }
        for (place, v) in row[24..27].iter_mut().zip(&splats.sh[0][3 * i..3 * i + 3]) {
            *place = byte(f64::from(0.5 + SH_C0 * v));
        }
        row[27] = byte(logistic(splats.opacity_logits[i]));
        let q = unit(splats.rotations[i]).map(|v| (128.0 * v + 128.0).round().clamp(0.0, 255.0) as u8);
        row[28..].copy_from_slice(&q);
        row
    };
    atomic_write(path, |out| (0..splats.len()).try_for_each(|i| out.write_all(&row(i))))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn splats_come_back_within_the_steps_of_the_format() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.splat");
        let splats = Splats {
            means: vec![[0.1, -2.0, 30.0], [1e-3, 5.0, 6.0]],
            log_scales: vec![[-3.0, 0.5, -9.0], [-1.0; 3]],
            rotations: vec![[0.5, -0.5, 0.5, 0.5], [-2.0, 0.0, 0.0, 0.0]],
            opacity_logits: vec![2.0, -1.0],
            sh: [vec![0.3, -0.3, 1.0, -1.0, 0.0, 0.7], Vec::new(), Vec::new(), Vec::new()],
            ..Splats::default()
        };
        write_splat(&path, &splats).unwrap();
        assert_eq!(std::fs::metadata(&path).unwrap().len(), 64);
        let file = read_splat(&path).unwrap();
        let found = file.splats;
        found.check().unwrap();
        assert_eq!(found.means, splats.means);
        let near = |a: &[f32], b: &[f32], step: f32| {
            assert!(a.iter().zip(b).all(|(a, b)| (a - b).abs() <= step), "{a:?} {b:?}");
        };
        near(found.log_scales.as_flattened(), splats.log_scales.as_flattened(), 1e-6);
        near(&found.sh[0], &splats.sh[0], 0.5001 / (255.0 * SH_C0));
        near(&found.rotations[0], &splats.rotations[0], 0.5001 / 128.0);
        near(&found.rotations[1], &[-1.0, 0.0, 0.0, 0.0], 0.5001 / 128.0);
        near(&found.opacity_logits, &splats.opacity_logits, 0.02);
    }

    #[test]
    fn partial_rows_and_infinite_numbers_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.splat");
        std::fs::write(&path, [0; 33]).unwrap();
        assert!(read_splat(&path).unwrap_err().to_string().contains("33 bytes"));
        let mut row = [0; 64];
        row[36..40].copy_from_slice(&f32::INFINITY.to_le_bytes());
        std::fs::write(&path, row).unwrap();
        assert!(read_splat(&path).unwrap_err().to_string().contains("splat 1: it holds inf"));
        row[36..40].copy_from_slice(&[0; 4]);
        std::fs::write(&path, row).unwrap();
        // Lengths and quaternions of 0 have a place, too.
        read_splat(&path).unwrap().splats.check().unwrap();
    }
}
