//! Distinguishable colors for classes.
//!
//! Guarantees: the color of a class depends on its index in the list only. Images of all runs with the same list
//! agree. Classes beyond the last color start again with the first.

/// Number of levels of each primary color among the candidates.
const STEPS: u32 = 7;

/// sRGB color, 8 bits per channel.
pub type Color = [u8; 3];

/// Returns `count` colors that differ as much as possible.
///
/// Each color is the candidate farthest from the earlier colors, black, white and gray. Distances are Euclidean in
/// Oklab, a perceptually uniform space.
pub fn colors(count: usize) -> Vec<Color> {
    let level = |i: u32| (i * 255 / (STEPS - 1)) as u8;
    let all = (0..STEPS.pow(3)).map(|i| [i / STEPS / STEPS, i / STEPS % STEPS, i % STEPS].map(level));
    // Darker colors are indistinguishable from black on a screen.
    let candidates: Vec<(Color, [f64; 3])> = all.map(|c| (c, oklab(c))).filter(|(_, lab)| lab[0] > 0.45).collect();
    let taken = [[0; 3], [255; 3], [128; 3]].map(oklab);
    let apart = |a: &[f64; 3], b: &[f64; 3]| a.iter().zip(b).map(|(x, y)| (x - y).powi(2)).sum::<f64>();
    let nearest = |lab: &[f64; 3]| taken.iter().map(|t| apart(lab, t)).fold(f64::INFINITY, f64::min);
    let mut distance: Vec<f64> = candidates.iter().map(|(_, lab)| nearest(lab)).collect();
    let mut chosen = Vec::new();
    while chosen.len() < count.min(candidates.len()) {
        let farther = |best: usize, i: usize| if distance[i] > distance[best] { i } else { best };
        let best = (0..candidates.len()).fold(0, farther);
        let (color, lab) = candidates[best];
        chosen.push(color);
        distance.iter_mut().zip(&candidates).for_each(|(d, (_, other))| *d = d.min(apart(&lab, other)));
    }
    (0..count).map(|i| chosen[i % chosen.len()]).collect()
}

/// Returns the color in HTML notation, `#rrggbb`.
pub fn hex([r, g, b]: Color) -> String {
    format!("#{r:02x}{g:02x}{b:02x}")
}

/// Converts to Oklab: lightness and two opponent colors.
///
/// Source: Ottosson 2020, "A perceptual color space for image processing".
fn oklab(color: Color) -> [f64; 3] {
    let [r, g, b] = color.map(|v| f64::from(sgs_scene::srgb_to_linear(f32::from(v) / 255.0)));
    let l = (0.412_221_470_8 * r + 0.536_332_536_3 * g + 0.051_445_992_9 * b).cbrt();
    let m = (0.211_903_498_2 * r + 0.680_699_545_1 * g + 0.107_396_956_6 * b).cbrt();
    let s = (0.088_302_461_9 * r + 0.281_718_837_6 * g + 0.629_978_700_5 * b).cbrt();
    [
        0.210_454_255_3 * l + 0.793_617_785_0 * m - 0.004_072_046_8 * s,
        1.977_998_495_1 * l - 2.428_592_205_0 * m + 0.450_593_709_9 * s,
        0.025_904_037_1 * l + 0.782_771_766_2 * m - 0.808_675_766_0 * s,
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn oklab_matches_published_values() {
        for (color, expected) in
            [([255; 3], [1.0, 0.0, 0.0]), ([255, 0, 0], [0.628, 0.225, 0.126]), ([0, 0, 255], [0.452, -0.032, -0.312])]
        {
            let found = oklab(color);
            assert!(found.iter().zip(expected).all(|(f, e)| (f - e).abs() < 1e-3), "{color:?}: {found:?}");
        }
    }

    #[test]
    fn colors_are_distinct_and_independent_of_their_number() {
        let many = colors(64);
        for (i, a) in many.iter().enumerate() {
            for b in &many[..i] {
                let d: i32 = a.iter().zip(b).map(|(x, y)| (i32::from(*x) - i32::from(*y)).abs()).sum();
                assert!(d >= 42, "{a:?} and {b:?}");
            }
        }
        assert_eq!(colors(5), many[..5]);
        assert_eq!(hex([0, 18, 255]), "#0012ff");
        assert!(colors(0).is_empty());
        // More classes than candidate colors.
        assert_eq!(colors(1000).len(), 1000);
    }
}
