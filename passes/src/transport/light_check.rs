//! Validity of physical lights.

use super::{AreaLight, LightShape};
use glam::Vec3;
use std::f32::consts::FRAC_PI_2;

/// Reason why a light is invalid. `property` names a field of the light.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum AreaLightError {
    /// A number is infinite or NaN.
    #[error("{property}: {value} is not finite; use finite numbers")]
    NotFinite {
        /// Name of the field.
        property: &'static str,
        /// First number that is not finite.
        value: f32,
    },
    /// A color is negative.
    #[error("color: {value} is negative; use 0 or more")]
    NegativeColor {
        /// Most negative number.
        value: f32,
    },
    /// A sharpness is negative.
    #[error("sharpness: {value} is negative; use 0 or more")]
    Sharpness {
        /// Sharpness.
        value: f32,
    },
    /// A length is zero, negative, or too small or large for single precision.
    #[error("{property}: length {value} is outside of {MIN_LENGTH:e} to {MAX_LENGTH:e}; use a length in this range")]
    Length {
        /// Name of the field.
        property: &'static str,
        /// Length.
        value: f32,
    },
    /// The edges of a rectangle are not perpendicular.
    #[error("edge_v: the cosine of its angle to edge_u is {cosine}; use perpendicular edges (at most {MAX_COSINE})")]
    Skewed {
        /// Cosine of the angle between the edges.
        cosine: f32,
    },
    /// An angle is outside of its range.
    #[error("{property}: {value} rad is outside of its range; use {low} to {high}")]
    Angle {
        /// Name of the field.
        property: &'static str,
        /// Angle.
        value: f32,
        /// Lower bound.
        low: f32,
        /// Upper bound.
        high: f32,
    },
}

/// Minimum length of radii, edges and directions.
const MIN_LENGTH: f32 = 1e-9;
/// Maximum length of radii, edges and directions.
const MAX_LENGTH: f32 = 1e9;
/// Maximum cosine of the angle between a rectangle's edges.
const MAX_COSINE: f32 = 1e-3;
/// Maximum angular radius of directional lights.
const MAX_ANGULAR_RADIUS: f32 = 1.57;

impl AreaLight {
    /// Checks that the light is valid.
    ///
    /// # Errors
    /// If a number is not finite, a color is negative, or a length or an angle is out of range.
    pub fn check(&self) -> Result<(), AreaLightError> {
        finite("color", &self.color)?;
        let least = self.color.iter().copied().fold(f32::INFINITY, f32::min);
        if least < 0.0 {
            return Err(AreaLightError::NegativeColor { value: least });
        }
        match self.shape {
            LightShape::Point { position } => finite("position", &position),
            LightShape::Sphere { center, radius } => {
                finite("center", &center)?;
                length("radius", radius)
            }
            LightShape::Rectangle { corner, edge_u, edge_v } | LightShape::Window { corner, edge_u, edge_v } => {
                finite("corner", &corner)?;
                direction("edge_u", edge_u)?;
                direction("edge_v", edge_v)?;
                let cosine = Vec3::from(edge_u).normalize().dot(Vec3::from(edge_v).normalize());
                if cosine.abs() > MAX_COSINE { Err(AreaLightError::Skewed { cosine }) } else { Ok(()) }
            }
            LightShape::Disk { center, normal, radius } => {
                finite("center", &center)?;
                direction("normal", normal)?;
                length("radius", radius)
            }
            LightShape::Spot { position, axis, inner_angle, outer_angle } => {
                finite("position", &position)?;
                direction("axis", axis)?;
                angle("outer_angle", outer_angle, 0.0, FRAC_PI_2)?;
                angle("inner_angle", inner_angle, 0.0, outer_angle)
            }
            LightShape::Directional { direction: along, angular_radius } => {
                direction("direction", along)?;
                angle("angular_radius", angular_radius, 0.0, MAX_ANGULAR_RADIUS)
            }
            LightShape::Lobe { position, axis, sharpness } => {
                finite("position", &position)?;
                direction("axis", axis)?;
                finite("sharpness", &[sharpness])?;
                if sharpness < 0.0 { Err(AreaLightError::Sharpness { value: sharpness }) } else { Ok(()) }
            }
        }
    }
}

fn finite(property: &'static str, values: &[f32]) -> Result<(), AreaLightError> {
    match values.iter().find(|v| !v.is_finite()) {
        Some(&value) => Err(AreaLightError::NotFinite { property, value }),
        None => Ok(()),
    }
}

fn length(property: &'static str, value: f32) -> Result<(), AreaLightError> {
    finite(property, &[value])?;
    if (MIN_LENGTH..=MAX_LENGTH).contains(&value) { Ok(()) } else { Err(AreaLightError::Length { property, value }) }
}

fn direction(property: &'static str, v: [f32; 3]) -> Result<(), AreaLightError> {
    finite(property, &v)?;
    length(property, Vec3::from(v).as_dvec3().length() as f32)
}

fn angle(property: &'static str, value: f32, low: f32, high: f32) -> Result<(), AreaLightError> {
    finite(property, &[value])?;
    if (low..=high).contains(&value) { Ok(()) } else { Err(AreaLightError::Angle { property, value, low, high }) }
}

#[cfg(test)]
mod tests {
    use super::super::area_light::tests::{disk, light, spot, sun};
    use super::*;

    fn rectangle(edge_v: [f32; 3]) -> AreaLight {
        light(LightShape::Rectangle { corner: [0.0; 3], edge_u: [2.0, 0.0, 0.0], edge_v })
    }

    #[test]
    fn valid_lights_pass_and_errors_name_property_and_value() {
        for l in [disk([0.0, 3.0, 0.0], 0.5), rectangle([0.0, 1.0, 0.0]), spot(0.0, 0.5), sun(0.0), sun(0.005)] {
            assert_eq!(l.check(), Ok(()));
            assert_eq!(AreaLight { color: [0.0; 3], ..l }.check(), Ok(()));
        }
        let text = |l: AreaLight| l.check().unwrap_err().to_string();
        assert_eq!(text(disk([0.0; 3], 1.0)), "normal: length 0 is outside of 1e-9 to 1e9; use a length in this range");
        assert!(text(disk([0.0, 1.0, 0.0], -1.0)).starts_with("radius: length -1 is"));
        assert!(text(disk([0.0, f32::NAN, 0.0], 1.0)).starts_with("normal: NaN is not finite"));
        assert!(matches!(rectangle([0.1, 1.0, 0.0]).check(), Err(AreaLightError::Skewed { .. })));
        assert!(text(rectangle([0.0; 3])).starts_with("edge_v: length 0 is"));
        assert!(text(spot(0.6, 0.5)).starts_with("inner_angle: 0.6 rad is outside of its range; use 0 to 0.5"));
        assert!(text(spot(0.6, 1.7)).starts_with("outer_angle: 1.7 rad"));
        assert!(text(sun(1.6)).starts_with("angular_radius: 1.6 rad"));
        let negative = AreaLight { color: [1.0, -0.5, 0.0], ..sun(0.0) };
        assert_eq!(text(negative), "color: -0.5 is negative; use 0 or more");
        let infinite = AreaLight { color: [1.0, f32::INFINITY, 0.0], ..sun(0.0) };
        assert_eq!(text(infinite), "color: inf is not finite; use finite numbers");
    }

    #[test]
    fn invalid_lobes_are_refused() {
        let lobe = |axis: [f32; 3], sharpness| light(LightShape::Lobe { position: [0.0; 3], axis, sharpness });
        let text = |l: AreaLight| l.check().unwrap_err().to_string();
        let up = [0.0, 3.0, 0.0];
        assert_eq!(text(lobe(up, -1.0)), "sharpness: -1 is negative; use 0 or more");
        assert!(text(lobe(up, f32::INFINITY)).starts_with("sharpness: inf is not finite"));
        assert!(text(lobe([0.0; 3], 1.0)).starts_with("axis: length 0 is"));
        assert_eq!(lobe(up, 0.0).check(), Ok(()));
    }
}
