//! Stream of binary PGM and PPM images, as ffmpeg writes them to a pipe.

use sgs_scene::{Image, MAX_IMAGE_SIDE};
use std::io::{self, Read};

/// Image of 8-bit values.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Pnm {
    pub(crate) width: u32,
    pub(crate) height: u32,
    pub(crate) channels: u32,
    pub(crate) data: Vec<u8>,
}

impl Pnm {
    /// Reads the next image of a stream; `None` at its end.
    pub(crate) fn read(stream: &mut impl Read) -> io::Result<Option<Self>> {
        let wrong = || io::Error::new(io::ErrorKind::InvalidData, "the frames are no PGM or PPM images of 8 bits");
        let mut first = [0];
        if stream.read(&mut first)? == 0 {
            return Ok(None);
        }
        let mut kind = [0];
        stream.read_exact(&mut kind)?;
        let channels = match &[first[0], kind[0]] {
            b"P5" => 1,
            b"P6" => 3,
            _ => return Err(wrong()),
        };
        let [width, height, most] = [number(stream)?, number(stream)?, number(stream)?];
        let sides = [width, height].iter().all(|side| (1..=MAX_IMAGE_SIDE).contains(side));
        if !sides || most != 255 {
            return Err(wrong());
        }
        let mut data = vec![0; width as usize * height as usize * channels as usize];
        stream.read_exact(&mut data)?;
        Ok(Some(Self { width, height, channels, data }))
    }

    /// Converts to an image of values from 0 to 1.
    pub(crate) fn image(&self) -> Image {
        let data = self.data.iter().map(|v| f32::from(*v) / 255.0).collect();
        Image { width: self.width, height: self.height, channels: self.channels, data }
    }
}

/// Reads a number, white space before it, and one character after it.
fn number(stream: &mut impl Read) -> io::Result<u32> {
    let mut value: Option<u32> = None;
    loop {
        let mut byte = [0];
        stream.read_exact(&mut byte)?;
        match (byte[0], value) {
            (digit @ b'0'..=b'9', old) => {
                value = Some(old.unwrap_or(0).saturating_mul(10).saturating_add(u32::from(digit - b'0')));
            }
            (_, Some(value)) => return Ok(value),
            (byte, None) if byte.is_ascii_whitespace() => {}
            _ => return Err(io::Error::new(io::ErrorKind::InvalidData, "the header of a frame is damaged")),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn streams_hold_several_images() {
        let mut stream = b"P5\n3 2\n255\n\x00\x01\x02\x03\x04\xffP6 1 1 255 abc".as_slice();
        let gray = Pnm::read(&mut stream).unwrap().unwrap();
        assert_eq!(
            (gray.width, gray.height, gray.channels, gray.data.as_slice()),
            (3, 2, 1, &[0, 1, 2, 3, 4, 255][..])
        );
        assert_eq!(gray.image().data[5], 1.0);
        let color = Pnm::read(&mut stream).unwrap().unwrap();
        assert_eq!((color.channels, color.data.as_slice()), (3, b"abc".as_slice()));
        assert_eq!(Pnm::read(&mut stream).unwrap(), None);
    }

    #[test]
    fn damaged_streams_are_refused() {
        for wrong in [
            "P",
            "P4\n1 1\n255\na",
            "P5\n0 1\n255\na",
            "P5\n1 1\n65535\naa",
            "P5\n99999999999 1\n255\na",
            "P5\n2 2\n255\nabc",
            "P5 x",
        ] {
            assert!(Pnm::read(&mut wrong.as_bytes()).is_err(), "{wrong:?}");
        }
    }
}
