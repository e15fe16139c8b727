//! FLIP: perceived difference of two images that alternate on a screen.
//!
//! Andersson et al. 2020, "FLIP: A Difference Evaluator for Alternating Images", for display-referred images. The
//! metric has no learned weights. The viewing conditions are those of the paper: a screen 0.7 m away, 0.7 m and 3840
//! pixels wide.

use sgs_scene::{Image, srgb_to_linear};

use super::{MetricError, check};

/// Pixels per degree. Distance in meters times pixels per meter times one degree in radians.
const PIXELS_A_DEGREE: f64 = 0.7 * (3840.0 / 0.7) * (std::f64::consts::PI / 180.0);

/// Contrast sensitivity to lightness, red-green and blue-yellow. Sums of Gaussians `a sqrt(pi / b) exp(-pi^2 x^2 / b)`,
/// with x in degrees (section 4.1.1, table 1).
const SENSITIVITY: [[(f64, f64); 2]; 3] =
    [[(1.0, 0.0047), (0.0, 1e-5)], [(1.0, 0.0053), (0.0, 1e-5)], [(34.1, 0.04), (13.5, 0.025)]];

/// Exponent of color differences (section 4.1.3).
const COLOR_EXPONENT: f64 = 0.7;
/// Share of the largest difference that maps to [`NEAR_RANGE`] of the scale.
const NEAR: f64 = 0.4;
const NEAR_RANGE: f64 = 0.95;

/// Width of features in degrees (section 4.2).
const FEATURE_WIDTH: f64 = 0.082;
const FEATURE_EXPONENT: f64 = 0.5;

/// Matrix from linear sRGB to XYZ, for the primaries and the white point D65.
const TO_XYZ: [[f64; 3]; 3] = [
    [10_135_552.0 / 24_577_794.0, 8_788_810.0 / 24_577_794.0, 4_435_075.0 / 24_577_794.0],
    [2_613_072.0 / 12_288_897.0, 8_788_810.0 / 12_288_897.0, 887_015.0 / 12_288_897.0],
    [1_425_312.0 / 73_733_382.0, 8_788_810.0 / 73_733_382.0, 70_074_185.0 / 73_733_382.0],
];

/// Returns the mean FLIP over the pixels that count. 0 for equal images, 1 for the largest difference. Images are
/// display-referred with three channels; values outside [0, 1] are clipped. Masked pixels of `a` are replaced by those
/// of `b`, so that they do not affect their neighbors.
pub fn flip(a: &Image, b: &Image, mask: Option<&Image>) -> Result<f64, MetricError> {
    check("flip", a, b, mask)?;
    if a.channels != 3 {
        let size = (a.width, a.height, a.channels);
        return Err(MetricError::Size { measure: "flip", a: size, b: (b.width, b.height, 3) });
    }
    let counts = |i: usize| mask.is_none_or(|mask| mask.data[i] > 0.5);
    let counted = (0..a.pixels()).filter(|&i| counts(i)).count();
    if counted == 0 {
        return Err(MetricError::Empty { measure: "flip" });
    }
    let theirs = opponent(b);
    let mut ours = opponent(a);
    for i in (0..a.pixels()).filter(|&i| !counts(i)) {
        ours.iter_mut().zip(&theirs).for_each(|(o, t)| o[i] = t[i]);
    }
    let size = [a.width as usize, a.height as usize];
    let color = color_difference(&ours, &theirs, size);
    let feature = feature_difference(&ours[0], &theirs[0], size);
    let each = |i: usize| color[i].powf(1.0 - feature[i]);
    Ok((0..a.pixels()).filter(|&i| counts(i)).map(each).sum::<f64>() / counted as f64)
}

type Planes = [Vec<f64>; 3];

fn white() -> [f64; 3] {
    TO_XYZ.map(|row| row.iter().sum())
}

fn to_xyz(rgb: [f64; 3]) -> [f64; 3] {
    TO_XYZ.map(|row| row.iter().zip(rgb).map(|(m, v)| m * v).sum())
}

/// Converts to lightness and two opponent colors, linear in light (YCxCz).
fn opponent(image: &Image) -> Planes {
    let w = white();
    let mut out = [0, 1, 2].map(|_| Vec::with_capacity(image.pixels()));
    for pixel in image.data.chunks_exact(3) {
        let linear = [0, 1, 2].map(|c| f64::from(srgb_to_linear(pixel[c].clamp(0.0, 1.0))));
        let [x, y, z] = to_xyz(linear);
        let [x, y, z] = [x / w[0], y / w[1], z / w[2]];
        for (plane, v) in out.iter_mut().zip([116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)]) {
            plane.push(v);
        }
    }
    out
}

/// Converts back to linear light, clipped to [0, 1].
fn shown([y, cx, cz]: [f64; 3], inverse: &glam::DMat3) -> [f64; 3] {
    let w = white();
    let y = (y + 16.0) / 116.0;
    let xyz = glam::DVec3::new((cx / 500.0 + y) * w[0], y * w[1], (y - cz / 200.0) * w[2]);
    (*inverse * xyz).to_array().map(|v| v.clamp(0.0, 1.0))
}

/// Converts to CIELab with chroma that fades with lightness (Hunt effect).
fn lab(rgb: [f64; 3]) -> [f64; 3] {
    let delta: f64 = 6.0 / 29.0;
    let root = |t: f64| if t > delta.powi(3) { t.cbrt() } else { t / (3.0 * delta * delta) + 4.0 / 29.0 };
    let (xyz, w) = (to_xyz(rgb), white());
    let [x, y, z] = [0, 1, 2].map(|c| root(xyz[c] / w[c]));
    let l = 116.0 * y - 16.0;
    [l, 0.01 * l * 500.0 * (x - y), 0.01 * l * 200.0 * (y - z)]
}

/// Returns the HyAB distance of colors, which remains valid for large differences.
fn distance(a: [f64; 3], b: [f64; 3]) -> f64 {
    (a[0] - b[0]).abs() + (a[1] - b[1]).hypot(a[2] - b[2])
}

/// Returns the difference of colors as seen by the eye, 0 to 1. Colors are filtered by contrast sensitivity first.
fn color_difference(a: &Planes, b: &Planes, size: [usize; 2]) -> Vec<f64> {
    let inverse = glam::DMat3::from_cols_array_2d(&TO_XYZ).transpose().inverse();
    let seen = |planes: &Planes| -> Vec<[f64; 3]> {
        let blurred = [0, 1, 2].map(|c| blur(&planes[c], size, &SENSITIVITY[c]));
        (0..planes[0].len()).map(|i| lab(shown([0, 1, 2].map(|c| blurred[c][i]), &inverse))).collect()
    };
    let most = distance(lab([0.0, 1.0, 0.0]), lab([0.0, 0.0, 1.0])).powf(COLOR_EXPONENT);
    let near = NEAR * most;
    let scaled = |d: f64| match d.powf(COLOR_EXPONENT) {
        d if d < near => d * NEAR_RANGE / near,
        d => (NEAR_RANGE + (d - near) / (most - near) * (1.0 - NEAR_RANGE)).min(1.0),
    };
    seen(a).iter().zip(seen(b)).map(|(a, b)| scaled(distance(*a, b))).collect()
}

/// Filters a plane by contrast sensitivity.
fn blur(plane: &[f64], size: [usize; 2], gaussians: &[(f64, f64)]) -> Vec<f64> {
    let pi = std::f64::consts::PI;
    let widest = SENSITIVITY.iter().flatten().map(|(_, b)| *b).fold(0.0, f64::max);
    let radius = (3.0 * (widest / (2.0 * pi * pi)).sqrt() * PIXELS_A_DEGREE).ceil() as i64;
    let (mut out, mut total) = (vec![0.0; plane.len()], 0.0);
    for (a, b) in gaussians.iter().filter(|(a, _)| *a > 0.0) {
        let weight = |i: i64| (-(pi * i as f64 / PIXELS_A_DEGREE).powi(2) / b).exp();
        let kernel: Vec<f64> = (-radius..=radius).map(weight).collect();
        let (sum, height) = (kernel.iter().sum::<f64>(), a * (pi / b).sqrt());
        total += height * sum * sum;
        let part = convolve(plane, size, &kernel, &kernel);
        out.iter_mut().zip(part).for_each(|(o, v)| *o += height * v);
    }
    out.iter_mut().for_each(|v| *v /= total);
    out
}

/// Returns the difference of edge and point strength, 0 to 1.
fn feature_difference(a: &[f64], b: &[f64], size: [usize; 2]) -> Vec<f64> {
    let sigma = 0.5 * FEATURE_WIDTH * PIXELS_A_DEGREE;
    let radius = (3.0 * sigma).ceil() as i64;
    let along = |f: &dyn Fn(f64) -> f64| -> Vec<f64> {
        let g = |i: i64| f(i as f64) * (-(i as f64).powi(2) / (2.0 * sigma * sigma)).exp();
        balanced((-radius..=radius).map(g).collect())
    };
    let smooth = along(&|_| 1.0);
    let edge = along(&|x| -x);
    let point = along(&|x| (x / sigma).powi(2) - 1.0);
    let strength = |plane: &[f64], kernel: &[f64]| -> Vec<f64> {
        let light: Vec<f64> = plane.iter().map(|y| (y + 16.0) / 116.0).collect();
        let x = convolve(&light, size, kernel, &smooth);
        let y = convolve(&light, size, &smooth, kernel);
        x.iter().zip(y).map(|(x, y)| x.hypot(y)).collect()
    };
    let difference = |kernel: &[f64]| -> Vec<f64> {
        strength(a, kernel).iter().zip(strength(b, kernel)).map(|(a, b)| (a - b).abs()).collect()
    };
    let larger = |(e, p): (&f64, f64)| (e.max(p) / 2.0_f64.sqrt()).powf(FEATURE_EXPONENT).min(1.0);
    difference(&edge).iter().zip(difference(&point)).map(larger).collect()
}

/// Scales a kernel. Its positive weights then sum to 1 and its negative weights to -1.
fn balanced(mut kernel: Vec<f64>) -> Vec<f64> {
    let sum = |sign: f64| kernel.iter().map(|k| (k * sign).max(0.0)).sum::<f64>().max(1e-300);
    let (above, below) = (sum(1.0), sum(-1.0));
    kernel.iter_mut().for_each(|k| *k /= if *k > 0.0 { above } else { below });
    kernel
}

/// Convolves rows with `across` and columns with `down`. Border pixels are repeated outside. Both kernels have the same
/// odd length.
fn convolve(plane: &[f64], [width, height]: [usize; 2], across: &[f64], down: &[f64]) -> Vec<f64> {
    let radius = across.len() / 2;
    let place = |i: usize, k: usize, n: usize| (i + k).saturating_sub(radius).min(n - 1);
    let mut half = vec![0.0; plane.len()];
    for (row, out) in plane.chunks_exact(width).zip(half.chunks_exact_mut(width)) {
        for (x, out) in out.iter_mut().enumerate() {
            *out = across.iter().enumerate().map(|(k, w)| w * row[place(x, k, width)]).sum();
        }
    }
    let mut out = vec![0.0; plane.len()];
    for (y, row) in out.chunks_exact_mut(width).enumerate() {
        for (k, w) in down.iter().enumerate() {
            let from = &half[place(y, k, height) * width..][..width];
            row.iter_mut().zip(from).for_each(|(o, v)| *o += w * v);
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    fn flat(color: [f32; 3]) -> Image {
        Image { width: 24, height: 20, channels: 3, data: color.repeat(480) }
    }

    #[test]
    fn scale_ranges_from_zero_to_one() {
        assert_eq!(flip(&flat([0.3, 0.5, 0.7]), &flat([0.3, 0.5, 0.7]), None), Ok(0.0));
        // Green against blue is the largest difference of the scale.
        let most = flip(&flat([0.0, 1.0, 0.0]), &flat([0.0, 0.0, 1.0]), None).unwrap();
        assert!((most - 1.0).abs() < 1e-6, "{most}");
        let near = flip(&flat([0.5; 3]), &flat([0.52; 3]), None).unwrap();
        assert!(near > 0.01 && near < 0.15, "{near}");
    }

    #[test]
    fn masked_pixels_do_not_count() {
        let (a, mut b) = (flat([0.2, 0.4, 0.6]), flat([0.2, 0.4, 0.6]));
        let mut mask = Image { width: 24, height: 20, channels: 1, data: vec![1.0; 480] };
        for i in 100..140 {
            b.data[3 * i..3 * i + 3].fill(1.0);
            mask.data[i] = 0.0;
        }
        assert!(flip(&a, &b, None).unwrap() > 0.05);
        assert_eq!(flip(&a, &b, Some(&mask)), Ok(0.0));
        mask.data.fill(0.0);
        assert_eq!(flip(&a, &b, Some(&mask)), Err(MetricError::Empty { measure: "flip" }));
        let gray = Image::new(24, 20, 1);
        assert!(flip(&gray, &gray, None).is_err());
    }

    #[test]
    fn kernels_are_balanced() {
        let k = balanced(vec![-2.0, 1.0, 0.0, 3.0, -6.0]);
        assert_eq!(k, [-0.25, 0.25, 0.0, 0.75, -0.75]);
        // A constant plane stays constant: the border is not darkened.
        let one = convolve(&[1.0; 6], [3, 2], &[0.25, 0.5, 0.25], &[0.25, 0.5, 0.25]);
        assert!(one.iter().all(|v| (v - 1.0).abs() < 1e-12));
    }
}
