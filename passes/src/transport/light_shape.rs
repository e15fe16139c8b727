//! Names, centers and transformations of light shapes, and their angles in files.

use super::LightShape;
use glam::Vec3;

impl LightShape {
    /// Names of all shapes, as in `emitters.json`.
    pub const NAMES: [&str; 8] = ["point", "sphere", "rectangle", "disk", "spot", "directional", "lobe", "window"];

    /// Returns the name of the shape, as in `emitters.json`.
    pub fn name(&self) -> &'static str {
        let [point, sphere, rectangle, disk, spot, directional, lobe, window] = LightShape::NAMES;
        match self {
            LightShape::Point { .. } => point,
            LightShape::Sphere { .. } => sphere,
            LightShape::Rectangle { .. } => rectangle,
            LightShape::Disk { .. } => disk,
            LightShape::Spot { .. } => spot,
            LightShape::Directional { .. } => directional,
            LightShape::Lobe { .. } => lobe,
            LightShape::Window { .. } => window,
        }
    }

    /// Returns the center; `None` for directional light.
    pub fn center(&self) -> Option<Vec3> {
        match *self {
            LightShape::Point { position } | LightShape::Spot { position, .. } | LightShape::Lobe { position, .. } => {
                Some(position.into())
            }
            LightShape::Sphere { center, .. } | LightShape::Disk { center, .. } => Some(center.into()),
            LightShape::Rectangle { corner, edge_u, edge_v } | LightShape::Window { corner, edge_u, edge_v } => {
                Some(Vec3::from(corner) + 0.5 * (Vec3::from(edge_u) + Vec3::from(edge_v)))
            }
            LightShape::Directional { .. } => None,
        }
    }

    /// Returns whether the color is a radiant intensity: the light has a place, but no extent.
    pub fn has_intensity(&self) -> bool {
        matches!(self, LightShape::Point { .. } | LightShape::Spot { .. } | LightShape::Lobe { .. })
    }

    /// Returns the shape after a translation.
    #[must_use]
    pub fn translated(self, by: [f32; 3]) -> LightShape {
        self.transformed(1.0, |v| v, |place| place + Vec3::from(by))
    }

    /// Returns the shape after a similarity: `scale` of lengths, `turn` of directions, `place` of positions.
    #[must_use]
    pub fn transformed(mut self, scale: f32, turn: impl Fn(Vec3) -> Vec3, place: impl Fn(Vec3) -> Vec3) -> LightShape {
        let to = |v: &mut [f32; 3]| *v = place(Vec3::from(*v)).into();
        let turned = |v: &mut [f32; 3]| *v = turn(Vec3::from(*v)).into();
        let edge = |v: &mut [f32; 3]| *v = (scale * turn(Vec3::from(*v))).into();
        match &mut self {
            LightShape::Point { position } => to(position),
            LightShape::Sphere { center, radius } => {
                to(center);
                *radius *= scale;
            }
            LightShape::Rectangle { corner, edge_u, edge_v } | LightShape::Window { corner, edge_u, edge_v } => {
                to(corner);
                edge(edge_u);
                edge(edge_v);
            }
            LightShape::Disk { center, normal, radius } => {
                to(center);
                turned(normal);
                *radius *= scale;
            }
            LightShape::Spot { position, axis, .. } | LightShape::Lobe { position, axis, .. } => {
                to(position);
                turned(axis);
            }
            LightShape::Directional { direction, .. } => turned(direction),
        }
        self
    }
}

/// Angles that are radians in memory and degrees in files.
pub(super) mod degrees {
    use serde::{Deserialize, Deserializer, Serializer};

    /// Writes the shortest number of degrees that is read as the same angle.
    pub fn serialize<S: Serializer>(radians: &f32, to: S) -> Result<S::Ok, S::Error> {
        to.serialize_f64(shortest(*radians))
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<f32, D::Error> {
        Ok(f64::deserialize(from)?.to_radians() as f32)
    }

    fn shortest(radians: f32) -> f64 {
        let exact = f64::from(radians).to_degrees();
        let rounded = (0..16).filter_map(|digits| format!("{exact:.digits$e}").parse::<f64>().ok());
        rounded.into_iter().find(|d| d.to_radians() as f32 == radians).unwrap_or(exact)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shapes_turn_scale_and_move() {
        let turn = |v: Vec3| Vec3::new(-v.y, v.x, v.z);
        let place = |v: Vec3| 2.0 * turn(v) + Vec3::Z;
        let (p, x, y) = ([1.0, 0.0, 0.0], [3.0, 0.0, 0.0], [0.0, 1.0, 0.0]);
        let there = [0.0, 2.0, 1.0];
        let [turned_x, turned_y] = [[0.0, 3.0, 0.0], [-1.0, 0.0, 0.0]];
        for (before, after) in [
            (LightShape::Point { position: p }, LightShape::Point { position: there }),
            (LightShape::Sphere { center: p, radius: 0.5 }, LightShape::Sphere { center: there, radius: 1.0 }),
            (
                LightShape::Rectangle { corner: p, edge_u: x, edge_v: y },
                LightShape::Rectangle { corner: there, edge_u: turned_x.map(|v| 2.0 * v), edge_v: [-2.0, 0.0, 0.0] },
            ),
            (
                LightShape::Disk { center: p, normal: x, radius: 0.5 },
                LightShape::Disk { center: there, normal: turned_x, radius: 1.0 },
            ),
            (
                LightShape::Spot { position: p, axis: y, inner_angle: 0.1, outer_angle: 0.2 },
                LightShape::Spot { position: there, axis: turned_y, inner_angle: 0.1, outer_angle: 0.2 },
            ),
            (
                LightShape::Directional { direction: x, angular_radius: 0.1 },
                LightShape::Directional { direction: turned_x, angular_radius: 0.1 },
            ),
            (
                LightShape::Lobe { position: p, axis: y, sharpness: 2.0 },
                LightShape::Lobe { position: there, axis: turned_y, sharpness: 2.0 },
            ),
        ] {
            assert_eq!(before.transformed(2.0, turn, place), after);
            let moved = before.translated([0.0, 0.0, 2.0]);
            assert_eq!(moved.center(), before.center().map(|c| c + 2.0 * Vec3::Z));
            assert_eq!(moved.translated([0.0, 0.0, -2.0]), before);
        }
    }
}
