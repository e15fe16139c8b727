//! Writer of SPZ files.

use super::{ANTIALIASED_FLAG, COLOR, EXTENSIONS_FLAG, HARMONICS, HEADER_4, MAGIC, SpzVersion, TRANSFORM, rotation};
use crate::activation::{byte, logistic, unit};
use crate::atomic::atomic_write;
use crate::error::{Result, SceneError};
use crate::placement::Placement;
use crate::splats::Splats;
use flate2::Compression;
use flate2::write::GzEncoder;
use std::io::{self, Write};
use std::path::Path;

/// Most fractional bits of a position; other readers shift by them.
const MOST_BITS: u32 = 20;
/// Level of Zstandard, between the fastest and the smallest.
const LEVEL: i32 = 12;

/// Writes splats as an SPZ file. Version 4 records the transform from the scene to the file; others have no place for it.
///
/// # Errors
/// Fails if a position does not fit, or if writing fails.
pub fn write_spz(path: &Path, splats: &Splats, version: SpzVersion, transform: Option<&Placement>) -> Result<()> {
    let file = Prepared::new(splats, version, transform)?;
    atomic_write(path, |out| file.write(out))
}

/// Returns the content of an SPZ file.
///
/// # Errors
/// Fails if a position does not fit.
pub(crate) fn spz_to_bytes(splats: &Splats, version: SpzVersion) -> Result<Vec<u8>> {
    let mut bytes = Vec::new();
    let written = Prepared::new(splats, version, None)?.write(&mut bytes);
    written.map_err(|e| data(e.to_string()))?;
    Ok(bytes)
}

/// Content of a file before compression.
struct Prepared {
    version: SpzVersion,
    header: Vec<u8>,
    /// Extension records.
    records: Vec<u8>,
    /// Attributes in file order.
    parts: [Vec<u8>; 6],
}

impl Prepared {
    fn new(splats: &Splats, version: SpzVersion, transform: Option<&Placement>) -> Result<Self> {
        splats.check()?;
        let bits = fractional_bits(splats)?;
        let count = u32::try_from(splats.len())
            .map_err(|_| data(format!("there are {}, but an SPZ file holds 4 billion at most", splats.len())))?;
        let parts = attributes(splats, version, bits);
        let records = transform.filter(|_| version == SpzVersion::V4).map_or(Vec::new(), record);
        let mut header = MAGIC.to_vec();
        header.extend(version.number().to_le_bytes());
        header.extend(count.to_le_bytes());
        let antialiased = if splats.antialiased { ANTIALIASED_FLAG } else { 0 };
        let flags = antialiased | if records.is_empty() { 0 } else { EXTENSIONS_FLAG };
        header.extend([splats.sh_degree() as u8, bits as u8, flags]);
        Ok(Self { version, header, records, parts })
    }

    fn write(&self, out: &mut impl Write) -> io::Result<()> {
        let mut header = self.header.clone();
        if self.version == SpzVersion::V4 {
            return streams(out, header, &self.records, &self.parts);
        }
        header.push(0);
        let mut packed = GzEncoder::new(out, Compression::best());
        packed.write_all(&header)?;
        self.parts.iter().try_for_each(|part| packed.write_all(part))?;
        packed.finish().map(|_| ())
    }
}

fn data(problem: String) -> SceneError {
    SceneError::Data { what: "the splats", problem }
}

/// Returns the most fractional bits with which every position fits into 24 bits.
fn fractional_bits(splats: &Splats) -> Result<u32> {
    let far = splats.means.iter().flatten().fold(0.0_f32, |most, v| most.max(v.abs()));
    let fits = |bits: u32| f64::from(far) * f64::from(1_u32 << bits) < f64::from((1 << 23) - 1);
    (0..=MOST_BITS).rev().find(|bits| fits(*bits)).ok_or_else(|| {
        data(format!(
            "a position is {far} from the origin, but SPZ holds 8388606 at most; scale the scene with --scale"
        ))
    })
}

fn attributes(s: &Splats, version: SpzVersion, bits: u32) -> [Vec<u8>; 6] {
    let factor = f64::from(1_u32 << bits);
    let fixed = |v: &f32| {
        let [a, b, c, _] = ((f64::from(*v) * factor).round() as i32).to_le_bytes();
        [a, b, c]
    };
    let small = |v: f64| v.round().clamp(0.0, 255.0) as u8;
    let rotations = s.rotations.iter().map(|q| unit(*q));
    let degree = s.sh_degree();
    let mut harmonics = Vec::with_capacity(s.len() * HARMONICS[degree]);
    for i in 0..s.len() {
        for (band, values) in s.sh.iter().enumerate().take(degree + 1).skip(1) {
            let wide = 3 * (2 * band + 1);
            harmonics.extend(values[i * wide..(i + 1) * wide].iter().map(|v| small(128.0 * f64::from(*v) + 128.0)));
        }
    }
    [
        s.means.as_flattened().iter().flat_map(fixed).collect(),
        s.opacity_logits.iter().map(|v| byte(logistic(*v))).collect(),
        s.sh[0].iter().map(|v| byte(COLOR * f64::from(*v) + 0.5)).collect(),
        s.log_scales.as_flattened().iter().map(|v| small(16.0 * (f64::from(*v) + 10.0))).collect(),
        match version {
            SpzVersion::V2 => rotations.flat_map(rotation::pack_3).collect(),
            _ => rotations.flat_map(|q| rotation::pack(q).to_le_bytes()).collect(),
        },
        harmonics,
    ]
}

/// Returns the extension record of the transform.
fn record(transform: &Placement) -> Vec<u8> {
    let [scale, rotation, translation] = [&[transform.scale][..], &transform.rotation, &transform.translation];
    let numbers = [scale, rotation, translation].concat();
    let mut record = TRANSFORM.to_le_bytes().to_vec();
    record.extend((8 * numbers.len() as u32).to_le_bytes());
    record.extend(numbers.iter().flat_map(|v| v.to_le_bytes()));
    record
}

/// Writes version 4: header, records, table of contents, streams.
fn streams(out: &mut impl Write, mut header: Vec<u8>, records: &[u8], parts: &[Vec<u8>; 6]) -> io::Result<()> {
    let count = if parts[5].is_empty() { 5 } else { 6 };
    header.push(count as u8);
    header.extend(((HEADER_4 + records.len()) as u32).to_le_bytes());
    header.resize(HEADER_4, 0);
    let packed = parts[..count].iter().map(|part| zstd::bulk::compress(part, LEVEL)).collect::<io::Result<Vec<_>>>()?;
    out.write_all(&header)?;
    out.write_all(records)?;
    for (part, packed) in parts.iter().zip(&packed) {
        [packed.len() as u64, part.len() as u64].iter().try_for_each(|size| out.write_all(&size.to_le_bytes()))?;
    }
    packed.iter().try_for_each(|stream| out.write_all(stream))
}

#[cfg(test)]
mod tests {
    use super::super::{read_spz, spz_of_bytes};
    use super::*;
    use crate::splats::tests::waves;

    #[test]
    fn splats_come_back_within_the_steps_of_the_format() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.spz");
        let placed = Placement { scale: 2.0, rotation: [0.5, 0.5, -0.5, 0.5], translation: [1.0, -2.0, 0.125] };
        for version in [SpzVersion::V2, SpzVersion::V3, SpzVersion::V4] {
            for degree in 0..=3 {
                let splats = waves(100, degree);
                write_spz(&path, &splats, version, Some(&placed)).unwrap();
                let file = read_spz(&path).unwrap();
                file.splats.check().unwrap();
                assert_eq!(file.transform, (version == SpzVersion::V4).then_some(placed));
                assert_eq!((file.splats.len(), file.splats.sh_degree()), (100, degree));
                let near = |a: &[f32], b: &[f32], step: f32| {
                    assert!(a.len() == b.len() && a.iter().zip(b).all(|(a, b)| (a - b).abs() <= 0.5001 * step));
                };
                // Positions up to 32 have 18 fractional bits.
                near(file.splats.means.as_flattened(), splats.means.as_flattened(), 0.5_f32.powi(18));
                near(file.splats.log_scales.as_flattened(), splats.log_scales.as_flattened(), 1.0 / 16.0);
                near(&file.splats.sh[0], &splats.sh[0], 1.0 / (255.0 * 0.15));
                (1..=degree).for_each(|band| near(&file.splats.sh[band], &splats.sh[band], 1.0 / 128.0));
                for (a, b) in file.splats.opacity_logits.iter().zip(&splats.opacity_logits) {
                    assert!((logistic(*a) - logistic(*b)).abs() <= 0.5001 / 255.0);
                }
            }
        }
        write_spz(&path, &waves(0, 2), SpzVersion::V4, None).unwrap();
        assert!(read_spz(&path).unwrap().splats.is_empty());
    }

    #[test]
    fn positions_too_far_away_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let mut splats = waves(2, 0);
        splats.means[1][2] = -1e7;
        let problem = write_spz(&folder.path().join("a.spz"), &splats, SpzVersion::V4, None).unwrap_err().to_string();
        assert!(problem.contains("10000000") && problem.contains("--scale"), "{problem}");
    }

    #[test]
    fn damaged_files_are_refused_or_read() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.spz");
        for version in [SpzVersion::V2, SpzVersion::V4] {
            write_spz(&path, &waves(20, 1), version, Some(&Placement::NONE)).unwrap();
            let bytes = std::fs::read(&path).unwrap();
            for length in 0..bytes.len() - 8 {
                assert!(spz_of_bytes(&bytes[..length]).is_err(), "{length}");
            }
            for at in 0..bytes.len() {
                let mut bad = bytes.clone();
                bad[at] ^= 0x41;
                if let Ok(file) = spz_of_bytes(&bad) {
                    file.splats.check().unwrap();
                }
            }
        }
    }
}
