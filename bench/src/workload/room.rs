//! Box room that contains boxes, as points with colors and normals.
//!
//! Seeded; the same on every machine.

use glam::DVec3;
use sgs_passes::reference::rng::Pcg;
use sgs_scene::PointCloud;

/// Half of the room's size. The room is 6 by 3 by 5 m with y up; the floor is at -1.5.
const HALF: DVec3 = DVec3::new(3.0, 1.5, 2.5);

/// Centers and half sizes of the boxes in the room.
const BOXES: [(DVec3, DVec3); 4] = [
    (DVec3::new(-2.2, -1.0, -1.6), DVec3::new(0.6, 0.5, 0.5)),
    (DVec3::new(2.0, -0.9, 1.5), DVec3::new(0.5, 0.6, 0.7)),
    (DVec3::new(0.2, -1.2, -1.9), DVec3::new(0.8, 0.3, 0.4)),
    (DVec3::new(-2.5, -0.4, 1.4), DVec3::new(0.3, 1.1, 0.5)),
];

/// Side of a box.
struct Face {
    center: DVec3,
    u: DVec3,
    v: DVec3,
    normal: DVec3,
}

impl Face {
    fn area(&self) -> f64 {
        4.0 * self.u.length() * self.v.length()
    }
}

fn faces() -> Vec<Face> {
    let mut all = Vec::new();
    let mut add = |center: DVec3, half: DVec3, outward: f64| {
        for axis in 0..3 {
            for sign in [-1.0, 1.0] {
                let along = |k: usize| DVec3::AXES[(axis + k) % 3] * half[(axis + k) % 3];
                let normal = DVec3::AXES[axis] * sign;
                all.push(Face {
                    center: center + normal * half[axis],
                    u: along(1),
                    v: along(2),
                    normal: normal * outward,
                });
            }
        }
    };
    add(DVec3::ZERO, HALF, -1.0);
    for (center, half) in BOXES {
        add(center, half, 1.0);
    }
    all
}

/// Returns the area of all surfaces in square meters.
pub fn area() -> f64 {
    faces().iter().map(Face::area).sum()
}

/// Returns points distributed evenly over all surfaces.
pub fn points(count: usize, seed: u32) -> PointCloud {
    let mut rng = Pcg::new(seed);
    let faces = faces();
    let total: f64 = faces.iter().map(Face::area).sum();
    let mut cloud = PointCloud { colors: Some(vec![]), normals: Some(vec![]), ..Default::default() };
    for _ in 0..count {
        let mut at = total * rng.uniform();
        let index = faces.iter().position(|f| {
            at -= f.area();
            at < 0.0
        });
        let index = index.unwrap_or(0);
        let f = &faces[index];
        let (u, v) = (rng.range(-1.0, 1.0), rng.range(-1.0, 1.0));
        let p = f.center + f.u * u + f.v * v;
        cloud.positions.push(p.as_vec3().to_array());
        cloud.colors.get_or_insert_default().push(texture(index, u * f.u.length(), v * f.v.length()));
        cloud.normals.get_or_insert_default().push(f.normal.as_vec3().to_array());
    }
    cloud
}

/// Returns the color of a face: checks, waves and a hue per face.
///
/// The texture has structure at several scales.
fn texture(face: usize, u: f64, v: f64) -> [f32; 3] {
    let check = ((u / 0.5).floor() + (v / 0.5).floor()).rem_euclid(2.0);
    let wave = (7.0 * u + 3.0 * (2.0 * v).sin()).sin() * (5.0 * v).cos();
    let fine = (40.0 * u).sin() * (40.0 * v).sin();
    [0, 1, 2].map(|c| {
        let hue = (1.7 * face as f64 + 2.1 * f64::from(c)).sin();
        (0.5 + 0.18 * hue + 0.15 * (check - 0.5) + 0.15 * wave + 0.06 * fine).clamp(0.02, 0.98) as f32
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_lie_on_surfaces_and_are_deterministic() {
        let a = points(2000, 3);
        assert_eq!(a, points(2000, 3));
        assert_ne!(a.positions, points(2000, 4).positions);
        let inside = |p: &[f32; 3]| p.iter().zip(HALF.to_array()).all(|(x, h)| f64::from(x.abs()) <= h + 1e-6);
        assert!(a.positions.iter().all(inside));
        let on_wall = |p: &&[f32; 3]| p.iter().zip(HALF.to_array()).any(|(x, h)| (f64::from(x.abs()) - h).abs() < 1e-6);
        let share = a.positions.iter().filter(on_wall).count() as f64 / 2000.0;
        let walls = 8.0 * (HALF.x * HALF.y + HALF.y * HALF.z + HALF.z * HALF.x);
        assert!(share > walls / area() - 0.05, "{share}");
    }
}
