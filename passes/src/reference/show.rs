//! Reference of `show`: an image with gain, encoding, marks and text. Values are in double precision, before rounding
//! to bytes.

use super::srgb::{decode, encode};
use crate::splat::{Letters, MARK_HOLLOW, MARK_RINGED, Mark, ShownKind};

/// Text over an image.
#[derive(Clone, Copy, Debug)]
pub struct Text<'a> {
    /// Character codes, a byte per cell, line by line.
    pub cells: &'a [u8],
    /// Cells of a line.
    pub columns: usize,
    /// Screen pixels along a pixel of a glyph.
    pub size: usize,
    /// Available glyphs.
    pub letters: Letters,
    /// Pixels of the glyphs.
    pub font: &'a [u8],
}

fn mixed(a: [f64; 3], b: [f64; 3], share: f64) -> [f64; 3] {
    [0, 1, 2].map(|c| a[c] + (b[c] - a[c]) * share)
}

fn edge(v: f64) -> f64 {
    v.clamp(0.0, 1.0)
}

fn marked(v: [f64; 3], mark: &Mark, [x, y]: [f64; 2]) -> [f64; 3] {
    let at = mark.at.map(f64::from);
    let away = (x - at[0]).hypot(y - at[1]) - f64::from(mark.radius);
    let disc = edge(0.5 - away);
    let inside = if mark.style & MARK_HOLLOW != 0 { disc - edge(-2.5 - away) } else { disc };
    let band = |outer: f64, inner: f64| {
        if mark.style & MARK_RINGED != 0 { edge(outer - away) - edge(inner - away) } else { 0.0 }
    };
    let v = mixed(v, mark.color.map(f64::from), inside);
    let v = mixed(v, [0.05; 3], disc - edge(-1.0 - away));
    mixed(mixed(v, [0.05; 3], band(4.5, 3.5)), [1.0; 3], band(3.5, 1.5))
}

impl Text<'_> {
    /// Returns the ink at a pixel, or `None` outside the glyphs' cells.
    fn ink(&self, [x, y]: [usize; 2]) -> Option<f64> {
        let [width, height] = self.letters.cell.map(|c| c as usize);
        let place = [x / (width * self.size), y / (height * self.size)];
        if place[0] >= self.columns {
            return None;
        }
        let cell = u32::from(*self.cells.get(place[1] * self.columns + place[0])?);
        let letter = cell.checked_sub(self.letters.first).filter(|l| *l < self.letters.count)? as usize;
        let dot = [x / self.size % width, y / self.size % height];
        Some(f64::from(self.font[(letter * height + dot[1]) * width + dot[0]]) / 255.0)
    }
}

/// Returns the color of every pixel, from 0 to 1, of an image `width` pixels wide.
pub fn show(
    image: &[[f64; 3]],
    width: usize,
    kind: ShownKind,
    gain: f64,
    marks: &[Mark],
    text: Option<Text<'_>>,
) -> Vec<[f64; 3]> {
    let pixel = |(i, texel): (usize, &[f64; 3])| {
        let v = texel.map(|v| match kind {
            ShownKind::Encoded if gain == 1.0 => v,
            ShownKind::Encoded => encode(decode(edge(v)) * gain),
            ShownKind::Linear => encode(v * gain),
            ShownKind::Values => v * gain,
            ShownKind::Directions => 0.5 * v + 0.5,
        });
        let at = [i % width, i / width];
        let center = at.map(|c| c as f64 + 0.5);
        let v = marks.iter().fold(v.map(edge), |v, mark| marked(v, mark, center));
        match text.as_ref().and_then(|text| text.ink(at)) {
            Some(ink) => mixed(v.map(|v| 0.35 * v), [0.95; 3], ink),
            None => v,
        }
    };
    image.iter().enumerate().map(pixel).collect()
}
