//! Writing NumPy's `.npy` files: version 1, C order, little-endian.

use std::io::Write;
use std::path::Path;

use half::f16;

use crate::atomic::atomic_write;
use crate::error::{Result, SceneError};

/// Writes an array of half-precision values.
pub fn write_npy_f16(path: &Path, shape: &[usize], values: &[f16]) -> Result<()> {
    write(path, "<f2", shape, values.len(), values.iter().flat_map(|v| v.to_le_bytes()).collect())
}

/// Writes an array of 32-bit floats.
pub fn write_npy_f32(path: &Path, shape: &[usize], values: &[f32]) -> Result<()> {
    write(path, "<f4", shape, values.len(), values.iter().flat_map(|v| v.to_le_bytes()).collect())
}

fn write(path: &Path, descr: &str, shape: &[usize], count: usize, bytes: Vec<u8>) -> Result<()> {
    if shape.iter().try_fold(1_usize, |n, &axis| n.checked_mul(axis)) != Some(count) {
        return Err(SceneError::image(path, format!("a shape of {shape:?} does not fit {count} values")));
    }
    let axes: String = shape.iter().map(|n| format!("{n},")).collect();
    let mut header = format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': ({axes}), }}");
    // Magic, version, header length, header and line break fill a multiple of 64 bytes.
    let used = 10 + header.len() + 1;
    header.push_str(&" ".repeat(used.next_multiple_of(64) - used));
    header.push('\n');
    let Ok(length) = u16::try_from(header.len()) else {
        return Err(SceneError::image(path, format!("an array of {} axes cannot be written", shape.len())));
    };
    atomic_write(path, |out| {
        out.write_all(b"\x93NUMPY\x01\x00")?;
        out.write_all(&length.to_le_bytes())?;
        out.write_all(header.as_bytes())?;
        out.write_all(&bytes)
    })
}

#[cfg(test)]
mod tests {
    use super::super::NpyArray;
    use super::*;

    #[test]
    fn arrays_round_trip() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("a.npy");
        let halves: Vec<f16> = (0..24).map(|i| f16::from_f32(i as f32 * 0.37)).collect();
        write_npy_f16(&path, &[2, 3, 4], &halves).unwrap();
        let back = NpyArray::read(&path).unwrap();
        assert_eq!((back.shape.clone(), back.to_f16()), (vec![2, 3, 4], halves));
        write_npy_f32(&path, &[5], &[1.0, -2.0, 1e-30, 4.0, 0.1]).unwrap();
        let back = NpyArray::read(&path).unwrap();
        assert_eq!((back.shape.clone(), back.to_f32()), (vec![5], vec![1.0, -2.0, 1e-30, 4.0, 0.1]));
        let bytes = std::fs::read(&path).unwrap();
        assert_eq!((bytes.len() - 20) % 64, 0);
        let error = write_npy_f32(&path, &[2, 3], &[0.0; 5]).unwrap_err().to_string();
        assert!(error.contains("a shape of [2, 3] does not fit 5 values"), "{error}");
    }
}
