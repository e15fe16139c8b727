//! Reader of SPZ files.

use super::{
    ANTIALIASED_FLAG, COLOR, EXTENSIONS_FLAG, HARMONICS, HEADER, HEADER_4, MAGIC, SpzVersion, TRANSFORM, rotation,
};
use crate::activation::unlogistic;
use crate::error::{Result, SceneError, io_error};
use crate::placement::Placement;
use crate::splats::{SplatFile, Splats};
use flate2::read::GzDecoder;
use std::io::Read;
use std::path::Path;

/// Result whose error is a description of the problem.
type Found<T> = std::result::Result<T, String>;

/// Largest accepted ratio of decompressed to compressed bytes in version 4. Deflate has a limit of its own.
const MOST_RATIO: usize = 1000;

/// Header of any version.
struct Header {
    version: SpzVersion,
    count: usize,
    degree: usize,
    fractional_bits: u8,
    flags: u8,
}

/// Reads an SPZ file of version 2, 3 or 4.
///
/// # Errors
/// Fails if the file is damaged or of another version.
pub fn read_spz(path: &Path) -> Result<SplatFile> {
    let bytes = std::fs::read(path).map_err(io_error("read", path))?;
    spz_of_bytes(&bytes).map_err(|problem| SceneError::points(path, "", problem))
}

/// Reads the content of an SPZ file.
///
/// # Errors
/// Describes what is damaged, or the version that is not read.
pub(crate) fn spz_of_bytes(bytes: &[u8]) -> Found<SplatFile> {
    if bytes.starts_with(&[0x1f, 0x8b]) {
        let mut reader = GzDecoder::new(bytes);
        let mut start = [0; HEADER];
        reader.read_exact(&mut start).map_err(|e| format!("its gzip stream is damaged: {e}"))?;
        let header = header(&start)?;
        if header.version == SpzVersion::V4 {
            return Err("it is version 4 inside a gzip stream; export it again".into());
        }
        let need = header.bytes()?;
        let mut payload = Vec::new();
        reader.take(need as u64).read_to_end(&mut payload).map_err(|e| format!("its gzip stream is damaged: {e}"))?;
        return whole(&header, &payload);
    }
    let header = header(bytes)?;
    match header.version {
        SpzVersion::V4 => streams(&header, bytes),
        _ => whole(&header, &bytes[HEADER..]),
    }
}

fn word(bytes: &[u8], at: usize) -> Found<u32> {
    let four = bytes.get(at..at.saturating_add(4)).ok_or("its header is cut off")?;
    Ok(u32::from_le_bytes([four[0], four[1], four[2], four[3]]))
}

fn long(bytes: &[u8], at: usize) -> Found<usize> {
    let value = u64::from(word(bytes, at)?) | u64::from(word(bytes, at.saturating_add(4))?) << 32;
    usize::try_from(value).map_err(|_| format!("a size of {value} bytes is impossible"))
}

fn header(bytes: &[u8]) -> Found<Header> {
    if !bytes.starts_with(&MAGIC) {
        return Err("it is not an SPZ file: it does not begin with NGSP".into());
    }
    let version = match word(bytes, 4)? {
        2 => SpzVersion::V2,
        3 => SpzVersion::V3,
        4 => SpzVersion::V4,
        other => return Err(format!("it is SPZ of version {other}; versions 2, 3 and 4 are read")),
    };
    let count = word(bytes, 8)? as usize;
    let [degree, fractional_bits, flags, _] = word(bytes, 12)?.to_le_bytes();
    if usize::from(degree) >= HARMONICS.len() {
        return Err(format!("its harmonics have degree {degree}; degrees 0 to 4 are read"));
    }
    if fractional_bits > 30 {
        return Err(format!("its positions have {fractional_bits} fractional bits, but 30 at most are possible"));
    }
    Ok(Header { version, count, degree: usize::from(degree), fractional_bits, flags })
}

impl Header {
    /// Returns the bytes of every attribute.
    fn sizes(&self) -> Found<[usize; 6]> {
        let mut sizes = self.version.sizes(self.degree);
        for size in &mut sizes {
            *size = size.checked_mul(self.count).ok_or("it promises more splats than memory can hold")?;
        }
        Ok(sizes)
    }

    fn bytes(&self) -> Found<usize> {
        self.sizes()?
            .iter()
            .try_fold(0_usize, |all, size| all.checked_add(*size))
            .ok_or_else(|| "it promises more splats than memory can hold".into())
    }
}

/// Reads the attributes one after another.
fn whole(header: &Header, payload: &[u8]) -> Found<SplatFile> {
    let need = header.bytes()?;
    if payload.len() < need {
        let have = payload.len();
        return Err(format!("it promises {} splats of {need} bytes, but has {have}; copy it again", header.count));
    }
    let mut rest = payload;
    let parts = header.sizes()?.map(|size| {
        let (part, after) = rest.split_at(size);
        rest = after;
        part
    });
    splats(header, parts, None)
}

/// Decompresses the streams of version 4.
fn streams(header: &Header, bytes: &[u8]) -> Found<SplatFile> {
    let count = usize::from(*bytes.get(15).ok_or("its header is cut off")?);
    let contents = word(bytes, 16)? as usize;
    let records = bytes.get(HEADER_4..contents).ok_or("its table of contents is outside of the file")?;
    let sizes = header.sizes()?;
    let expected = if header.degree == 0 { 5 } else { 6 };
    if count != expected && count != 6 {
        return Err(format!("it has {count} streams, but splats of degree {} have {expected}", header.degree));
    }
    if header.bytes()? / MOST_RATIO > bytes.len() {
        return Err(format!("it promises {} splats, which {} bytes cannot hold", header.count, bytes.len()));
    }
    let mut at = contents + 16 * count;
    let mut parts: [Vec<u8>; 6] = Default::default();
    for (i, part) in parts.iter_mut().enumerate().take(count) {
        let packed = long(bytes, contents + 16 * i).map_err(|_| "its table of contents is cut off")?;
        let size = long(bytes, contents + 16 * i + 8).map_err(|_| "its table of contents is cut off")?;
        if size != sizes[i] {
            return Err(format!("stream {i} holds {size} bytes, but {} splats need {}", header.count, sizes[i]));
        }
        let end = at.checked_add(packed);
        let stream = end.and_then(|end| bytes.get(at..end)).ok_or_else(|| format!("stream {i} is cut off"))?;
        at += packed;
        // Writers leave the stream of an empty attribute out.
        if size > 0 {
            *part = zstd::bulk::decompress(stream, size).map_err(|e| format!("stream {i} is damaged: {e}"))?;
        }
        if part.len() != size {
            return Err(format!("stream {i} has {} bytes, but promises {size}", part.len()));
        }
    }
    let transform = if header.flags & EXTENSIONS_FLAG == 0 { None } else { transform(records)? };
    splats(header, parts.each_ref().map(Vec::as_slice), transform)
}

/// Returns the recorded transform among the extension records. Others are skipped.
fn transform(records: &[u8]) -> Found<Option<Placement>> {
    let mut at = 0;
    while at < records.len() {
        let (kind, length) = (word(records, at)?, word(records, at + 4)? as usize);
        let end = (at + 8).checked_add(length);
        let payload = end.and_then(|end| records.get(at + 8..end)).ok_or("an extension record is cut off")?;
        if kind == TRANSFORM {
            let words = payload.as_chunks::<8>().0;
            let numbers: Vec<f64> = words.iter().map(|b| f64::from_le_bytes(*b)).collect();
            let [scale, w, x, y, z, a, b, c] = numbers[..] else {
                return Err(format!("its recorded transform has {length} bytes instead of 64"));
            };
            let placement = Placement { scale, rotation: [w, x, y, z], translation: [a, b, c] };
            placement.check()?;
            return Ok(Some(placement));
        }
        at = at + 8 + length;
    }
    Ok(None)
}

fn splats(header: &Header, parts: [&[u8]; 6], transform: Option<Placement>) -> Found<SplatFile> {
    let [positions, alphas, colors, scales, rotations, harmonics] = parts;
    let step = 0.5_f64.powi(i32::from(header.fractional_bits));
    let fixed = |b: &[u8; 3]| {
        let raw = i32::from_le_bytes([0, b[0], b[1], b[2]]) >> 8;
        (f64::from(raw) * step) as f32
    };
    let triples = |bytes: &[u8], of: &dyn Fn(u8) -> f32| -> Vec<[f32; 3]> {
        bytes.as_chunks::<3>().0.iter().map(|b| b.map(of)).collect()
    };
    let color = |b: u8| ((f64::from(b) / 255.0 - 0.5) / COLOR) as f32;
    let coefficient = |b: &u8| (f32::from(*b) - 128.0) / 128.0;
    let mut sh = [colors.iter().map(|b| color(*b)).collect(), Vec::new(), Vec::new(), Vec::new()];
    for (band, out) in sh.iter_mut().enumerate().take(header.degree.min(3) + 1).skip(1) {
        let of_band = HARMONICS[band - 1]..HARMONICS[band];
        out.reserve_exact(header.count * of_band.len());
        for row in harmonics.chunks_exact(HARMONICS[header.degree]) {
            out.extend(row[of_band.clone()].iter().map(coefficient));
        }
    }
    let rotations = match header.version {
        SpzVersion::V2 => rotations.as_chunks::<3>().0.iter().map(|b| rotation::unpack_3(*b)).collect(),
        _ => rotations.as_chunks::<4>().0.iter().map(|b| rotation::unpack(u32::from_le_bytes(*b))).collect(),
    };
    let splats = Splats {
        means: positions
            .as_chunks::<9>()
            .0
            .iter()
            .map(|b| [0, 3, 6].map(|k| fixed(&[b[k], b[k + 1], b[k + 2]])))
            .collect(),
        log_scales: triples(scales, &|b| f32::from(b) / 16.0 - 10.0),
        rotations,
        opacity_logits: alphas.iter().map(|b| unlogistic(f64::from(*b) / 255.0)).collect(),
        sh,
        antialiased: header.flags & ANTIALIASED_FLAG != 0,
        ..Splats::default()
    };
    let mut left_out = Vec::new();
    if header.degree > 3 {
        left_out.push("band 4 of the harmonics".to_owned());
    }
    Ok(SplatFile { splats, transform, left_out })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn impossible_headers_are_refused_with_a_reason() {
        let refused = |bytes: &[u8], words: &str| {
            let problem = spz_of_bytes(bytes).unwrap_err();
            assert!(problem.contains(words), "{problem}");
        };
        let head = |version: u32, count: u32, degree: u8, bits: u8| {
            let mut bytes = MAGIC.to_vec();
            bytes.extend(version.to_le_bytes());
            bytes.extend(count.to_le_bytes());
            bytes.extend([degree, bits, 0, 6, 32, 0, 0, 0]);
            bytes.resize(32, 0);
            bytes
        };
        refused(b"NGS", "not an SPZ file");
        refused(b"NGSP\x02\0\0\0", "header is cut off");
        refused(&head(1, 0, 0, 12), "version 1");
        refused(&head(2, 0, 5, 12), "degree 5");
        refused(&head(2, 0, 0, 31), "31 fractional bits");
        refused(&head(3, u32::MAX, 3, 12), "copy it again");
        refused(&head(4, u32::MAX, 3, 12), "cannot hold");
        refused(&head(4, 1, 3, 12), "table of contents is cut off");
        refused(&[0x1f, 0x8b, 8, 0], "gzip stream is damaged");
        assert!(spz_of_bytes(&head(2, 0, 0, 12)).unwrap().splats.is_empty());
    }

    #[test]
    fn unknown_extension_records_are_skipped() {
        let mut records = vec![3, 0, 0xbe, 0xad, 4, 0, 0, 0, 1, 2, 3, 4];
        assert_eq!(transform(&records), Ok(None));
        records.extend(TRANSFORM.to_le_bytes());
        records.extend(64_u32.to_le_bytes());
        for number in [2.0, 1.0, 0.0, 0.0, 0.0, 1.0, 2.0, 3.0_f64] {
            records.extend(number.to_le_bytes());
        }
        let placed = Placement { scale: 2.0, translation: [1.0, 2.0, 3.0], ..Placement::NONE };
        assert_eq!(transform(&records), Ok(Some(placed)));
        assert!(transform(&records[..40]).unwrap_err().contains("cut off"));
    }
}
