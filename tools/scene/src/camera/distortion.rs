//! Lens distortion of OpenCV and COLMAP.
//!
//! Maps ideal normalized coordinates (`x/z`, `y/z`) to distorted ones. The radial term is the polynomial `1 + k1 r² +
//! k2 r⁴ + k3 r⁶ + k4 r⁸`. `k4` follows nerfstudio; OpenCV's rational model has its last three coefficients in
//! [`Distortion::rational`]. The tangential term has the coefficients `p1` and `p2`, the thin prism `sx1` and `sy1`. A
//! fisheye lens first replaces the radius by the angle to the axis. Only this direction is needed: undistortion samples
//! the distorted image at the position of each ideal pixel.

/// Distortion coefficients; all zero for an ideal lens.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Distortion {
    /// Radial coefficient of r².
    pub k1: f64,
    /// Radial coefficient of r⁴.
    pub k2: f64,
    /// Radial coefficient of r⁶.
    pub k3: f64,
    /// Radial coefficient of r⁸.
    pub k4: f64,
    /// First tangential coefficient.
    pub p1: f64,
    /// Second tangential coefficient.
    pub p2: f64,
    /// Coefficients of r², r⁴ and r⁶ in the divisor of the radial term: OpenCV's k4, k5 and k6.
    pub rational: [f64; 3],
    /// Thin-prism coefficients of r², horizontal and vertical.
    pub prism: [f64; 2],
    /// Whether the coefficients apply to angles instead of tangents.
    pub fisheye: bool,
}

impl Default for Distortion {
    fn default() -> Self {
        Self::NONE
    }
}

impl Distortion {
    /// Ideal lens.
    pub const NONE: Self = Self {
        k1: 0.0,
        k2: 0.0,
        k3: 0.0,
        k4: 0.0,
        p1: 0.0,
        p2: 0.0,
        rational: [0.0; 3],
        prism: [0.0; 2],
        fisheye: false,
    };

    /// Returns whether the lens is ideal, that is, all coefficients are zero.
    pub fn is_none(&self) -> bool {
        *self == Self::NONE
    }

    /// Returns whether all coefficients are finite.
    pub fn is_finite(&self) -> bool {
        let each = [self.k1, self.k2, self.k3, self.k4, self.p1, self.p2];
        each.iter().chain(&self.rational).chain(&self.prism).all(|k| k.is_finite())
    }

    /// Returns the distorted position of the ideal normalized point `(x, y)`.
    pub fn distort(&self, x: f64, y: f64) -> (f64, f64) {
        let (x, y) = self.bent(x, y);
        let r2 = x * x + y * y;
        let (radial, _) = self.radial(r2);
        (
            x * radial + 2.0 * self.p1 * x * y + self.p2 * (r2 + 2.0 * x * x) + self.prism[0] * r2,
            y * radial + self.p1 * (r2 + 2.0 * y * y) + 2.0 * self.p2 * x * y + self.prism[1] * r2,
        )
    }

    /// Returns whether the distortion is one-to-one at `(x, y)`. Fitted polynomials fold back outside the calibrated
    /// field, where they would show a mirrored part of the image.
    pub fn is_one_to_one_at(&self, x: f64, y: f64) -> bool {
        // The angle grows with its tangent, so that a fisheye lens folds only where its polynomial does.
        let (x, y) = self.bent(x, y);
        let r2 = x * x + y * y;
        let (radial, slope) = self.radial(r2);
        let [sx, sy] = self.prism;
        let xx = radial + 2.0 * x * x * slope + 2.0 * self.p1 * y + 6.0 * self.p2 * x + 2.0 * sx * x;
        let yy = radial + 2.0 * y * y * slope + 6.0 * self.p1 * y + 2.0 * self.p2 * x + 2.0 * sy * y;
        let common = 2.0 * x * y * slope + 2.0 * self.p1 * x + 2.0 * self.p2 * y;
        let (xy, yx) = (common + 2.0 * sx * y, common + 2.0 * sy * x);
        // The radius must also grow along the ray: two simultaneous folds leave the determinant positive.
        xx * yy - xy * yx > 0.0 && radial + 2.0 * r2 * slope > 0.0
    }

    /// Returns the point whose radius a fisheye lens replaces by the angle.
    fn bent(&self, x: f64, y: f64) -> (f64, f64) {
        let r = x.hypot(y);
        if !self.fisheye || r < 1e-9 {
            return (x, y);
        }
        let scale = r.atan() / r;
        (x * scale, y * scale)
    }

    /// Returns the radial factor and its derivative with respect to r².
    fn radial(&self, r2: f64) -> (f64, f64) {
        let value = 1.0 + r2 * (self.k1 + r2 * (self.k2 + r2 * (self.k3 + r2 * self.k4)));
        let slope = self.k1 + r2 * (2.0 * self.k2 + r2 * (3.0 * self.k3 + r2 * 4.0 * self.k4));
        if self.rational == [0.0; 3] {
            return (value, slope);
        }
        let [k4, k5, k6] = self.rational;
        let divisor = 1.0 + r2 * (k4 + r2 * (k5 + r2 * k6));
        let divisor_slope = k4 + r2 * (2.0 * k5 + r2 * 3.0 * k6);
        (value / divisor, (slope * divisor - value * divisor_slope) / (divisor * divisor))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LENS: Distortion = Distortion {
        k1: 0.0578421,
        k2: -0.0805099,
        k3: 0.01,
        k4: -0.002,
        p1: -0.000980296,
        p2: 0.00015575,
        ..Distortion::NONE
    };

    #[test]
    fn ideal_lens_is_the_identity() {
        assert!(Distortion::default().is_none());
        assert!(!LENS.is_none());
        assert_eq!(Distortion::default().distort(0.3, -0.7), (0.3, -0.7));
    }

    /// Expected values are computed by hand from OpenCV's published formulas.
    #[test]
    fn coefficients_match_opencv() {
        let (x, y): (f64, f64) = (0.5, -0.25);
        let r2 = 0.3125;
        let at = |lens: Distortion| lens.distort(x, y);
        let close = |a: (f64, f64), b: (f64, f64)| (a.0 - b.0).abs() < 1e-15 && (a.1 - b.1).abs() < 1e-15;
        assert!(close(at(Distortion { k1: 0.1, ..Default::default() }), (x * (1.0 + 0.1 * r2), y * (1.0 + 0.1 * r2))));
        let r4 = 1.0 + 0.1 * r2 * r2;
        assert!(close(at(Distortion { k2: 0.1, ..Default::default() }), (x * r4, y * r4)));
        let r6 = 1.0 + 0.1 * r2 * r2 * r2;
        assert!(close(at(Distortion { k3: 0.1, ..Default::default() }), (x * r6, y * r6)));
        let p1 = (x + 0.2 * x * y, y + 0.1 * (r2 + 2.0 * y * y));
        assert!(close(at(Distortion { p1: 0.1, ..Default::default() }), p1));
        let p2 = (x + 0.1 * (r2 + 2.0 * x * x), y + 0.2 * x * y);
        assert!(close(at(Distortion { p2: 0.1, ..Default::default() }), p2));
    }

    #[test]
    fn folding_is_detected_where_the_radius_stops_growing() {
        // `r (1 − 0.5 r²)` grows until r² = 2/3.
        let lens = Distortion { k1: -0.5, ..Default::default() };
        assert!(lens.is_one_to_one_at(0.8, 0.0));
        assert!(!lens.is_one_to_one_at(0.83, 0.0));
        assert!(!lens.is_one_to_one_at(0.7, 0.5));
        assert!(!lens.is_one_to_one_at(3.0, 3.0));
        assert!(LENS.is_one_to_one_at(0.4, -0.7));
    }

    /// Expected values are computed by hand from COLMAP's published formulas.
    #[test]
    fn wide_lenses_match_colmap() {
        let (x, y): (f64, f64) = (1.5, -2.0);
        let close = |a: (f64, f64), b: (f64, f64)| assert!((a.0 - b.0).hypot(a.1 - b.1) < 1e-12, "{a:?} {b:?}");
        let angle = 2.5_f64.atan();
        let fisheye = Distortion { fisheye: true, ..Distortion::NONE };
        close(fisheye.distort(x, y), (angle * 0.6, angle * -0.8));
        close(fisheye.distort(0.0, 0.0), (0.0, 0.0));
        let lens = Distortion { k1: 0.05, k2: -0.01, k3: 0.003, k4: -0.001, ..fisheye };
        let t2 = angle * angle;
        let grown = angle * (1.0 + 0.05 * t2 - 0.01 * t2.powi(2) + 0.003 * t2.powi(3) - 0.001 * t2.powi(4));
        close(lens.distort(x, y), (grown * 0.6, grown * -0.8));
        let prism = Distortion { prism: [0.01, -0.02], ..lens };
        close(prism.distort(x, y), (grown * 0.6 + 0.01 * t2, grown * -0.8 - 0.02 * t2));
        let (x, y) = (0.3, 0.4);
        let full = Distortion { k1: 0.1, k2: 0.2, k3: 0.3, rational: [0.4, 0.5, 0.6], ..Distortion::NONE };
        let factor =
            (1.0 + 0.1 * 0.25 + 0.2 * 0.0625 + 0.3 * 0.015625) / (1.0 + 0.4 * 0.25 + 0.5 * 0.0625 + 0.6 * 0.015625);
        close(full.distort(x, y), (x * factor, y * factor));
    }

    #[test]
    fn folds_are_where_the_determinant_of_differences_changes_sign() {
        let lenses = [
            Distortion { rational: [0.5, 0.2, 0.1], k1: -0.3, ..Distortion::NONE },
            Distortion { fisheye: true, k1: -0.3, prism: [0.05, -0.03], p1: 0.02, ..Distortion::NONE },
            Distortion { prism: [0.2, 0.1], k2: -0.4, p2: -0.05, ..Distortion::NONE },
        ];
        for lens in lenses {
            let mut found = [0; 2];
            for i in 0..400 {
                let (x, y) = (f64::from(i % 20) * 0.15 - 1.5, f64::from(i / 20) * 0.15 - 1.5);
                let h = 1e-5;
                let difference = |dx: f64, dy: f64| {
                    let (a, b) = (lens.distort(x + dx, y + dy), lens.distort(x - dx, y - dy));
                    ((a.0 - b.0) / (2.0 * h), (a.1 - b.1) / (2.0 * h))
                };
                let (along_x, along_y) = (difference(h, 0.0), difference(0.0, h));
                let determinant = along_x.0 * along_y.1 - along_x.1 * along_y.0;
                if determinant.abs() > 1e-3 && lens.is_one_to_one_at(x, y) {
                    assert!(determinant > 0.0, "{lens:?} at {x} {y}: {determinant}");
                }
                found[usize::from(lens.is_one_to_one_at(x, y))] += 1;
            }
            assert!(found[1] > 50, "{lens:?}: {found:?}");
        }
    }
}
