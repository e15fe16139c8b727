//! Reference of `material_images` and its gradients: images of materials. Albedo is encoded in sRGB, roughness is
//! gray.

use super::gbuffer::LEAST_COVERAGE;
use super::srgb;

/// Returns images of albedo in sRGB and of gray roughness, three numbers per pixel. `materials` holds the linear albedo
/// and the roughness of each pixel.
pub fn material_images(materials: &[[f64; 4]], coverage: &[f64]) -> (Vec<f64>, Vec<f64>) {
    let (mut albedo, mut roughness) = (Vec::new(), Vec::new());
    for (m, &c) in materials.iter().zip(coverage) {
        let m = if c >= LEAST_COVERAGE { *m } else { [0.0; 4] };
        albedo.extend([m[0], m[1], m[2]].map(srgb::encode));
        roughness.extend([if m[3].is_finite() { m[3] } else { 0.0 }; 3]);
    }
    (albedo, roughness)
}

/// Returns the gradients of materials from those of both images.
pub fn material_images_bwd(
    materials: &[[f64; 4]],
    coverage: &[f64],
    by_albedo: &[f64],
    by_roughness: &[f64],
) -> Vec<[f64; 4]> {
    let pixel = |(p, m): (usize, &[f64; 4])| {
        if coverage[p] < LEAST_COVERAGE {
            return [0.0; 4];
        }
        let [r, g, b] = [0, 1, 2].map(|c| srgb::derivative(m[c]) * by_albedo[3 * p + c]);
        let gray: f64 = by_roughness[3 * p..3 * p + 3].iter().sum();
        [r, g, b, if m[3].is_finite() { gray } else { 0.0 }]
    };
    materials.iter().enumerate().map(pixel).collect()
}
