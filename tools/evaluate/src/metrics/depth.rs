//! Error of depth maps.

use sgs_scene::Image;

use super::{MetricError, check, pairs};

/// Returns the mean of `|d − truth| / truth`. Counts pixels that the mask includes, with a finite `d` and a true depth
/// that is positive and finite.
///
/// A pixel where nothing was rendered has the depth 0 and counts as an error of 1.
pub fn depth_rel(depth: &Image, truth: &Image, mask: Option<&Image>) -> Result<f64, MetricError> {
    let measure = "depth_rel";
    check(measure, depth, truth, mask)?;
    if depth.channels != 1 {
        return Err(MetricError::Size {
            measure,
            a: (depth.width, depth.height, depth.channels),
            b: (truth.width, truth.height, 1),
        });
    }
    let (mut sum, mut count) = (0.0, 0_u64);
    for (d, t) in pairs(depth, truth, mask) {
        let (d, t) = (f64::from(d[0]), f64::from(t[0]));
        if t > 0.0 && t.is_finite() && d.is_finite() {
            sum += (d - t).abs() / t;
            count += 1;
        }
    }
    if count == 0 { Err(MetricError::Empty { measure }) } else { Ok(sum / count as f64) }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn image(data: &[f32]) -> Image {
        Image::from_data(data.len() as u32, 1, 1, data.to_vec()).unwrap()
    }

    #[test]
    fn errors_are_relative_to_the_truth() {
        let truth = image(&[2.0, 4.0, 0.0, -1.0, f32::INFINITY, 1.0]);
        let depth = image(&[2.5, 3.0, 9.0, 9.0, 9.0, f32::NAN]);
        assert!((depth_rel(&depth, &truth, None).unwrap() - 0.25).abs() < 1e-9);
        let mask = image(&[1.0, 0.0, 1.0, 1.0, 1.0, 1.0]);
        assert!((depth_rel(&depth, &image(&[2.0; 6]), Some(&mask)).unwrap() - (0.25 + 3.0 * 3.5) / 4.0).abs() < 1e-6);
        assert_eq!(depth_rel(&image(&[0.0]), &image(&[3.0]), None), Ok(1.0));
        assert!(matches!(depth_rel(&depth, &image(&[0.0; 6]), None), Err(MetricError::Empty { .. })));
        let rgb = Image::new(1, 1, 3);
        assert!(matches!(depth_rel(&rgb, &rgb, None), Err(MetricError::Size { .. })));
    }
}
