//! Simulated language-aligned features: class embeddings on a grid.
//!
//! Features are mixed at borders and have noise. Whole regions may have a wrong class.

use half::f16;

use crate::noise::value;
use crate::rng::{Rng, text_key};
use crate::scene::classes::CLASSES;
use crate::trace::film::Film;

/// Length of an embedding.
pub(crate) const DIM: usize = 512;
/// Side in pixels of a region that may have a wrong class.
///
/// The correlated noise of features varies over about three regions.
const REGION: usize = 8;

/// Returns one unit vector per class.
///
/// A label has the same vector in every scene, so features are comparable across scenes.
pub(crate) fn embeddings() -> Vec<Vec<f32>> {
    CLASSES
        .iter()
        .map(|label| {
            let mut rng = Rng::new(&[text_key(label)]);
            unit((0..DIM).map(|_| rng.normal()).collect())
        })
        .collect()
}

/// Feature map: height, width and values, cell by cell.
pub(crate) struct Features {
    /// Number of rows of cells.
    pub(crate) height: usize,
    /// Number of columns of cells.
    pub(crate) width: usize,
    /// `height × width ×` [`DIM`] values.
    pub(crate) values: Vec<f16>,
}

/// Parameters of a feature map.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Grid {
    /// Side of a cell in pixels.
    pub(crate) cell: usize,
    /// Fraction of the regions that have the class of another pixel of the view.
    pub(crate) wrong: f32,
}

/// Simulates the features of one view.
pub(crate) fn imitate(film: &Film, embeddings: &[Vec<f32>], grid: Grid, seed: u64, view: u64) -> Features {
    let (height, width) = (film.height.div_ceil(grid.cell), film.width.div_ceil(grid.cell));
    let classes = classes(film, grid.wrong, seed, view);
    let mut rng = Rng::new(&[seed, view, 31]);
    let salt = rng.next_u32();
    let mut values = Vec::with_capacity(height * width * DIM);
    for row in 0..height {
        for column in 0..width {
            let share = shares(film, &classes, grid.cell, row, column);
            let mut feature = vec![0.0; DIM];
            for (class, share) in share.iter().enumerate().filter(|(_, s)| **s > 0.0) {
                for (f, e) in feature.iter_mut().zip(&embeddings[class]) {
                    *f += share * e;
                }
            }
            let mut feature = unit(feature);
            // Half of the noise is shared with neighbors, as with features of large receptive fields.
            let place = glam::Vec2::new(column as f32, row as f32) * (grid.cell as f32 / REGION as f32) / 3.0;
            let scale = 1.0 / (DIM as f32).sqrt();
            for (k, f) in feature.iter_mut().enumerate() {
                let slow = (value(place, salt.wrapping_add(k as u32)) - 0.5) * 4.5;
                *f += scale * (0.5 * rng.normal() + 0.5 * slow);
            }
            values.extend(unit(feature).into_iter().map(f16::from_f32));
        }
    }
    Features { height, width, values }
}

/// Returns the class of every pixel, after replacing that of some regions.
///
/// The replacement is the class of another pixel of the view.
fn classes(film: &Film, wrong: f32, seed: u64, view: u64) -> Vec<usize> {
    let truth: Vec<usize> = film.features.iter().map(|f| f.class as usize).collect();
    let mut rng = Rng::new(&[seed, view, 32]);
    let across = film.width.div_ceil(REGION);
    let moved: Vec<Option<usize>> = (0..across * film.height.div_ceil(REGION))
        .map(|_| {
            // Both numbers are always drawn, so that a larger fraction makes the same regions wrong and adds others.
            let (chance, place) = (rng.uniform(), rng.index(truth.len()));
            (chance < wrong).then(|| truth[place])
        })
        .collect();
    let region = |i: usize| i / film.width / REGION * across + i % film.width / REGION;
    truth.iter().enumerate().map(|(i, class)| moved[region(i)].unwrap_or(*class)).collect()
}

/// Returns each class's fraction of a cell.
///
/// The counted area includes a margin of a quarter cell.
fn shares(film: &Film, classes: &[usize], cell: usize, row: usize, column: usize) -> Vec<f32> {
    let mut share = vec![0.0; CLASSES.len()];
    let span = |i: usize, limit: usize| {
        let from = (i * cell).saturating_sub(cell / 4);
        from..((i + 1) * cell + cell / 4).min(limit)
    };
    for y in span(row, film.height) {
        for x in span(column, film.width) {
            share[classes[y * film.width + x]] += 1.0;
        }
    }
    let total: f32 = share.iter().sum();
    share.iter_mut().for_each(|s| *s /= total.max(1.0));
    share
}

/// Scales a vector to unit length.
fn unit(mut v: Vec<f32>) -> Vec<f32> {
    let length = v.iter().map(|x| x * x).sum::<f32>().sqrt().max(1e-9);
    v.iter_mut().for_each(|x| *x /= length);
    v
}
