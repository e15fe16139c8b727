//! Angles between normals.

use sgs_scene::Image;

use super::{MetricError, check, pairs};

/// Mean angle in degrees between the vectors of two three-channel images, over the pixels that count and in which neither
/// vector is zero or not a number.
///
/// The vectors need not have unit length. The angle is `atan2(‖a×b‖, a·b)`, which is exact near 0° and 180°, where the
/// arc cosine of a rounded product is not.
pub fn normal_mae_deg(a: &Image, b: &Image, mask: Option<&Image>) -> Result<f64, MetricError> {
    let measure = "normal_mae_deg";
    check(measure, a, b, mask)?;
    if a.channels != 3 {
        return Err(MetricError::Size { measure, a: (a.width, a.height, a.channels), b: (b.width, b.height, 3) });
    }
    let (mut sum, mut count) = (0.0, 0_u64);
    for (a, b) in pairs(a, b, mask) {
        if let Some(angle) = angle(a, b) {
            sum += angle;
            count += 1;
        }
    }
    if count == 0 { Err(MetricError::Empty { measure }) } else { Ok((sum / count as f64).to_degrees()) }
}

/// The angle in radians; `None` where a vector has no direction.
fn angle(a: &[f32], b: &[f32]) -> Option<f64> {
    let [a, b] = [a, b].map(|v| [0, 1, 2].map(|k| f64::from(v[k])));
    let dot = |a: [f64; 3], b: [f64; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
    let directed = |v: [f64; 3]| {
        let square = dot(v, v);
        square > 0.0 && square.is_finite()
    };
    if !directed(a) || !directed(b) {
        return None;
    }
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
    fn known_angles() {
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

    /// Parallel vectors of any length are no angle apart, opposite ones half a turn: an arc cosine is off by 1e-8, or no number.
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

    #[test]
    fn only_directions_count() {
        let a = image(&[0.0, 0.0, 1.0, 0.0, 0.0, 0.0, f32::NAN, 0.0, 1.0, 1.0, 0.0, 0.0]);
        let b = image(&[0.0, 1.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 0.0, 1.0, 0.0, 0.0]);
        assert!((normal_mae_deg(&a, &b, None).unwrap() - 45.0).abs() < 1e-9);
        let mask = Image::from_data(4, 1, 1, vec![1.0, 1.0, 1.0, 0.0]).unwrap();
        assert!((normal_mae_deg(&a, &b, Some(&mask)).unwrap() - 90.0).abs() < 1e-9);
        let none = Image::from_data(4, 1, 1, vec![0.0, 1.0, 1.0, 0.0]).unwrap();
        assert!(matches!(normal_mae_deg(&a, &b, Some(&none)), Err(MetricError::Empty { .. })));
        let gray = Image::new(4, 1, 1);
        assert!(matches!(normal_mae_deg(&gray, &gray, None), Err(MetricError::Size { .. })));
    }
}
