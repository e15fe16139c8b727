//! Small binary files.

use image::codecs::jpeg::JpegEncoder;
use image::codecs::png::PngEncoder;
use image::{ExtendedColorType, ImageEncoder, ImageFormat, RgbImage};
use std::io::Cursor;

/// Returns bytes in which all values are about equally frequent.
fn pattern(count: usize) -> Vec<u8> {
    (0..count).map(|i| (i * 37 % 251) as u8).collect()
}

fn encoded(width: u32, height: u32, color: ExtendedColorType) -> Vec<u8> {
    let mut out = Vec::new();
    let bytes = pattern((u64::from(width) * u64::from(height) * u64::from(color.bits_per_pixel()) / 8) as usize);
    PngEncoder::new(&mut out).write_image(&bytes, width, height, color).expect("an image is written");
    out
}

/// Returns a color image in a format.
pub(super) fn photograph(format: ImageFormat) -> Vec<u8> {
    let mut out = Cursor::new(Vec::new());
    let image = RgbImage::from_raw(8, 6, pattern(8 * 6 * 3)).expect("the size fits");
    image.write_to(&mut out, format).expect("an image is written");
    out.into_inner()
}

/// Returns a color image.
pub(crate) fn png(width: u32, height: u32) -> Vec<u8> {
    encoded(width, height, ExtendedColorType::Rgb8)
}

pub(super) fn rgba(width: u32, height: u32) -> Vec<u8> {
    encoded(width, height, ExtendedColorType::Rgba8)
}

pub(super) fn gray(width: u32, height: u32) -> Vec<u8> {
    encoded(width, height, ExtendedColorType::L8)
}

pub(super) fn gray16(width: u32, height: u32) -> Vec<u8> {
    encoded(width, height, ExtendedColorType::L16)
}

pub(super) fn gray_alpha(width: u32, height: u32) -> Vec<u8> {
    encoded(width, height, ExtendedColorType::La8)
}

pub(super) fn jpeg(width: u32, height: u32) -> Vec<u8> {
    let mut out = Vec::new();
    let bytes = pattern((width * height * 3) as usize);
    let encoder = JpegEncoder::new_with_quality(&mut out, 60);
    encoder.write_image(&bytes, width, height, ExtendedColorType::Rgb8).expect("an image is written");
    out
}

pub(super) fn jpeg_gray(width: u32, height: u32) -> Vec<u8> {
    let mut out = Vec::new();
    let encoder = JpegEncoder::new_with_quality(&mut out, 90);
    let bytes = pattern((width * height) as usize);
    encoder.write_image(&bytes, width, height, ExtendedColorType::L8).expect("an image is written");
    out
}

/// Returns an image with these channels; values lie between 0.1 and 1.1.
pub(super) fn exr(width: usize, height: usize, names: &[&str], compressed: bool) -> Vec<u8> {
    let encoding =
        if compressed { exr::prelude::Encoding::SMALL_LOSSLESS } else { exr::prelude::Encoding::UNCOMPRESSED };
    exr_as(width, height, names, encoding, false)
}

pub(super) fn exr_as(
    width: usize,
    height: usize,
    names: &[&str],
    encoding: exr::prelude::Encoding,
    halves: bool,
) -> Vec<u8> {
    use exr::prelude::*;
    let values = |k: usize| (0..width * height).map(move |i| 0.1 + ((i * 7 + 3 * k) % 11) as f32 * 0.1);
    let samples = |k: usize| match halves {
        true => FlatSamples::F16(values(k).map(f16::from_f32).collect()),
        false => FlatSamples::F32(values(k).collect()),
    };
    let channels = names.iter().enumerate().map(|(k, name)| AnyChannel::new(*name, samples(k)));
    let layer =
        Layer::new((width, height), LayerAttributes::default(), encoding, AnyChannels::sort(channels.collect()));
    let mut out = Cursor::new(Vec::new());
    Image::from_layer(layer).write().non_parallel().to_buffered(&mut out).expect("an image is written");
    out.into_inner()
}

/// Returns an environment map.
pub(crate) fn exr_sky() -> Vec<u8> {
    exr(8, 4, &["R", "G", "B"], true)
}

/// Returns a NumPy array of this type, with `size` bytes per element.
pub(super) fn npy(kind: &str, shape: &[usize], size: usize) -> Vec<u8> {
    let axes: String = shape.iter().map(|n| format!("{n}, ")).collect();
    let mut header = format!("{{'descr': '{kind}', 'fortran_order': False, 'shape': ({axes}), }}");
    while (header.len() + 11) % 16 != 0 {
        header.push(' ');
    }
    header.push('\n');
    let mut out = b"\x93NUMPY\x01\x00".to_vec();
    out.extend((header.len() as u16).to_le_bytes());
    out.extend(header.bytes());
    let count: usize = shape.iter().product();
    for i in 0..count {
        let v = 0.25 + (i % 3) as f32 * 0.25;
        match (kind, size) {
            ("<f2", _) => out.extend([0x00, 0x38 + (i % 3) as u8]),
            ("<f4", _) => out.extend(v.to_le_bytes()),
            ("<f8", _) => out.extend(f64::from(v).to_le_bytes()),
            _ => out.extend((i as u64 % 5).to_le_bytes().iter().take(size)),
        }
    }
    out
}

/// Writer of little-endian values.
struct Words(Vec<u8>);

impl Words {
    fn u32(mut self, v: u32) -> Self {
        self.0.extend(v.to_le_bytes());
        self
    }

    fn u64(mut self, v: u64) -> Self {
        self.0.extend(v.to_le_bytes());
        self
    }

    fn f64(mut self, all: &[f64]) -> Self {
        all.iter().for_each(|v| self.0.extend(v.to_le_bytes()));
        self
    }

    fn bytes(mut self, all: &[u8]) -> Self {
        self.0.extend(all);
        self
    }
}

pub(super) fn colmap_cameras() -> Vec<u8> {
    let camera = |w: Words, id, model, parameters: &[f64]| w.u32(id).u32(model).u64(8).u64(6).f64(parameters);
    let w = camera(Words(Vec::new()).u64(3), 1, 1, &[7.0, 7.0, 4.0, 3.0]);
    let w = camera(w, 2, 4, &[7.0, 7.0, 4.0, 3.0, 0.01, 0.0, 0.001, 0.0]);
    camera(w, 3, 2, &[7.0, 4.0, 3.0, 0.1]).0
}

/// Number of a camera model, and its parameters.
type Lens<'a> = (u32, &'a [f64]);

/// Returns cameras whose lenses are not polynomials of the tangent. Images have the first two of each file.
pub(super) fn colmap_wide_cameras() -> Vec<(&'static str, Vec<u8>)> {
    let mut rad_tan = [0.01; 16];
    rad_tan[..4].copy_from_slice(&[7.0, 7.0, 4.0, 3.0]);
    let thin_prism = [7.0, 7.0, 4.0, 3.0, 0.1, 0.0, 0.001, 0.0, 0.01, 0.0, 0.001, 0.002];
    let files: [(&str, [Lens; 2]); 4] = [
        ("fov.bin", [(7, &[7.0, 7.0, 4.0, 3.0, 0.9]), (16, &[7.0, 7.0, 4.0, 3.0, 0.6, 1.1])]),
        ("division.bin", [(12, &[7.0, 4.0, 3.0, -0.2]), (13, &[7.0, 7.0, 4.0, 3.0, 0.3])]),
        ("fisheye.bin", [(11, &rad_tan), (14, &[7.0, 4.0, 3.0])]),
        ("polynomials.bin", [(5, &[7.0, 7.0, 4.0, 3.0, 0.1, 0.01, 0.0, 0.0]), (10, &thin_prism)]),
    ];
    let file = |cameras: [Lens; 2]| {
        let start = Words(Vec::new()).u64(2);
        let all = (1..).zip(cameras);
        all.fold(start, |w, (id, (model, p))| w.u32(id).u32(model).u64(8).u64(6).f64(p)).0
    };
    files.map(|(name, cameras)| (name, file(cameras))).into()
}

pub(super) fn colmap_images() -> Vec<u8> {
    let image = |w: Words, id, q: &[f64], name: &[u8], camera| w.u32(id).f64(q).u32(camera).bytes(name).bytes(&[0]);
    let w = image(Words(Vec::new()).u64(2), 1, &[1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 2.0], b"000.png", 1);
    let w = w.u64(1).f64(&[1.5, 2.5]).u64(u64::MAX);
    image(w, 2, &[0.96, 0.0, 0.28, 0.0, 0.5, 0.0, 2.0], b"001.png", 2).u64(0).0
}

pub(super) fn colmap_rigs() -> Vec<u8> {
    let w = Words(Vec::new()).u64(2).u32(1).u32(2).u32(0).u32(1).u32(0).u32(2).bytes(&[1]);
    w.f64(&[0.96, 0.0, 0.28, 0.0, 0.5, 0.0, 0.0]).u32(2).u32(1).u32(1).u32(4).0
}

pub(super) fn colmap_frames() -> Vec<u8> {
    let w = Words(Vec::new()).u64(1).u32(1).u32(1).f64(&[1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 2.0]).u32(3);
    w.u32(0).u32(1).u64(1).u32(0).u32(2).u64(2).u32(1).u32(3).u64(7).0
}

/// Returns EXIF data with an orientation and a focal length.
pub(super) fn exif() -> Vec<u8> {
    let entry = |w: Words, tag: u32, kind: u32, count, value| w.u32(kind << 16 | tag).u32(count).u32(value);
    let w = Words(b"II*\0\x08\0\0\0\x03\0".to_vec());
    let w = entry(w, 0x0110, 2, 4, u32::from_le_bytes(*b"Cam\0"));
    let w = entry(w, 0x0112, 3, 1, 6);
    let w = entry(w, 0x8769, 4, 1, 50).u32(0).bytes(&[3, 0]);
    let w = entry(w, 0xa405, 3, 1, 26);
    let w = entry(w, 0x920a, 5, 1, 92);
    entry(w, 0xa20e, 5, 1, 100).u32(0).u32(50).u32(10).u32(25_400).u32(10).0
}

pub(super) fn colmap_points() -> Vec<u8> {
    let point = |w: Words, id, place: &[f64]| w.u64(id).f64(place).bytes(&[255, 0, 10]).f64(&[0.5]);
    let w = point(Words(Vec::new()).u64(2), 1, &[0.1, 0.2, 0.3]).u64(2).u32(1).u32(0).u32(2).u32(1);
    point(w, 2, &[-0.1, 0.5, 1.0]).u64(0).0
}

/// Returns a binary PLY file of two Gaussians, in either byte order.
///
/// `names`: properties in addition to the standard ones.
pub(super) fn splats(degree: usize, big: bool, names: &[&str]) -> Vec<u8> {
    let mut all: Vec<String> = "x y z nx ny nz f_dc_0 f_dc_1 f_dc_2".split(' ').map(String::from).collect();
    all.extend((0..[0, 9, 24, 45][degree]).map(|i| format!("f_rest_{i}")));
    all.extend("opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3".split(' ').map(String::from));
    all.extend(names.iter().map(|n| (*n).to_owned()));
    let order = if big { "big" } else { "little" };
    let mut out = format!("ply\nformat binary_{order}_endian 1.0\nelement vertex 2\n").into_bytes();
    all.iter().for_each(|name| out.extend(format!("property float {name}\n").bytes()));
    out.extend(b"end_header\n");
    for i in 0..2 * all.len() {
        let v = 0.5 + 0.01 * i as f32;
        out.extend(if big { v.to_be_bytes() } else { v.to_le_bytes() });
    }
    out
}
