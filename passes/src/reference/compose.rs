//! Twin of `compose`: light over a background, in sRGB, cut off at white, with the way back.

use super::gbuffer::LEAST_COVERAGE;
use super::srgb;

/// The linear light of a pixel: the shaded part, and all of it.
fn composed(radiance: [f64; 3], coverage: f64, background: [f64; 3]) -> [[f64; 3]; 2] {
    let light = radiance.map(|x| if coverage >= LEAST_COVERAGE { x * coverage } else { 0.0 });
    let all = [0, 1, 2].map(|c| {
        let light = if light[c].is_finite() { light[c] } else { 0.0 };
        light + (1.0 - coverage) * srgb::decode(background[c])
    });
    [light, all]
}

/// The picture, three numbers a pixel, and how many pixels have a channel that was cut off at white. `radiance`: direct and
/// ambient light together.
pub fn compose(radiance: &[[f64; 3]], coverage: &[f64], background: [f64; 3]) -> (Vec<f64>, usize) {
    let all: Vec<[f64; 3]> = radiance.iter().zip(coverage).map(|(&r, &c)| composed(r, c, background)[1]).collect();
    let saturated = all.iter().filter(|l| l.iter().any(|&x| x > 1.0)).count();
    (all.as_flattened().iter().map(|&x| srgb::encode(x)).collect(), saturated)
}

/// Gradient by radiance. `returning`: what was cut off keeps those gradients that lead it back.
pub fn compose_bwd(
    radiance: &[[f64; 3]],
    coverage: &[f64],
    background: [f64; 3],
    by_image: &[f64],
    returning: bool,
) -> Vec<f64> {
    let mut out = Vec::new();
    for (p, (&r, &covered)) in radiance.iter().zip(coverage).enumerate() {
        let [light, all] = composed(r, covered, background);
        for c in 0..3 {
            let (x, g) = (all[c], by_image[3 * p + c]);
            let kept = match () {
                () if x > 1.0 => returning && g > 0.0,
                () if x < 0.0 => returning && g < 0.0,
                () => true,
            };
            let counts = kept && covered >= LEAST_COVERAGE && light[c].is_finite();
            out.push(if counts { g * covered * srgb::slope(x) } else { 0.0 });
        }
    }
    out
}
