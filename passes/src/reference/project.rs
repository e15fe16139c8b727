//! Reference of `project` in double precision on the CPU.
//!
//! Written from the textbook (EWA splatting, Zwicker et al. 2001, as 3DGS uses it) with the quadratic form, not from
//! the kernel. An error in one is therefore not repeated in the other.

use super::stored::stored;
use crate::Accuracy;
use crate::scene::SEMANTIC_FEATURES;
use glam::{DMat3, DVec2, DVec3};

/// Pinhole camera in OpenCV axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Camera {
    /// Rotation from world to camera.
    pub rotation: DMat3,
    /// Translation from world to camera.
    pub translation: DVec3,
    /// Focal lengths in pixels.
    pub focal: DVec2,
    /// Principal point in pixels.
    pub center: DVec2,
    /// Columns and rows.
    pub size: [u32; 2],
    /// Near plane: minimum visible depth along z.
    pub near: f64,
    /// Radial distortion: the shift at half the image's diagonal.
    ///
    /// It is the shift of a pixel at that distance from the principal point, relative to this distance, and grows with its third power.
    pub radial: f64,
}

impl Camera {
    /// Returns a distorted offset and the columns of its derivative.
    ///
    /// Offsets are from the principal point, in pixels.
    pub(super) fn distorted(&self, offset: DVec2) -> (DVec2, [DVec2; 2]) {
        let half = 0.5 * f64::from(self.size[0]).hypot(f64::from(self.size[1]));
        let r = offset.length() / half;
        let factor = |r: f64| 1.0 + self.radial * r.powi(2);
        // Along the radius the derivative is that of r times its factor, across it is the factor.
        let along = 1.0 + 3.0 * self.radial * r.powi(2);
        let direction = offset.normalize_or_zero();
        let column = |axis: DVec2| {
            let part = axis.dot(direction) * direction;
            along * part + factor(r) * (axis - part)
        };
        (factor(r) * offset, [column(DVec2::X), column(DVec2::Y)])
    }

    /// Returns the slopes x/z and y/z of the points that a pixel shows.
    pub fn slope(&self, pixel: DVec2) -> DVec2 {
        let target = pixel - self.center;
        let mut offset = target;
        for _ in 0..200 {
            offset += target - self.distorted(offset).0;
        }
        offset / self.focal
    }
}

/// Parameters of some Gaussians, before activation.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Gaussians {
    /// Centers, 3 per Gaussian.
    pub means: Vec<f64>,
    /// Logarithms of scales, 3.
    pub log_scales: Vec<f64>,
    /// Quaternions w, x, y, z, 4; any length.
    pub rotations: Vec<f64>,
    /// Opacities before the sigmoid, 1.
    pub opacity_logits: Vec<f64>,
    /// Spherical harmonics by band: 3, 9, 15 and 21, coefficient-major. Empty above the degree.
    pub sh: [Vec<f64>; 4],
    /// Normals, 3; empty if absent.
    pub normals: Vec<f64>,
    /// Semantic features, [`SEMANTIC_FEATURES`]; empty if absent.
    pub semantics: Vec<f64>,
    /// Whether opacities are scaled by the 2D Mip filter.
    pub mip: bool,
}

impl Gaussians {
    /// Returns the number of Gaussians.
    pub fn len(&self) -> usize {
        self.opacity_logits.len()
    }

    /// Returns whether the set is empty.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

/// Gaussian projected to one camera.
#[derive(Clone, Debug)]
pub struct Projected {
    /// Index of the Gaussian.
    pub id: usize,
    /// Depth along z.
    pub depth: f64,
    /// Center in pixels.
    pub mean: DVec2,
    /// Scaled axes in pixels: x of the three axes, then y. The covariance is the sums of their products, plus the
    /// dilation of 0.3.
    pub axes: [DVec3; 2],
    /// Opacity after the sigmoid and the filter.
    pub opacity: f64,
    /// RGB, normal if present, z and z² if requested, semantic features.
    pub features: Vec<f64>,
    /// Sort key.
    pub key: u32,
    /// Whether rounding in single precision may change the key.
    pub key_doubtful: bool,
    /// Maximum change of the stored color by rounding in single precision.
    pub color_doubt: f64,
    /// Minimum alpha of a pixel that counts.
    pub alpha_min: f64,
}

impl Projected {
    /// Returns the opacity times the Gaussian at a pixel position. The value is not yet clamped at 0.99.
    pub fn alpha(&self, at: DVec2) -> f64 {
        let (d, [x, y]) = (at - self.mean, self.axes);
        // The covariance is 0.3 on the diagonal plus a sum of products. Its determinant is computed from the axes
        // (Lagrange's identity). A determinant of products loses all digits for Gaussians of condition number 1e16,
        // even in double precision.
        let determinant = x.cross(y).length_squared() + 0.3 * (x.length_squared() + y.length_squared()) + 0.09;
        let power = 0.5 * ((d.x * y - d.y * x).length_squared() + 0.3 * d.length_squared()) / determinant;
        self.opacity * (-power).exp()
    }

    /// Returns the half width and height of the box where alpha reaches `alpha_min`.
    pub fn reach(&self) -> DVec2 {
        let k = 2.0 * (self.opacity / self.alpha_min).ln().max(0.0);
        let [x, y] = self.axes.map(|axis| axis.length_squared() + 0.3);
        DVec2::new((k * x).sqrt(), (k * y).sqrt())
    }
}

/// Projects every visible Gaussian, nearest first. Ties keep the order of the input.
pub fn project(g: &Gaussians, camera: &Camera, sh_degree: usize, depth: bool) -> Vec<Projected> {
    project_at(g, camera, sh_degree, depth, &Accuracy::EXACT)
}

/// Projects like [`project`] at a given accuracy.
pub fn project_at(g: &Gaussians, camera: &Camera, sh_degree: usize, depth: bool, a: &Accuracy) -> Vec<Projected> {
    let one = |i| project_one(g, i, camera, sh_degree, depth, a);
    let mut seen: Vec<Projected> = (0..g.len()).filter_map(one).collect();
    if a.depth_bits >= 31 {
        seen.sort_by(|a, b| a.depth.total_cmp(&b.depth));
    } else {
        seen.sort_by_key(|s| s.key);
    }
    seen
}

/// Returns the sort key of a depth. The key is the depth's single-precision bits above those of the near plane. The
/// lowest bits are dropped to fit `bits`.
fn depth_key(z: f64, near: f64, bits: u32) -> u32 {
    let z = (z as f32).to_bits();
    if bits >= 31 {
        return z;
    }
    (z.saturating_sub((near as f32).max(1e-30).to_bits()) >> (28 - bits)).min((1 << bits) - 1)
}

fn project_one(
    g: &Gaussians,
    i: usize,
    camera: &Camera,
    sh_degree: usize,
    with_depth: bool,
    a: &Accuracy,
) -> Option<Projected> {
    let alpha_min = f64::from(a.alpha_min);
    let mean = DVec3::from_slice(&g.means[3 * i..]);
    let p = camera.rotation * mean + camera.translation;
    let opacity = 1.0 / (1.0 + (-g.opacity_logits[i]).exp());
    let finite = mean.is_finite() && g.log_scales[3 * i..3 * i + 3].iter().all(|s| s.is_finite());
    if !(finite && g.opacity_logits[i].is_finite() && p.z >= camera.near && p.z.is_finite() && opacity >= alpha_min) {
        return None;
    }
    let scale = DVec3::from_slice(&g.log_scales[3 * i..]).clamp(DVec3::splat(-16.0), DVec3::splat(8.0)).map(f64::exp);
    let m = rotation(&g.rotations[4 * i..4 * i + 4]) * DMat3::from_diagonal(scale);
    let q = camera.rotation * m;
    let half = DVec2::new(f64::from(camera.size[0]), f64::from(camera.size[1])) / (2.0 * camera.focal);
    let middle = half - camera.center / camera.focal;
    let slope = DVec2::new(p.x, p.y) / p.z;
    let held = slope.clamp(middle - 1.3 * half, middle + 1.3 * half);
    let (rx, ry, rz) = (q.row(0), q.row(1), q.row(2));
    let t0 = camera.focal.x / p.z * (rx - held.x * rz);
    let t1 = camera.focal.y / p.z * (ry - held.y * rz);
    // Beyond the held slopes the image goes straight on.
    let (place, [x, y]) = camera.distorted(camera.focal * held);
    let (t0, t1) = (x.x * t0 + y.x * t1, x.y * t0 + y.y * t1);
    let beyond = camera.focal * (slope - held);
    let center = place + beyond.x * x + beyond.y * y + camera.center;
    if !(t0.is_finite() && t1.is_finite() && center.is_finite()) {
        return None;
    }
    let filtered = match g.mip {
        true => opacity * mip_factor([t0, t1]),
        false => opacity,
    };
    if filtered < alpha_min {
        return None;
    }
    let color = color(g, i, camera, mean, sh_degree);
    let rounded = |by: f64| color.map(|c| stored(c + by * c.max(1.0), a.color_bits));
    let color_doubt = if a.color_bits < 32 { (rounded(5e-7) - rounded(-5e-7)).abs().max_element() } else { 0.0 };
    let mut features = rounded(0.0).to_array().to_vec();
    if !g.normals.is_empty() {
        let n = DVec3::from_slice(&g.normals[3 * i..]);
        features.extend((n / n.length().max(1e-3)).to_array());
    }
    if with_depth {
        // Depth is limited so that single precision can hold the square.
        let z = p.z.min(1e18);
        features.extend([z, z * z]);
    }
    if !g.semantics.is_empty() {
        let width = SEMANTIC_FEATURES as usize;
        features.extend(&g.semantics[width * i..width * (i + 1)]);
    }
    let key = |scale: f64| depth_key(p.z * scale, camera.near, a.depth_bits);
    let projected = Projected {
        id: i,
        depth: p.z,
        mean: center,
        axes: [t0, t1],
        opacity: filtered,
        features,
        key: key(1.0),
        key_doubtful: key(1.0 - 1e-6) != key(1.0 + 1e-6),
        color_doubt,
        alpha_min,
    };
    // A box without a pixel center is invisible.
    let reach = projected.reach();
    let low = (center - reach - 0.5).ceil().max(DVec2::ZERO);
    let size = DVec2::new(f64::from(camera.size[0]), f64::from(camera.size[1]));
    let high = (center + reach - 0.5).floor().min(size - 1.0);
    (low.x <= high.x && low.y <= high.y).then_some(projected)
}

/// Returns the factor of the 2D Mip filter on an opacity.
///
/// It is the root of the ratio of the determinants without and with dilation. Yu et al. 2024, Mip-Splatting, equation 10. `axes`: scaled axes in pixels, x then y.
pub fn mip_factor(axes: [DVec3; 2]) -> f64 {
    // Eigenvalues of the covariance, rather than the determinants of the kernel. The small one from the product, which is a sum
    // of squares.
    let [x, y] = axes;
    let (a, b, c) = (x.length_squared(), x.dot(y), y.length_squared());
    let large = 0.5 * (a + c) + (0.25 * (a - c).powi(2) + b * b).sqrt();
    if large <= 0.0 {
        return 0.0;
    }
    let small = x.cross(y).length_squared() / large;
    [large, small].iter().map(|v| (v / (v + 0.3)).sqrt()).product()
}

/// Returns the rotation matrix of a quaternion of any length. The identity if the quaternion is zero or not finite.
pub fn rotation(q: &[f64]) -> DMat3 {
    let largest = q.iter().fold(0.0_f64, |m, v| m.max(v.abs()));
    if !(largest > 0.0 && largest.is_finite() && q.iter().all(|v| v.is_finite())) {
        return DMat3::IDENTITY;
    }
    let scaled: Vec<f64> = q.iter().map(|v| v / largest).collect();
    DMat3::from_quat(glam::DQuat::from_xyzw(scaled[1], scaled[2], scaled[3], scaled[0]).normalize())
}

/// Returns the color of a Gaussian seen from the camera. The color is the harmonics plus one half, clamped at black.
fn color(g: &Gaussians, i: usize, camera: &Camera, mean: DVec3, degree: usize) -> DVec3 {
    let position = -(camera.rotation.transpose() * camera.translation);
    let away = mean - position;
    let d = away / away.length().max(1e-15);
    let mut sum = DVec3::splat(0.5);
    for (band, coefficients) in g.sh.iter().enumerate().take(degree + 1) {
        if coefficients.is_empty() {
            continue;
        }
        for (k, y) in harmonics(band, d).into_iter().enumerate() {
            sum += y * DVec3::from_slice(&coefficients[3 * ((2 * band + 1) * i + k)..]);
        }
    }
    sum.map(|v| if v > 0.0 { v.min(1e6) } else { 0.0 })
}

/// Returns the real harmonics of one band, with the signs of 3DGS. Built from associated Legendre functions; the signs
/// are those of the Condon–Shortley phase with axes x, y, z.
fn harmonics(band: usize, d: DVec3) -> Vec<f64> {
    let l = band as i32;
    let radius = d.x.hypot(d.y);
    let (cos, sin) = if radius > 0.0 { (d.x / radius, d.y / radius) } else { (1.0, 0.0) };
    (-l..=l)
        .map(|m| {
            let order = m.unsigned_abs();
            let factorial = |n: u32| (1..=n).map(f64::from).product::<f64>();
            let norm = ((2.0 * f64::from(l) + 1.0) / (4.0 * std::f64::consts::PI) * factorial(l as u32 - order)
                / factorial(l as u32 + order))
            .sqrt();
            // cos(m phi) and sin(m phi) by complex powers of the azimuth.
            let (mut c, mut s) = (1.0, 0.0);
            for _ in 0..order {
                (c, s) = (c * cos - s * sin, c * sin + s * cos);
            }
            let legendre = legendre(l as u32, order, d.z, radius);
            match m {
                0 => norm * legendre,
                m if m > 0 => std::f64::consts::SQRT_2 * norm * c * legendre,
                _ => std::f64::consts::SQRT_2 * norm * s * legendre,
            }
        })
        .collect()
}

/// Returns the associated Legendre function with the Condon–Shortley phase. `s` is the sine of the polar angle.
fn legendre(l: u32, m: u32, x: f64, s: f64) -> f64 {
    let mut pmm = 1.0;
    for k in 1..=m {
        pmm *= -(2.0 * f64::from(k) - 1.0) * s;
    }
    if l == m {
        return pmm;
    }
    let mut next = x * (2.0 * f64::from(m) + 1.0) * pmm;
    let mut last = pmm;
    for k in m + 2..=l {
        let value = (x * (2.0 * f64::from(k) - 1.0) * next - f64::from(k + m - 1) * last) / f64::from(k - m);
        (last, next) = (next, value);
    }
    next
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn harmonics_have_the_signs_of_3dgs() {
        let d = DVec3::new(0.3, -0.5, 0.8).normalize();
        let y1 = harmonics(1, d);
        let c1 = 0.4886025119029199;
        for (a, b) in y1.iter().zip([-c1 * d.y, c1 * d.z, -c1 * d.x]) {
            assert!((a - b).abs() < 1e-12);
        }
        let y2 = harmonics(2, d);
        assert!((y2[0] - 1.0925484305920792 * d.x * d.y).abs() < 1e-12);
        assert!((y2[1] + 1.0925484305920792 * d.y * d.z).abs() < 1e-12);
        let y3 = harmonics(3, d);
        assert!((y3[6] + 0.5900435899266435 * d.x * (d.x * d.x - 3.0 * d.y * d.y)).abs() < 1e-12);
    }

    /// The filter's factor keeps the opacity summed over the image.
    #[test]
    fn mip_factor_keeps_the_sum_of_opacity() {
        for axes in [
            [DVec3::new(2.0, 0.1, 0.0), DVec3::new(-0.3, 1.5, 0.2)],
            [DVec3::new(0.1, 0.02, 0.0), DVec3::new(0.03, 0.2, 0.0)],
            [DVec3::new(5.0, 0.0, 0.0), DVec3::new(4.9, 1e-3, 0.0)],
            [DVec3::ZERO, DVec3::ZERO],
        ] {
            let [x, y] = axes;
            let (a, b, c) = (x.length_squared(), x.dot(y), y.length_squared());
            let area = |d: f64| ((a + d) * (c + d) - b * b).max(0.0).sqrt();
            let factor = mip_factor(axes);
            assert!((factor * area(0.3) - area(0.0)).abs() < 1e-9 * area(0.3), "{axes:?}: {factor}");
            assert!((0.0..=1.0).contains(&factor));
        }
    }
}
