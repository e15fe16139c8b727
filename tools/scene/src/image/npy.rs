//! NumPy's `.npy` files, the format of array priors.
//!
//! Supports versions 1 to 3, C order and little-endian numbers. The array's bytes stay unconverted until a caller
//! requests a number type, because feature maps are large and mostly half precision.

use std::path::{Path, PathBuf};

use half::f16;

use super::{Image, file};
use crate::error::{Result, SceneError, io_error};

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    F16,
    F32,
    F64,
    U8,
    U16,
    I32,
    I64,
}

impl Kind {
    fn size(self) -> usize {
        match self {
            Self::U8 => 1,
            Self::F16 | Self::U16 => 2,
            Self::F32 | Self::I32 => 4,
            Self::F64 | Self::I64 => 8,
        }
    }
}

/// Array in C order: the last index varies fastest.
#[derive(Clone, Debug, PartialEq)]
pub struct NpyArray {
    /// Length along each axis.
    pub shape: Vec<usize>,
    path: PathBuf,
    kind: Kind,
    bytes: Vec<u8>,
}

impl NpyArray {
    /// Reads a file.
    pub fn read(path: &Path) -> Result<Self> {
        let bytes = std::fs::read(path).map_err(io_error("read", path))?;
        let fail = |problem: String| SceneError::image(path, problem);
        let (header, start) = split_header(&bytes)
            .ok_or_else(|| fail("the file is not a complete .npy file; save it again with numpy.save".into()))?;
        let descr = value_of(header, "descr").unwrap_or_default().trim_matches(['\'', '"']);
        let kind = match descr.trim_start_matches(['<', '|', '=']) {
            "f2" => Kind::F16,
            "f4" => Kind::F32,
            "f8" => Kind::F64,
            "u1" | "b1" => Kind::U8,
            "u2" => Kind::U16,
            "i4" => Kind::I32,
            "i8" => Kind::I64,
            _ => {
                let problem = format!(
                    "the array holds \"{descr}\"; save it as float16, float32, float64, uint8, uint16, int32 or int64"
                );
                return Err(fail(problem));
            }
        };
        if value_of(header, "fortran_order") != Some("False") {
            return Err(fail("the array is in Fortran order; save it with numpy.ascontiguousarray".into()));
        }
        let shape = value_of(header, "shape").and_then(parse_shape);
        let shape = shape.ok_or_else(|| fail("the header has no readable shape; save the array again".into()))?;
        let size = shape.iter().try_fold(kind.size(), |size, &n| size.checked_mul(n));
        let found = bytes.len() - start;
        if size != Some(found) {
            let problem = format!(
                "the array of shape {shape:?} and type \"{descr}\" does not fit the {found} bytes that follow the header; \
                 save it again"
            );
            return Err(fail(problem));
        }
        Ok(Self { shape, path: path.to_path_buf(), kind, bytes: bytes[start..].to_vec() })
    }

    /// Returns the values as 32-bit floats.
    pub fn to_f32(&self) -> Vec<f32> {
        let b = &self.bytes;
        match self.kind {
            Kind::F16 => words::<2>(b).map(|w| f16::from_le_bytes(w).to_f32()).collect(),
            Kind::F32 => words::<4>(b).map(f32::from_le_bytes).collect(),
            Kind::F64 => words::<8>(b).map(|w| f64::from_le_bytes(w) as f32).collect(),
            Kind::U8 => b.iter().map(|&v| f32::from(v)).collect(),
            Kind::U16 => words::<2>(b).map(|w| f32::from(u16::from_le_bytes(w))).collect(),
            Kind::I32 => words::<4>(b).map(|w| i32::from_le_bytes(w) as f32).collect(),
            Kind::I64 => words::<8>(b).map(|w| i64::from_le_bytes(w) as f32).collect(),
        }
    }

    /// Returns the values in half precision; exact if they are stored that way.
    pub fn to_f16(&self) -> Vec<f16> {
        match self.kind {
            Kind::F16 => words::<2>(&self.bytes).map(f16::from_le_bytes).collect(),
            _ => self.to_f32().into_iter().map(f16::from_f32).collect(),
        }
    }

    /// Converts the array to an image. Accepts height×width, height×width×channels, or channels×height×width. The last
    /// applies if the first axis is at most 4 and the second is longer.
    pub fn to_image(&self) -> Result<Image> {
        let short = |n: usize| n <= 4;
        let values = self.to_f32();
        let (height, width, channels, planar) = match self.shape[..] {
            [h, w] => (h, w, 1, false),
            [c, h, w] if short(c) && !short(w) => (h, w, c, true),
            [h, w, c] => (h, w, c, false),
            _ => {
                let problem = format!("the array has the shape {:?}; a map is height×width×channels", self.shape);
                return Err(SceneError::image(&self.path, problem));
            }
        };
        let side = |n: usize| u32::try_from(n).unwrap_or(u32::MAX);
        file::check_size(&self.path, side(width), side(height))?;
        if channels == 0 {
            return Err(SceneError::image(&self.path, "the array has no channels"));
        }
        let data = if planar {
            let pixels = width * height;
            (0..pixels).flat_map(|i| (0..channels).map(move |c| c * pixels + i)).map(|at| values[at]).collect()
        } else {
            values
        };
        Ok(Image { width: side(width), height: side(height), channels: side(channels), data })
    }

    /// Returns the lengths of the three axes. Fails if the array does not have exactly three axes or if an axis is
    /// empty.
    pub(crate) fn dimensions3(&self) -> Result<[usize; 3]> {
        match self.shape[..] {
            [a, b, c] if a > 0 && b > 0 && c > 0 => Ok([a, b, c]),
            _ => {
                let problem = format!("the array has the shape {:?}; it must have three axes, none empty", self.shape);
                Err(SceneError::image(&self.path, problem))
            }
        }
    }
}

fn words<const N: usize>(bytes: &[u8]) -> impl Iterator<Item = [u8; N]> {
    bytes.chunks_exact(N).map(|chunk| {
        let mut word = [0; N];
        word.copy_from_slice(chunk);
        word
    })
}

/// Returns the header's text and the offset of the data.
fn split_header(bytes: &[u8]) -> Option<(&str, usize)> {
    let rest = bytes.strip_prefix(b"\x93NUMPY")?;
    let (prefix, length) = match rest.first()? {
        1 => (10, usize::from(u16::from_le_bytes([*rest.get(2)?, *rest.get(3)?]))),
        2 | 3 => (12, u32::from_le_bytes([*rest.get(2)?, *rest.get(3)?, *rest.get(4)?, *rest.get(5)?]) as usize),
        _ => return None,
    };
    let end = length.checked_add(prefix)?;
    let text = std::str::from_utf8(bytes.get(prefix..end)?).ok()?;
    Some((text, end))
}

/// Returns the text of a value in the header's dictionary. The dictionary is a Python literal with three known keys.
fn value_of<'a>(header: &'a str, key: &str) -> Option<&'a str> {
    let at = header.find(&format!("'{key}'"))? + key.len() + 2;
    let value = header[at..].trim_start().strip_prefix(':')?.trim_start();
    let end = match value.chars().next()? {
        '(' => value.find(')')? + 1,
        quote @ ('\'' | '"') => value[1..].find(quote)? + 2,
        _ => value.find([',', '}'])?,
    };
    Some(value[..end].trim())
}

fn parse_shape(text: &str) -> Option<Vec<usize>> {
    let inner = text.strip_prefix('(')?.strip_suffix(')')?;
    inner.split(',').map(str::trim).filter(|n| !n.is_empty()).map(|n| n.parse().ok()).collect()
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    /// Returns a version 1 file with NumPy's layout.
    pub(crate) fn npy(descr: &str, shape: &str, data: &[u8]) -> Vec<u8> {
        let mut header = format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': {shape}, }}");
        while (header.len() + 11) % 64 != 0 {
            header.push(' ');
        }
        header.push('\n');
        let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
        bytes.extend((header.len() as u16).to_le_bytes());
        bytes.extend(header.as_bytes());
        bytes.extend(data);
        bytes
    }

    fn read(bytes: &[u8]) -> Result<NpyArray> {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("a.npy");
        std::fs::write(&path, bytes).unwrap();
        NpyArray::read(&path)
    }

    #[test]
    fn number_types_are_converted() {
        let floats: Vec<u8> = [1.5_f32, -2.0].iter().flat_map(|v| v.to_le_bytes()).collect();
        let array = read(&npy("<f4", "(2,)", &floats)).unwrap();
        assert_eq!((array.shape.as_slice(), array.to_f32()), (&[2][..], vec![1.5, -2.0]));
        let halves: Vec<u8> = [1.5_f32, -2.0].iter().flat_map(|&v| f16::from_f32(v).to_le_bytes()).collect();
        let array = read(&npy("<f2", "(1, 1, 2)", &halves)).unwrap();
        assert_eq!(array.to_f16(), [f16::from_f32(1.5), f16::from_f32(-2.0)]);
        assert_eq!(array.dimensions3().unwrap(), [1, 1, 2]);
        let doubles: Vec<u8> = [0.25_f64].iter().flat_map(|v| v.to_le_bytes()).collect();
        assert_eq!(read(&npy("<f8", "(1,)", &doubles)).unwrap().to_f32(), [0.25]);
        assert_eq!(read(&npy("|u1", "(2,)", &[7, 255])).unwrap().to_f32(), [7.0, 255.0]);
        assert_eq!(read(&npy("<i8", "()", &(-3_i64).to_le_bytes())).unwrap().to_f32(), [-3.0]);
    }

    #[test]
    fn maps_may_be_interleaved_or_planar() {
        let bytes: Vec<u8> = (0..30).map(|v| v as u8).collect();
        let image = |shape: &str, n: usize| read(&npy("|u1", shape, &bytes[..n])).unwrap().to_image();
        let interleaved = image("(2, 5, 3)", 30).unwrap();
        assert_eq!((interleaved.width, interleaved.height, interleaved.channels), (5, 2, 3));
        assert_eq!(interleaved.pixel(1, 0), [3.0, 4.0, 5.0]);
        let planar = image("(3, 2, 5)", 30).unwrap();
        assert_eq!((planar.width, planar.height, planar.channels), (5, 2, 3));
        assert_eq!(planar.pixel(1, 0), [1.0, 11.0, 21.0]);
        assert_eq!(image("(5, 6)", 30).unwrap().channels, 1);
        assert!(image("(30,)", 30).unwrap_err().to_string().contains("the shape [30]; a map is height×width"));
        assert!(image("(0, 5, 3)", 0).unwrap_err().to_string().contains("5×0 pixels, which is empty"));
        assert!(image("(5, 6, 0)", 0).unwrap_err().to_string().contains("no channels"));
    }

    #[test]
    fn each_error_has_its_message() {
        let fail = |bytes: &[u8]| read(bytes).unwrap_err().to_string();
        assert!(fail(b"hello").contains("not a complete .npy file"));
        assert!(fail(&npy(">f4", "(1,)", &[0; 4])).contains("the array holds \">f4\""));
        assert!(fail(&npy("<f4", "(2, 3)", &[0; 20])).contains("[2, 3] and type \"<f4\" does not fit the 20 bytes"));
        assert!(fail(&npy("<f4", "(18446744073709551615, 18446744073709551615)", &[])).contains("does not fit"));
        assert!(fail(&npy("<f4", "(-1,)", &[])).contains("no readable shape"));
        let text = String::from_utf8_lossy(&npy("<f4", "(1,)", &[0; 4])[10..]).replace("False", "True ");
        let mut fortran = npy("<f4", "(1,)", &[0; 4])[..10].to_vec();
        fortran.extend(text.as_bytes());
        assert!(fail(&fortran).contains("Fortran order"));
        let flat = read(&npy("<f4", "(1,)", &[0; 4])).unwrap();
        assert!(flat.dimensions3().unwrap_err().to_string().contains("the shape [1]; it must have three axes"));
    }

    #[test]
    fn truncated_files_are_errors() {
        let whole = npy("<f4", "(2, 1, 1)", &[0; 8]);
        assert!(read(&whole).is_ok());
        for length in 0..whole.len() {
            assert!(read(&whole[..length]).is_err(), "{length}");
        }
    }
}
