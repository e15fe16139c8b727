//! Reference of `transport_reflect`: radiance of surfels and patches that reaches the specular lobe of a pixel.

use super::brdf::{ALPHA_MIN, V3, along, dot, unit};
use super::lights::Pixel;
use super::transport::{Bounds, Disc, Possible};
use crate::rng::{random_bits, uniform_from};
use std::f64::consts::PI;

/// Smallest n.v of a pixel's rays.
const FACING_MIN: f64 = 0.01;
/// Smallest weight of a disc.
const EDGE_MIN: f64 = 1e-6;

/// Surfaces that pixels reflect, and options of the rays.
#[derive(Clone, Debug)]
pub struct Room {
    /// Discs.
    pub discs: Vec<Disc>,
    /// Box that closes the scene.
    pub bounds: Bounds,
    /// Radiosity of discs, then patches, as a radiance.
    pub radiosity: Vec<V3>,
    /// Distance above the surface at which rays begin.
    pub offset: f64,
    /// Depth behind the first disc in which discs count.
    pub window: f64,
    /// Seed of the directions.
    pub seed: u32,
    /// Number of rays of a pixel that is no mirror.
    pub rays: u32,
    /// Roughness below which a pixel has one ray.
    pub mirror: f64,
    /// Roughness from which reflections fade.
    pub fade: f64,
    /// Roughness from which there are none.
    pub diffuse: f64,
}

/// Reflected radiance of a pixel.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Reflected {
    /// Radiance.
    pub radiance: V3,
    /// Number of rays.
    pub rays: u32,
    /// Whether rounding may decide which discs or patches a ray meets.
    pub unsure: bool,
}

/// Ray of a lobe, and its weight.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LobeRay {
    /// Unit direction.
    pub along: V3,
    /// G2 / G1.
    pub weight: f64,
}

impl Room {
    /// Returns the radiance along a ray, and whether rounding may decide it.
    pub fn radiance_along(&self, from: V3, direction: V3) -> (V3, bool) {
        let passes: Vec<_> = self.discs.iter().map(|d| d.pass(from, direction)).collect();
        let first = passes.iter().filter(|p| p.met).map(|p| p.at).fold(f64::INFINITY, f64::min);
        let mut unsure =
            self.discs.iter().zip(&passes).any(|(d, p)| self.doubtful(d, p, from, direction, first + self.window));
        if first.is_infinite() {
            let (radiance, steep) = self.patch_radiance(from, direction);
            return (radiance, unsure || steep);
        }
        let mut sum = [0.0; 4];
        for (i, (disc, p)) in self.discs.iter().zip(&passes).enumerate() {
            if !p.met || p.at > first + self.window {
                continue;
            }
            // Distances are differences of coordinates; grazing rays amplify their rounding.
            unsure |= p.doubt > 1e-3 * self.window;
            let beside = along(along(from, p.at, direction), -1.0, disc.point);
            let edge = (1.0 - dot(beside, beside) / (disc.radius * disc.radius)).max(EDGE_MIN);
            let weight = edge * (1.0 - (p.at - first) / self.window).max(EDGE_MIN);
            (0..3).for_each(|c| sum[c] += weight * self.radiosity[i][c]);
            sum[3] += weight;
        }
        ([sum[0], sum[1], sum[2]].map(|x| x / sum[3]), unsure)
    }

    /// Returns whether rounding may decide if a ray meets a disc before `reach`.
    fn doubtful(&self, disc: &Disc, p: &Possible, from: V3, direction: V3, reach: f64) -> bool {
        // Angles between ray and direction in 24-bit numbers, at most.
        let angle = 4e-6;
        let beside = along(along(from, p.at, direction), -1.0, disc.point);
        let (facing, apart) = (dot(disc.normal, direction), dot(beside, beside).sqrt());
        let margin = p.doubt + angle * (1.0 + p.at.abs()) / facing.abs().max(1e-12);
        let near = p.at < reach + margin && p.at > -margin;
        near && (p.unsure || (apart - disc.radius).abs() < margin || (facing.abs() < angle && apart < disc.radius))
    }

    /// Returns the radiance of the patches where a ray leaves the box.
    ///
    /// It is bilinear between their centers. The second result says whether rounding may decide the face.
    pub fn patch_radiance(&self, from: V3, direction: V3) -> (V3, bool) {
        let b = &self.bounds;
        let inside: V3 = std::array::from_fn(|k| from[k].clamp(b.low[k], b.high[k]));
        let wall = |k: usize| if direction[k] > 0.0 { b.high[k] } else { b.low[k] };
        let reach = |k: usize| if direction[k] == 0.0 { f64::INFINITY } else { (wall(k) - inside[k]) / direction[k] };
        let axis = (1..3).fold(0, |best, k| if reach(k) < reach(best) { k } else { best });
        let unsure = (0..3).any(|k| k != axis && reach(k) - reach(axis) < 1e-5 * (1.0 + reach(axis)))
            || direction[axis].abs() < 1e-3;
        let place = along(inside, reach(axis), direction);
        let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
        let share = |k: usize| {
            let last = f64::from(b.cells[k] - 1);
            let at = ((place[k] - b.low[k]) / (b.high[k] - b.low[k]) * f64::from(b.cells[k]) - 0.5).clamp(0.0, last);
            let low = at.floor();
            (low as usize, (low + 1.0).min(last) as usize, at - low)
        };
        let (a, c) = (share(u), share(v));
        let size = |k: usize| (b.cells[(k + 1) % 3] * b.cells[(k + 2) % 3]) as usize;
        let before: usize = (0..axis).map(|k| 2 * size(k)).sum();
        let first = self.discs.len() + before + if direction[axis] > 0.0 { size(axis) } else { 0 };
        let at = |i: usize, j: usize| self.radiosity[first + i + b.cells[u] as usize * j];
        let mix = |x: V3, y: V3, t: f64| std::array::from_fn(|k| x[k] + t * (y[k] - x[k]));
        let rows = [c.0, c.1].map(|j| mix(at(a.0, j), at(a.1, j), a.2));
        (mix(rows[0], rows[1], c.2), unsure)
    }

    /// Returns the rays of a pixel.
    pub fn lobe(&self, camera: V3, p: &Pixel, index: u32) -> Vec<LobeRay> {
        let n = p.normal;
        let v = unit(along(camera, -1.0, p.point));
        let facing = dot(n, v);
        let v = unit(along(v, facing.max(FACING_MIN) - facing, n));
        let side = if n[2] >= 0.0 { 1.0 } else { -1.0 };
        let c = -1.0 / (side + n[2]);
        let d = n[0] * n[1] * c;
        let tangent = [1.0 + side * n[0] * n[0] * c, side * d, -side * n[0]];
        let bitangent = [d, side + n[1] * n[1] * c, -n[1]];
        let local = [dot(v, tangent), dot(v, bitangent), dot(v, n)];
        let mirror = p.material.roughness < self.mirror;
        let alpha = (p.material.roughness * p.material.roughness).max(ALPHA_MIN);
        let g = |z: f64| (alpha * alpha + z * z * (1.0 - alpha * alpha)).sqrt();
        let shift = random_bits(self.seed, index, 0);
        let ray = |s: u32| {
            let radial = (f64::from(s) + 0.5) / f64::from(self.rays);
            let turn = uniform_from(shift.wrapping_add(s.reverse_bits()));
            let h = if mirror { [0.0, 0.0, 1.0] } else { visible_normal(local, alpha, [radial, turn]) };
            let l = along(local.map(|x| -x), 2.0 * dot(local, h), h);
            let weight = l[2] * (local[2] + g(local[2])) / (l[2] * g(local[2]) + local[2] * g(l[2]));
            let along = std::array::from_fn(|k| l[0] * tangent[k] + l[1] * bitangent[k] + l[2] * n[k]);
            (l[2] > 0.0).then_some(LobeRay { along: unit(along), weight })
        };
        (0..if mirror { 1 } else { self.rays }).filter_map(ray).collect()
    }

    /// Returns the radiance that reaches the lobe of a pixel with number `index`.
    pub fn reflect(&self, camera: V3, p: &Pixel, index: u32, irradiance: V3) -> Reflected {
        if p.coverage < 1e-3 || p.normal == [0.0; 3] {
            return Reflected::default();
        }
        let gathered = irradiance.map(|e| e / PI);
        let none = Reflected { radiance: gathered, ..Default::default() };
        let finite = p.point.iter().chain(&p.normal).all(|x| x.is_finite());
        // Neither does a roughness that is not a number trace rays.
        if !finite || p.material.roughness.is_nan() || p.material.roughness >= self.diffuse {
            return none;
        }
        let (mut sum, mut all, mut unsure) = ([0.0; 3], 0.0, false);
        let from = along(p.point, self.offset, p.normal);
        for ray in self.lobe(camera, p, index) {
            let (radiance, doubt) = self.radiance_along(from, ray.along);
            sum = along(sum, ray.weight, radiance);
            all += ray.weight;
            unsure |= doubt;
        }
        if all == 0.0 {
            return none;
        }
        let share = ((self.diffuse - p.material.roughness) / (self.diffuse - self.fade)).clamp(0.0, 1.0);
        let radiance = std::array::from_fn(|c| share * sum[c] / all + (1.0 - share) * gathered[c]);
        let rays = if p.material.roughness < self.mirror { 1 } else { self.rays };
        Reflected { radiance, rays, unsure }
    }
}

/// Returns a visible normal around z.
///
/// `view` is a unit direction above the surface, `x` a point in (0, 1)². Source: Dupuy and Benyoub 2023.
pub fn visible_normal(view: V3, alpha: f64, x: [f64; 2]) -> V3 {
    let stretched = unit([alpha * view[0], alpha * view[1], view[2]]);
    let z = (1.0 - x[0]) * (1.0 + stretched[2]) - stretched[2];
    let sine = (1.0 - z * z).max(0.0).sqrt();
    let (sin, cos) = (2.0 * PI * x[1]).sin_cos();
    let h = [sine * cos + stretched[0], sine * sin + stretched[1], z + stretched[2]];
    unit([alpha * h[0], alpha * h[1], h[2].max(0.0)])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reference::brdf::{Material, brdf};

    /// Tests total weight and mean direction of rays against a quadrature.
    #[test]
    fn rays_have_the_distribution_of_the_lobe() {
        for roughness in [0.15, 0.4, 0.7, 1.0] {
            for nv in [0.1, 0.5, 0.95_f64] {
                let (v, n) = ([(1.0 - nv * nv).sqrt(), 0.0, nv], [0.0, 0.0, 1.0]);
                let alpha: f64 = roughness * roughness;
                let g = |z: f64| (alpha.powi(2) + z * z * (1.0 - alpha.powi(2))).sqrt();
                let count = 200;
                let mut found = [0.0; 4];
                // Light directions over the hemisphere, denser about the mirrored view.
                let mut right = [0.0; 4];
                let material = Material { albedo: [1.0; 3], roughness, metallic: 1.0 };
                for i in 0..count {
                    for j in 0..count {
                        let x = [i, j].map(|k| (f64::from(k) + 0.5) / f64::from(count));
                        let h = visible_normal(v, alpha, x);
                        let l = along(v.map(|x| -x), 2.0 * dot(v, h), h);
                        if l[2] > 0.0 {
                            let weight = l[2] * (nv + g(nv)) / (l[2] * g(nv) + nv * g(l[2]));
                            (0..3).for_each(|k| found[k] += weight * l[k]);
                            found[3] += weight;
                        }
                        // The density of half vectors is D (n.h).
                        let nh = ((1.0 - x[0]) / (1.0 + (alpha * alpha - 1.0) * x[0])).sqrt();
                        let (sin, cos) = (2.0 * PI * x[1]).sin_cos();
                        let h = [(1.0 - nh * nh).sqrt() * cos, (1.0 - nh * nh).sqrt() * sin, nh];
                        let vh = dot(v, h);
                        let l = along(v.map(|x| -x), 2.0 * vh, h);
                        if vh > 0.0 && l[2] > 0.0 {
                            let d = alpha * alpha / (PI * (alpha * alpha * nh * nh + 1.0 - nh * nh).powi(2));
                            let weight = brdf(material, n, l, v)[1][0] * l[2] * 4.0 * vh / (d * nh);
                            (0..3).for_each(|k| right[k] += weight * l[k]);
                            right[3] += weight;
                        }
                    }
                }
                let points = f64::from(count * count);
                for k in 0..4 {
                    let (is, should) = (found[k] / points, right[k] / points);
                    assert!((is - should).abs() < 5e-3, "{roughness} {nv} {k}: {is} {should}");
                }
            }
        }
    }
}
