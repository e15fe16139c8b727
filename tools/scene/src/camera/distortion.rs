//! Lens distortion of OpenCV and COLMAP.
//!
//! Maps ideal normalized coordinates (`x/z`, `y/z`) to distorted ones. A [`Projection`] first replaces the radius, as
//! fisheye lenses do. The radial term is the polynomial `1 + k1 r² + k2 r⁴ + … + k6 r¹²` of the new radius. `k4` follows
//! nerfstudio; OpenCV's rational model has its last three coefficients in [`Distortion::rational`]. The tangential term
//! has the coefficients `p1` and `p2`, the thin prism those of [`Distortion::prism`]. Only this direction is needed:
//! undistortion samples the distorted image at the position of each ideal pixel.

use super::Residual;
use std::f64::consts::PI;

/// Radius of an ideal lens.
///
/// It is a function of the tangent `r` of the angle to the axis, and grows with `r`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Projection {
    /// `r`, for lenses that keep straight lines.
    #[default]
    Perspective,
    /// `atan(r)`, for equidistant fisheye lenses.
    Equidistant,
    /// `atan(2 r tan(ω/2)) / ω` with the angle `ω` in radians.
    ///
    /// By Devernay and Faugeras.
    FieldOfView(f64),
    /// `2 r / (1 + √(1 − 4 k r²))` with the coefficient `k`.
    ///
    /// By Fitzgibbon.
    Division(f64),
    /// `r / (α √(β r² + 1) + 1 − α)`, the enhanced unified model.
    ///
    /// By Khomutenko and others.
    Unified {
        /// Blend of perspective (0) and a sphere's projection (1).
        alpha: f64,
        /// Shape of the sphere; positive.
        beta: f64,
    },
}

impl Projection {
    /// Returns the new radius divided by `r`.
    fn scale(self, r: f64) -> f64 {
        // The limits at the axis; `r` is nowhere near the rounding of 1.
        let axis = r < 1e-9;
        match self {
            Self::Equidistant if !axis => r.atan() / r,
            Self::FieldOfView(omega) if omega != 0.0 => {
                let edge = 2.0 * (0.5 * omega).tan();
                if axis { edge / omega } else { (r * edge).atan() / (r * omega) }
            }
            // Beyond the field, the function continues with its steepest value.
            Self::Division(k) => 2.0 / (1.0 + (1.0 - 4.0 * k * r * r).max(0.0).sqrt()),
            Self::Unified { alpha, beta } => 1.0 / (alpha * (beta * r * r + 1.0).sqrt() + 1.0 - alpha),
            _ => 1.0,
        }
    }

    /// Returns whether the lens shows points at `r`.
    fn shows(self, r: f64) -> bool {
        match self {
            Self::Division(k) => 4.0 * k * r * r < 1.0,
            _ => true,
        }
    }

    /// Describes why the parameters are invalid, or returns `None` if they are valid.
    pub(crate) fn problem(self) -> Option<String> {
        match self {
            Self::FieldOfView(omega) if omega.is_nan() || omega.abs() >= PI => {
                Some(format!("the field of view omega is {omega} radians; it must lie between -π and π"))
            }
            Self::Division(k) if !k.is_finite() => {
                Some(format!("the coefficient of the division model is {k}; it must be finite"))
            }
            Self::Unified { alpha, beta } if !((0.0..=1.0).contains(&alpha) && beta > 0.0 && beta.is_finite()) => {
                Some(format!(
                    "the model's alpha and beta are {alpha} and {beta}; alpha must lie in 0..=1, beta must be positive"
                ))
            }
            _ => None,
        }
    }
}

/// Distortion coefficients; all zero for an ideal lens.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Distortion {
    /// Learned distortion, which comes first.
    pub residual: Option<Residual>,
    /// Radius to which the coefficients apply.
    pub projection: Projection,
    /// Radial coefficient of r².
    pub k1: f64,
    /// Radial coefficient of r⁴.
    pub k2: f64,
    /// Radial coefficient of r⁶.
    pub k3: f64,
    /// Radial coefficient of r⁸.
    pub k4: f64,
    /// Radial coefficients of r¹⁰ and r¹².
    pub higher: [f64; 2],
    /// First tangential coefficient.
    pub p1: f64,
    /// Second tangential coefficient.
    pub p2: f64,
    /// Coefficients of r², r⁴ and r⁶ in the divisor of the radial term: OpenCV's k4, k5 and k6.
    pub rational: [f64; 3],
    /// Thin-prism coefficients of r² and r⁴, horizontal, then vertical.
    pub prism: [f64; 4],
    /// Whether the tangential and prism terms apply after the radial term.
    ///
    /// Otherwise they apply to the position before it.
    pub after_radial: bool,
}

impl Default for Distortion {
    fn default() -> Self {
        Self::NONE
    }
}

impl Distortion {
    /// Ideal lens.
    pub const NONE: Self = Self {
        residual: None,
        projection: Projection::Perspective,
        k1: 0.0,
        k2: 0.0,
        k3: 0.0,
        k4: 0.0,
        higher: [0.0; 2],
        p1: 0.0,
        p2: 0.0,
        rational: [0.0; 3],
        prism: [0.0; 4],
        after_radial: false,
    };

    /// Returns the calibrated distortion, without what training learned.
    #[must_use]
    pub fn given(&self) -> Distortion {
        Distortion { residual: None, ..*self }
    }

    /// Returns whether the lens is ideal, that is, all coefficients are zero.
    pub fn is_none(&self) -> bool {
        *self == Self::NONE
    }

    /// Describes why the lens is invalid, or returns `None` if it is valid.
    pub fn problem(&self) -> Option<String> {
        let each = [self.k1, self.k2, self.k3, self.k4, self.p1, self.p2];
        let all = each.iter().chain(&self.higher).chain(&self.rational).chain(&self.prism);
        match all.into_iter().all(|k| k.is_finite()) {
            true => self.projection.problem(),
            false => Some("the distortion holds values that are not finite".into()),
        }
    }

    /// Returns the distorted position of the ideal normalized point `(x, y)`.
    pub fn distort(&self, x: f64, y: f64) -> (f64, f64) {
        let [x, y] = self.residual.map_or([x, y], |residual| residual.distort(x, y).0);
        let scale = self.projection.scale(x.hypot(y));
        let (x, y) = (x * scale, y * scale);
        let (radial, _) = self.radial(x * x + y * y);
        let (grown_x, grown_y) = (x * radial, y * radial);
        let (dx, dy) = if self.after_radial { self.offset(grown_x, grown_y) } else { self.offset(x, y) };
        (grown_x + dx, grown_y + dy)
    }

    /// Returns the ideal normalized point whose distorted position is `(x, y)`. Returns `None` if the lens shows none
    /// there.
    pub fn undistort(&self, x: f64, y: f64) -> Option<(f64, f64)> {
        if self.is_none() {
            return Some((x, y));
        }
        // Newton's method with differences, which every lens has.
        let away = |(u, v): (f64, f64)| {
            let (a, b) = self.distort(u, v);
            (a - x, b - y)
        };
        let mut at = (x, y);
        let mut off = away(at);
        for _ in 0..40 {
            if off.0.hypot(off.1) < 1e-12 * (1.0 + x.hypot(y)) {
                break;
            }
            let h = 1e-7 * (1.0 + at.0.hypot(at.1));
            let (right, below) = (away((at.0 + h, at.1)), away((at.0, at.1 + h)));
            let (xx, yx) = ((right.0 - off.0) / h, (right.1 - off.1) / h);
            let (xy, yy) = ((below.0 - off.0) / h, (below.1 - off.1) / h);
            let determinant = xx * yy - xy * yx;
            let step = ((yy * off.0 - xy * off.1) / determinant, (xx * off.1 - yx * off.0) / determinant);
            // A step that leads away is too long.
            let shorter = (0..20).map(|i| 0.5_f64.powi(i)).find_map(|f| {
                let next = (at.0 - f * step.0, at.1 - f * step.1);
                let left = away(next);
                (left.0.hypot(left.1) < off.0.hypot(off.1)).then_some((next, left))
            });
            let Some(next) = shorter else { break };
            (at, off) = next;
        }
        (off.0.hypot(off.1) < 1e-7 * (1.0 + x.hypot(y)) && self.is_one_to_one_at(at.0, at.1)).then_some(at)
    }

    /// Returns whether the distortion is one-to-one at `(x, y)`. Fitted polynomials fold back outside the calibrated
    /// field, where they would show a mirrored part of the image.
    pub fn is_one_to_one_at(&self, x: f64, y: f64) -> bool {
        let ([x, y], folds) = self.residual.map_or(([x, y], false), |residual| residual.distort(x, y));
        if folds {
            return false;
        }
        let r = x.hypot(y);
        if !self.projection.shows(r) {
            return false;
        }
        // The projection's radius grows with r, so that the lens folds only where its polynomials do.
        let scale = self.projection.scale(r);
        let (x, y) = (x * scale, y * scale);
        let r2 = x * x + y * y;
        let (radial, slope) = self.radial(r2);
        let cross = 2.0 * x * y * slope;
        let grown = [[radial + 2.0 * x * x * slope, cross], [cross, radial + 2.0 * y * y * slope]];
        let total = if self.after_radial {
            let outer = self.offset_slopes(x * radial, y * radial);
            let at = |i: usize, j: usize| grown[i][j] + outer[i][0] * grown[0][j] + outer[i][1] * grown[1][j];
            [[at(0, 0), at(0, 1)], [at(1, 0), at(1, 1)]]
        } else {
            let beside = self.offset_slopes(x, y);
            [0, 1].map(|i| [0, 1].map(|j| grown[i][j] + beside[i][j]))
        };
        // The radius must also grow along the ray: two simultaneous folds leave the determinant positive.
        total[0][0] * total[1][1] - total[0][1] * total[1][0] > 0.0 && radial + 2.0 * r2 * slope > 0.0
    }

    /// Returns the shift by the tangential and prism terms at `(x, y)`.
    fn offset(&self, x: f64, y: f64) -> (f64, f64) {
        let r2 = x * x + y * y;
        let [sx1, sx2, sy1, sy2] = self.prism;
        (
            2.0 * self.p1 * x * y + self.p2 * (r2 + 2.0 * x * x) + r2 * (sx1 + r2 * sx2),
            self.p1 * (r2 + 2.0 * y * y) + 2.0 * self.p2 * x * y + r2 * (sy1 + r2 * sy2),
        )
    }

    /// Returns the derivatives of [`Self::offset`]: a row for each of its values, a column for each coordinate.
    fn offset_slopes(&self, x: f64, y: f64) -> [[f64; 2]; 2] {
        let r2 = x * x + y * y;
        let [sx1, sx2, sy1, sy2] = self.prism;
        let (sx, sy) = (2.0 * sx1 + 4.0 * r2 * sx2, 2.0 * sy1 + 4.0 * r2 * sy2);
        let common = 2.0 * self.p1 * x + 2.0 * self.p2 * y;
        [
            [2.0 * self.p1 * y + 6.0 * self.p2 * x + sx * x, common + sx * y],
            [common + sy * x, 6.0 * self.p1 * y + 2.0 * self.p2 * x + sy * y],
        ]
    }

    /// Returns the radial factor and its derivative with respect to r².
    fn radial(&self, r2: f64) -> (f64, f64) {
        let coefficients = [self.k1, self.k2, self.k3, self.k4, self.higher[0], self.higher[1]];
        let (mut value, mut slope) = (0.0, 0.0);
        for k in coefficients.into_iter().rev() {
            slope = slope * r2 + value;
            value = value * r2 + k;
        }
        // The polynomial has no constant term yet.
        (value, slope) = (1.0 + r2 * value, value + r2 * slope);
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

    const RESIDUAL: Residual = Residual { center: [0.01, -0.02], half_diagonal: [0.9, 0.95], radial: -0.05 };

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
        let fisheye = Distortion { projection: Projection::Equidistant, ..Distortion::NONE };
        close(fisheye.distort(x, y), (angle * 0.6, angle * -0.8));
        close(fisheye.distort(0.0, 0.0), (0.0, 0.0));
        let lens = Distortion { k1: 0.05, k2: -0.01, k3: 0.003, k4: -0.001, ..fisheye };
        let t2 = angle * angle;
        let grown = angle * (1.0 + 0.05 * t2 - 0.01 * t2.powi(2) + 0.003 * t2.powi(3) - 0.001 * t2.powi(4));
        close(lens.distort(x, y), (grown * 0.6, grown * -0.8));
        let prism = Distortion { prism: [0.01, 0.0, -0.02, 0.0], ..lens };
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
            Distortion {
                projection: Projection::Equidistant,
                k1: -0.3,
                prism: [0.05, 0.0, -0.03, 0.0],
                p1: 0.02,
                ..Distortion::NONE
            },
            Distortion { prism: [0.2, 0.0, 0.1, 0.0], k2: -0.4, p2: -0.05, ..Distortion::NONE },
            Distortion { projection: Projection::FieldOfView(0.9), k1: -0.2, ..Distortion::NONE },
            Distortion { residual: Some(RESIDUAL), p1: 0.02, ..Distortion::NONE },
            Distortion { projection: Projection::Division(0.1), k2: 0.01, ..Distortion::NONE },
            Distortion { projection: Projection::Unified { alpha: 0.6, beta: 1.1 }, k1: -0.3, ..Distortion::NONE },
            Distortion {
                projection: Projection::Equidistant,
                k1: -0.2,
                higher: [-0.05, 0.02],
                p1: 0.03,
                prism: [0.05, 0.04, -0.03, 0.06],
                after_radial: true,
                ..Distortion::NONE
            },
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

    /// The inverses are closed forms, derived by solving each projection for `r`.
    #[test]
    fn projections_are_inverted_by_their_closed_forms() {
        let (omega, alpha, beta) = (0.9_f64, 0.6, 1.1);
        let unified = Projection::Unified { alpha, beta };
        let inverse_unified = move |d: f64| {
            let d2 = d * d;
            let root = (1.0 - (2.0 * alpha - 1.0) * beta * d2).sqrt();
            d * (alpha * root + 1.0 - alpha) / (1.0 - alpha * alpha * beta * d2)
        };
        type Inverse = Box<dyn Fn(f64) -> f64>;
        let inverses: [(Projection, Inverse); 6] = [
            (Projection::Perspective, Box::new(|d| d)),
            (Projection::Equidistant, Box::new(f64::tan)),
            (Projection::FieldOfView(omega), Box::new(move |d| (d * omega).tan() / (2.0 * (0.5 * omega).tan()))),
            (Projection::Division(-0.2), Box::new(|d| d / (1.0 - 0.2 * d * d))),
            (Projection::Division(0.08), Box::new(|d| d / (1.0 + 0.08 * d * d))),
            (unified, Box::new(inverse_unified)),
        ];
        for (projection, inverse) in inverses {
            let lens = Distortion { projection, ..Distortion::NONE };
            for r in [0.0, 1e-12, 1e-6, 0.01, 0.3, 1.0, 1.7] {
                let (x, y) = lens.distort(0.6 * r, -0.8 * r);
                let found = inverse(x.hypot(y));
                assert!((found - r).abs() <= 1e-12 * (1.0 + r), "{projection:?} at {r}: {found}");
                assert!(x >= 0.0 && y <= 0.0 && lens.is_one_to_one_at(0.6 * r, -0.8 * r), "{projection:?} at {r}");
            }
        }
    }

    #[test]
    fn undistortion_inverts_every_lens() {
        let equidistant = Distortion { projection: Projection::Equidistant, ..Distortion::NONE };
        let prism = [0.01, -0.004, -0.02, 0.003];
        for lens in [
            Distortion::NONE,
            LENS,
            Distortion { residual: Some(RESIDUAL), ..LENS },
            Distortion { k1: 0.05, k2: -0.01, prism, ..equidistant },
            Distortion {
                k1: 0.05,
                higher: [-0.001, 0.0005],
                p1: 0.003,
                p2: -0.004,
                prism,
                after_radial: true,
                ..equidistant
            },
            Distortion { projection: Projection::FieldOfView(0.9), ..Distortion::NONE },
            Distortion { projection: Projection::Division(-0.2), ..Distortion::NONE },
            Distortion { projection: Projection::Division(0.08), ..Distortion::NONE },
            Distortion { projection: Projection::Unified { alpha: 0.6, beta: 1.1 }, ..Distortion::NONE },
        ] {
            for (x, y) in [(0.0, 0.0), (1e-9, 0.0), (0.3, -0.2), (-0.7, 0.9), (1.1, 0.4)] {
                let (u, v) = lens.distort(x, y);
                let found = lens.undistort(u, v).unwrap_or_else(|| panic!("{lens:?} at {x} {y}"));
                assert!((found.0 - x).hypot(found.1 - y) < 1e-8, "{lens:?} at {x} {y}: {found:?}");
            }
        }
        // `r (1 − 0.5 r²)` has no values above 0.544, and an equidistant lens none from a quarter turn on.
        assert_eq!(Distortion { k1: -0.5, ..Distortion::NONE }.undistort(0.6, 0.0), None);
        assert_eq!(equidistant.undistort(1.7, 0.0), None);
    }

    #[test]
    fn division_ends_at_its_field() {
        // The largest tangent that the model shows is 1/(2 √k) = 2.5.
        let lens = Distortion { projection: Projection::Division(0.04), ..Distortion::NONE };
        assert!(lens.is_one_to_one_at(2.49, 0.0));
        assert!(!lens.is_one_to_one_at(2.51, 0.0));
        assert_eq!(lens.distort(3.0, 0.0), (6.0, 0.0));
    }

    #[test]
    fn vanishing_parameters_leave_the_perspective() {
        let at = |projection| Distortion { projection, ..Distortion::NONE }.distort(0.4, -0.3);
        for small in [0.0, 1e-310, 1e-12] {
            for projection in [
                Projection::FieldOfView(small),
                Projection::Division(small),
                Projection::Unified { alpha: small, beta: 1.0 },
            ] {
                let (x, y) = at(projection);
                assert!((x - 0.4).hypot(y + 0.3) < 1e-12, "{projection:?}: {x} {y}");
            }
        }
    }

    #[test]
    fn invalid_lenses_are_described() {
        let describe = |lens: Distortion| lens.problem().unwrap_or_default();
        assert_eq!(describe(LENS), "");
        assert!(describe(Distortion { higher: [0.0, f64::NAN], ..LENS }).contains("not finite"));
        assert!(describe(Distortion { prism: [f64::INFINITY; 4], ..LENS }).contains("not finite"));
        let of = |projection| describe(Distortion { projection, ..LENS });
        assert_eq!(of(Projection::FieldOfView(-0.9)), "");
        assert!(of(Projection::FieldOfView(3.2)).contains("omega is 3.2 radians"));
        assert!(of(Projection::FieldOfView(f64::NAN)).contains("omega is NaN"));
        assert!(of(Projection::Division(f64::INFINITY)).contains("division model is inf"));
        assert!(of(Projection::Unified { alpha: 1.5, beta: 1.0 }).contains("1.5 and 1; alpha must"));
        assert!(of(Projection::Unified { alpha: f64::NAN, beta: 1.0 }).contains("alpha must"));
        assert!(of(Projection::Unified { alpha: 0.5, beta: 0.0 }).contains("beta must be positive"));
    }
}
