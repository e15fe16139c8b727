//! EXIF data of photographs: orientation, focal length and camera.
//!
//! EXIF data is a TIFF file: directories of entries, of which the first has the orientation and the camera, and points
//! to the directory of the exposure. Only entries that [`Exif`] needs are read. Damaged entries count as absent.

/// Diagonal of a 35 mm frame in millimeters; equivalent focal lengths refer to it.
const DIAGONAL: f64 = 43.266_615_305_567_87;

/// EXIF data of a photograph.
#[derive(Clone, Debug, PartialEq)]
pub struct Exif {
    /// Orientation of the stored pixels, 1 (upright) to 8.
    pub orientation: u16,
    /// Maker, model and lens; empty if unknown.
    pub camera: String,
    /// Focal length in millimeters of a 35 mm camera with the same diagonal view.
    equivalent: Option<f64>,
    /// Focal length in pixels of the sensor, and the longer side of its image.
    sensor: Option<(f64, Option<f64>)>,
}

impl Default for Exif {
    fn default() -> Self {
        Self { orientation: 1, camera: String::new(), equivalent: None, sensor: None }
    }
}

impl Exif {
    /// Parses EXIF data, with or without the prefix that some files give it. Invalid data yields the default.
    pub fn parse(bytes: &[u8]) -> Self {
        let bytes = bytes.strip_prefix(b"Exif\0\0").unwrap_or(bytes);
        let Some((tiff, main)) = Tiff::open(bytes) else { return Self::default() };
        let whole = |v: f64| (v.fract() == 0.0 && (1.0..=8.0).contains(&v)).then_some(v as u16);
        let positive = |v: &f64| v.is_finite() && *v > 0.0;
        let exposure = tiff.number(main, 0x8769).map(|at| at as usize);
        let of = |tag| exposure.and_then(|at| tiff.number(at, tag)).filter(positive);
        let words = [tiff.text(main, 0x010f), tiff.text(main, 0x0110), exposure.and_then(|at| tiff.text(at, 0xa434))];
        let words: Vec<String> = words.into_iter().flatten().filter(|w| !w.is_empty()).collect();
        let unit = match of(0xa210) {
            Some(3.0) => 10.0,
            Some(4.0) => 1.0,
            _ => 25.4,
        };
        let side = of(0xa002).map(|w| of(0xa003).map_or(w, |h| w.max(h)));
        let sensor = of(0x920a).zip(of(0xa20e)).map(|(focal, resolution)| (focal * resolution / unit, side));
        Self {
            orientation: tiff.number(main, 0x0112).and_then(whole).unwrap_or(1),
            camera: words.join(" "),
            equivalent: of(0xa405),
            sensor,
        }
    }

    /// Returns the focal length in pixels of an image of this size; `None` if it is unknown or cannot be right.
    pub fn focal_pixels(&self, width: u32, height: u32) -> Option<f64> {
        let (w, h) = (f64::from(width), f64::from(height));
        let equivalent = self.equivalent.map(|focal| focal / DIAGONAL * w.hypot(h));
        let sensor = || self.sensor.map(|(focal, side)| focal * side.map_or(1.0, |side| w.max(h) / side));
        let focal = equivalent.or_else(sensor)?;
        // Fields of view from 3 to 150 degrees.
        (w.max(h) * 0.13..=w.max(h) * 20.0).contains(&focal).then_some(focal)
    }
}

/// TIFF structure of EXIF data.
struct Tiff<'a> {
    bytes: &'a [u8],
    little: bool,
}

impl<'a> Tiff<'a> {
    /// Returns the structure and the position of its first directory.
    fn open(bytes: &'a [u8]) -> Option<(Self, usize)> {
        let little = match bytes.get(..2)? {
            b"II" => true,
            b"MM" => false,
            _ => return None,
        };
        let tiff = Self { bytes, little };
        let main = tiff.long(4)?;
        Some((tiff, main as usize))
    }

    fn short(&self, at: usize) -> Option<u16> {
        let bytes: [u8; 2] = self.bytes.get(at..at.checked_add(2)?)?.try_into().ok()?;
        Some(if self.little { u16::from_le_bytes(bytes) } else { u16::from_be_bytes(bytes) })
    }

    fn long(&self, at: usize) -> Option<u32> {
        let bytes: [u8; 4] = self.bytes.get(at..at.checked_add(4)?)?.try_into().ok()?;
        Some(if self.little { u32::from_le_bytes(bytes) } else { u32::from_be_bytes(bytes) })
    }

    /// Returns the kind of an entry's values, their number, and the first position.
    fn entry(&self, directory: usize, tag: u16) -> Option<(u16, usize, usize)> {
        let entries = usize::from(self.short(directory)?);
        let at = |i: usize| directory.checked_add(2 + 12 * i);
        let found = (0..entries).map_while(at).find(|at| self.short(*at) == Some(tag))?;
        let (kind, count) = (self.short(found.checked_add(2)?)?, self.long(found.checked_add(4)?)? as usize);
        let size = match kind {
            2 => 1,
            3 => 2,
            4 => 4,
            5 => 8,
            _ => return None,
        };
        let place = found.checked_add(8)?;
        let inside = count.checked_mul(size)? <= 4;
        Some((kind, count, if inside { place } else { self.long(place)? as usize }))
    }

    /// Returns the first number of an entry.
    fn number(&self, directory: usize, tag: u16) -> Option<f64> {
        match self.entry(directory, tag)? {
            (3, _, at) => self.short(at).map(f64::from),
            (4, _, at) => self.long(at).map(f64::from),
            (5, _, at) => Some(f64::from(self.long(at)?) / f64::from(self.long(at.checked_add(4)?)?)),
            _ => None,
        }
    }

    /// Returns the text of an entry.
    fn text(&self, directory: usize, tag: u16) -> Option<String> {
        let (2, count, at) = self.entry(directory, tag)? else { return None };
        let bytes = self.bytes.get(at..at.checked_add(count)?)?;
        let text = String::from_utf8_lossy(bytes.split(|b| *b == 0).next().unwrap_or_default()).into_owned();
        Some(text.trim().to_owned())
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    /// Builds EXIF data with an orientation, a camera, and entries of the exposure.
    pub(crate) fn exif(orientation: u16, camera: &str, exposure: &[(u16, [u32; 2])]) -> Vec<u8> {
        let text = format!("{camera}\0");
        let entry = |tag: u16, kind: u16, count: u32, value: u32| {
            let halves = [tag.to_le_bytes(), kind.to_le_bytes()].concat();
            [halves, count.to_le_bytes().to_vec(), value.to_le_bytes().to_vec()].concat()
        };
        let (second, names) = (8 + 2 + 3 * 12 + 4, 8 + 2 + 3 * 12 + 4 + 2 + 12 * exposure.len() as u32 + 4);
        let numbers = names + text.len() as u32;
        let mut bytes = [b"II*\0\x08\0\0\0".as_slice(), &3_u16.to_le_bytes()].concat();
        let short = <[u8; 4]>::try_from(format!("{text:\0<4}").as_bytes()).map(u32::from_le_bytes);
        bytes.extend(entry(0x0110, 2, text.len() as u32, short.unwrap_or(names)));
        bytes.extend(entry(0x0112, 3, 1, orientation.into()));
        bytes.extend(entry(0x8769, 4, 1, second));
        bytes.extend([0; 4]);
        bytes.extend((exposure.len() as u16).to_le_bytes());
        exposure.iter().zip(0..).for_each(|((tag, _), i)| bytes.extend(entry(*tag, 5, 1, numbers + 8 * i)));
        bytes.extend([0; 4]);
        bytes.extend(text.as_bytes());
        exposure.iter().flat_map(|(_, value)| value).for_each(|v| bytes.extend(v.to_le_bytes()));
        bytes
    }

    #[test]
    fn orientations_are_read_in_both_byte_orders() {
        let little = [b"II*\0\x08\0\0\0\x01\0\x12\x01\x03\0\x01\0\0\0\x06\0\0\0".as_slice(), &[0; 4]].concat();
        let big = [b"MM\0*\0\0\0\x08\0\x01\x01\x12\0\x03\0\0\0\x01\0\x08\0\0".as_slice(), &[0; 4]].concat();
        assert_eq!((Exif::parse(&little).orientation, Exif::parse(&big).orientation), (6, 8));
        for end in 0..20 {
            assert_eq!(Exif::parse(&little[..end]), Exif::default());
        }
        assert_eq!(Exif::parse(b"II*\0\xff\xff\xff\xff\x01\0"), Exif::default());
    }

    #[test]
    fn focal_lengths_are_in_pixels_of_the_image() {
        // A 24 mm equivalent on 3:2 film covers 36 mm with its width.
        let wide = Exif::parse(&exif(1, "Maker Phone", &[(0xa405, [24, 1])]));
        assert_eq!(wide.camera, "Maker Phone");
        assert!((wide.focal_pixels(3600, 2400).unwrap() - 2400.0).abs() < 1e-6);
        assert!((wide.focal_pixels(240, 360).unwrap() - 240.0).abs() < 1e-6);
        // 5 mm on a sensor of 1000 pixels per millimeter, resized to half.
        let resolution = [(0x920a, [50, 10]), (0xa20e, [25_400, 1]), (0xa002, [4000, 1])];
        let prefixed = [b"Exif\0\0".as_slice(), &exif(3, "", &resolution)].concat();
        let sensor = Exif::parse(&prefixed);
        assert_eq!((sensor.orientation, sensor.camera.as_str()), (3, ""));
        assert!((sensor.focal_pixels(2000, 1500).unwrap() - 2500.0).abs() < 1e-9);
        for wrong in [[0, 1], [1, 0], [0, 0], [1, 1], [90_000, 1]] {
            assert_eq!(Exif::parse(&exif(1, "", &[(0xa405, wrong)])).focal_pixels(100, 80), None, "{wrong:?}");
        }
        assert_eq!(Exif::default().focal_pixels(100, 80), None);
    }

    #[test]
    fn truncated_data_never_panics() {
        let whole = exif(6, "Maker", &[(0xa405, [28, 1]), (0x920a, [4, 1])]);
        for end in 0..whole.len() {
            let _ = Exif::parse(&whole[..end]);
        }
    }
}
