//! Simulated region masks: instance ids with ragged borders set to 0 and small regions removed.

use crate::noise::cell;
use crate::rng::Rng;
use crate::trace::film::Film;

/// Smallest retained region, as a fraction of the pixels: 14 pixels of a 160×120 image.
const SMALLEST: f32 = 14.0 / 19_200.0;

/// Returns the region ids of one view; 0 marks pixels of no region.
pub(crate) fn imitate(film: &Film, seed: u64, view: u64) -> Vec<u16> {
    let (w, h) = (film.width as i32, film.height as i32);
    let salt = Rng::new(&[seed, view, 21]).next_u32();
    let id = |x: i32, y: i32| film.features[(y.clamp(0, h - 1) * w + x.clamp(0, w - 1)) as usize].instance;
    let mut mask: Vec<u16> = (0..h)
        .flat_map(|y| (0..w).map(move |x| (x, y)))
        .map(|(x, y)| {
            let own = id(x, y);
            // The width of the removed border varies along it, in steps of a few pixels.
            let ragged = cell(glam::IVec2::new(x / 3, y / 3), salt);
            let reach = if ragged < 0.35 {
                0
            } else if ragged < 0.85 {
                1
            } else {
                2
            };
            let clean = (-reach..=reach).all(|d| id(x + d, y) == own && id(x, y + d) == own);
            if clean { own } else { 0 }
        })
        .collect();
    let largest = mask.iter().copied().max().unwrap_or(0) as usize;
    let mut sizes = vec![0usize; largest + 1];
    for region in &mask {
        sizes[*region as usize] += 1;
    }
    let smallest = (SMALLEST * mask.len() as f32).ceil() as usize;
    for region in &mut mask {
        if sizes[*region as usize] < smallest {
            *region = 0;
        }
    }
    mask
}
