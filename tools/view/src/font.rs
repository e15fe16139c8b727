//! Bitmap font, and text lines as cells of a display.

use noto_sans_mono_bitmap::{FontWeight, RasterHeight, get_raster, get_raster_width};
use sgs_engine::Device;
use sgs_passes::pipeline::{DisplayRoom, Font};
use sgs_passes::splat::Letters;

const HEIGHT: RasterHeight = RasterHeight::Size16;
const FIRST: u8 = b' ';
const LAST: u8 = b'~';

/// Returns the available letters: printable ASCII.
pub fn letters() -> Letters {
    let width = get_raster_width(FontWeight::Regular, HEIGHT);
    let cell = [width as u32, HEIGHT.val() as u32];
    Letters { cell, first: u32::from(FIRST), count: u32::from(LAST - FIRST + 1) }
}

/// Uploads the font to the device.
pub fn font(device: &Device) -> sgs_engine::Result<Font> {
    let letters = letters();
    let mut pixels = Vec::with_capacity(letters.bytes() as usize);
    for letter in FIRST..=LAST {
        match get_raster(char::from(letter), FontWeight::Regular, HEIGHT) {
            Some(raster) => pixels.extend_from_slice(raster.pixels()),
            None => pixels.resize(pixels.len() + (letters.cell[0] * letters.cell[1]) as usize, 0),
        }
    }
    Font::new(device, letters, &pixels)
}

/// Text cells of a window, filled line by line without allocation.
pub struct Page {
    cells: Vec<u8>,
    columns: usize,
    row: usize,
}

impl Page {
    /// Creates cells for the display's capacity.
    pub fn new(room: DisplayRoom) -> Page {
        Page { cells: vec![0; (room.columns * room.rows) as usize], columns: room.columns as usize, row: 0 }
    }

    /// Clears all cells and restarts at the top line.
    pub fn clear(&mut self) {
        self.cells.fill(0);
        self.row = 0;
    }

    /// Writes a line with a margin.
    ///
    /// Truncates overlong lines. Unknown characters become question marks.
    pub fn line(&mut self, text: std::fmt::Arguments<'_>) {
        let first = self.row * self.columns;
        let Some(row) = self.cells.get_mut(first..first + self.columns) else { return };
        let mut line = Line { row, at: 0 };
        // Writing to a line never fails.
        let _ = std::fmt::Write::write_fmt(&mut line, format_args!(" {text} "));
        self.row += 1;
    }

    /// Returns the cells.
    pub fn cells(&self) -> &[u8] {
        &self.cells
    }
}

struct Line<'a> {
    row: &'a mut [u8],
    at: usize,
}

impl std::fmt::Write for Line<'_> {
    fn write_str(&mut self, text: &str) -> std::fmt::Result {
        for letter in text.chars() {
            let Some(cell) = self.row.get_mut(self.at) else { break };
            let known = u8::try_from(letter).ok().filter(|l| (FIRST..=LAST).contains(l));
            *cell = known.unwrap_or(b'?');
            self.at += 1;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn long_lines_are_truncated_and_unknown_letters_replaced() {
        let mut page = Page::new(DisplayRoom { columns: 6, rows: 2, marks: 0 });
        page.line(format_args!("a{}", "é~"));
        page.line(format_args!("abcdefgh"));
        page.line(format_args!("too low"));
        assert_eq!(page.cells(), b" a?~ \0 abcde");
        page.clear();
        page.line(format_args!("b"));
        assert_eq!(page.cells(), b" b \0\0\0\0\0\0\0\0\0");
    }

    #[test]
    fn every_letter_has_pixels() {
        let letters = letters();
        assert_eq!((letters.count, letters.cell[1]), (95, 16));
        for letter in FIRST + 1..=LAST {
            let raster = get_raster(char::from(letter), FontWeight::Regular, HEIGHT).expect("a letter");
            assert_eq!([raster.width() as u32, raster.height() as u32], letters.cell);
            assert!(raster.pixels().iter().any(|p| *p > 100), "{letter}");
        }
    }
}
