//! COLMAP's binary files.
//!
//! Little-endian records follow a 64-bit count. Files are read as a whole. Every count is checked against the remaining
//! bytes before memory is allocated for it.

use std::path::Path;

use super::{CameraRow, ImageRow, model};
use crate::error::{Result, SceneError, io_error};
use crate::points::{PointCloud, Tracks};

/// Reader of a file's remaining bytes.
pub(super) struct Bytes<'a> {
    path: &'a Path,
    all: &'a [u8],
    at: usize,
}

impl<'a> Bytes<'a> {
    pub(super) fn fail(&self, problem: impl Into<String>) -> SceneError {
        SceneError::cameras(self.path, format!("byte {}", self.at), problem)
    }

    fn take(&mut self, n: usize) -> Result<&'a [u8]> {
        match self.at.checked_add(n).and_then(|end| self.all.get(self.at..end)) {
            Some(bytes) => {
                self.at += n;
                Ok(bytes)
            }
            None => Err(self.fail(format!(
                "the file ends at {} bytes in the middle of a record; copy or export it again",
                self.all.len()
            ))),
        }
    }

    pub(super) fn word<const N: usize>(&mut self) -> Result<[u8; N]> {
        let mut word = [0; N];
        word.copy_from_slice(self.take(N)?);
        Ok(word)
    }

    pub(super) fn u32(&mut self) -> Result<u32> {
        self.word().map(u32::from_le_bytes)
    }

    pub(super) fn u64(&mut self) -> Result<u64> {
        self.word().map(u64::from_le_bytes)
    }

    pub(super) fn f64<const N: usize>(&mut self) -> Result<[f64; N]> {
        let mut values = [0.0; N];
        for value in &mut values {
            *value = f64::from_le_bytes(self.word()?);
        }
        Ok(values)
    }

    /// Reads a count of records that have at least `size` bytes each.
    pub(super) fn count(&mut self, size: usize) -> Result<usize> {
        let at = self.at;
        let count = self.u64()?;
        let left = (self.all.len() - self.at) as u64;
        if count.checked_mul(size as u64).is_some_and(|need| need <= left) {
            return Ok(count as usize);
        }
        self.at = at;
        Err(self
            .fail(format!("{count} records are promised, but only {left} bytes follow; copy or export the file again")))
    }
}

pub(super) fn with_file<T>(path: &Path, read: impl FnOnce(&mut Bytes) -> Result<T>) -> Result<T> {
    let all = std::fs::read(path).map_err(io_error("read", path))?;
    read(&mut Bytes { path, all: &all, at: 0 })
}

/// Reads `cameras.bin`.
pub(super) fn read_cameras(path: &Path) -> Result<Vec<CameraRow>> {
    with_file(path, |bytes| {
        let count = bytes.count(24)?;
        let mut cameras = Vec::with_capacity(count);
        for _ in 0..count {
            let id = bytes.u32()?;
            let place = format!("camera {id}");
            let fail = |problem| SceneError::cameras(path, place.clone(), problem);
            let (name, parameters) = model::by_number(bytes.word().map(i32::from_le_bytes)?).map_err(fail)?;
            let (width, height) = (bytes.u64()?, bytes.u64()?);
            let mut values = Vec::with_capacity(parameters);
            for _ in 0..parameters {
                values.extend(bytes.f64::<1>()?);
            }
            let model = model::from_parameters(name, &values).map_err(fail)?;
            cameras.push(CameraRow { id, width, height, model });
        }
        Ok(cameras)
    })
}

/// Reads `images.bin`; the observed points are skipped.
pub(super) fn read_images(path: &Path) -> Result<Vec<ImageRow>> {
    with_file(path, |bytes| {
        let count = bytes.count(73)?;
        let mut images = Vec::with_capacity(count);
        for _ in 0..count {
            let id = bytes.u32()?;
            let place = format!("image {id}");
            let (rotation, translation) = (bytes.f64()?, bytes.f64()?);
            let camera = bytes.u32()?;
            let rest = &bytes.all[bytes.at..];
            let Some(length) = rest.iter().position(|&b| b == 0) else {
                return Err(bytes.fail("the name of an image has no end; copy or export the file again"));
            };
            let name = String::from_utf8_lossy(bytes.take(length + 1)?).trim_end_matches('\0').to_string();
            let observed = bytes.count(24)?;
            bytes.take(observed * 24)?;
            images.push(ImageRow { id, rotation, translation, camera, name, place });
        }
        Ok(images)
    })
}

/// Reads `points3D.bin`: points and their tracks.
pub(super) fn read_points(path: &Path) -> Result<(PointCloud, Tracks)> {
    with_file(path, |bytes| {
        let count = bytes.count(51)?;
        let mut positions = Vec::with_capacity(count);
        let mut colors = Vec::with_capacity(count);
        let mut tracks = Tracks::default();
        for _ in 0..count {
            let id = bytes.u64()?;
            let position = bytes.f64::<3>()?.map(|v| v as f32);
            if position.iter().any(|v| !v.is_finite()) {
                let problem = "the position is not finite; remove the point or run the reconstruction again";
                return Err(SceneError::points(path, format!("point {id}"), problem));
            }
            positions.push(position);
            colors.push(bytes.word::<3>()?.map(|v| f32::from(v) / 255.0));
            bytes.take(8)?;
            for _ in 0..bytes.count(8)? {
                tracks.add(bytes.u32()?);
                bytes.take(4)?;
            }
            tracks.end_point();
        }
        Ok((PointCloud { positions, colors: Some(colors), normals: None }, tracks))
    })
}
