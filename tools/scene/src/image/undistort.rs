//! Removing lens distortion from an image.
//!
//! The undistorted image has the size, focal lengths and principal point of the distorted image, so the camera stays
//! the same. Values come from Catmull-Rom interpolation clamped to the range of the four nearest pixels. This is
//! sharper than linear interpolation and does not ring around light sources and windows. Colors must be linear.

use super::Image;
use crate::camera::{Camera, Distortion};

/// Returns the distorted position of the center of the ideal pixel `(x, y)`. The position is in pixels. The third value
/// is whether the distortion is one-to-one there.
fn source_of(camera: &Camera, lens: &Distortion, x: u32, y: u32) -> (f64, f64, bool) {
    let nx = (f64::from(x) + 0.5 - camera.cx) / camera.fx;
    let ny = (f64::from(y) + 0.5 - camera.cy) / camera.fy;
    let (dx, dy) = lens.distort(nx, ny);
    (dx * camera.fx + camera.cx, dy * camera.fy + camera.cy, lens.is_one_to_one_at(nx, ny))
}

/// Returns Catmull-Rom weights of the pixels at −1, 0, 1 and 2. `t` in `[0, 1]` is the position relative to the pixel
/// at 0.
fn cubic(t: f64) -> [f64; 4] {
    let (t2, t3) = (t * t, t * t * t);
    [0.5 * (-t + 2.0 * t2 - t3), 0.5 * (2.0 - 5.0 * t2 + 3.0 * t3), 0.5 * (t + 4.0 * t2 - 3.0 * t3), 0.5 * (t3 - t2)]
}

/// Returns the four pixel indices around a coordinate and their weights. Indices are clamped at the border.
fn taps(position: f64, size: u32) -> ([usize; 4], [f64; 4]) {
    let last = i64::from(size) - 1;
    // The clamp also handles coordinates that an extreme polynomial maps to infinity.
    let position = (position - 0.5).clamp(0.0, last as f64);
    let base = position.floor() as i64;
    let index = |offset: i64| (base + offset).clamp(0, last) as usize;
    ([index(-1), index(0), index(1), index(2)], cubic(position - base as f64))
}

/// Removes the distortion of `lens` from `image`. `camera` is the pinhole camera and has the size of the image.
///
/// Pixels outside the lens's field repeat the border; [`undistort_coverage`] marks them.
pub fn undistort(image: &Image, camera: &Camera, lens: &Distortion) -> Image {
    if lens.is_none() || image.check().is_err() {
        return image.clone();
    }
    let mut out = Image::new(image.width, image.height, image.channels);
    for y in 0..image.height {
        for x in 0..image.width {
            let (u, v, _) = source_of(camera, lens, x, y);
            let (columns, wx) = taps(u, image.width);
            let (rows, wy) = taps(v, image.height);
            for c in 0..image.channels as usize {
                let at = |i: usize, j: usize| image.pixel(columns[i] as u32, rows[j] as u32)[c];
                let mut sum = 0.0;
                for j in 0..4 {
                    for i in 0..4 {
                        sum += wx[i] * wy[j] * f64::from(at(i, j));
                    }
                }
                let near = [at(1, 1), at(2, 1), at(1, 2), at(2, 2)];
                let low = near.iter().copied().fold(f32::INFINITY, f32::min);
                let high = near.iter().copied().fold(f32::NEG_INFINITY, f32::max);
                out.pixel_mut(x, y)[c] = (sum as f32).max(low).min(high);
            }
        }
    }
    out
}

/// Returns the coverage of undistortion in one channel. The value is 1 where the lens captured the ideal pixel, and 0
/// where [`undistort`] repeats the border or the distortion folds.
pub fn undistort_coverage(camera: &Camera, lens: &Distortion) -> Image {
    let mut out = Image::new(camera.width, camera.height, 1);
    for y in 0..camera.height {
        for x in 0..camera.width {
            let (u, v, one_to_one) = source_of(camera, lens, x, y);
            let inside = u >= 0.0 && v >= 0.0 && u <= f64::from(camera.width) && v <= f64::from(camera.height);
            out.pixel_mut(x, y)[0] = f32::from(u8::from(inside && one_to_one));
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::{Projection, tests::camera};

    const LENS: Distortion = Distortion { k1: 0.12, k2: -0.08, p1: -0.004, p2: 0.003, ..Distortion::NONE };

    /// Returns a smooth pattern over ideal normalized coordinates.
    fn pattern(x: f64, y: f64) -> f64 {
        0.5 + 0.25 * (9.0 * x).sin() + 0.25 * (7.0 * y + 2.0 * x).cos()
    }

    /// Inverts the distortion by fixed-point iteration. The inverse is independent of the code under test.
    fn ideal(lens: &Distortion, dx: f64, dy: f64) -> (f64, f64) {
        let (mut x, mut y) = (dx, dy);
        for _ in 0..200 {
            let (u, v) = lens.distort(x, y);
            (x, y) = (x + dx - u, y + dy - v);
        }
        (x, y)
    }

    /// Returns the largest error after undistorting a rendered pattern. Compares the undistorted image with a direct
    /// rendering, away from the border.
    fn error_inside(lens_of_image: &Distortion, lens_removed: &Distortion) -> f32 {
        let camera = camera();
        let (mut seen, mut straight) = (Image::new(160, 120, 1), Image::new(160, 120, 1));
        for y in 0..120 {
            for x in 0..160 {
                let nx = (f64::from(x) + 0.5 - camera.cx) / camera.fx;
                let ny = (f64::from(y) + 0.5 - camera.cy) / camera.fy;
                let (ix, iy) = ideal(lens_of_image, nx, ny);
                seen.pixel_mut(x, y)[0] = pattern(ix, iy) as f32;
                straight.pixel_mut(x, y)[0] = pattern(nx, ny) as f32;
            }
        }
        let undistorted = undistort(&seen, &camera, lens_removed);
        let mut worst = 0.0_f32;
        for y in 8..112 {
            for x in 8..152 {
                worst = worst.max((undistorted.pixel(x, y)[0] - straight.pixel(x, y)[0]).abs());
            }
        }
        worst
    }

    #[test]
    fn undistortion_recovers_the_ideal_image() {
        let right = error_inside(&LENS, &LENS);
        assert!(right < 0.01, "{right}");
        // The test must detect a wrong sign and a missing correction.
        let negated = Distortion { k1: -0.12, k2: 0.08, p1: 0.004, p2: -0.003, ..Distortion::NONE };
        assert!(error_inside(&LENS, &negated) > 0.1);
        assert!(error_inside(&LENS, &Distortion::default()) > 0.05);
        let swapped = Distortion { p1: LENS.p2, p2: LENS.p1, ..LENS };
        assert!(error_inside(&LENS, &swapped) > 0.02);
    }

    #[test]
    fn undistortion_recovers_the_image_of_wide_lenses() {
        let none = Distortion::NONE;
        let equidistant = Distortion { projection: Projection::Equidistant, ..none };
        for lens in [
            Distortion { k1: 0.05, k2: -0.02, prism: [0.01, 0.0, -0.02, 0.0], p1: 0.003, ..equidistant },
            Distortion { k1: 0.1, k2: 0.02, k3: -0.01, rational: [0.2, 0.05, 0.01], ..none },
            Distortion {
                k1: 0.05,
                higher: [-0.02, 0.01],
                prism: [0.01, 0.02, -0.02, 0.01],
                after_radial: true,
                ..equidistant
            },
            Distortion { projection: Projection::FieldOfView(0.9), ..none },
            Distortion { projection: Projection::Division(-0.2), ..none },
            Distortion { projection: Projection::Unified { alpha: 0.6, beta: 1.1 }, ..none },
        ] {
            let right = error_inside(&lens, &lens);
            assert!(right < 0.02, "{lens:?}: {right}");
            assert!(
                error_inside(&lens, &Distortion { projection: none.projection, rational: [0.0; 3], ..lens }) > 0.05
            );
        }
    }

    #[test]
    fn ideal_lens_is_the_identity() {
        let image = Image::from_data(2, 1, 1, vec![0.25, 0.5]).unwrap();
        assert_eq!(undistort(&image, &camera().scaled(2, 1), &Distortion::default()), image);
    }

    #[test]
    fn interpolation_does_not_ring() {
        let mut image = Image::new(160, 120, 1);
        for (i, v) in image.data.iter_mut().enumerate() {
            *v = if i % 160 < 20 { 0.0 } else { 1.0 };
        }
        let out = undistort(&image, &camera(), &LENS);
        assert!(out.data.iter().all(|v| (0.0..=1.0).contains(v)));
        assert!(out.data.iter().any(|v| (0.1..=0.9).contains(v)));
    }

    #[test]
    fn coverage_marks_pixels_outside_the_lens_field() {
        let camera = camera();
        let pincushion = Distortion { k1: 0.3, ..Default::default() };
        let cover = undistort_coverage(&camera, &pincushion);
        assert_eq!(cover.pixel(0, 0), [0.0]);
        assert_eq!(cover.pixel(80, 60), [1.0]);
        let barrel = Distortion { k1: -0.1, ..Default::default() };
        assert!(undistort_coverage(&camera, &barrel).data.iter().all(|&v| v == 1.0));
        let folding = Distortion { k1: -0.6, ..Default::default() };
        assert_eq!(undistort_coverage(&camera, &folding).pixel(0, 0), [0.0]);
    }

    #[test]
    fn extreme_coefficients_do_not_sample_outside_the_image() {
        let wild = Distortion { k4: 1e300, k1: -1e300, ..Default::default() };
        let out = undistort(&Image::new(160, 120, 3), &camera(), &wild);
        assert!(out.data.iter().all(|&v| v == 0.0));
    }
}
