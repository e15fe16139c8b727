//! Angular error of normals.

use sgs_scene::Image;

use super::{MetricError, check, pairs};

/// Angle of a pixel without a rendered normal, in degrees.
const HOLE_DEG: f64 = 90.0;

/// Error of rendered normals.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NormalError {
    /// Mean angle in degrees over the pixels whose true normal is known. A pixel without a rendered normal counts as
    /// 90°.
    pub mae_deg: f64,
    /// Share of pixels with a rendered normal, 0 to 1. Of the pixels whose true normal is known.
    pub coverage: f64,
}

/// Compares rendered normals with true ones. Counts pixels that the mask includes and whose true vector is neither zero
/// nor NaN.
///
/// Vectors need not have unit length. A rendered vector that is zero or NaN is a hole: it counts as 90° and lowers the
/// coverage. The angle is `atan2(‖a×b‖, a·b)`, which is exact near 0° and 180°. The arc cosine of a rounded product is
/// not.
///
/// # Errors
/// If the sizes differ, or no true normal counts.
pub fn normal_error(rendered: &Image, truth: &Image, mask: Option<&Image>) -> Result<NormalError, MetricError> {
    let measure = "normal_mae_deg";
    let (a, b) = (rendered, truth);
    check(measure, a, b, mask)?;
    if a.channels != 3 {
        return Err(MetricError::Size { measure, a: (a.width, a.height, a.channels), b: (b.width, b.height, 3) });
    }
    let (mut sum, mut count, mut covered) = (0.0, 0_u64, 0_u64);
    for (a, b) in pairs(a, b, mask).filter(|(_, b)| directed(b).is_some()) {
        count += 1;
        if let Some(angle) = angle(a, b) {
            sum += angle.to_degrees();
            covered += 1;
        } else {
            sum += HOLE_DEG;
        }
    }
    if count == 0 {
        return Err(MetricError::Empty { measure });
    }
    Ok(NormalError { mae_deg: sum / count as f64, coverage: covered as f64 / count as f64 })
}

/// Returns the mean angle of [`normal_error`].
///
/// # Errors
/// As [`normal_error`].
pub fn normal_mae_deg(rendered: &Image, truth: &Image, mask: Option<&Image>) -> Result<f64, MetricError> {
    normal_error(rendered, truth, mask).map(|e| e.mae_deg)
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Returns the vector of a pixel; `None` where it has no direction.
fn directed(v: &[f32]) -> Option<[f64; 3]> {
    let v = [0, 1, 2].map(|k| f64::from(v[k]));
    let square = dot(v, v);
    (square > 0.0 && square.is_finite()).then_some(v)
}

/// Returns the angle in radians; `None` where a vector has no direction.
fn angle(a: &[f32], b: &[f32]) -> Option<f64> {
    let (a, b) = (directed(a)?, directed(b)?);
    let cross = [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
    Some(dot(cross, cross).sqrt().atan2(dot(a, b)))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn image(data: &[f32]) -> Image {
        Image::from_data(data.len() as u32 / 3, 1, 3, data.to_vec()).unwrap()
    }

    #[test]
    fn known_angles_are_exact() {
        let up = image(&[0.0, 0.0, 2.0]);
        for (other, degrees) in [
            ([0.0, 0.0, 5.0], 0.0),
            ([1.0, 0.0, 0.0], 90.0),
            ([0.0, -3.0, 3.0], 45.0),
            ([0.0, 0.0, -1.0], 180.0),
            ([1e-4, 0.0, 1.0], 1e-4_f64.to_degrees()),
        ] {
            let found = normal_mae_deg(&up, &image(&other), None).unwrap();
            assert!((found - degrees).abs() < 1e-6 * degrees.max(1e-3), "{other:?}: {found}");
        }
    }

    /// The angle of parallel vectors is 0, of opposite ones 180°. An arc cosine would be off by 1e-8, or NaN.
    #[test]
    fn parallel_vectors_have_no_angle() {
        for i in 1..1000 {
            let x = i as f32;
            let a = [(0.37 * x).sin(), (0.73 * x).cos(), 0.01 * x - 4.0];
            let of = |factor: f32| normal_mae_deg(&image(&a), &image(&a.map(|v| factor * v)), None).unwrap();
            assert_eq!(of(2.0), 0.0, "{a:?}");
            assert!((of(-4.0) - 180.0).abs() < 1e-12, "{a:?}");
        }
    }

    /// Rendered: a correct normal, a hole, a NaN, and a vector whose truth is unknown.
    #[test]
    fn holes_count_as_ninety_degrees() {
        let rendered = image(&[0.0, 0.0, 1.0, 0.0, 0.0, 0.0, f32::NAN, 0.0, 1.0, 1.0, 0.0, 0.0]);
        let truth = image(&[0.0, 0.0, 2.0, 0.0, 1.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0]);
        let found = normal_error(&rendered, &truth, None).unwrap();
        assert!((found.mae_deg - 60.0).abs() < 1e-9 && (found.coverage - 1.0 / 3.0).abs() < 1e-12, "{found:?}");
        assert_eq!(normal_mae_deg(&rendered, &truth, None), Ok(found.mae_deg));
        let mask = |data: [f32; 4]| Image::from_data(4, 1, 1, data.to_vec()).unwrap();
        let found = normal_error(&rendered, &truth, Some(&mask([1.0, 1.0, 0.0, 1.0]))).unwrap();
        assert_eq!(found, NormalError { mae_deg: 45.0, coverage: 0.5 });
        // No normal was rendered.
        let found = normal_error(&rendered, &truth, Some(&mask([0.0, 1.0, 1.0, 0.0]))).unwrap();
        assert_eq!(found, NormalError { mae_deg: 90.0, coverage: 0.0 });
        let unknown = normal_error(&rendered, &truth, Some(&mask([0.0, 0.0, 0.0, 1.0])));
        assert!(matches!(unknown, Err(MetricError::Empty { .. })));
        let gray = Image::new(4, 1, 1);
        assert!(matches!(normal_error(&gray, &gray, None), Err(MetricError::Size { .. })));
    }
}
