//! Physical lights: shapes, units and records of the device.
//!
//! Colors are radiance of spheres, rectangles and disks, radiant intensity of points, spots and lobes (in the direction of
//! its axis), and irradiance at normal incidence of directional lights. They are linear RGB. The color of a window is a
//! factor on the environment behind it.

use super::light_shape::degrees;
use glam::Vec3;
use serde::{Deserialize, Serialize};
use sgs_engine::graph::{Buffer, Graph};
use sgs_shaders::structs::LightRecord;
use std::f32::consts::PI;

/// Shape and place of a light, in world space. Lengths are in the unit of the caller, angles in radians. Files hold
/// degrees.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "type", rename_all = "lowercase", deny_unknown_fields)]
pub enum LightShape {
    /// Point that emits equally in all directions.
    Point {
        /// Position.
        position: [f32; 3],
    },
    /// Sphere of constant radiance.
    Sphere {
        /// Center.
        center: [f32; 3],
        /// Radius.
        radius: f32,
    },
    /// Rectangle of constant radiance. Emits on the side of `edge_u` x `edge_v`.
    Rectangle {
        /// Corner where both edges begin.
        corner: [f32; 3],
        /// First edge.
        edge_u: [f32; 3],
        /// Second edge, perpendicular to the first.
        edge_v: [f32; 3],
    },
    /// Disk of constant radiance. Emits on the side of its normal.
    Disk {
        /// Center.
        center: [f32; 3],
        /// Normal of any length.
        normal: [f32; 3],
        /// Radius.
        radius: f32,
    },
    /// Point with a cone of light. Its edge is smooth as `KHR_lights_punctual` defines it.
    Spot {
        /// Position.
        position: [f32; 3],
        /// Axis of the cone, of any length.
        axis: [f32; 3],
        /// Angle from the axis at which the light begins to fall off, at least 0.
        #[serde(with = "degrees")]
        inner_angle: f32,
        /// Angle from the axis at which the light ends. Not below the inner one, at most pi / 2.
        #[serde(with = "degrees")]
        outer_angle: f32,
    },
    /// Light from a distant disk, such as the sun.
    Directional {
        /// Direction in which the light travels, of any length.
        direction: [f32; 3],
        /// Angular radius, from 0 to below pi / 2.
        #[serde(with = "degrees")]
        angular_radius: f32,
    },
    /// Point whose intensity is a spherical Gaussian: `color * exp(sharpness * (cos - 1))`. `cos` is the cosine between the
    /// axis and the direction in which the light leaves.
    Lobe {
        /// Position.
        position: [f32; 3],
        /// Direction in which the most light leaves, of any length.
        axis: [f32; 3],
        /// Sharpness, at least 0. A lobe of sharpness 0 is a point.
        sharpness: f32,
    },
    /// Rectangle through which the environment shines.
    ///
    /// It shines to the side of `edge_u` x `edge_v`.
    Window {
        /// Corner where both edges begin.
        corner: [f32; 3],
        /// First edge.
        edge_u: [f32; 3],
        /// Second edge, perpendicular to the first.
        edge_v: [f32; 3],
    },
}

/// Light of one shape and color.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AreaLight {
    /// Shape and place.
    pub shape: LightShape,
    /// Linear RGB: radiance, intensity or irradiance, as the module says. Not negative.
    pub color: [f32; 3],
}

/// Minimum difference of a spot's cosines, as in `KHR_lights_punctual`.
const MIN_EDGE: f32 = 1e-3;

const POINT: u32 = 0;
const SPHERE: u32 = 1;
const RECTANGLE: u32 = 2;
const DISK: u32 = 3;
const SPOT: u32 = 4;
const DIRECTIONAL: u32 = 5;
const LOBE: u32 = 6;
const WINDOW: u32 = 7;

impl AreaLight {
    /// Returns the radiant power, RGB. Directional lights have none; that of windows is under a white environment.
    pub fn power(&self) -> Option<[f32; 3]> {
        let factor = match self.shape {
            LightShape::Point { .. } => 4.0 * PI,
            LightShape::Sphere { radius, .. } => PI * 4.0 * PI * radius * radius,
            LightShape::Rectangle { edge_u, edge_v, .. } | LightShape::Window { edge_u, edge_v, .. } => {
                PI * Vec3::from(edge_u).cross(Vec3::from(edge_v)).length()
            }
            LightShape::Disk { radius, .. } => PI * PI * radius * radius,
            LightShape::Spot { inner_angle, outer_angle, .. } => {
                // The falloff is the square of a ramp of the cosine.
                let (low, width) = spot_ramp(inner_angle, outer_angle);
                let end = (low + width).min(1.0);
                2.0 * PI * ((1.0 - end) + (end - low).powi(3) / (3.0 * width * width))
            }
            LightShape::Directional { .. } => return None,
            LightShape::Lobe { sharpness, .. } => 4.0 * PI * mean_of_lobe(sharpness),
        };
        Some(self.color.map(|c| factor * c))
    }

    /// Returns the light in another unit of length: lengths are multiplied by `factor`, irradiance is unchanged.
    #[must_use]
    pub fn scaled(&self, factor: f32) -> AreaLight {
        let shape = self.shape.transformed(factor, |v| v, |place| factor * place);
        let by = if shape.has_intensity() { factor * factor } else { 1.0 };
        AreaLight { shape, color: self.color.map(|c| by * c) }
    }

    /// Returns the parts of the light on the device: one, or one per channel of a window.
    ///
    /// The light must be valid ([`AreaLight::check`]).
    pub fn parts(&self) -> Vec<LightPart> {
        let record = self.record();
        let LightShape::Window { .. } = self.shape else { return vec![LightPart { record, color: self.color }] };
        let channel = |c: usize| LightPart {
            record: LightRecord { bias: c as f32, ..record },
            color: std::array::from_fn(|k| if k == c { self.color[c] } else { 0.0 }),
        };
        (0..3).map(channel).collect()
    }

    /// Returns the first record of the device, without the color. The light must be valid ([`AreaLight::check`]).
    pub fn record(&self) -> LightRecord {
        let zero = LightRecord {
            origin: [0.0; 3],
            kind: POINT,
            axis: [0.0; 3],
            radius: 0.0,
            side: [0.0; 3],
            bias: 0.0,
            normal: [0.0; 3],
            area: 0.0,
        };
        let unit = |v: [f32; 3]| Vec3::from(v).as_dvec3().normalize_or_zero().as_vec3();
        match self.shape {
            LightShape::Point { position } => LightRecord { origin: position, ..zero },
            LightShape::Sphere { center, radius } => LightRecord { origin: center, kind: SPHERE, radius, ..zero },
            LightShape::Rectangle { corner, edge_u, edge_v } | LightShape::Window { corner, edge_u, edge_v } => {
                let window = matches!(self.shape, LightShape::Window { .. });
                let across = Vec3::from(edge_u).as_dvec3().cross(Vec3::from(edge_v).as_dvec3());
                LightRecord {
                    origin: corner,
                    kind: if window { WINDOW } else { RECTANGLE },
                    axis: edge_u,
                    side: edge_v,
                    normal: across.normalize_or_zero().as_vec3().into(),
                    area: across.length() as f32,
                    ..zero
                }
            }
            LightShape::Disk { center, normal, radius } => {
                let (axis, side) = unit(normal).any_orthonormal_pair();
                LightRecord {
                    origin: center,
                    kind: DISK,
                    axis: axis.into(),
                    radius,
                    side: side.into(),
                    normal: unit(normal).into(),
                    area: PI * radius * radius,
                    ..zero
                }
            }
            LightShape::Spot { position, axis, inner_angle, outer_angle } => {
                let (low, width) = spot_ramp(inner_angle, outer_angle);
                LightRecord {
                    origin: position,
                    kind: SPOT,
                    axis: unit(axis).into(),
                    radius: 1.0 / width,
                    bias: -low / width,
                    ..zero
                }
            }
            LightShape::Directional { direction, angular_radius } => LightRecord {
                origin: (-unit(direction)).into(),
                kind: DIRECTIONAL,
                radius: angular_radius.sin(),
                ..zero
            },
            LightShape::Lobe { position, axis, sharpness } => {
                LightRecord { origin: position, kind: LOBE, axis: unit(axis).into(), radius: sharpness, ..zero }
            }
        }
    }
}

/// Returns the cosine at which the ramp of a spot begins, and its width.
fn spot_ramp(inner_angle: f32, outer_angle: f32) -> (f32, f32) {
    let low = outer_angle.cos();
    (low, (inner_angle.cos() - low).max(MIN_EDGE))
}

/// Returns the mean of a spherical Gaussian over all directions; its largest value is 1.
fn mean_of_lobe(sharpness: f32) -> f32 {
    let twice = 2.0 * f64::from(sharpness);
    if twice > 0.0 { (-(-twice).exp_m1() / twice) as f32 } else { 1.0 }
}

/// Light of the device: a physical light, or a channel of a window.
#[derive(Clone, Copy, Debug)]
pub struct LightPart {
    /// Record.
    pub record: LightRecord,
    /// Color; of a window, that of the channel alone.
    pub color: [f32; 3],
}

/// Returns the parts of lights, in their order. The lights must be valid.
pub fn parts_of<'a>(lights: impl IntoIterator<Item = &'a AreaLight>) -> Vec<LightPart> {
    lights.into_iter().flat_map(AreaLight::parts).collect()
}

/// Physical lights as inputs of a graph.
#[derive(Clone, Copy, Debug)]
pub struct AreaLights {
    /// Records, `[count]`.
    pub records: Buffer,
    /// Colors, `[count * 3]` floats.
    pub colors: Buffer,
    /// Number of parts of lights.
    pub count: u32,
}

impl AreaLights {
    /// Declares `count` parts of lights as inputs of a graph.
    pub fn declare(g: &mut Graph, count: u32) -> AreaLights {
        let room = u64::from(count.max(1));
        let records = g.input("light_records", size_of::<LightRecord>() as u64 * room);
        AreaLights { records, colors: g.input("light_colors", 12 * room), count }
    }

    /// Returns the contents of the buffers. The lights must be valid.
    ///
    /// Without lights, the contents are one zeroed record, as a buffer cannot be empty.
    ///
    /// # Panics
    /// If the number of parts ([`parts_of`]) differs from the declared one.
    pub fn contents(&self, lights: &[AreaLight]) -> [(Buffer, Vec<u8>); 2] {
        let parts = parts_of(lights);
        assert_eq!(parts.len(), self.count as usize, "number of parts of lights");
        let mut records: Vec<LightRecord> = parts.iter().map(|p| p.record).collect();
        let mut colors: Vec<[f32; 3]> = parts.iter().map(|p| p.color).collect();
        if lights.is_empty() {
            records.push(bytemuck::Zeroable::zeroed());
            colors.push([0.0; 3]);
        }
        [(self.records, bytemuck::cast_slice(&records).to_vec()), (self.colors, bytemuck::cast_slice(&colors).to_vec())]
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    pub(in crate::transport) fn light(shape: LightShape) -> AreaLight {
        AreaLight { shape, color: [1.0, 2.0, 0.0] }
    }

    pub(in crate::transport) fn disk(normal: [f32; 3], radius: f32) -> AreaLight {
        light(LightShape::Disk { center: [1.0, 2.0, 3.0], normal, radius })
    }

    pub(in crate::transport) fn spot(inner_angle: f32, outer_angle: f32) -> AreaLight {
        light(LightShape::Spot { position: [0.0; 3], axis: [0.0, 0.0, -3.0], inner_angle, outer_angle })
    }

    pub(in crate::transport) fn sun(angular_radius: f32) -> AreaLight {
        light(LightShape::Directional { direction: [0.0, -2.0, 0.0], angular_radius })
    }

    #[test]
    fn records_have_sixteen_words() {
        assert_eq!(size_of::<LightRecord>(), 64);
    }

    /// Integrates the light over a sphere of directions.
    #[test]
    fn power_of_a_spot_matches_quadrature() {
        for (inner, outer) in [(0.0, 0.5), (0.3, 1.2), (0.5, 0.5), (0.0, 0.02)] {
            let (low, width) = spot_ramp(inner, outer);
            let n = 2_000_000;
            // Only the cone is sampled.
            let sum: f64 = (0..n)
                .map(|i| f64::from(low) + f64::from(1.0 - low) * (f64::from(i) + 0.5) / f64::from(n))
                .map(|c| ((c - f64::from(low)) / f64::from(width)).clamp(0.0, 1.0).powi(2))
                .sum();
            let expected = 2.0 * std::f64::consts::PI * sum * f64::from(1.0 - low) / f64::from(n);
            let [r, g, b] = spot(inner, outer).power().unwrap().map(f64::from);
            assert!((r / expected - 1.0).abs() < 1e-4 && (g / r - 2.0).abs() < 1e-6 && b == 0.0, "{inner} {outer}");
        }
        assert_eq!(sun(0.1).power(), None);
        let [r, ..] = disk([1.0, 0.0, 0.0], 2.0).power().unwrap();
        assert!((r - PI * PI * 4.0).abs() < 1e-4);
    }

    #[test]
    fn power_of_a_lobe_matches_quadrature() {
        let lobe = |sharpness| light(LightShape::Lobe { position: [0.0; 3], axis: [0.0, 3.0, 0.0], sharpness });
        for sharpness in [0.0, 1e-6, 0.5, 9.5, 1e4] {
            // Over the cosine, where the lobe is not 0.
            let (n, width) = (200_000, 2.0_f64.min(40.0 / f64::from(sharpness)));
            let sum: f64 =
                (0..n).map(|i| (-f64::from(sharpness) * width * (f64::from(i) + 0.5) / f64::from(n)).exp()).sum();
            let expected = 2.0 * std::f64::consts::PI * sum * width / f64::from(n);
            let [r, ..] = lobe(sharpness).power().unwrap().map(f64::from);
            assert!((r / expected - 1.0).abs() < 1e-6, "{sharpness}: {r} {expected}");
        }
        assert_eq!(lobe(0.0).power(), light(LightShape::Point { position: [0.0; 3] }).power());
        assert_eq!(lobe(2.0).scaled(4.0).color, [16.0, 32.0, 0.0]);
    }

    #[test]
    fn scaled_lights_keep_radiance_and_scale_intensity() {
        let d = disk([0.0, 1.0, 0.0], 0.5).scaled(4.0);
        assert_eq!(d.shape, LightShape::Disk { center: [4.0, 8.0, 12.0], normal: [0.0, 1.0, 0.0], radius: 2.0 });
        assert_eq!(d.color, [1.0, 2.0, 0.0]);
        assert_eq!(spot(0.1, 0.2).scaled(4.0).color, [16.0, 32.0, 0.0]);
        assert_eq!(sun(0.1).scaled(4.0), sun(0.1));
    }
}
