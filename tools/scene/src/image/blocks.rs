//! Check of the block lengths stated in an EXR file.
//!
//! The decoder allocates memory for the stated length before it reads a block, up to the size of the block's pixels.
//! Tiles may be larger than the image, so a damaged file can request excessive memory.

use std::fs::File;
use std::io::{BufReader, ErrorKind, Read, Result as IoResult, Seek, SeekFrom};
use std::path::Path;

use ::exr::meta::header::Header;
use ::exr::meta::{BlockDescription, MetaData};

use super::exr::unreadable;
use crate::error::{Result, SceneError, io_error};

/// Block size in bytes up to which blocks are not checked.
const FREE: u64 = 16 << 20;

/// Returns whether a file's blocks need the check. They do if the pixels of a block exceed `held`, the most that the
/// file can hold.
pub(super) fn applies(header: &Header, held: u64) -> bool {
    let pixels = match header.blocks {
        BlockDescription::Tiles(tiles) => (tiles.tile_size.0 as u64).saturating_mul(tiles.tile_size.1 as u64),
        BlockDescription::ScanLines => {
            (header.compression.scan_lines_per_block() as u64).saturating_mul(header.layer_size.0 as u64)
        }
    };
    pixels.saturating_mul(header.channels.bytes_per_pixel as u64) > held.max(FREE)
}

/// Returns an error if a block states a length that exceeds the file.
pub(super) fn check(path: &Path) -> Result<()> {
    let cannot = |e| io_error("read", path)(e);
    let file = File::open(path).map_err(cannot)?;
    let length = file.metadata().map_err(cannot)?.len();
    let mut reader = BufReader::new(file);
    let meta = MetaData::read_from_buffered(&mut reader, false).map_err(|e| unreadable(path, &e))?;
    // The table of block offsets follows the headers.
    let blocks = meta.headers.iter().fold(0_u64, |sum, h| sum.saturating_add(h.chunk_count as u64));
    let at = reader.stream_position().map_err(cannot)?;
    let mut table = Vec::new();
    reader
        .by_ref()
        .take(blocks.saturating_mul(8).min(length - at.min(length)))
        .read_to_end(&mut table)
        .map_err(cannot)?;
    for offset in table.as_chunks().0 {
        let offset = u64::from_le_bytes(*offset);
        if offset >= length {
            return Err(SceneError::image(path, "a block of the EXR file lies beyond its end; copy it again"));
        }
        let stated = match stated(&mut reader, offset, &meta) {
            Err(e) if e.kind() == ErrorKind::UnexpectedEof => continue,
            other => other.map_err(cannot)?,
        };
        if stated.is_some_and(|bytes| bytes > length - offset) {
            let problem = "a block of the EXR file says that it is longer than the file; copy it again";
            return Err(SceneError::image(path, problem));
        }
    }
    Ok(())
}

/// Returns the stated length of a block. Returns `None` for deep data, of which the decoder reads little at a time, and
/// for blocks of unknown layers.
fn stated(reader: &mut (impl Read + Seek), offset: u64, meta: &MetaData) -> IoResult<Option<u64>> {
    reader.seek(SeekFrom::Start(offset))?;
    let mut number = || -> IoResult<i32> {
        let mut bytes = [0; 4];
        reader.read_exact(&mut bytes).map(|()| i32::from_le_bytes(bytes))
    };
    let part = if meta.requirements.is_multilayer() { number()? } else { 0 };
    let header = usize::try_from(part).ok().and_then(|part| meta.headers.get(part)).filter(|h| !h.deep);
    let Some(header) = header else { return Ok(None) };
    // Tiles have two coordinates and two levels; scan-line blocks have one coordinate.
    for _ in 0..if matches!(header.blocks, BlockDescription::Tiles(_)) { 4 } else { 1 } {
        number()?;
    }
    Ok(u64::try_from(number()?).ok())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::exr::read_exr;
    use ::exr::image::{AnyChannel, AnyChannels, Blocks, Encoding, FlatSamples, Image, Layer};
    use ::exr::meta::attribute::LineOrder;
    use ::exr::meta::header::LayerAttributes;
    use ::exr::prelude::{Compression, SmallVec, Vec2, WritableImage};

    /// Writes an 8×6 image with one channel, in larger tiles or in scan lines. Returns the file position of the length
    /// of its only block.
    fn write(path: &Path, blocks: Blocks, compression: Compression) -> usize {
        let values = (0..48).map(|i| i as f32).collect();
        let mut channels = SmallVec::new();
        channels.push(AnyChannel::new("Y", FlatSamples::F32(values)));
        let encoding = Encoding { compression, blocks, line_order: LineOrder::Increasing };
        let layer = Layer::new((8, 6), LayerAttributes::default(), encoding, AnyChannels::sort(channels));
        Image::from_layer(layer).write().non_parallel().to_file(path).unwrap();
        let mut reader = BufReader::new(File::open(path).unwrap());
        let meta = MetaData::read_from_buffered(&mut reader, false).unwrap();
        assert_eq!(meta.headers[0].chunk_count, 1);
        let mut offset = [0; 8];
        reader.read_exact(&mut offset).unwrap();
        let skipped = if blocks == Blocks::ScanLines { 4 } else { 16 };
        u64::from_le_bytes(offset) as usize + skipped
    }

    #[test]
    fn oversized_tiles_are_read_and_overlong_blocks_rejected() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("tiles.exr");
        let huge = Blocks::Tiles(Vec2(1 << 14, 1 << 14));
        for blocks in [huge, Blocks::Tiles(Vec2(16, 16)), Blocks::ScanLines] {
            let at = write(&path, blocks, Compression::ZIP16);
            let image = read_exr(&path).unwrap().image;
            assert!(image.data.iter().enumerate().all(|(i, v)| *v == i as f32), "{blocks:?}");
            let whole = std::fs::read(&path).unwrap();
            let length = whole.len();
            for (stated, message) in
                [(length as i32, "longer than the file"), (i32::MAX, "longer than the file"), (-1, "EXR")]
            {
                let damaged = [&whole[..at], &stated.to_le_bytes()[..], &whole[at + 4..]].concat();
                std::fs::write(&path, damaged).unwrap();
                let error = read_exr(&path).unwrap_err().to_string();
                // In the other cases the decoder reports the error and needs little memory to do so.
                assert!(error.contains(if blocks == huge { message } else { "EXR" }), "{blocks:?} {stated}: {error}");
            }
            // Truncate within the block table, within a block's header, and within the block.
            for end in [at - 20, at - 1, at + 3, length - 1] {
                std::fs::write(&path, &whole[..end]).unwrap();
                assert!(read_exr(&path).is_err(), "{blocks:?} cut off at {end} of {length}");
            }
        }
    }
}
