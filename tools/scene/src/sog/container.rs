//! Files of a SOG: in a zip archive or in a directory.

use std::io::{self, Cursor, Read, Seek, Write};
use std::path::{Path, PathBuf};
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipArchive, ZipWriter};

/// Result whose error is a description of the problem.
type Found<T> = std::result::Result<T, String>;

/// Image of four bytes per pixel.
pub(super) struct Texture {
    pub(super) width: usize,
    pub(super) height: usize,
    pub(super) data: Vec<[u8; 4]>,
}

/// Place of the files.
pub(super) enum Container {
    Archive { archive: ZipArchive<Cursor<Vec<u8>>>, bytes: usize },
    Directory(PathBuf),
}

impl Container {
    /// Opens a zip archive, or the directory of a `meta.json`.
    pub(super) fn open(path: &Path, bytes: Vec<u8>) -> Found<Container> {
        if !bytes.starts_with(b"PK") {
            return Ok(Container::Directory(path.parent().unwrap_or(Path::new(".")).to_owned()));
        }
        let size = bytes.len();
        let archive = ZipArchive::new(Cursor::new(bytes)).map_err(|e| format!("its zip archive is damaged: {e}"))?;
        Ok(Container::Archive { archive, bytes: size })
    }

    /// Returns the bytes of a file.
    pub(super) fn file(&mut self, name: &str) -> Found<Vec<u8>> {
        if name.is_empty() || name.contains(['/', '\\', ':']) || name.starts_with('.') {
            return Err(format!("meta.json names the file \"{name}\", which is not beside it"));
        }
        match self {
            Container::Directory(folder) => {
                std::fs::read(folder.join(name)).map_err(|e| format!("cannot read {name}: {e}"))
            }
            Container::Archive { archive, .. } => {
                let mut entry = archive.by_name(name).map_err(|e| format!("its zip archive has no {name}: {e}"))?;
                let mut bytes = Vec::new();
                entry.read_to_end(&mut bytes).map_err(|e| format!("{name} is damaged: {e}"))?;
                Ok(bytes)
            }
        }
    }

    /// Reads an image of `pixels` pixels at least.
    pub(super) fn texture(&mut self, name: &str, pixels: usize) -> Found<Texture> {
        let bytes = self.file(name)?;
        let whole = match self {
            Container::Archive { bytes, .. } => *bytes,
            Container::Directory(folder) => folder_size(folder),
        };
        texture(&bytes, pixels, whole).map_err(|e| format!("{name}: {e}"))
    }
}

/// Returns the bytes of all files of a directory.
fn folder_size(folder: &Path) -> usize {
    let files = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let size = |file: std::fs::DirEntry| file.metadata().map_or(0, |m| if m.is_file() { m.len() as usize } else { 0 });
    files.map(size).fold(0, usize::saturating_add)
}

/// Decodes a WebP image. `whole` is the number of bytes of all images together.
fn texture(bytes: &[u8], pixels: usize, whole: usize) -> Found<Texture> {
    let wrong = |e: image_webp::DecodingError| format!("it is no lossless WebP image: {e}");
    let mut decoder = image_webp::WebPDecoder::new(Cursor::new(bytes)).map_err(wrong)?;
    if decoder.is_lossy() || decoder.is_animated() {
        return Err("it is a lossy or animated image, which changes the numbers; export it lossless".into());
    }
    let (width, height) = decoder.dimensions();
    let (width, height) = (width as usize, height as usize);
    // The positions of a splat take more than a byte in all, so larger images are bombs.
    if width * height > 16 * whole + (1 << 16) {
        return Err(format!("it has {width}×{height} pixels, which {whole} bytes do not hold"));
    }
    if width * height < pixels {
        return Err(format!("it has {width}×{height} pixels, but {pixels} are needed"));
    }
    let channels = if decoder.has_alpha() { 4 } else { 3 };
    let mut data = vec![0; width * height * channels];
    decoder.read_image(&mut data).map_err(wrong)?;
    let data = match channels {
        4 => data.as_chunks::<4>().0.to_vec(),
        _ => data.as_chunks::<3>().0.iter().map(|[r, g, b]| [*r, *g, *b, 255]).collect(),
    };
    Ok(Texture { width, height, data })
}

impl Texture {
    /// Encodes a lossless WebP image.
    pub(super) fn encode(&self) -> io::Result<Vec<u8>> {
        let mut bytes = Vec::new();
        let encoder = image_webp::WebPEncoder::new(&mut bytes);
        let (width, height) = (self.width as u32, self.height as u32);
        encoder
            .encode(self.data.as_flattened(), width, height, image_webp::ColorType::Rgba8)
            .map_err(|e| io::Error::other(e.to_string()))?;
        Ok(bytes)
    }
}

/// Writes an archive of files that are compressed already.
pub(super) fn write_archive(out: &mut (impl Write + Seek), files: &[(&str, Vec<u8>)]) -> io::Result<()> {
    // A fixed date gives the same bytes every time.
    let options = SimpleFileOptions::default()
        .compression_method(CompressionMethod::Stored)
        .last_modified_time(zip::DateTime::default());
    let mut archive = ZipWriter::new(out);
    for (name, bytes) in files {
        archive.start_file(*name, options.large_file(bytes.len() > u32::MAX as usize))?;
        archive.write_all(bytes)?;
    }
    archive.finish()?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_byte_of_an_image_comes_back() {
        let data: Vec<[u8; 4]> =
            (0..96_u32).map(|i| [i as u8, (i * 77) as u8, (i * i) as u8, (i * 3 % 7) as u8]).collect();
        let image = Texture { width: 12, height: 8, data };
        let bytes = image.encode().unwrap();
        let found = texture(&bytes, 96, bytes.len()).unwrap();
        assert!(found.data == image.data && (found.width, found.height) == (12, 8));
        assert!(texture(&bytes, 97, bytes.len()).err().unwrap().contains("12×8"));
        assert!(texture(&bytes[..20], 1, 20).err().unwrap().contains("no lossless WebP"));
    }

    #[test]
    fn images_larger_than_their_file_are_refused() {
        let image = Texture { width: 1024, height: 1024, data: vec![[7; 4]; 1 << 20] };
        let bytes = image.encode().unwrap();
        assert!(bytes.len() < 4096);
        assert!(texture(&bytes, 1, bytes.len()).err().unwrap().contains("1024×1024"));
        assert!(texture(&bytes, 1, 1 << 17).is_ok());
    }
}
