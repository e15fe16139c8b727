//! Material values before and after activation.

use sgs_scene::{ALBEDO_RANGE as ALBEDO, ROUGHNESS_RANGE as ROUGHNESS};

/// Minimum distance from the ends of the range. Values at the ends would be infinite before activation.
const MARGIN: f32 = 1e-4;

/// Converts the ends of an albedo range to its low end and its width.
pub fn span([low, high]: [f32; 2]) -> [f32; 2] {
    // Files use exactly these constants; the difference is not bit-identical.
    if [low, high] == [0.01, 0.99] { ALBEDO } else { [low, high - low] }
}

/// Converts raw albedo to another range. Values outside it are clamped.
pub fn in_range(raw: Vec<f32>, from: [f32; 2], to: [f32; 2]) -> Vec<f32> {
    if from == to {
        return raw;
    }
    raw.into_iter().map(|raw| logit((from[0] + from[1] * sigmoid(raw) - to[0]) / to[1])).collect()
}

/// Returns albedo before activation. Values outside the range are clamped.
pub fn raw(value: f32) -> f32 {
    logit((value - ALBEDO[0]) / ALBEDO[1])
}

/// Returns roughness before activation.
pub fn raw_roughness(value: f32) -> f32 {
    logit((value - ROUGHNESS[0]) / ROUGHNESS[1])
}

/// Returns metallic before activation.
pub fn raw_metallic(value: f32) -> f32 {
    logit(value)
}

/// Returns albedo after activation.
pub fn value(raw: f32) -> f32 {
    ALBEDO[0] + ALBEDO[1] * sigmoid(raw)
}

/// Returns roughness after activation.
pub fn roughness_value(raw: f32) -> f32 {
    ROUGHNESS[0] + ROUGHNESS[1] * sigmoid(raw)
}

fn logit(share: f32) -> f32 {
    let p = share.clamp(MARGIN, 1.0 - MARGIN);
    (p / (1.0 - p)).ln()
}

/// Logistic function.
pub fn sigmoid(raw: f32) -> f32 {
    1.0 / (1.0 + (-raw).exp())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn albedo_keeps_its_values_in_another_range() {
        let published = span([0.09, 0.99]);
        let of = |raw: f32, [low, range]: [f32; 2]| low + range * sigmoid(raw);
        for raw in [-3.0, -1.0, 0.0, 0.5, 4.0] {
            let there = in_range(vec![raw], published, ALBEDO)[0];
            assert!((of(raw, published) - of(there, ALBEDO)).abs() < 1e-6, "{raw}");
            let back = in_range(vec![there], ALBEDO, published)[0];
            assert!((back - raw).abs() < 1e-3, "{raw} {back}");
        }
        // Values below the range become its low end.
        let dark = in_range(vec![-9.0], ALBEDO, published)[0];
        assert!(dark.is_finite() && of(dark, published) < 0.0902);
        assert_eq!(in_range(vec![-9.0], ALBEDO, span([0.01, 0.99])), [-9.0]);
    }
}
