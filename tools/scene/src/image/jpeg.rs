//! JPEG files.
//!
//! The decoder of the crate `image` is not used. Version 0.25 silently accepts truncated files, with the rest gray, and
//! silently confuses components in separate scans (`docs/adr/0021-jpeg.md`).

use std::fs::File;
use std::io::{BufReader, ErrorKind, Read, Result as IoResult, Seek, SeekFrom};
use std::path::Path;

use jpeg_decoder::{CodingProcess, Decoder, Error, ImageInfo, PixelFormat};

use super::{Exif, Image, file};
use crate::error::{Result, SceneError, io_error};

/// Largest number of pixels per byte of a file. The bound is one bit for a block of 64 pixels, times two for odd
/// samplings.
const RATIO: u64 = 1024;

/// Returns the width and height from the file's header.
pub(super) fn read_size(path: &Path) -> Result<(u32, u32)> {
    open(path).map(|(_, info)| size(&info))
}

/// Returns the EXIF data of the file; the default if it has none.
pub(super) fn exif(path: &Path) -> Exif {
    let data = open(path).ok().and_then(|(decoder, _)| decoder.exif_data().map(Exif::parse));
    data.unwrap_or_default()
}

/// Reads the image, gray or RGB, in `[0, 1]`.
pub(super) fn read(path: &Path) -> Result<Image> {
    let (mut decoder, info) = open(path)?;
    let (width, height) = size(&info);
    let channels = if info.pixel_format == PixelFormat::L8 { 1 } else { 3 };
    let bytes = decoder.decode().map_err(|e| undecodable(path, e))?;
    let data = bytes.into_iter().map(|v| f32::from(v) / 255.0).collect();
    let image = Image { width, height, channels, data };
    image.check()?;
    Ok(image)
}

/// Opens a file, reads its header, and checks that the file can hold its size.
fn open(path: &Path) -> Result<(Decoder<BufReader<File>>, ImageInfo)> {
    let file = File::open(path).map_err(io_error("read", path))?;
    let length = file.metadata().map_err(io_error("read", path))?.len();
    let mut reader = BufReader::new(file);
    let mixed = mixed_samplings(&mut reader);
    reader.rewind().map_err(io_error("read", path))?;
    let mut decoder = Decoder::new(reader);
    decoder.read_info().map_err(|e| undecodable(path, e))?;
    let Some(info) = decoder.info() else {
        return Err(SceneError::image(path, "the JPEG file has no image"));
    };
    let (width, height) = size(&info);
    file::check_size(path, width, height)?;
    file::check_held(path, (width, height), u64::from(width) * u64::from(height), length.saturating_mul(RATIO))?;
    if info.coding_process == CodingProcess::Lossless {
        return Err(SceneError::image(path, "the JPEG file is a lossless one, which is not read; export it as PNG"));
    }
    if mixed.map_err(|e| undecodable(path, e.into()))? {
        let problem =
            "the JPEG file samples a component neither once nor most often, which is not read; export it again";
        return Err(SceneError::image(path, problem));
    }
    match info.pixel_format {
        PixelFormat::L8 | PixelFormat::RGB24 => Ok((decoder, info)),
        PixelFormat::CMYK32 => {
            Err(SceneError::image(path, "the JPEG file holds inks (CMYK) instead of light; export it as RGB"))
        }
        PixelFormat::L16 => {
            Err(SceneError::image(path, "the JPEG file has samples of more than 8 bits; export it as PNG"))
        }
    }
}

/// Returns whether a component of the first frame has a mixed sampling factor. Such a factor is above 1 and below that
/// of another component along the same axis. The decoder reads too many blocks of such a component in a separate scan.
fn mixed_samplings(reader: &mut (impl Read + Seek)) -> IoResult<bool> {
    loop {
        while byte(reader)? != 0xff {}
        let marker = loop {
            match byte(reader)? {
                0xff => continue,
                marker => break marker,
            }
        };
        // Markers without a segment: stuffed zeros, restarts, start and end of image.
        if matches!(marker, 0 | 1 | 0xd0..=0xd9) {
            continue;
        }
        let length = u16::from_be_bytes([byte(reader)?, byte(reader)?]);
        if !matches!(marker, 0xc0..=0xcf) || matches!(marker, 0xc4 | 0xc8 | 0xcc) {
            reader.seek(SeekFrom::Current(i64::from(length.saturating_sub(2))))?;
            continue;
        }
        // Precision, height and width precede the component count. Each component has an id, sampling factors and a
        // table.
        reader.seek(SeekFrom::Current(5))?;
        let mut samplings = Vec::new();
        for _ in 0..byte(reader)? {
            byte(reader)?;
            let both = byte(reader)?;
            samplings.push([both >> 4, both & 15]);
            byte(reader)?;
        }
        return Ok((0..2).any(|axis| {
            let most = samplings.iter().map(|s| s[axis]).max();
            samplings.iter().any(|s| s[axis] > 1 && Some(s[axis]) < most)
        }));
    }
}

fn byte(reader: &mut impl Read) -> IoResult<u8> {
    let mut byte = [0];
    reader.read_exact(&mut byte).map(|()| byte[0])
}

fn size(info: &ImageInfo) -> (u32, u32) {
    (info.width.into(), info.height.into())
}

fn undecodable(path: &Path, error: Error) -> SceneError {
    match error {
        Error::Io(e) if e.kind() == ErrorKind::UnexpectedEof => {
            SceneError::image(path, "the JPEG file ends before its image does; copy it again")
        }
        Error::Io(e) => io_error("read", path)(e),
        other => SceneError::image(path, format!("the file cannot be read as JPEG ({other}); copy or export it again")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::process::Command;

    /// The same image with various samplings and scans. The files are written by `cjpeg` of libjpeg-turbo.
    const WRITTEN: [(&str, &[u8]); 9] = [
        ("together", include_bytes!("../../tests/jpeg/together.jpg")),
        ("apart", include_bytes!("../../tests/jpeg/apart.jpg")),
        ("two_scans", include_bytes!("../../tests/jpeg/two_scans.jpg")),
        ("upright", include_bytes!("../../tests/jpeg/upright.jpg")),
        ("colors_finer", include_bytes!("../../tests/jpeg/colors_finer.jpg")),
        ("progressive", include_bytes!("../../tests/jpeg/progressive.jpg")),
        ("restarts", include_bytes!("../../tests/jpeg/restarts.jpg")),
        ("rgb", include_bytes!("../../tests/jpeg/rgb.jpg")),
        ("gray", include_bytes!("../../tests/jpeg/gray.jpg")),
    ];

    fn of<T>(bytes: &[u8], read: impl Fn(&Path) -> Result<T>) -> Result<T> {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("a.jpg");
        std::fs::write(&path, bytes).unwrap();
        read(&path)
    }

    /// Returns a pixel of the original image.
    fn pixel(x: usize, y: usize) -> [f32; 3] {
        [40 + 5 * x, 60 + 8 * y, 200 - 3 * x - 3 * y].map(|v| v as f32 / 255.0)
    }

    #[test]
    fn decoded_image_is_independent_of_sampling_and_scans() {
        for (name, bytes) in WRITTEN {
            let image = of(bytes, read).unwrap();
            let channels = if name == "gray" { 1 } else { 3 };
            assert_eq!((image.width, image.height, image.channels), (37, 23, channels), "{name}");
            assert_eq!(of(bytes, read_size).unwrap(), (37, 23), "{name}");
            let (mut sum, mut worst) = (0.0, 0.0_f32);
            for (i, found) in image.data.chunks(channels as usize).enumerate() {
                let [r, g, b] = pixel(i % 37, i / 37);
                let wanted = if channels == 1 { vec![0.299 * r + 0.587 * g + 0.114 * b] } else { vec![r, g, b] };
                for (found, wanted) in found.iter().zip(wanted) {
                    sum += (found - wanted).abs() * 255.0;
                    worst = worst.max((found - wanted).abs() * 255.0);
                }
            }
            let mean = sum / image.data.len() as f32;
            println!("{name}: off by {mean:.2} of 255 in the mean, by {worst:.1} at most");
            // Chroma subsampled 2×2 has gradients of 5 and 8 codes per pixel.
            assert!(mean < 1.0 && worst < 8.0, "{name}: {mean} {worst}");
        }
    }

    #[test]
    fn truncated_files_are_rejected_at_every_length() {
        for (name, bytes) in WRITTEN {
            for length in 0..bytes.len() {
                let error = of(&bytes[..length], read).map(|_| ()).unwrap_err().to_string();
                assert!(
                    error.contains("a.jpg: the JPEG file ends before its image does; copy it again"),
                    "{name} {length}: {error}"
                );
            }
            // Bytes after the image are ignored.
            assert!(of(&[bytes, &[0xff, 0xd8, 1, 2]].concat(), read).is_ok(), "{name}");
        }
    }

    #[test]
    fn unsupported_jpegs_are_rejected() {
        let error = |bytes: &[u8]| {
            let message = |e: SceneError| e.to_string().split_once("a.jpg: ").unwrap().1.to_owned();
            let (size, rendered) = (of(bytes, read_size).map_err(message), of(bytes, read).map_err(message));
            let rendered = rendered.map(|_| ()).unwrap_err();
            assert_eq!(size.unwrap_err(), rendered, "of the size, too");
            rendered
        };
        let inks = error(include_bytes!("../../tests/jpeg/inks.jpg"));
        assert!(inks.contains("the JPEG file holds inks (CMYK) instead of light; export it as RGB"), "{inks}");
        let arithmetic = error(include_bytes!("../../tests/jpeg/arithmetic.jpg"));
        assert!(arithmetic.contains("cannot be read as JPEG (unsupported JPEG feature: "), "{arithmetic}");
        let between = error(include_bytes!("../../tests/jpeg/between.jpg"));
        assert!(
            between.contains("samples a component neither once nor most often, which is not read; export it again"),
            "{between}"
        );
        // The marker encodes the frame type; this changes a sequential frame to a lossless one.
        let mut lossless = WRITTEN[8].1.to_vec();
        let at = lossless.windows(2).position(|w| w == [0xff, 0xc0]).unwrap();
        lossless[at + 1] = 0xc3;
        assert!(error(&lossless).contains("the JPEG file is a lossless one, which is not read; export it as PNG"));
        let png = error(&[0x89, b'P', b'N', b'G', 13, 10, 26, 10]);
        assert!(
            png.contains("the file cannot be read as JPEG (") && png.ends_with("; copy or export it again"),
            "{png}"
        );
    }

    /// Compares the decoder with `djpeg`, at odd sizes. Covers all samplings, scans and restarts that `cjpeg` writes.
    /// Runs with `SGS_TEST_LONG` set if both programs are installed (Debian: `libjpeg-turbo-progs`). Also reports the
    /// results of the `image` crate's decoder.
    #[test]
    fn decoder_matches_libjpeg() {
        let there = Command::new("cjpeg").arg("-version").output().is_ok();
        if std::env::var_os("SGS_TEST_LONG").is_none() || !there {
            return println!("skipped: SGS_TEST_LONG is not set, or there is no cjpeg");
        }
        const SAMPLINGS: &str = "1x1 2x1 1x2 2x2 4x1 1x4 4x2 2x4 4x4 1x1,2x1,2x1 1x1,1x2,1x2 1x1,2x2,2x2 1x1,4x1,1x1 2x2,2x1,2x1 2x2,1x2,1x2 \
             2x2,2x2,1x1 2x1,2x1,1x1 2x1,1x2,1x1 1x2,1x2,1x1 2x1,2x1,2x1 1x2,1x2,1x2 1x3,1x1,1x1 3x1,1x1,1x1";
        let directory = tempfile::tempdir().unwrap();
        let path = |name: &str| directory.path().join(name);
        let run = |program: &str, options: &[&str], input: &str| {
            let out = Command::new(program).args(options).arg(path(input)).output().unwrap();
            out.status.success().then_some(out.stdout)
        };
        let (mut files, mut least, mut wrong, mut panics, mut refused) = (0, f64::INFINITY, 0, 0, 0);
        for (name, script) in [("apart", "0;1;2;"), ("two", "0;1 2;"), ("uneven", "0 1;2;")] {
            std::fs::write(path(name), script).unwrap();
        }
        let scripts = ["apart", "two", "uneven"].map(|name| path(name).display().to_string());
        let ways: Vec<Vec<&str>> = [vec![], vec!["-progressive"]]
            .into_iter()
            .chain(scripts.iter().map(|script| vec!["-scans", script]))
            .flat_map(|way| [way.clone(), [way, vec!["-restart", "1"]].concat()])
            .collect();
        for (width, height) in [(160, 120), (123, 77), (24, 16), (16, 16), (9, 7), (8, 8), (1, 1), (40, 3), (250, 9)] {
            let pixels = (0..height).flat_map(|y| (0..width).map(move |x| (f64::from(x), f64::from(y))));
            let wave = |a: f64, b: f64| (128.0 + 60.0 * a.sin() + 60.0 * b.cos()) as u8;
            let colors =
                pixels.flat_map(|(x, y)| [wave(x / 9.0, y / 7.0), wave(y / 11.0, x / 23.0), wave(x / 31.0, y / 5.0)]);
            let ppm = [format!("P6\n{width} {height}\n255\n").into_bytes(), colors.collect()].concat();
            std::fs::write(path("a.ppm"), ppm).unwrap();
            for (way, sampling) in ways.iter().flat_map(|way| SAMPLINGS.split_whitespace().map(move |s| (way, s))) {
                let options = [&["-quality", "92", "-sample", sampling][..], way].concat();
                let Some(written) = run("cjpeg", &options, "a.ppm") else { continue };
                std::fs::write(path("a.jpg"), written).unwrap();
                let truth = run("djpeg", &["-ppm"], "a.jpg").unwrap();
                let truth = &truth[truth.len() - 3 * (width * height) as usize..];
                let near = |found: &[f32]| {
                    assert_eq!(found.len(), truth.len());
                    let square = |(f, t): (&f32, &u8)| (f64::from(*f) - f64::from(*t) / 255.0).powi(2);
                    -10.0 * (found.iter().zip(truth).map(square).sum::<f64>() / truth.len() as f64).max(1e-10).log10()
                };
                let found = near(&read(&path("a.jpg")).unwrap().data);
                assert!(found > 49.0, "{width}×{height} {options:?}: {found:.1} dB");
                (files, least) = (files + 1, least.min(found));
                match std::panic::catch_unwind(|| ::image::open(path("a.jpg"))) {
                    Err(_) => panics += 1,
                    Ok(Err(_)) => refused += 1,
                    Ok(Ok(other)) if near(other.to_rgb32f().as_raw()) < 25.0 => wrong += 1,
                    Ok(Ok(_)) => {}
                }
            }
        }
        println!(
            "{files} files, within {least:.1} dB; by image: {wrong} below 25 dB, {panics} panics, {refused} refused"
        );
        assert!(files > 1000, "cjpeg wrote {files} files");
    }
}
