//! OpenCV lens distortion.
//!
//! Maps ideal normalized coordinates (`x/z`, `y/z`) to distorted ones. The radial term is the polynomial `1 + k1 r² +
//! k2 r⁴ + k3 r⁶ + k4 r⁸`. `k4` follows nerfstudio, not OpenCV's rational model. The tangential term has the
//! coefficients `p1` and `p2`. Only this direction is needed: undistortion samples the distorted image at the position
//! of each ideal pixel.

/// Distortion coefficients; all zero for an ideal lens.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
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
}

impl Distortion {
    /// Returns whether the lens is ideal, that is, all coefficients are zero.
    pub fn is_none(&self) -> bool {
        *self == Self::default()
    }

    /// Returns whether all coefficients are finite.
    pub fn is_finite(&self) -> bool {
        [self.k1, self.k2, self.k3, self.k4, self.p1, self.p2].iter().all(|k| k.is_finite())
    }

    /// Returns the distorted position of the ideal normalized point `(x, y)`.
    pub fn distort(&self, x: f64, y: f64) -> (f64, f64) {
        let r2 = x * x + y * y;
        let radial = 1.0 + r2 * (self.k1 + r2 * (self.k2 + r2 * (self.k3 + r2 * self.k4)));
        (
            x * radial + 2.0 * self.p1 * x * y + self.p2 * (r2 + 2.0 * x * x),
            y * radial + self.p1 * (r2 + 2.0 * y * y) + 2.0 * self.p2 * x * y,
        )
    }

    /// Returns whether the distortion is one-to-one at `(x, y)`. Fitted polynomials fold back outside the calibrated
    /// field, where they would show a mirrored part of the image.
    pub fn is_one_to_one_at(&self, x: f64, y: f64) -> bool {
        let r2 = x * x + y * y;
        let radial = 1.0 + r2 * (self.k1 + r2 * (self.k2 + r2 * (self.k3 + r2 * self.k4)));
        // Derivative of `radial` with respect to r².
        let slope = self.k1 + r2 * (2.0 * self.k2 + r2 * (3.0 * self.k3 + r2 * 4.0 * self.k4));
        let xx = radial + 2.0 * x * x * slope + 2.0 * self.p1 * y + 6.0 * self.p2 * x;
        let yy = radial + 2.0 * y * y * slope + 6.0 * self.p1 * y + 2.0 * self.p2 * x;
        let xy = 2.0 * x * y * slope + 2.0 * self.p1 * x + 2.0 * self.p2 * y;
        // The radius must also grow along the ray: two simultaneous folds leave the determinant positive.
        xx * yy - xy * xy > 0.0 && radial + 2.0 * r2 * slope > 0.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LENS: Distortion =
        Distortion { k1: 0.0578421, k2: -0.0805099, k3: 0.01, k4: -0.002, p1: -0.000980296, p2: 0.00015575 };

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
}
