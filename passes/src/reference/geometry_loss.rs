//! Reference of `geometry_loss` and its gradients. The terms are prior normals, prior depths, edge-aware smoothness and
//! the variance of depth.
//!
//! Filters are applied tap by tap, and transposed by scattering tap by tap, without the kernel's rearrangements.

use super::photometric::{counts, unpack};
use super::project::Camera;
use crate::loss::octahedral::octahedral_decode;
use crate::loss::unpack_depth;
use glam::{DMat3, DVec2, DVec3};

/// Minimum divisor, as in the kernel; smaller divisors are replaced by it.
pub const FLOOR: f64 = 1e-3;
/// Minimum variance under the root.
pub const VARIANCE_MIN: f64 = 1e-6;

/// Focal lengths and principal point in pixels, and radial distortion.
#[derive(Clone, Copy, Debug)]
pub struct Lens {
    /// Focal lengths.
    pub focal: DVec2,
    /// Principal point.
    pub center: DVec2,
    /// As in [`Camera::radial`].
    pub radial: f64,
}

/// Blended values and the targets that they are compared with.
#[derive(Clone, Debug)]
pub struct Scene {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Blended normals, if any.
    pub normals: Option<Vec<[f64; 3]>>,
    /// Blended depth and squared depth, if any.
    pub depths: Option<Vec<[f64; 2]>>,
    /// Transmittance.
    pub transmittance: Vec<f64>,
    /// Packed prior normals, if any.
    pub priors: Option<Vec<u32>>,
    /// Packed prior depths, if any.
    pub depth_priors: Option<Vec<u32>>,
    /// Slope and offset from prior values to inverse depths. A constant of the loss.
    pub depth_line: Option<[f64; 2]>,
    /// Lenses of the view and of the prior depths, if they differ.
    ///
    pub depth_lens: Option<[Lens; 2]>,
    /// Photograph, packed RGBA8. Pixels with alpha 0 are invalid.
    pub photo: Vec<u32>,
}

/// Unweighted losses, as means over all pixels; or their weights.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Terms {
    /// 1 - cos of the angle to the prior; pixels without a prior count as 0.
    pub normal: f64,
    /// Edge-aware smoothness of the unit normals, also averaged over coordinates.
    pub normal_smooth: f64,
    /// Edge-aware smoothness of depth, also averaged over the photograph's channels.
    pub depth_smooth: f64,
    /// Standard deviation of depth along the ray.
    pub depth_variance: f64,
    /// Confidence times the relative difference from the prior depth; pixels without one count as 0.
    pub depth: f64,
}

/// Gradients of the blended values.
#[derive(Clone, Debug)]
pub struct Gradient {
    /// Gradient of normals.
    pub normals: Vec<[f64; 3]>,
    /// Gradient of depth and squared depth.
    pub depths: Vec<[f64; 2]>,
    /// Gradient of transmittance.
    pub transmittance: Vec<f64>,
}

impl Scene {
    fn pixels(&self) -> usize {
        self.width * self.height
    }

    fn camera(&self, lens: Lens) -> Camera {
        Camera {
            rotation: DMat3::IDENTITY,
            translation: DVec3::ZERO,
            focal: lens.focal,
            center: lens.center,
            size: [self.width as u32, self.height as u32],
            near: 0.0,
            radial: lens.radial,
        }
    }

    fn unit_normals(&self) -> Vec<[f64; 3]> {
        self.normals.iter().flatten().map(|n| n.map(|x| x / length(*n).max(FLOOR))).collect()
    }

    /// Returns whether a pixel of the photograph is valid. Others have no terms.
    fn valid(&self, p: usize) -> bool {
        counts(self.photo[p])
    }

    fn opacity(&self, p: usize) -> f64 {
        1.0 - self.transmittance[p]
    }

    fn depth(&self) -> Vec<f64> {
        let depths = self.depths.iter().flatten();
        depths.enumerate().map(|(p, d)| d[0] / self.opacity(p).max(FLOOR)).collect()
    }

    /// Returns the inverse and the confidence of a pixel's prior depth.
    fn depth_prior(&self, p: usize) -> Option<[f64; 2]> {
        let at = match self.depth_lens {
            None => p,
            Some([view, sensor]) => {
                let pixel = [p % self.width, p / self.width].map(|n| n as f64 + 0.5);
                let slope = self.camera(view).slope(pixel.into());
                let [x, y] = (slope * sensor.focal + sensor.center).to_array();
                let inside = (0.0..self.width as f64).contains(&x) && (0.0..self.height as f64).contains(&y);
                inside.then_some(y as usize * self.width + x as usize)?
            }
        };
        let [value, confidence] = unpack_depth(self.depth_priors.as_ref()?[at])?;
        let inverse = self.depth_line.map_or(value, |[slope, offset]| slope * value + offset);
        (inverse > 0.0).then_some([inverse, confidence])
    }

    fn variance(&self, p: usize, depth: f64) -> f64 {
        let square = self.depths.as_ref().map_or(0.0, |d| d[p][1] / self.opacity(p).max(FLOOR));
        square - depth * depth
    }

    /// Returns the nine taps, pixel and weight, of a direction's Sobel filter. The taps surround pixel `p`. Borders
    /// repeat. Returns none if a tap is invalid.
    fn taps(&self, p: usize, vertical: bool) -> Option<Vec<(usize, f64)>> {
        let (x, y) = ((p % self.width) as i64, (p / self.width) as i64);
        let mut taps = Vec::with_capacity(9);
        for dy in -1..=1_i64 {
            for dx in -1..=1_i64 {
                let (along, across) = if vertical { (dy, dx) } else { (dx, dy) };
                let column = (x + dx).clamp(0, self.width as i64 - 1) as usize;
                let row = (y + dy).clamp(0, self.height as i64 - 1) as usize;
                taps.push((row * self.width + column, (along * (2 - across.abs())) as f64 / 8.0));
            }
        }
        taps.iter().all(|&(q, _)| self.valid(q)).then_some(taps)
    }

    /// Returns `exp(-|gradient|)` of the photograph, by channel.
    fn edge(&self, taps: &[(usize, f64)]) -> [f64; 3] {
        [0, 1, 2].map(|c| {
            let g: f64 = taps.iter().map(|&(q, w)| w * unpack(self.photo[q], c)).sum();
            (-g.abs()).exp()
        })
    }
}

/// Returns slope and offset from prior values to inverse blended depths.
///
/// Zero if no line with a positive slope fits, as in [`crate::loss::depth_fit()`].
pub fn depth_line(s: &Scene, shift: bool) -> [f64; 2] {
    let mut rows = Vec::new();
    for (p, word) in s.depth_priors.iter().flatten().enumerate() {
        let (opacity, depth) = (s.opacity(p), s.depths.as_ref().map_or(0.0, |d| d[p][0]));
        if let Some([x, confidence]) = unpack_depth(*word)
            && opacity >= 0.5
            && depth > 0.0
        {
            rows.push((confidence * opacity, x, opacity / depth));
        }
    }
    let mean = |f: &dyn Fn(f64, f64) -> f64| {
        rows.iter().map(|(w, x, y)| w * f(*x, *y)).sum::<f64>() / rows.iter().map(|r| r.0).sum::<f64>()
    };
    let (x, y) = if shift { (mean(&|x, _| x), mean(&|_, y| y)) } else { (0.0, 0.0) };
    let slope = mean(&|a, b| (a - x) * (b - y)) / mean(&|a, _| (a - x).powi(2));
    if slope.is_finite() && slope > 0.0 { [slope, y - slope * x] } else { [0.0; 2] }
}

fn length(v: [f64; 3]) -> f64 {
    v.iter().map(|x| x * x).sum::<f64>().sqrt()
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// Returns the losses (SGS-Intrinsic, stage I). Smoothness is the Sobel filter over 8, times exp of the photograph's
/// negative gradient magnitude, summed over the two directions.
pub fn geometry_loss(s: &Scene) -> Terms {
    let (units, depth) = (s.unit_normals(), s.depth());
    let mut t = Terms::default();
    for p in 0..s.pixels() {
        for vertical in [false, true] {
            let Some(taps) = s.taps(p, vertical) else { continue };
            let edge = s.edge(&taps);
            if s.normals.is_some() {
                for c in 0..3 {
                    t.normal_smooth += edge[c] * taps.iter().map(|&(q, w)| w * units[q][c]).sum::<f64>().abs();
                }
            }
            if s.depths.is_some() {
                let g = taps.iter().map(|&(q, w)| w * depth[q]).sum::<f64>().abs();
                t.depth_smooth += edge.iter().sum::<f64>() / 3.0 * g;
            }
        }
        if !s.valid(p) {
            continue;
        }
        if let (Some(priors), true) = (&s.priors, s.normals.is_some())
            && let Some(prior) = octahedral_decode(priors[p])
        {
            t.normal += 1.0 - dot(units[p], prior);
        }
        if s.depths.is_some() {
            t.depth_variance += s.variance(p, depth[p]).max(VARIANCE_MIN).sqrt();
            if let Some([inverse, confidence]) = s.depth_prior(p) {
                t.depth += confidence * (depth[p] * inverse - 1.0).abs();
            }
        }
    }
    let n = s.pixels() as f64;
    Terms {
        normal: t.normal / n,
        normal_smooth: t.normal_smooth / (3.0 * n),
        depth_smooth: t.depth_smooth / n,
        depth_variance: t.depth_variance / n,
        depth: t.depth / n,
    }
}

fn sign(x: f64) -> f64 {
    if x == 0.0 { 0.0 } else { x.signum() }
}

/// Returns the gradient of the losses with these weights.
pub fn geometry_loss_bwd(s: &Scene, weights: &Terms) -> Gradient {
    geometry_loss_bwd_sized(s, weights).0
}

/// Returns the gradient and the magnitudes of the summands of each of its numbers.
pub fn geometry_loss_bwd_sized(s: &Scene, weights: &Terms) -> (Gradient, Gradient) {
    let (units, depth) = (s.unit_normals(), s.depth());
    let n = s.pixels() as f64;
    // Sums, and the sums of magnitudes.
    let mut by_unit = vec![[[0.0; 2]; 3]; units.len()];
    let mut by_depth = vec![[0.0; 2]; depth.len()];
    let add = |to: &mut [f64; 2], x: f64| *to = [to[0] + x, to[1] + x.abs()];
    for p in 0..s.pixels() {
        for vertical in [false, true] {
            let Some(taps) = s.taps(p, vertical) else { continue };
            let edge = s.edge(&taps);
            if s.normals.is_some() {
                for c in 0..3 {
                    let g: f64 = taps.iter().map(|&(q, w)| w * units[q][c]).sum();
                    for &(q, w) in &taps {
                        add(&mut by_unit[q][c], weights.normal_smooth / (3.0 * n) * edge[c] * sign(g) * w);
                    }
                }
            }
            if s.depths.is_some() {
                let g: f64 = taps.iter().map(|&(q, w)| w * depth[q]).sum();
                for &(q, w) in &taps {
                    add(&mut by_depth[q], weights.depth_smooth / n * edge.iter().sum::<f64>() / 3.0 * sign(g) * w);
                }
            }
        }
        if let (Some(priors), true) = (&s.priors, s.normals.is_some() && s.valid(p))
            && let Some(prior) = octahedral_decode(priors[p])
        {
            for c in 0..3 {
                // Coordinates of unit vectors have summands near one.
                let [sum, all] = by_unit[p][c];
                by_unit[p][c] = [sum - weights.normal / n * prior[c], all + weights.normal / n];
            }
        }
    }
    let none = Gradient { normals: vec![], depths: vec![], transmittance: vec![0.0; s.pixels()] };
    let (mut out, mut sizes) = (none.clone(), none);
    for (p, &blended) in s.normals.iter().flatten().enumerate() {
        if !s.valid(p) {
            out.normals.push([0.0; 3]);
            sizes.normals.push([0.0; 3]);
            continue;
        }
        let (size, unit) = (length(blended), units[p]);
        let (g, all) = (by_unit[p].map(|g| g[0]), by_unit[p].map(|g| g[1]));
        let (along, most) = if size > FLOOR { (dot(unit, g), dot(unit.map(f64::abs), all)) } else { (0.0, 0.0) };
        out.normals.push([0, 1, 2].map(|c| (g[c] - unit[c] * along) / size.max(FLOOR)));
        sizes.normals.push([0, 1, 2].map(|c| (all[c] + unit[c].abs() * most) / size.max(FLOOR)));
    }
    for (p, &[z, z2]) in s.depths.iter().flatten().enumerate() {
        if !s.valid(p) {
            out.depths.push([0.0; 2]);
            sizes.depths.push([0.0; 2]);
            continue;
        }
        let (opacity, variance) = (s.opacity(p), s.variance(p, depth[p]));
        let by_variance = match variance > VARIANCE_MIN {
            true => weights.depth_variance / n * 0.5 / variance.sqrt(),
            false => 0.0,
        };
        let [smooth, all] = by_depth[p];
        let by_prior = s.depth_prior(p).map_or(0.0, |[inverse, confidence]| {
            weights.depth / n * confidence * inverse * sign(depth[p] * inverse - 1.0)
        });
        let by_depth = smooth - 2.0 * depth[p] * by_variance + by_prior;
        let most = all + 2.0 * depth[p].abs() * by_variance + by_prior.abs();
        let divisor = opacity.max(FLOOR);
        out.depths.push([by_depth / divisor, by_variance / divisor]);
        sizes.depths.push([most / divisor, by_variance / divisor]);
        if opacity > FLOOR {
            out.transmittance[p] = (by_depth * z + by_variance * z2) / (opacity * opacity);
            sizes.transmittance[p] = (most * z.abs() + by_variance * z2.abs()) / (opacity * opacity);
        }
    }
    (out, sizes)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::loss::octahedral::octahedral_encode;
    use crate::loss::pack_depth;
    use crate::rng::Pcg;

    /// A depth from 1 to 20, unknown for a fifth of the pixels.
    fn random_depth(rng: &mut Pcg) -> u32 {
        let depth = if rng.uniform() < 0.2 { 0.0 } else { rng.range(1.0, 20.0) };
        pack_depth(depth as f32, rng.range(0.1, 1.0) as f32)
    }

    fn lens([fx, fy, cx, cy]: [f64; 4], radial: f64) -> Lens {
        Lens { focal: DVec2::new(fx, fy), center: DVec2::new(cx, cy), radial }
    }

    fn scene(width: usize, height: usize) -> Scene {
        let mut rng = Pcg::new(width as u32);
        let n = width * height;
        let normal = |rng: &mut Pcg| [rng.normal(), rng.normal(), rng.normal()];
        Scene {
            width,
            height,
            normals: Some((0..n).map(|_| normal(&mut rng)).collect()),
            depths: Some((0..n).map(|_| [rng.range(1.0, 2.0), rng.range(6.0, 9.0)]).collect()),
            transmittance: (0..n).map(|_| rng.range(0.1, 0.9)).collect(),
            priors: Some((0..n).map(|_| octahedral_encode(normal(&mut rng).map(|x| x as f32))).collect()),
            depth_priors: Some((0..n).map(|_| random_depth(&mut rng)).collect()),
            depth_line: (width.is_multiple_of(2)).then_some([0.7, -0.05]),
            depth_lens: (width == 6).then_some([lens([7.0, 7.0, 3.0, 2.0], 0.05), lens([7.7, 6.5, 3.2, 2.3], 0.0)]),
            photo: (0..n).map(|p| (rng.next_u32() & 0x00ff_ffff) | if p % 7 == 3 { 0 } else { 0xff00_0000 }).collect(),
        }
    }

    #[test]
    fn gradient_matches_finite_differences() {
        let weights = Terms { normal: 0.3, normal_smooth: 0.7, depth_smooth: 0.5, depth_variance: 0.9, depth: 0.6 };
        for (width, height) in [(1, 1), (1, 5), (6, 4)] {
            let mut s = scene(width, height);
            let gradient = geometry_loss_bwd(&s, &weights);
            let loss = |s: &Scene| {
                let t = geometry_loss(s);
                0.3 * t.normal + 0.7 * t.normal_smooth + 0.5 * t.depth_smooth + 0.9 * t.depth_variance + 0.6 * t.depth
            };
            let mut check = |of: &dyn Fn(&mut Scene) -> &mut f64, expected: f64| {
                let x = *of(&mut s);
                *of(&mut s) = x + 1e-6;
                let up = loss(&s);
                *of(&mut s) = x - 1e-6;
                let fd = (up - loss(&s)) / 2e-6;
                *of(&mut s) = x;
                assert!((fd - expected).abs() < 1e-7 + 1e-6 * fd.abs(), "{width}x{height}: {fd} {expected}");
            };
            for p in 0..width * height {
                for c in 0..3 {
                    check(&|s| &mut s.normals.as_mut().unwrap()[p][c], gradient.normals[p][c]);
                }
                for c in 0..2 {
                    check(&|s| &mut s.depths.as_mut().unwrap()[p][c], gradient.depths[p][c]);
                }
                check(&|s| &mut s.transmittance[p], gradient.transmittance[p]);
            }
        }
    }

    #[test]
    fn invalid_pixels_have_no_loss_and_no_gradient() {
        let weights = Terms { normal: 0.3, normal_smooth: 0.7, depth_smooth: 0.5, depth_variance: 0.9, depth: 0.6 };
        let mut s = scene(6, 4);
        let (loss, gradient) = (geometry_loss(&s), geometry_loss_bwd(&s, &weights));
        for p in (0..24).filter(|p| p % 7 == 3) {
            s.normals.as_mut().unwrap()[p] = [f64::NAN; 3];
            s.depths.as_mut().unwrap()[p] = [f64::NAN; 2];
            s.transmittance[p] = f64::NAN;
            assert_eq!((gradient.normals[p], gradient.depths[p], gradient.transmittance[p]), ([0.0; 3], [0.0; 2], 0.0));
        }
        assert_eq!(geometry_loss(&s), loss);
        let again = geometry_loss_bwd(&s, &weights);
        assert_eq!((&again.normals, &again.depths), (&gradient.normals, &gradient.depths));
        assert_eq!(again.transmittance, gradient.transmittance);
        // If every pixel is valid, all terms differ.
        s = scene(6, 4);
        s.photo.iter_mut().for_each(|word| *word |= 0xff00_0000);
        let all = geometry_loss(&s);
        assert!(all.normal > loss.normal && all.normal_smooth > loss.normal_smooth, "{all:?} {loss:?}");
        assert!(all.depth_smooth > loss.depth_smooth && all.depth_variance > loss.depth_variance, "{all:?} {loss:?}");
    }

    #[test]
    fn flat_wall_with_exact_prior_has_minimal_loss() {
        let n = 30;
        let s = Scene {
            width: 6,
            height: 5,
            normals: Some(vec![[0.0, 0.0, -0.7]; n]),
            depths: Some(vec![[1.4, 2.8]; n]),
            transmittance: vec![0.3; n],
            priors: Some([vec![octahedral_encode([0.0, 0.0, -1.0]); 20], vec![0; 10]].concat()),
            depth_priors: Some([vec![pack_depth(2.0, 0.5); 20], vec![0; 10]].concat()),
            depth_line: None,
            depth_lens: None,
            photo: (0..n as u32).map(|p| p | 0xff00_0000).collect(),
        };
        let t = geometry_loss(&s);
        assert!(t.normal.abs() < 1e-8 && t.normal_smooth == 0.0 && t.depth_smooth < 1e-12, "{t:?}");
        assert!((t.depth_variance - 1e-3).abs() < 1e-6, "{t:?}");
        assert!(t.depth < 1e-12, "{t:?}");
        // A wall at half the distance differs by a half of the prior, in two thirds of the pixels.
        let near = Scene { depth_priors: Some([vec![pack_depth(4.0, 0.5); 20], vec![0; 10]].concat()), ..s };
        assert!((geometry_loss(&near).depth - 0.5 * 0.5 * 2.0 / 3.0).abs() < 1e-9);
    }
}
