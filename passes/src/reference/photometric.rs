//! Reference of `photometric`: L1 and SSIM of an image against a photograph. Includes the gradient.
//!
//! Written from the definition: 11 x 11 windows evaluated directly on the plain values. The kernel works differently
//! (separable, shifted, tiled).

/// Radius of the window of SSIM.
const RADIUS: i64 = 5;
/// Standard deviation of the window.
const SIGMA: f64 = 1.5;
/// Stabilizer of the means: (0.01)^2.
const C1: f64 = 1e-4;
/// Stabilizer of the variances: (0.03)^2.
const C2: f64 = 9e-4;

/// Layout of an image in memory, of which the first three channels are compared.
#[derive(Clone, Copy, Debug)]
pub struct Shape {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Floats per pixel.
    pub channels: usize,
}

impl Shape {
    /// Returns the number of pixels.
    pub fn pixels(self) -> usize {
        self.width * self.height
    }
}

/// Unweighted losses, as means over pixels and channels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Photometric {
    /// Mean absolute difference.
    pub l1: f64,
    /// Mean structural similarity (1 is equal).
    pub ssim: f64,
}

/// Returns a channel of a packed RGBA8 pixel in 0 to 1, rounded as in the kernel.
pub fn unpack(packed: u32, channel: usize) -> f64 {
    f64::from(((packed >> (8 * channel)) & 255) as f32 / 255.0)
}

/// Returns SSIM's window at an offset from its center. The sum over all 121 offsets is 1.
fn window(dx: i64, dy: i64) -> f64 {
    let tap = |d: i64| (-((d * d) as f64) / (2.0 * SIGMA * SIGMA)).exp();
    let sum: f64 = (-RADIUS..=RADIUS).map(tap).sum();
    tap(dx) * tap(dy) / (sum * sum)
}

/// Returns the window's 121 offsets and weights, row by row.
fn windows() -> Vec<(i64, i64, f64)> {
    (-RADIUS..=RADIUS).flat_map(|dy| (-RADIUS..=RADIUS).map(move |dx| (dx, dy, window(dx, dy)))).collect()
}

/// Returns SSIM at one pixel and its partial derivatives. The derivatives are those by the windowed means of x, x^2 and
/// xy.
fn ssim(ex: f64, ey: f64, exx: f64, eyy: f64, exy: f64) -> (f64, [f64; 3]) {
    let (a1, b1) = (2.0 * ex * ey + C1, ex * ex + ey * ey + C1);
    // Both bounds hold exactly; they only take effect where means are inexact.
    let variances = (exx - ex * ex + eyy - ey * ey).max(0.0);
    let covariance = (exy - ex * ey).clamp(-0.5 * variances, 0.5 * variances);
    let (a2, b2) = (2.0 * covariance + C2, variances + C2);
    let s = a1 * a2 / (b1 * b2);
    // b1 and b2 are positive; a1 and a2 need not be, so logarithms are not possible.
    let by_a1 = a2 / (b1 * b2);
    let by_a2 = a1 / (b1 * b2);
    let (by_b1, by_b2) = (-s / b1, -s / b2);
    let by_ex = 2.0 * ey * (by_a1 - by_a2) + 2.0 * ex * (by_b1 - by_b2);
    (s, [by_ex, by_b2, 2.0 * by_a2])
}

/// Returns SSIM of one channel summed over pixels, and the maps of derivatives. The fourth map holds the magnitude of
/// the first derivative's summands. `off` returns the error to add to a windowed mean of values minus one half, or of
/// their products, given the magnitude of its summands.
fn ssim_maps(x: &[f64], y: &[f64], shape: Shape, off: &mut dyn FnMut(f64) -> f64) -> (f64, Vec<[f64; 4]>) {
    let taps = windows();
    let mut sum = 0.0;
    let mut maps = Vec::with_capacity(shape.pixels());
    for row in 0..shape.height as i64 {
        for column in 0..shape.width as i64 {
            let (mut e, mut size) = ([0.0; 5], [0.0; 4]);
            for &(dx, dy, w) in &taps {
                let (mut a, mut b) = (0.0, 0.0);
                if let Some(i) = inside(shape, column + dx, row + dy) {
                    (a, b) = (x[i], y[i]);
                    for (e, v) in e.iter_mut().zip([a, b, a * a, b * b, a * b]) {
                        *e += w * v;
                    }
                }
                let (a, b) = (a - 0.5, b - 0.5);
                for (size, v) in size.iter_mut().zip([a, b, a * a + b * b, a * b]) {
                    *size += w * f64::abs(v);
                }
            }
            let [by_x, by_y, by_squares, by_products] = size.map(&mut *off);
            e[0] += by_x;
            e[1] += by_y;
            e[2] += by_squares + by_x;
            e[3] += by_y;
            e[4] += by_products + 0.5 * (by_x + by_y);
            let (s, [a, b, c]) = ssim(e[0], e[1], e[2], e[3], e[4]);
            sum += s;
            let made_of = a.abs() + b.abs() * (1.0 + 2.0 * size[0]) + c.abs() * (0.5 + size[1]);
            maps.push([a, b, c, made_of]);
        }
    }
    (sum, maps)
}

/// Returns the index of a pixel, if inside the image.
fn inside(shape: Shape, x: i64, y: i64) -> Option<usize> {
    let ok = x >= 0 && y >= 0 && x < shape.width as i64 && y < shape.height as i64;
    ok.then(|| y as usize * shape.width + x as usize)
}

/// Returns whether a packed pixel is compared; pixels with alpha 0 are not.
pub fn counts(packed: u32) -> bool {
    packed >> 24 != 0
}

/// Returns one channel of the image and of the photograph. A pixel that does not count equals the photograph.
fn channel(image: &[f64], targets: &[u32], shape: Shape, c: usize) -> (Vec<f64>, Vec<f64>) {
    let pixel = |p: usize| {
        let y = unpack(targets[p], c);
        (if counts(targets[p]) { image[p * shape.channels + c] } else { y }, y)
    };
    (0..shape.pixels()).map(pixel).unzip()
}

/// Returns L1 and SSIM. Wang et al. 2004; window, padding and means as in 3D Gaussian splatting.
pub fn photometric(image: &[f64], targets: &[u32], shape: Shape) -> Photometric {
    let (mut l1, mut sum) = (0.0, 0.0);
    for c in 0..3 {
        let (x, y) = channel(image, targets, shape, c);
        l1 += x.iter().zip(&y).map(|(x, y)| (x - y).abs()).sum::<f64>();
        sum += ssim_maps(&x, &y, shape, &mut |_| 0.0).0;
    }
    let n = 3.0 * shape.pixels() as f64;
    Photometric { l1: l1 / n, ssim: sum / n }
}

/// Returns the gradient of the weighted loss by the image. The loss is `weight_l1 * L1 + weight_dssim * (1 - SSIM)`.
/// Channels past the third are zero.
pub fn photometric_bwd(image: &[f64], targets: &[u32], shape: Shape, weight_l1: f64, weight_dssim: f64) -> Vec<f64> {
    photometric_bwd_off(image, targets, shape, [weight_l1, weight_dssim], &mut |_| 0.0).0
}

/// Returns the gradient with inexact windowed means, and rounding bounds. A bound is the magnitude of a gradient's
/// summands. `off` returns the error to add to a mean, given the magnitude of its summands. Values are reduced by one
/// half, as in the kernel.
pub fn photometric_bwd_off(
    image: &[f64],
    targets: &[u32],
    shape: Shape,
    [weight_l1, weight_dssim]: [f64; 2],
    off: &mut dyn FnMut(f64) -> f64,
) -> (Vec<f64>, Vec<f64>) {
    let taps = windows();
    let n = 3.0 * shape.pixels() as f64;
    let mut gradient = vec![0.0; shape.pixels() * shape.channels];
    let mut sizes = gradient.clone();
    for c in 0..3 {
        let (x, y) = channel(image, targets, shape, c);
        let (_, maps) = ssim_maps(&x, &y, shape, off);
        for p in 0..shape.pixels() {
            let (column, row) = ((p % shape.width) as i64, (p / shape.width) as i64);
            let (mut by_ssim, mut size) = (0.0, 0.0);
            for &(dx, dy, w) in &taps {
                if let Some(q) = inside(shape, column + dx, row + dy) {
                    let [a, b, c, made_of] = maps[q];
                    by_ssim += w * (a + 2.0 * x[p] * b + y[p] * c);
                    size += w * (made_of + (2.0 * (x[p] - 0.5) * b).abs() + ((y[p] - 0.5) * c).abs());
                }
            }
            let sign = if x[p] == y[p] { 0.0 } else { (x[p] - y[p]).signum() };
            if counts(targets[p]) {
                gradient[p * shape.channels + c] = (weight_l1 * sign - weight_dssim * by_ssim) / n;
                sizes[p * shape.channels + c] = (weight_l1 + weight_dssim * size) / n;
            }
        }
    }
    (gradient, sizes)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::Pcg;

    fn case(shape: Shape, seed: u32) -> (Vec<f64>, Vec<u32>) {
        let mut rng = Pcg::new(seed);
        let image = (0..shape.pixels() * shape.channels).map(|_| rng.uniform()).collect();
        (image, (0..shape.pixels()).map(|_| rng.next_u32()).collect())
    }

    #[test]
    fn window_sums_to_one() {
        assert!((windows().iter().map(|t| t.2).sum::<f64>() - 1.0).abs() < 1e-14);
    }

    #[test]
    fn equal_images_have_no_loss() {
        let shape = Shape { width: 9, height: 4, channels: 3 };
        let (_, targets) = case(shape, 1);
        let image: Vec<f64> = targets.iter().flat_map(|&t| [0, 1, 2].map(|c| unpack(t, c))).collect();
        let r = photometric(&image, &targets, shape);
        assert!(r.l1 == 0.0 && (r.ssim - 1.0).abs() < 1e-12, "{r:?}");
        assert!(photometric_bwd(&image, &targets, shape, 0.8, 0.2).iter().all(|g| g.abs() < 1e-12));
    }

    #[test]
    fn pixels_that_do_not_count_have_no_loss_and_no_gradient() {
        let shape = Shape { width: 14, height: 9, channels: 3 };
        let (mut image, mut targets) = case(shape, 3);
        for (p, t) in targets.iter_mut().enumerate() {
            *t = (*t & 0x00ff_ffff) | if p % 14 < 5 { 0 } else { 0xff00_0000 };
        }
        let (loss, gradient) =
            (photometric(&image, &targets, shape), photometric_bwd(&image, &targets, shape, 0.8, 0.2));
        for p in (0..shape.pixels()).filter(|p| p % 14 < 5) {
            assert_eq!(gradient[3 * p..3 * p + 3], [0.0; 3]);
            image[3 * p..3 * p + 3].fill(f64::NAN);
        }
        assert_eq!(photometric(&image, &targets, shape), loss);
        assert_eq!(photometric_bwd(&image, &targets, shape, 0.8, 0.2), gradient);
        // If every pixel counts, the same image has another loss.
        targets.iter_mut().for_each(|t| *t |= 0xff00_0000);
        assert!(photometric(&image, &targets, shape).l1.is_nan());
    }

    #[test]
    fn gradient_matches_finite_differences() {
        for (width, height, channels) in [(1, 1, 3), (7, 13, 3), (17, 3, 5)] {
            let shape = Shape { width, height, channels };
            let (mut image, targets) = case(shape, 7);
            let gradient = photometric_bwd(&image, &targets, shape, 0.8, 0.2);
            let h = 1e-5;
            for i in 0..image.len() {
                let x = image[i];
                let mut loss = |x: f64| {
                    image[i] = x;
                    let r = photometric(&image, &targets, shape);
                    0.8 * r.l1 + 0.2 * (1.0 - r.ssim)
                };
                let fd = (loss(x + h) - loss(x - h)) / (2.0 * h);
                loss(x);
                assert!((fd - gradient[i]).abs() < 1e-7 + 1e-5 * fd.abs(), "{shape:?} {i}: {fd} {}", gradient[i]);
            }
        }
    }
}
