//! References of `gbuffer`, `weights` and `materials` in double precision.

use super::blend::Blended;
use super::project::{Camera, Projected};
use glam::{DVec2, DVec3};

/// Minimum coverage of a pixel with a surface.
pub const LEAST_COVERAGE: f64 = 1e-3;

/// Visible surfaces of a view, by pixel.
#[derive(Clone, Debug, Default)]
pub struct Surfaces {
    /// World-space points.
    pub points: Vec<DVec3>,
    /// Unit normals or zero.
    pub normals: Vec<DVec3>,
    /// Opacity.
    pub coverage: Vec<f64>,
}

/// Computes surfaces from blended normals and depth. A pixel has `channels` channels; normal, z and z² are the last
/// five.
pub fn gbuffer(camera: &Camera, blended: &Blended, channels: usize) -> Surfaces {
    let mut s = Surfaces::default();
    for (p, transmittance) in blended.transmittance.iter().enumerate() {
        let coverage = 1.0 - transmittance;
        let at = &blended.image[p * channels + channels - 5..(p + 1) * channels];
        s.coverage.push(coverage);
        if coverage < LEAST_COVERAGE {
            s.points.push(DVec3::ZERO);
            s.normals.push(DVec3::ZERO);
            continue;
        }
        let width = camera.size[0] as usize;
        let pixel = DVec2::new((p % width) as f64 + 0.5, (p / width) as f64 + 0.5);
        let z = at[3] / coverage;
        let seen = ((pixel - camera.center) / camera.focal * z).extend(z);
        s.points.push(camera.rotation.transpose() * (seen - camera.translation));
        s.normals.push(DVec3::from_slice(at).normalize_or_zero());
    }
    s
}

/// Returns the visible Gaussians of every pixel, nearest first, with their weights. Weights are divided by the pixel's
/// opacity.
pub fn weights(splats: &[Projected], size: [u32; 2]) -> Vec<Vec<(usize, f64)>> {
    let [width, height] = size.map(|s| s as usize);
    let pixel = |p: usize| {
        let at = DVec2::new((p % width) as f64 + 0.5, (p / width) as f64 + 0.5);
        let (mut transmittance, mut row) = (1.0, Vec::new());
        for s in splats {
            let reach = s.reach() + 1.0;
            if (at - s.mean).abs().cmpgt(reach + 0.5).any() {
                continue;
            }
            let alpha = s.alpha(at).min(0.99);
            if alpha < 1.0 / 255.0 {
                continue;
            }
            let next = transmittance * (1.0 - alpha);
            if next < 1e-4 {
                break;
            }
            row.push((s.id, alpha * transmittance));
            transmittance = next;
        }
        let coverage = 1.0 - transmittance;
        let scale = if coverage >= LEAST_COVERAGE { 1.0 / coverage } else { 0.0 };
        row.iter_mut().for_each(|(_, w)| *w *= scale);
        row
    };
    (0..width * height).map(pixel).collect()
}

/// Rounds rows to 16 bits, in units of 1/65535. The rounding error is carried along the row.
pub fn stored_rows(rows: &[Vec<(usize, f64)>]) -> Vec<Vec<(usize, f64)>> {
    let row = |row: &Vec<(usize, f64)>| {
        let mut carried = 0.0;
        let mut rounded = |w: f64| {
            let parts = (65535.0 * w + carried).round_ties_even().clamp(0.0, 65535.0);
            carried += 65535.0 * w - parts;
            parts / 65535.0
        };
        row.iter().map(|(i, w)| (*i, rounded(*w))).collect()
    };
    rows.iter().map(row).collect()
}

/// Materials before activation. Each Gaussian has albedo (3), roughness and, where `metallic` is not empty, metallic.
#[derive(Clone, Debug, Default)]
pub struct Materials {
    /// Albedo, 3 per Gaussian.
    pub albedo: Vec<f64>,
    /// Roughness, 1 per Gaussian.
    pub roughness: Vec<f64>,
    /// Metallic, 1 per Gaussian, or empty.
    pub metallic: Vec<f64>,
    /// Lowest albedo, and the range above it.
    pub albedo_range: [f64; 2],
}

fn sigmoid(x: f64) -> f64 {
    1.0 / (1.0 + (-x).exp())
}

impl Materials {
    /// Returns albedo, roughness and metallic of one Gaussian.
    pub fn values(&self, i: usize) -> [f64; 5] {
        let metallic = self.metallic.get(i).map_or(0.0, |m| sigmoid(*m));
        let [low, range] = self.albedo_range;
        let [r, g, b] = [0, 1, 2].map(|c| low + range * sigmoid(self.albedo[3 * i + c]));
        [r, g, b, 0.09 + 0.9 * sigmoid(self.roughness[i]), metallic]
    }

    /// Returns the blended materials of every pixel.
    pub fn blend(&self, rows: &[Vec<(usize, f64)>]) -> Vec<[f64; 5]> {
        let sum = |row: &Vec<(usize, f64)>| {
            let mut sum = [0.0; 5];
            for (i, w) in row {
                self.values(*i).iter().zip(&mut sum).for_each(|(v, s)| *s += w * v);
            }
            sum
        };
        rows.iter().map(sum).collect()
    }
}
