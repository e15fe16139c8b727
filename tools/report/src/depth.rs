//! Depth maps as colors, with their scale.

use sgs_scene::Image;

/// Viridis at ten evenly spaced positions from 0 to 1.
///
/// Perceptually uniform, and readable in grayscale.
const VIRIDIS: [[u8; 3]; 10] = [
    [0x44, 0x01, 0x54],
    [0x48, 0x28, 0x78],
    [0x3e, 0x49, 0x89],
    [0x31, 0x68, 0x8e],
    [0x26, 0x82, 0x8e],
    [0x1f, 0x9e, 0x89],
    [0x35, 0xb7, 0x79],
    [0x6e, 0xce, 0x58],
    [0xb5, 0xde, 0x2b],
    [0xfd, 0xe7, 0x25],
];

/// Fraction of the pixels that may lie outside the range at each end.
const OUTSIDE: f64 = 0.01;

/// Returns the near and far end of the depth of an image.
///
/// Percentiles 1 and 99 of its positive values.
pub fn range(depth: &Image) -> [f32; 2] {
    let mut values: Vec<f32> = depth.data.iter().copied().filter(|v| *v > 0.0 && v.is_finite()).collect();
    values.sort_by(f32::total_cmp);
    let Some(last) = values.len().checked_sub(1) else { return [0.0, 1.0] };
    let cut = (OUTSIDE * last as f64).round() as usize;
    let (near, far) = (values[cut], values[last - cut]);
    [near, if far > near { far } else { near * 1.001 }]
}

/// Colors a depth map: near yellow, far violet, black without a hit.
pub fn colored(depth: &Image, [near, far]: [f32; 2]) -> Image {
    let color = |v: &f32| {
        if !(*v > 0.0 && v.is_finite()) {
            return [0.0; 3];
        }
        let t = 1.0 - ((v - near) / (far - near)).clamp(0.0, 1.0);
        let at = t * (VIRIDIS.len() - 1) as f32;
        let low = (at as usize).min(VIRIDIS.len() - 2);
        let mix = at - low as f32;
        [0, 1, 2].map(|c| {
            let [a, b] = [VIRIDIS[low][c], VIRIDIS[low + 1][c]].map(f32::from);
            (a + (b - a) * mix) / 255.0
        })
    };
    Image { channels: 3, data: depth.data.iter().flat_map(color).collect(), ..depth.clone() }
}

/// Returns the scale of a depth map, as an HTML note below an image.
pub fn scale([near, far]: [f32; 2]) -> String {
    let digits = if far < 10.0 { 2 } else { 1 };
    format!("{near:.digits$} <i class=\"ramp\" role=\"img\" aria-label=\"near to far\"></i> {far:.digits$} scene units")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn image(data: Vec<f32>) -> Image {
        Image { width: data.len() as u32, height: 1, channels: 1, data }
    }

    #[test]
    fn near_is_yellow_and_far_is_violet() {
        let shown = colored(&image(vec![1.0, 3.0, 0.0, f32::NAN, 9.0]), [1.0, 3.0]);
        let bytes: Vec<u8> = shown.data.iter().map(|v| (v * 255.0).round() as u8).collect();
        assert_eq!(&bytes[..6], &[0xfd, 0xe7, 0x25, 0x44, 0x01, 0x54]);
        assert_eq!((&bytes[6..12], &bytes[12..]), (&[0; 6][..], &[0x44, 0x01, 0x54][..]));
        // Luminance decreases monotonically.
        let ramp = colored(&image((0..50).map(|i| 1.0 + i as f32).collect()), [1.0, 50.0]);
        let light: Vec<f32> = ramp.data.chunks(3).map(|p| 0.2126 * p[0] + 0.7152 * p[1] + 0.0722 * p[2]).collect();
        assert!(light.windows(2).all(|w| w[0] > w[1]), "{light:?}");
    }

    #[test]
    fn range_ignores_outliers() {
        let mut data: Vec<f32> = (1..=1000).map(|i| i as f32).collect();
        data.extend([1e9, 0.0, f32::NAN, f32::INFINITY]);
        let [near, far] = range(&image(data));
        assert!((near - 11.0).abs() < 1.5 && (far - 991.0).abs() < 1.5, "{near} {far}");
        assert_eq!(range(&image(vec![0.0; 4])), [0.0, 1.0]);
        let [near, far] = range(&image(vec![2.0; 4]));
        assert!(
            far > near && scale([1.25, 12.0]).starts_with("1.2 <i") && scale([1.25, 2.0]).contains("2.00 scene units")
        );
    }
}
