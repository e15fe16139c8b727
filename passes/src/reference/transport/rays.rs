//! Rays, discs and the box around them.

use super::{V3, dot};
use crate::rng::{random_bits, uniform_from};

/// One-sided disc.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Disc {
    /// Center.
    pub point: V3,
    /// Unit normal.
    pub normal: V3,
    /// Radius.
    pub radius: f64,
}

/// How a ray passes a disc.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Possible {
    /// Distance at which the ray meets the disc's plane.
    pub at: f64,
    /// Error of the distance, in a computation with 24-bit numbers.
    pub doubt: f64,
    /// Whether the ray meets the disc.
    pub met: bool,
    /// Whether rounding may decide that.
    pub unsure: bool,
}

impl Disc {
    /// Returns whether a ray can meet the disc: finite, with a normal and an area.
    pub fn is_real(&self) -> bool {
        let finite = self.point.iter().chain(&self.normal).all(|x| x.is_finite()) && self.radius.is_finite();
        finite && dot(self.normal, self.normal) > 0.0 && self.radius > 0.0
    }

    /// Intersects a ray of unit direction.
    pub fn pass(&self, from: V3, along: V3) -> Possible {
        if !self.is_real() {
            return Possible { at: f64::INFINITY, doubt: 0.0, met: false, unsure: false };
        }
        let to: V3 = std::array::from_fn(|k| self.point[k] - from[k]);
        let facing = dot(self.normal, along);
        let at = dot(self.normal, to) / facing;
        let beside: V3 = std::array::from_fn(|k| at * along[k] - to[k]);
        let apart = dot(beside, beside).sqrt();
        let met = facing < 0.0 && at > 0.0 && apart <= self.radius;
        // Rounding of coordinates shifts the hit by their size over the sine of the angle with the plane.
        let size = dot(from, from).sqrt() + dot(to, to).sqrt() + dot(self.point, self.point).sqrt() + self.radius;
        let doubt = 2e-6 * size / facing.abs().max(1e-12);
        let possible = facing < 2e-6 && at > -doubt && apart <= self.radius + doubt;
        let sure = facing < -2e-6 && at > doubt && apart < self.radius - doubt;
        Possible { at, doubt, met, unsure: possible != sure }
    }

    /// Returns the number of the disc that a ray meets first before `reach`. The lowest number of equal ones counts.
    pub fn closest(discs: &[Disc], from: V3, along: V3, reach: f64) -> Option<usize> {
        let mut best = (reach, None);
        for (i, disc) in discs.iter().enumerate() {
            let p = disc.pass(from, along);
            if p.met && p.at < best.0 {
                best = (p.at, Some(i));
            }
        }
        best.1
    }

    /// Returns whether rounding to 24 bits may make `found` the first disc of a ray.
    pub fn may_be_closest(discs: &[Disc], from: V3, along: V3, reach: f64, found: Option<usize>) -> bool {
        let mine = found.map(|i| discs[i].pass(from, along));
        if mine.is_some_and(|p| !(p.met || p.unsure) || p.at - p.doubt >= reach) {
            return false;
        }
        let (at, doubt) = mine.map_or((reach, 0.0), |p| (p.at, p.doubt));
        // No disc is surely met before.
        discs.iter().map(|d| d.pass(from, along)).all(|p| !p.met || p.unsure || p.at + p.doubt >= at - doubt)
    }
}

/// Axis-aligned box with patches.
#[derive(Clone, Copy, Debug)]
pub struct Bounds {
    /// Corner with the least coordinates.
    pub low: V3,
    /// Corner with the largest coordinates.
    pub high: V3,
    /// Cells along each axis.
    pub cells: [u32; 3],
}

impl Bounds {
    /// Returns the patch in which a ray leaves the box. A point outside is moved to the nearest one of the box.
    pub fn exit(&self, from: V3, along: V3) -> u32 {
        self.exits(from, along, 0.0)[0]
    }

    /// Returns the patches within distance `doubt` of where a ray leaves the box.
    ///
    /// The right one is the first.
    pub fn exits(&self, from: V3, along: V3, doubt: f64) -> Vec<u32> {
        let inside: V3 = std::array::from_fn(|k| from[k].clamp(self.low[k], self.high[k]));
        let wall = |k: usize| if along[k] > 0.0 { self.high[k] } else { self.low[k] };
        let reach = |k: usize| if along[k] == 0.0 { f64::INFINITY } else { (wall(k) - inside[k]) / along[k] };
        let axis = (1..3).fold(0, |best, k| if reach(k) < reach(best) { k } else { best });
        let mut all = Vec::new();
        for k in std::iter::once(axis).chain((0..3).filter(|k| *k != axis)) {
            // The ray is this far from wall `k` when it leaves the box.
            let apart = (reach(k) - reach(axis)) * along[k].abs();
            if k == axis || apart <= doubt {
                let place: V3 = std::array::from_fn(|j| inside[j] + reach(axis) * along[j]);
                for (a, b) in [(0.0, 0.0), (-1.0, -1.0), (-1.0, 1.0), (1.0, -1.0), (1.0, 1.0)] {
                    all.push(self.patch(k, along[k] > 0.0, place, [a * doubt, b * doubt]));
                }
            }
        }
        all
    }

    /// Returns the patch of a face at a place, moved along the two axes of the face.
    fn patch(&self, axis: usize, upper: bool, place: V3, moved: [f64; 2]) -> u32 {
        let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
        let cell = |k: usize, moved: f64| {
            let share = (place[k] + moved - self.low[k]) / (self.high[k] - self.low[k]) * f64::from(self.cells[k]);
            (share.max(0.0) as u32).min(self.cells[k] - 1)
        };
        let size = |k: usize| self.cells[(k + 1) % 3] * self.cells[(k + 2) % 3];
        let before: u32 = (0..axis).map(|k| 2 * size(k)).sum();
        before + u32::from(upper) * size(axis) + cell(u, moved[0]) + self.cells[u] * cell(v, moved[1])
    }
}

/// Returns the direction of a ray of a receiver.
pub fn direction(normal: V3, seed: u32, receiver: u32, ray: u32, rays: u32) -> V3 {
    let stride = u32::MAX / rays;
    let radial = random_bits(seed, receiver, 0).wrapping_add(ray.wrapping_mul(stride)).wrapping_add(stride / 2);
    let turn = random_bits(seed, receiver, 1).wrapping_add(ray.reverse_bits());
    let (radial, turn) = (uniform_from(radial), std::f64::consts::TAU * uniform_from(turn));
    let local = [radial.sqrt() * turn.cos(), radial.sqrt() * turn.sin(), (1.0 - radial).sqrt()];
    let side = if normal[2] >= 0.0 { 1.0 } else { -1.0 };
    let a = -1.0 / (side + normal[2]);
    let b = normal[0] * normal[1] * a;
    let tangent = [1.0 + side * normal[0] * normal[0] * a, side * b, -side * normal[0]];
    let bitangent = [b, side + normal[1] * normal[1] * a, -normal[1]];
    let along: V3 = std::array::from_fn(|k| local[0] * tangent[k] + local[1] * bitangent[k] + local[2] * normal[k]);
    let length = dot(along, along).sqrt();
    along.map(|x| x / length)
}

/// Returns the irradiance of Gaussians from their neighbors, `of` each.
pub fn gather(neighbors: &[u32], weights: &[f64], of: usize, irradiance: &[V3]) -> Vec<V3> {
    let row = |(n, w): (&[u32], &[f64])| {
        let real = n.iter().zip(w).filter(|(i, _)| (**i as usize) < irradiance.len());
        real.fold([0.0; 3], |sum, (i, w)| std::array::from_fn(|c| sum[c] + w * irradiance[*i as usize][c]))
    };
    neighbors.chunks(of).zip(weights.chunks(of)).map(row).collect()
}

/// Returns the gradient of the receivers' irradiance from that of the Gaussians.
pub fn gather_bwd(neighbors: &[u32], weights: &[f64], of: usize, gradient: &[V3], receivers: usize) -> Vec<V3> {
    let mut sums = vec![[0.0; 3]; receivers];
    for (at, (&i, w)) in neighbors.iter().zip(weights).enumerate().filter(|(_, (i, _))| (**i as usize) < receivers) {
        (0..3).for_each(|c| sums[i as usize][c] += w * gradient[at / of][c]);
    }
    sums
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn discs_are_met_on_their_front_only() {
        let disc = |z: f64, up: f64| Disc { point: [0.0, 0.0, z], normal: [0.0, 0.0, up], radius: 1.0 };
        let discs = [disc(5.0, 1.0), disc(4.0, -1.0), disc(4.0, -1.0), disc(-1.0, -1.0)];
        let at = |x: f64, up: f64, reach: f64| Disc::closest(&discs, [x, 0.0, 0.0], [0.0, 0.0, up], reach);
        assert_eq!([at(0.0, 1.0, 9.0), at(0.9, 1.0, 9.0)], [Some(1); 2]);
        assert_eq!([at(1.1, 1.0, 9.0), at(0.0, 1.0, 3.9), at(0.0, -1.0, 9.0)], [None; 3]);
    }

    #[test]
    fn patches_are_numbered_face_by_face() {
        let bounds = Bounds { low: [0.0; 3], high: [2.0, 3.0, 4.0], cells: [2, 3, 4] };
        let exit = |along: V3| bounds.exit([0.5, 0.5, 0.5], along);
        assert_eq!([exit([-1.0, 0.0, 0.0]), exit([1.0, 0.0, 0.0])], [0, 12]);
        // Cells of y faces are numbered along z first, those of z faces along x.
        assert_eq!([exit([0.0, -1.0, 0.0]), exit([0.0, 1.0, 0.0])], [24, 32]);
        assert_eq!([exit([0.0, 0.0, -1.0]), exit([0.0, 0.0, 1.0])], [40, 46]);
        assert_eq!(bounds.exit([1.5, 2.5, 3.5], [1.0, 0.0, 0.0]), 12 + 2 + 3 * 3);
        assert_eq!(bounds.exit([1.5, 9.0, 3.5], [0.0, 1.0, 0.0]), 32 + 3 + 4);
    }

    #[test]
    fn directions_have_the_distribution_of_the_cosine() {
        for normal in [[0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [0.6, 0.0, -0.8], [1.0, 0.0, 0.0]] {
            let all: Vec<V3> = (0..4096).map(|k| direction(normal, 3, 7, k, 4096)).collect();
            let mean: V3 = std::array::from_fn(|c| all.iter().map(|d| d[c]).sum::<f64>() / 4096.0);
            // The mean of cosine-distributed directions is two thirds of the normal.
            assert!((0..3).all(|c| (mean[c] - normal[c] * 2.0 / 3.0).abs() < 2e-3), "{mean:?}");
            let square = all.iter().map(|d| dot(*d, normal).powi(2)).sum::<f64>() / 4096.0;
            assert!((square - 0.5).abs() < 1e-3 && all.iter().all(|d| dot(*d, normal) > 0.0), "{square}");
        }
    }
}
