//! Reader of `.ksplat` files: splats in sections and buckets, at three levels of compression.
//!
//! Level 0 has 32-bit floats. Levels 1 and 2 have 16-bit positions in the cube of a bucket and 16-bit floats; level 2
//! has harmonics in bytes. The format is that of <https://github.com/mkkellogg/GaussianSplats3D>.

use crate::activation::{log_length, unlogistic};
use crate::dot_splat::color;
use crate::error::{Result, SceneError, io_error};
use crate::splats::{SplatFile, Splats};
use half::f16;
use std::path::Path;

/// Result whose error is a description of the problem.
type Found<T> = std::result::Result<T, String>;

/// Bytes of the header of the file.
const HEADER: usize = 4096;
/// Bytes of the header of a section.
const SECTION: usize = 1024;
/// Harmonics above band 0, by degree.
const HARMONICS: [usize; 4] = [0, 9, 24, 45];
/// Range of harmonics in bytes where the header has none.
const RANGE: [f32; 2] = [-1.5, 1.5];

/// Returns whether the bytes begin like a file of a known version.
pub(crate) fn is_ksplat(start: &[u8]) -> bool {
    matches!(start, [0, minor, 0, 0, ..] if *minor > 0)
}

/// Reads a `.ksplat` file.
///
/// # Errors
/// Fails if the file is damaged or of another version.
pub fn read_ksplat(path: &Path) -> Result<SplatFile> {
    let bytes = std::fs::read(path).map_err(io_error("read", path))?;
    read(&bytes).map_err(|problem| SceneError::points(path, "", problem))
}

/// Little-endian numbers of a file.
struct Numbers<'a>(&'a [u8]);

impl Numbers<'_> {
    fn part<const N: usize>(&self, at: usize) -> Found<[u8; N]> {
        let end = at.checked_add(N);
        let bytes = end.and_then(|end| self.0.get(at..end)).ok_or("it is cut off; copy or export it again")?;
        let mut part = [0; N];
        part.copy_from_slice(bytes);
        Ok(part)
    }

    fn short(&self, at: usize) -> Found<usize> {
        Ok(usize::from(u16::from_le_bytes(self.part(at)?)))
    }

    fn word(&self, at: usize) -> Found<usize> {
        Ok(u32::from_le_bytes(self.part(at)?) as usize)
    }

    fn float(&self, at: usize) -> Found<f32> {
        Ok(f32::from_le_bytes(self.part(at)?))
    }

    /// Returns a float of 4 bytes, or of 2 if `halves` is set: number `index` of those at `at`.
    fn either(&self, at: usize, index: usize, halves: bool) -> Found<f32> {
        match halves {
            true => Ok(f16::from_le_bytes(self.part(at.saturating_add(2 * index))?).to_f32()),
            false => self.float(at.saturating_add(4 * index)),
        }
    }
}

/// Settings of the whole file.
struct File<'a> {
    numbers: Numbers<'a>,
    level: usize,
    range: [f32; 2],
}

/// Section of the file.
struct Section {
    count: usize,
    most: usize,
    bucket: usize,
    buckets: usize,
    /// Edge of a bucket's cube.
    edge: f32,
    /// Bytes of a bucket's data.
    storage: usize,
    /// Stored number in the middle of the cube.
    middle: usize,
    full: usize,
    partial: usize,
    degree: usize,
}

fn read(bytes: &[u8]) -> Found<SplatFile> {
    if bytes.len() < HEADER {
        return Err(format!("it has {} bytes, but the header of a .ksplat file has {HEADER}", bytes.len()));
    }
    if !is_ksplat(bytes) {
        return Err(format!("it is .ksplat of version {}.{}; versions 0.1 and later are read", bytes[0], bytes[1]));
    }
    let numbers = Numbers(bytes);
    let (sections, level) = (numbers.word(4)?, numbers.short(20)?);
    if level > 2 {
        return Err(format!("its compression level is {level}; levels 0, 1 and 2 are read"));
    }
    let mut range = [numbers.float(36)?, numbers.float(40)?];
    if range == [0.0; 2] || range.iter().any(|v| !v.is_finite()) {
        range = RANGE;
    }
    let file = File { numbers, level, range };
    let mut at = sections.checked_mul(SECTION).and_then(|n| n.checked_add(HEADER)).ok_or("it has too many sections")?;
    if at > bytes.len() {
        return Err(format!("it promises {sections} sections, but is cut off; copy or export it again"));
    }
    let headers = (0..sections).map(|i| file.section(HEADER + i * SECTION)).collect::<Found<Vec<_>>>()?;
    let degree = headers.iter().filter(|s| s.count > 0).map(|s| s.degree).max().unwrap_or(0);
    let mut splats = Splats::default();
    for (i, section) in headers.iter().enumerate() {
        at = file.read(section, at, degree, &mut splats).map_err(|e| format!("section {i}: {e}"))?;
    }
    let numbers = splats.means.as_flattened().iter().chain(splats.log_scales.as_flattened());
    if numbers.chain(splats.rotations.as_flattened()).chain(splats.sh.iter().flatten()).any(|v| !v.is_finite()) {
        return Err("it holds numbers that are not finite; export it again".into());
    }
    Ok(SplatFile { splats, ..SplatFile::default() })
}

impl File<'_> {
    fn section(&self, at: usize) -> Found<Section> {
        let n = &self.numbers;
        let middle = n.word(at + 24)?;
        let section = Section {
            count: n.word(at)?,
            most: n.word(at + 4)?,
            bucket: n.word(at + 8)?,
            buckets: n.word(at + 12)?,
            edge: n.float(at + 16)?,
            storage: n.short(at + 20)?,
            middle: if middle == 0 { 32_767 } else { middle },
            full: n.word(at + 32)?,
            partial: n.word(at + 36)?,
            degree: n.short(at + 40)?,
        };
        match section.degree {
            0..=3 => Ok(section),
            other => Err(format!("its harmonics have degree {other}; degrees 0 to 3 are read")),
        }
    }

    /// Appends the splats of a section, and returns its end.
    fn read(&self, s: &Section, start: usize, degree: usize, splats: &mut Splats) -> Found<usize> {
        let floats = if self.level == 0 { 4 } else { 2 };
        let rest = HARMONICS[s.degree];
        let row = 10 * floats + 4 + rest * [4, 2, 1][self.level];
        let over = || "its sizes are impossible".to_owned();
        let sizes = s.partial.checked_mul(4).ok_or_else(over)?;
        let centers = start.checked_add(sizes).ok_or_else(over)?;
        let data = s.storage.checked_mul(s.buckets).and_then(|n| n.checked_add(centers)).ok_or_else(over)?;
        let end = row.checked_mul(s.most).and_then(|n| n.checked_add(data)).ok_or_else(over)?;
        if s.count > s.most || end > self.numbers.0.len() {
            return Err(format!("it promises {} splats, but is cut off; copy or export it again", s.count));
        }
        let mut bucket = Bucket { index: 0, end: if s.full > 0 { s.bucket } else { 0 } };
        for i in 0..s.count {
            let at = data + i * row;
            let center = if self.level == 0 { [0.0; 3] } else { self.center(s, start, centers, i, &mut bucket)? };
            self.splat(s, at, center, degree, splats)?;
        }
        Ok(end)
    }

    /// Returns the center of the bucket that holds splat `i`.
    fn center(&self, s: &Section, start: usize, centers: usize, i: usize, bucket: &mut Bucket) -> Found<[f32; 3]> {
        while i >= bucket.end {
            if s.full > 0 || bucket.end > 0 {
                bucket.index += 1;
            }
            let full = bucket.index < s.full;
            if !full && bucket.index >= s.full.saturating_add(s.partial) {
                return Err(format!("splat {i} is in no bucket"));
            }
            let size = if full { s.bucket } else { self.numbers.word(start + 4 * (bucket.index - s.full))? };
            if size == 0 {
                return Err(format!("bucket {} is empty", bucket.index));
            }
            bucket.end = bucket.end.saturating_add(size);
        }
        if bucket.index >= s.buckets || s.storage < 12 {
            return Err(format!("bucket {} has no center", bucket.index));
        }
        let at = centers + bucket.index * s.storage;
        Ok([self.numbers.float(at)?, self.numbers.float(at + 4)?, self.numbers.float(at + 8)?])
    }

    fn splat(&self, s: &Section, at: usize, center: [f32; 3], degree: usize, splats: &mut Splats) -> Found<()> {
        let n = &self.numbers;
        let halves = self.level > 0;
        let floats = if halves { 2 } else { 4 };
        let mut mean = [0.0; 3];
        for (k, v) in mean.iter_mut().enumerate() {
            *v = match halves {
                false => n.float(at + 4 * k)?,
                true => {
                    let step = f64::from(s.edge) / 2.0 / s.middle as f64;
                    ((n.short(at + 2 * k)? as f64 - s.middle as f64) * step + f64::from(center[k])) as f32
                }
            };
        }
        let number = |k: usize| n.either(at, k, halves);
        splats.means.push(mean);
        splats.log_scales.push([number(3)?, number(4)?, number(5)?].map(log_length));
        let q = [number(6)?, number(7)?, number(8)?, number(9)?];
        splats.rotations.push(if q == [0.0; 4] { [1.0, 0.0, 0.0, 0.0] } else { q });
        let colors = at + 10 * floats;
        let [red, green, blue, opacity] = n.part(colors)?;
        splats.sh[0].extend([red, green, blue].map(color));
        splats.opacity_logits.push(unlogistic(f64::from(opacity) / 255.0));
        let harmonic = |k: usize| -> Found<f32> {
            match self.level {
                2 => {
                    let [byte] = n.part(colors + 4 + k)?;
                    Ok(self.range[0] + f32::from(byte) / 255.0 * (self.range[1] - self.range[0]))
                }
                _ => n.either(colors + 4, k, halves),
            }
        };
        for band in 1..=degree {
            let (first, wide) = (HARMONICS[band - 1], 2 * band + 1);
            // The file has a band channel by channel.
            for (coefficient, channel) in (0..3 * wide).map(|i| (i / 3, i % 3)) {
                let value = if band > s.degree { 0.0 } else { harmonic(first + channel * wide + coefficient)? };
                splats.sh[band].push(value);
            }
        }
        Ok(())
    }
}

/// Bucket at which the reader is, and the index after its last splat.
struct Bucket {
    index: usize,
    end: usize,
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns a file of level 1 or 2 with degree 1: a full bucket of two splats and a partial one of one.
    fn file(level: u8) -> Vec<u8> {
        let mut bytes = vec![0; HEADER + SECTION];
        bytes[1] = 1;
        bytes[4] = 1;
        bytes[16] = 3;
        bytes[20] = level;
        let mut put = |at: usize, v: &[u8]| bytes[HEADER + at..HEADER + at + v.len()].copy_from_slice(v);
        for (at, v) in [(0, 3_u32), (4, 3), (8, 2), (12, 2), (24, 32_767), (32, 1), (36, 1)] {
            put(at, &v.to_le_bytes());
        }
        put(16, &2.0_f32.to_le_bytes());
        put(20, &[12, 0]);
        put(40, &[1, 0]);
        bytes.extend(1_u32.to_le_bytes());
        for v in [10.0_f32, 0.0, 0.0, -10.0, 0.0, 0.0] {
            bytes.extend(v.to_le_bytes());
        }
        for _ in 0..3 {
            [32_767_u16, 65_534, 0].iter().for_each(|v| bytes.extend(v.to_le_bytes()));
            [0.5_f32, 1.0, 2.0, 1.0, 0.0, 0.0, 0.0].iter().for_each(|v| bytes.extend(f16::from_f32(*v).to_le_bytes()));
            bytes.extend([255, 0, 128, 51]);
            for k in 0..9 {
                match level {
                    1 => bytes.extend(f16::from_f32(k as f32).to_le_bytes()),
                    _ => bytes.push(k * 10),
                }
            }
        }
        bytes
    }

    #[test]
    fn positions_are_relative_to_their_bucket() {
        let splats = read(&file(1)).unwrap().splats;
        splats.check().unwrap();
        assert_eq!(splats.means, [[10.0, 1.0, -1.0], [10.0, 1.0, -1.0], [-10.0, 1.0, -1.0]]);
        assert_eq!(splats.log_scales[0], [0.5_f32.ln(), 0.0, 2.0_f32.ln()]);
        // The file has red of the three coefficients first.
        assert_eq!(splats.sh[1][..9], [0.0, 3.0, 6.0, 1.0, 4.0, 7.0, 2.0, 5.0, 8.0]);
        assert!((splats.opacity_logits[2] + 4.0_f32.ln()).abs() < 1e-4);
        let bytes = read(&file(2)).unwrap().splats;
        assert!((bytes.sh[1][1] - (-1.5 + 3.0 * 30.0 / 255.0)).abs() < 1e-6);
    }

    #[test]
    fn damaged_files_are_refused_or_read() {
        for level in [1, 2] {
            let bytes = file(level);
            (0..bytes.len()).step_by(7).for_each(|length| assert!(read(&bytes[..length]).is_err(), "{length}"));
            let places = (0..64).chain(HEADER..HEADER + 64).chain(HEADER + SECTION..bytes.len());
            for (at, change) in places.flat_map(|at| [1, 0x80, 0xff].map(|change| (at, change))) {
                let mut bad = bytes.clone();
                bad[at] ^= change;
                if let Ok(file) = read(&bad) {
                    file.splats.check().unwrap();
                }
            }
        }
    }
}
