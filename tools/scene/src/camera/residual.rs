//! Lens distortion that training learned.

use super::Camera;

/// Radial distortion that a calibration left and training learned.
///
/// It comes before the calibrated one. All lengths are in focal lengths, those of each axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Residual {
    /// Learned principal point, relative to the calibrated one.
    pub center: [f64; 2],
    /// Half the diagonal of the image.
    pub half_diagonal: [f64; 2],
    /// Shift of a point at half the diagonal from the principal point.
    ///
    /// It is relative to this distance, and grows with its third power.
    pub radial: f64,
}

impl Residual {
    /// Makes the residual of a camera's images.
    pub fn of(camera: &Camera, center: [f64; 2], radial: f64) -> Residual {
        let half = 0.5 * f64::from(camera.width).hypot(f64::from(camera.height));
        Residual { center, half_diagonal: [half / camera.fx, half / camera.fy], radial }
    }

    /// Returns the distorted position, and whether the distortion folds there.
    pub(super) fn distort(&self, x: f64, y: f64) -> ([f64; 2], bool) {
        let Residual { center, half_diagonal, radial } = *self;
        let away = [x - center[0], y - center[1]];
        let q = (away[0] / half_diagonal[0]).powi(2) + (away[1] / half_diagonal[1]).powi(2);
        let factor = 1.0 + radial * q;
        let folds = 1.0 + 3.0 * radial * q <= 0.0;
        ([0, 1].map(|i| center[i] + factor * away[i]), folds)
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Distortion, tests::camera};
    use super::*;

    /// The shift is that of the pixel, whatever the focal lengths are.
    #[test]
    fn corners_move_by_their_share() {
        let (camera, center) = (camera(), [0.03, -0.02]);
        let half = 0.5 * f64::from(camera.width).hypot(f64::from(camera.height));
        let lens = Distortion { residual: Some(Residual::of(&camera, center, 0.05)), ..Distortion::NONE };
        for (share, angle) in [(1.0, 0.3_f64), (0.5, 2.0), (0.0, 0.0)] {
            let offset = [share * half * angle.cos(), share * half * angle.sin()];
            let (x, y) = (center[0] + offset[0] / camera.fx, center[1] + offset[1] / camera.fy);
            let (u, v) = lens.distort(x, y);
            let grown = 1.0 + 0.05 * share * share;
            let found = [(u - center[0]) * camera.fx, (v - center[1]) * camera.fy];
            assert!((0..2).all(|i| (found[i] - grown * offset[i]).abs() < 1e-9), "{found:?}");
        }
        assert_eq!(lens.given(), Distortion::NONE);
    }

    /// `r (1 - 0.1 r²)` grows until r² = 10 / 3.
    #[test]
    fn folds_are_found() {
        let camera = camera();
        let half = 0.5 * f64::from(camera.width).hypot(f64::from(camera.height)) / camera.fx;
        let lens = Distortion { residual: Some(Residual::of(&camera, [0.0; 2], -0.1)), ..Distortion::NONE };
        assert!(lens.is_one_to_one_at(1.82 * half, 0.0) && !lens.is_one_to_one_at(1.83 * half, 0.0));
    }
}
