//! EXR files: linear values with any number of named channels.
//!
//! After reading, colors come first (`R G B A`), independent of the order in the file. Other channels follow by name.
//! Files are written as 32-bit float with lossless compression. Only the first layer of a file is read.

use std::fs::File;
use std::io;
use std::path::Path;

use ::exr::image::{AnyChannel, AnyChannels, Encoding, FlatSamples, Layer, read::read};
use ::exr::meta::MetaData;
use ::exr::meta::attribute::Text;
use ::exr::meta::header::{ImageAttributes, LayerAttributes};
use ::exr::prelude::{ReadChannels, ReadLayers, SmallVec, WritableImage};

use super::{Image, blocks, dwa, file};
use crate::atomic::atomic_write;
use crate::error::{Result, SceneError, io_error};

/// First layer of an EXR file.
#[derive(Clone, Debug, PartialEq)]
pub struct ExrImage {
    /// Values, with channels in the order of `names`.
    pub image: Image,
    /// Channel names: `R G B A` first where present, then the others in alphabetical order.
    pub names: Vec<String>,
}

pub(super) fn unreadable(path: &Path, error: &::exr::error::Error) -> SceneError {
    SceneError::image(path, format!("the file cannot be read as EXR ({error}); copy or export it again"))
}

/// Returns the sort rank of a channel; colors come before all others.
fn rank(name: &str) -> usize {
    ["R", "G", "B", "A"].iter().position(|&c| c == name).unwrap_or(4)
}

/// Largest number of pixel bytes per byte of the file. The best EXR compression is deflate of three in four bytes.
const RATIO: u64 = 1400;

/// Properties from the headers.
struct Headers {
    /// Width and height in pixels.
    size: (u32, u32),
    channels: usize,
    /// Whether blocks state the sizes of their parts ([`dwa`]).
    sized: bool,
    /// Whether blocks may be longer than the file ([`blocks`]).
    long: bool,
}

/// Reads the headers and checks that the file is long enough for its image size.
fn header(path: &Path) -> Result<Headers> {
    let file = File::open(path).map_err(io_error("read", path))?;
    let length = file.metadata().map_err(io_error("read", path))?.len();
    let meta = MetaData::read_from_unbuffered(file, false).map_err(|e| unreadable(path, &e))?;
    let Some(layer) = meta.headers.first() else {
        return Err(SceneError::image(path, "the EXR file has no layer"));
    };
    if layer.deep {
        return Err(SceneError::image(path, "the EXR file holds deep data; flatten it first"));
    }
    let window = layer.shared_attributes.display_window;
    let (data_at, data_size) = (layer.own_attributes.layer_position, layer.layer_size);
    if window.size != data_size || window.position != data_at {
        let problem = format!(
            "the data window ({}×{} at {}, {}) is not the display window ({}×{} at {}, {}); save the image uncropped",
            data_size.0,
            data_size.1,
            data_at.0,
            data_at.1,
            window.size.0,
            window.size.1,
            window.position.0,
            window.position.1
        );
        return Err(SceneError::image(path, problem));
    }
    let side = |n: usize| u32::try_from(n).unwrap_or(u32::MAX);
    let (width, height) = (side(data_size.0), side(data_size.1));
    file::check_size(path, width, height)?;
    let bytes: u64 = layer.channels.list.iter().map(|c| c.sample_type.bytes_per_sample() as u64).sum();
    let pixels = u64::from(width) * u64::from(height);
    let held = length.saturating_mul(RATIO);
    file::check_held(path, (width, height), pixels.saturating_mul(bytes), held)?;
    Ok(Headers {
        size: (width, height),
        channels: layer.channels.list.len(),
        sized: meta.headers.iter().any(dwa::applies),
        long: meta.headers.iter().any(|h| blocks::applies(h, held)),
    })
}

/// Returns the width and height from the header.
pub(super) fn read_size(path: &Path) -> Result<(u32, u32)> {
    header(path).map(|headers| headers.size)
}

/// Reads all channels of the first layer as 32-bit floats.
pub fn read_exr(path: &Path) -> Result<ExrImage> {
    let Headers { size: (width, height), channels, sized, long } = header(path)?;
    if u64::from(width) * u64::from(height) * channels as u64 > file::MAX_PIXELS * 4 {
        let problem = format!("{width}×{height} pixels with {channels} channels are more than an image may have");
        return Err(SceneError::image(path, problem));
    }
    if long {
        blocks::check(path)?;
    }
    if sized {
        dwa::check(path)?;
    }
    let file = File::open(path).map_err(io_error("read", path))?;
    let layer = read()
        .no_deep_data()
        .largest_resolution_level()
        .all_channels()
        .first_valid_layer()
        .all_attributes()
        // Scenes are read with one thread per image; nested threads only add cost.
        .non_parallel()
        .from_buffered(io::BufReader::new(file))
        .map_err(|e| unreadable(path, &e))?
        .layer_data;

    let mut list: Vec<_> = layer.channel_data.list.iter().map(|c| (c.name.to_string(), &c.sample_data)).collect();
    list.sort_by(|a, b| (rank(&a.0), &a.0).cmp(&(rank(&b.0), &b.0)));
    let channels = list.len();
    let mut image = Image::new(width, height, channels as u32);
    for (c, (name, samples)) in list.iter().enumerate() {
        if samples.len() != image.pixels() {
            let problem = format!("the channel {name} is subsampled; save all channels at full size");
            return Err(SceneError::image(path, problem));
        }
        for (value, pixel) in samples.values_as_f32().zip(image.data.chunks_exact_mut(channels)) {
            pixel[c] = value;
        }
    }
    if image.data.is_empty() {
        return Err(SceneError::image(path, "the EXR file has no channels"));
    }
    Ok(ExrImage { image, names: list.into_iter().map(|(name, _)| name).collect() })
}

/// Writes 32-bit float channels, with one name for each channel of the image.
///
/// The usual names are `R G B` or `R G B A` for colors, `X Y Z` for vectors, and `Y` for a single channel. Values are
/// written unchanged.
pub fn write_exr(path: &Path, image: &Image, names: &[&str]) -> Result<()> {
    let layer = layer(path, image, names, LayerAttributes::default())?;
    let file = ::exr::image::Image::from_layer(layer);
    // A single thread keeps the block order deterministic, so equal images produce equal files.
    atomic_write(path, |out| file.write().non_parallel().to_buffered(out).map_err(unwritten))
}

/// Writes images of one size as named layers.
///
/// Layers have the channels `R G B` as 32-bit floats. [`read_exr`] reads the first. Values are written unchanged.
pub fn write_exr_layers(path: &Path, images: &[(&str, Image)]) -> Result<()> {
    let mut layers = SmallVec::new();
    for (i, (name, image)) in images.iter().enumerate() {
        let text = Text::new_or_none(name).filter(|_| !name.is_empty() && !images[..i].iter().any(|(n, _)| n == name));
        let Some(text) = text else {
            return Err(SceneError::image(path, format!("{name:?} cannot name a layer, or names two of them")));
        };
        if (image.width, image.height) != (images[0].1.width, images[0].1.height) {
            return Err(SceneError::image(path, format!("the layer {name} differs from the first in size")));
        }
        layers.push(layer(path, image, &["R", "G", "B"], LayerAttributes::named(text))?);
    }
    let Some((_, first)) = images.first() else {
        return Err(SceneError::image(path, "an EXR file needs a layer"));
    };
    let size = (first.width as usize, first.height as usize);
    let file = ::exr::image::Image::from_layers(ImageAttributes::with_size(size), layers);
    atomic_write(path, |out| file.write().non_parallel().to_buffered(out).map_err(unwritten))
}

/// Returns whether a name can be that of a layer: not empty, and of Latin letters.
pub fn names_exr_layer(name: &str) -> bool {
    !name.is_empty() && Text::new_or_none(name).is_some()
}

fn unwritten(error: ::exr::error::Error) -> io::Error {
    match error {
        ::exr::error::Error::Io(error) => error,
        other => io::Error::other(other.to_string()),
    }
}

/// Returns a layer with one name for each channel of the image.
fn layer(
    path: &Path,
    image: &Image,
    names: &[&str],
    attributes: LayerAttributes,
) -> Result<Layer<AnyChannels<FlatSamples>>> {
    image.check()?;
    if names.len() != image.channels as usize {
        let problem = format!("{} names were given for {} channels", names.len(), image.channels);
        return Err(SceneError::image(path, problem));
    }
    let mut channels = SmallVec::new();
    for (c, &name) in names.iter().enumerate() {
        let text = Text::new_or_none(name).filter(|_| !name.is_empty() && !names[..c].contains(&name));
        let Some(text) = text else {
            return Err(SceneError::image(path, format!("{name:?} cannot name a channel, or names two of them")));
        };
        let values = image.data.iter().skip(c).step_by(names.len()).copied().collect();
        channels.push(AnyChannel::new(text, FlatSamples::F32(values)));
    }
    let size = (image.width as usize, image.height as usize);
    Ok(Layer::new(size, attributes, Encoding::SMALL_FAST_LOSSLESS, AnyChannels::sort(channels)))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample(width: u32, height: u32, channels: u32) -> Image {
        let mut image = Image::new(width, height, channels);
        for (i, v) in image.data.iter_mut().enumerate() {
            *v = (i as f32 * 0.37 - 3.0) * 10.0_f32.powi(i as i32 % 9 - 4);
        }
        image
    }

    #[test]
    fn floats_round_trip_bit_exactly() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("a.exr");
        for names in [&["Y"][..], &["R", "G", "B"], &["R", "G", "B", "A"], &["R", "G", "B", "A", "depth.Z", "x", "y"]] {
            let mut image = sample(7, 5, names.len() as u32);
            image.data[3] = f32::INFINITY;
            image.data[4] = f32::MIN_POSITIVE / 8.0;
            write_exr(&path, &image, names).unwrap();
            assert_eq!(read_size(&path).unwrap(), (7, 5));
            let back = read_exr(&path).unwrap();
            assert_eq!(back.names, names);
            assert_eq!(back.image, image);
        }
    }

    #[test]
    fn layers_have_their_names_and_values() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("a.exr");
        let images = [("window 1", sample(7, 5, 3)), ("lämp", Image { data: vec![2.0; 105], ..sample(7, 5, 3) })];
        write_exr_layers(&path, &images).unwrap();
        assert_eq!(read_exr(&path).unwrap().image, images[0].1, "the first layer is that of other readers");
        let all = read().no_deep_data().largest_resolution_level().all_channels().all_layers().all_attributes();
        let file = all.from_file(&path).unwrap();
        for (layer, (name, image)) in file.layer_data.iter().zip(&images) {
            assert_eq!(layer.attributes.layer_name.as_ref().unwrap().to_string(), *name);
            for (c, channel) in ["B", "G", "R"].iter().zip(&layer.channel_data.list).enumerate() {
                assert_eq!(channel.1.name.to_string(), *channel.0);
                let values: Vec<f32> = channel.1.sample_data.values_as_f32().collect();
                assert!(values.iter().zip(image.data.chunks(3)).all(|(v, pixel)| *v == pixel[2 - c]));
            }
        }
        assert_eq!(file.layer_data.len(), 2);
        let fail = |images: &[(&str, Image)]| write_exr_layers(&path, images).unwrap_err().to_string();
        assert!(fail(&[]).contains("needs a layer"));
        assert!(fail(&[("a", sample(2, 2, 3)), ("a", sample(2, 2, 3))]).contains("\"a\" cannot name a layer"));
        assert!(fail(&[("a", sample(2, 2, 3)), ("b", sample(2, 3, 3))]).contains("differs from the first in size"));
        assert!(fail(&[("深", sample(2, 2, 3))]).contains("cannot name a layer") && !names_exr_layer("深"));
        assert!(names_exr_layer("window 1") && !names_exr_layer(""));
    }

    #[test]
    fn color_channels_come_first() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("a.exr");
        let image = Image::from_data(1, 1, 5, vec![1.0, 2.0, 3.0, 4.0, 5.0]).unwrap();
        write_exr(&path, &image, &["A", "Z", "B", "G", "R"]).unwrap();
        let back = read_exr(&path).unwrap();
        assert_eq!(back.names, ["R", "G", "B", "A", "Z"]);
        assert_eq!(back.image.data, [5.0, 4.0, 3.0, 1.0, 2.0]);
    }

    #[test]
    fn invalid_channel_names_are_rejected() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("a.exr");
        let fail = |names: &[&str]| write_exr(&path, &sample(2, 2, 3), names).unwrap_err().to_string();
        assert!(fail(&["R"]).ends_with("1 names were given for 3 channels"));
        assert!(fail(&["R", "G", "R"]).contains("\"R\" cannot name a channel, or names two"));
        assert!(fail(&["R", "G", ""]).contains("\"\" cannot name a channel"));
        assert!(fail(&["R", "G", "深"]).contains("cannot name a channel"));
        assert!(!path.exists());
    }

    #[test]
    fn truncated_or_damaged_files_never_panic() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("a.exr");
        write_exr(&path, &sample(9, 40, 3), &["R", "G", "B"]).unwrap();
        let whole = std::fs::read(&path).unwrap();
        for length in 0..whole.len() {
            std::fs::write(&path, &whole[..length]).unwrap();
            let error = read_exr(&path).unwrap_err().to_string();
            assert!(error.starts_with(&path.display().to_string()), "{error}");
        }
        for i in 0..whole.len() {
            for flip in [0x01, 0x80, 0xff] {
                let mut damaged = whole.clone();
                damaged[i] ^= flip;
                std::fs::write(&path, &damaged).unwrap();
                let _ = (read_exr(&path), read_size(&path));
            }
        }
    }
}
