//! Reference of `compose` and its gradients: radiance over a background, in sRGB. The result is clamped at white.

use super::gbuffer::LEAST_COVERAGE;
use super::srgb;

/// Returns the linear light of a pixel: the shaded contribution, and the total.
fn composed(radiance: [f64; 3], coverage: f64, background: [f64; 3]) -> [[f64; 3]; 2] {
    let light = radiance.map(|x| if coverage >= LEAST_COVERAGE { x * coverage } else { 0.0 });
    let all = [0, 1, 2].map(|c| {
        let light = if light[c].is_finite() { light[c] } else { 0.0 };
        light + (1.0 - coverage) * srgb::decode(background[c])
    });
    [light, all]
}

/// Returns the image, three numbers per pixel, and the number of saturated pixels. A pixel is saturated if a channel
/// was clamped at white. `radiance` is direct and ambient light together.
pub fn compose(radiance: &[[f64; 3]], coverage: &[f64], background: [f64; 3]) -> (Vec<f64>, usize) {
    let all: Vec<[f64; 3]> = radiance.iter().zip(coverage).map(|(&r, &c)| composed(r, c, background)[1]).collect();
    let saturated = all.iter().filter(|l| l.iter().any(|&x| x > 1.0)).count();
    (all.as_flattened().iter().map(|&x| srgb::encode(x)).collect(), saturated)
}

/// Returns the gradient of radiance. Clamped values have none.
pub fn compose_bwd(radiance: &[[f64; 3]], coverage: &[f64], background: [f64; 3], by_image: &[f64]) -> Vec<f64> {
    let mut out = Vec::new();
    for (p, (&r, &covered)) in radiance.iter().zip(coverage).enumerate() {
        let [light, all] = composed(r, covered, background);
        for c in 0..3 {
            let (x, g) = (all[c], by_image[3 * p + c]);
            let counts = (0.0..=1.0).contains(&x) && covered >= LEAST_COVERAGE && light[c].is_finite();
            out.push(if counts { g * covered * srgb::slope(x) } else { 0.0 });
        }
    }
    out
}
