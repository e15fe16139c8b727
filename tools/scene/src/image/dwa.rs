//! Check of the sizes stated in DWA-compressed blocks of an EXR file.
//!
//! Each block begins with the sizes of its parts, and the decoder allocates memory for them. A damaged block may
//! request more than is available, which would end the process.

use std::fs::File;
use std::io::BufReader;
use std::path::Path;

use ::exr::block::chunk::{CompressedBlock, CompressedScanLineBlock, CompressedTileBlock};
use ::exr::compression::Compression;
use ::exr::meta::header::Header;

use super::exr::unreadable;
use crate::error::{Result, SceneError, io_error};

/// Bytes of one stated size, little-endian.
const WIDE: usize = 8;
/// Indices of the sizes, of eleven, that count decoder output. They count uncompressed bytes, run-length-encoded bytes
/// before and after expansion, and the numbers of 16-bit coefficients. The other sizes count bytes in the file, and the
/// decoder checks them against the block.
const COUNTS: [usize; 5] = [1, 6, 7, 8, 9];
/// Side of a coefficient block; an 8×8 block has as many coefficients as pixels.
const EDGE: usize = 8;

/// Returns whether a file's blocks need the check.
pub(super) fn applies(header: &Header) -> bool {
    matches!(header.compression, Compression::DWAA(_) | Compression::DWAB(_))
}

/// Returns an error if a block states more output than its pixels allow.
pub(super) fn check(path: &Path) -> Result<()> {
    let file = File::open(path).map_err(io_error("read", path))?;
    let reader = ::exr::block::read(BufReader::new(file), false).map_err(|e| unreadable(path, &e))?;
    let headers: Vec<Header> = reader.headers().to_vec();
    // Chunks are visited at the offsets that the decoder uses; they need not be contiguous.
    for chunk in reader.filter_chunks(false, |_, _, _| true).map_err(|e| unreadable(path, &e))? {
        let chunk = chunk.map_err(|e| unreadable(path, &e))?;
        let Some(header) = headers.get(chunk.layer_index).filter(|h| applies(h)) else { continue };
        let held = match &chunk.compressed_block {
            CompressedBlock::ScanLine(CompressedScanLineBlock { compressed_pixels_le, .. })
            | CompressedBlock::Tile(CompressedTileBlock { compressed_pixels_le, .. }) => compressed_pixels_le,
            _ => continue,
        };
        let place = header
            .get_block_data_indices(&chunk.compressed_block)
            .and_then(|tile| header.get_absolute_block_pixel_coordinates(tile))
            .map_err(|e| unreadable(path, &e))?;
        // Incompressible blocks are stored uncompressed.
        if held.len() == place.size.area().saturating_mul(header.channels.bytes_per_pixel) {
            continue;
        }
        let padded = |n: usize| n.div_ceil(EDGE).saturating_mul(EDGE);
        let pixels = padded(place.size.width()).saturating_mul(padded(place.size.height()));
        if most_counted(held) > most(pixels.saturating_mul(header.channels.bytes_per_pixel)) {
            let problem = "a block of the EXR file says that more comes out of it than it has pixels; copy it again";
            return Err(SceneError::image(path, problem));
        }
    }
    Ok(())
}

/// Returns the largest valid count of a block with `bytes` bytes of pixels. Incompressible data grows by one byte in
/// 127 under run-length encoding.
fn most(bytes: usize) -> u64 {
    (bytes as u64).saturating_mul(2).saturating_add(64)
}

/// Returns the largest count at the beginning of a block. Returns 0 for blocks that are too short; the decoder reports
/// those.
fn most_counted(held: &[u8]) -> u64 {
    let sizes = held.as_chunks::<WIDE>().0;
    COUNTS.iter().filter_map(|&i| sizes.get(i)).map(|&size| u64::from_le_bytes(size)).max().unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::exr::read_exr;
    use ::exr::image::{AnyChannel, AnyChannels, Blocks, Encoding, FlatSamples, Layer};
    use ::exr::meta::attribute::LineOrder;
    use ::exr::meta::header::LayerAttributes;
    use ::exr::prelude::{SmallVec, Vec2, WritableImage, f16};

    const SIZE: (usize, usize) = (70, 50);
    const TILES: Blocks = Blocks::Tiles(Vec2(64, 64));

    /// Writes an image with channels for each compression scheme. Colors are compressed with loss, coverage is
    /// run-length-encoded, and depth stays uncompressed.
    fn write(path: &Path, compression: Compression, blocks: Blocks) -> Vec<f32> {
        let value = |i: usize, c: usize| {
            let (x, y) = ((i % SIZE.0) as f32, (i / SIZE.0) as f32);
            if c == 3 { f32::from(u8::from(x > 30.0)) } else { 0.5 + 0.4 * (0.1 * x + 0.07 * y + c as f32).sin() }
        };
        let mut channels = SmallVec::new();
        for (c, name) in ["R", "G", "B", "A"].into_iter().enumerate() {
            let values = (0..SIZE.0 * SIZE.1).map(|i| f16::from_f32(value(i, c))).collect();
            channels.push(AnyChannel::new(name, FlatSamples::F16(values)));
        }
        let depth = (0..SIZE.0 * SIZE.1).map(|i| value(i, 5)).collect();
        channels.push(AnyChannel::new("depth", FlatSamples::F32(depth)));
        let encoding = Encoding { compression, blocks, line_order: LineOrder::Increasing };
        let layer = Layer::new(SIZE, LayerAttributes::default(), encoding, AnyChannels::sort(channels));
        ::exr::image::Image::from_layer(layer).write().non_parallel().to_file(path).unwrap();
        (0..SIZE.0 * SIZE.1).flat_map(|i| [0, 1, 2, 3, 5].map(|c| value(i, c))).collect()
    }

    /// Returns the file offsets of the compressed blocks.
    fn blocks(path: &Path) -> Vec<usize> {
        let bytes = std::fs::read(path).unwrap();
        let reader = ::exr::block::read(BufReader::new(File::open(path).unwrap()), false).unwrap();
        let held = reader.all_chunks(false).unwrap().map(|chunk| match chunk.unwrap().compressed_block {
            CompressedBlock::ScanLine(CompressedScanLineBlock { compressed_pixels_le, .. })
            | CompressedBlock::Tile(CompressedTileBlock { compressed_pixels_le, .. }) => compressed_pixels_le,
            _ => panic!("the blocks are of colors"),
        });
        held.map(|b| bytes.windows(b.len()).position(|w| w == b).unwrap()).collect()
    }

    #[test]
    fn intact_dwa_files_are_read() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("a.exr");
        let kinds = [(Compression::DWAA(None), Blocks::ScanLines), (Compression::DWAB(Some(10.0)), TILES)];
        for (compression, blocks) in kinds {
            let truth = write(&path, compression, blocks);
            assert!(std::fs::metadata(&path).unwrap().len() < (SIZE.0 * SIZE.1 * 12) as u64 / 2, "it is compressed");
            let image = read_exr(&path).unwrap().image;
            assert_eq!((image.width, image.height, image.channels), (SIZE.0 as u32, SIZE.1 as u32, 5));
            let off = image.data.iter().zip(&truth).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
            assert!(off < 0.05, "{off}");
        }
    }

    #[test]
    fn blocks_with_excessive_counts_are_rejected() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("a.exr");
        for kind in [Blocks::ScanLines, TILES] {
            write(&path, Compression::DWAA(None), kind);
            let whole = std::fs::read(&path).unwrap();
            let found = blocks(&path);
            assert!(found.len() >= 2);
            for at in found {
                for count in COUNTS {
                    for value in [1 << 20, 532_942_459_764_736, i64::MAX as u64, u64::MAX] {
                        let mut bytes = whole.clone();
                        let at = at + WIDE * count;
                        bytes[at..at + WIDE].copy_from_slice(&u64::to_le_bytes(value));
                        std::fs::write(&path, bytes).unwrap();
                        let error = read_exr(&path).unwrap_err().to_string();
                        assert!(error.contains("more comes out of it than it has pixels"), "{count} {value}: {error}");
                    }
                }
            }
        }
    }
}
