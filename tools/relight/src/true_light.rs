//! Lights of `gt/lights.json`.

use crate::NewLight;
use glam::Vec3;
use serde::Deserialize;
use sgs_passes::transport::{AreaLight, LightShape};
use sgs_run::OpeningRow;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Fields of `gt/lights.json` that are read.
#[derive(Default, Deserialize)]
pub struct TrueLights {
    /// Lights of the photographs.
    #[serde(default)]
    pub training: Vec<TrueLight>,
    /// Lights of each relit set.
    #[serde(default)]
    pub relight: BTreeMap<String, Vec<TrueLight>>,
}

/// Light, in world units. The fields that are present determine its kind.
///
/// | kind | fields |
/// |---|---|
/// | rectangle | `corners`, `radiance`, optional `normal` |
/// | directional | `direction`, `irradiance`, optional `angular_radius` |
/// | disk | `position`, `normal`, `radius`, `radiance` |
/// | sphere | `position`, `radius`, `radiance` |
/// | spot | `position`, `direction`, `cutoff_angle`, `intensity` |
/// | point | `position`, `intensity` |
/// | environment | `environment`, optional `factor`, optional `corners` of its window and `normal` |
///
/// The first kind whose fields are all present counts. `point_light_intensity_equivalent` stands in for `intensity`.
#[derive(Clone, Debug, Deserialize)]
pub struct TrueLight {
    /// Whether it shines.
    pub on: bool,
    /// Name: lights of the same name in different sets are the same light.
    #[serde(default)]
    pub name: String,
    /// Center of a sphere or disk, position of a point or spot.
    position: Option<[f32; 3]>,
    radius: Option<f32>,
    /// Intensity of a point that lights far surfaces as the light does.
    point_light_intensity_equivalent: Option<[f32; 3]>,
    /// Corners of a rectangle, in order around it.
    corners: Option<[[f32; 3]; 4]>,
    /// Side to which a rectangle or disk shines.
    normal: Option<[f32; 3]>,
    /// Linear red, green, blue, as are irradiance and intensity.
    radiance: Option<[f32; 3]>,
    /// Direction in which directional light travels, or the axis of a spot.
    direction: Option<[f32; 3]>,
    /// Irradiance of a surface that faces directional light.
    irradiance: Option<[f32; 3]>,
    /// Angular radius of directional light in degrees; 0 by default.
    angular_radius: Option<f32>,
    intensity: Option<[f32; 3]>,
    /// Half angle of a spot's cone in degrees.
    cutoff_angle: Option<f32>,
    /// Latitude-longitude map of the light from outside, beside `gt/lights.json`.
    ///
    /// It enters through the window of these corners, else through the openings of the room.
    environment: Option<PathBuf>,
    /// Factor on an environment.
    factor: Option<[f32; 3]>,
}

impl TrueLight {
    /// Returns the light as a new light of an edit, which shines without bounces.
    ///
    /// Only rectangles and lights with a position and an intensity can be one; returns `None` for others.
    pub fn as_new(&self) -> Option<NewLight> {
        if self.environment.is_some() {
            return None;
        }
        if let (Some(corners), Some(radiance)) = (self.corners, self.radiance) {
            return Some(NewLight { corners: Some(corners), radiance: Some(radiance), ..Default::default() });
        }
        let (position, intensity) = (self.position?, self.point_light_intensity_equivalent.or(self.intensity)?);
        Some(NewLight { position: Some(position), intensity: Some(intensity), ..Default::default() })
    }

    /// Returns the map of an environment, and the factor on it. `None` for other lights.
    pub fn environment(&self) -> Option<(&Path, [f32; 3])> {
        self.environment.as_deref().map(|file| (file, self.factor.unwrap_or([1.0; 3])))
    }

    /// Returns the window of an environment, if it has one.
    pub fn window(&self) -> Option<OpeningRow> {
        self.environment.as_ref()?;
        OpeningRow::of(&rectangle(self.corners?, self.normal)).filter(|o| o.check().is_ok())
    }

    /// Returns the light as a physical light; `None` for an environment, or if its shape or brightness is unknown.
    pub fn as_area(&self) -> Option<AreaLight> {
        let light = |shape, color| Some(AreaLight { shape, color });
        if self.environment.is_some() {
            return None;
        }
        if let (Some(corners), Some(radiance)) = (self.corners, self.radiance) {
            return light(rectangle(corners, self.normal), radiance);
        }
        if let (Some(direction), Some(irradiance)) = (self.direction, self.irradiance) {
            let angular_radius = self.angular_radius.unwrap_or(0.0).to_radians();
            return light(LightShape::Directional { direction, angular_radius }, irradiance);
        }
        let position = self.position?;
        match (self.radius, self.radiance, self.normal) {
            (Some(radius), Some(radiance), Some(normal)) => {
                return light(LightShape::Disk { center: position, normal, radius }, radiance);
            }
            (Some(radius), Some(radiance), None) => {
                return light(LightShape::Sphere { center: position, radius }, radiance);
            }
            _ => {}
        }
        let intensity = self.intensity.or(self.point_light_intensity_equivalent)?;
        match (self.direction, self.cutoff_angle) {
            (Some(axis), Some(angle)) => {
                let outer_angle = angle.to_radians();
                light(LightShape::Spot { position, axis, inner_angle: 0.75 * outer_angle, outer_angle }, intensity)
            }
            _ => light(LightShape::Point { position }, intensity),
        }
    }
}

/// Returns the rectangle between four corners.
///
/// It shines along the normal. Without one, it shines to the side from which the corners run counterclockwise.
fn rectangle(corners: [[f32; 3]; 4], normal: Option<[f32; 3]>) -> LightShape {
    let [a, b, _, d] = corners.map(Vec3::from);
    let (u, v) = (b - a, d - a);
    // Corners in files are rounded. The edges of a light must be perpendicular.
    let v = v - u * (v.dot(u) / u.length_squared().max(f32::MIN_POSITIVE));
    let turned = normal.is_some_and(|n| u.cross(v).dot(n.into()) < 0.0);
    let (u, v) = if turned { (v, u) } else { (u, v) };
    LightShape::Rectangle { corner: a.into(), edge_u: u.into(), edge_v: v.into() }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn light(text: &str) -> TrueLight {
        serde_json::from_str(text).unwrap()
    }

    #[test]
    fn fields_tell_the_kind() {
        let pane = light(
            r#"{"on": true, "corners": [[0,0,0],[2,0,0],[2,1,0],[0,1,0]], "normal": [0,0,-1], "radiance": [1,2,3]}"#,
        );
        let area = pane.as_area().unwrap();
        let LightShape::Rectangle { edge_u, edge_v, .. } = area.shape else { panic!("{area:?}") };
        assert!(Vec3::from(edge_u).cross(edge_v.into()) == Vec3::new(0.0, 0.0, -2.0), "it shines along its normal");
        assert!(area.check().is_ok() && area.shape.center() == Some(Vec3::new(1.0, 0.5, 0.0)));
        let bulb = r#"{"on": true, "position": [0,1,0], "radius": 0.1, "radiance": [9,9,9],
            "point_light_intensity_equivalent": [1,1,1]}"#;
        assert!(matches!(light(bulb).as_area().unwrap().shape, LightShape::Sphere { .. }));
        let point = light(r#"{"on": true, "position": [0,1,0], "point_light_intensity_equivalent": [1,2,3]}"#);
        assert_eq!(point.as_area().unwrap().color, [1.0, 2.0, 3.0]);
        assert!(matches!(point.as_area().unwrap().shape, LightShape::Point { .. }));
        let sun = light(r#"{"on": true, "direction": [0,-1,0], "irradiance": [5,5,4], "angular_radius": 0.27}"#);
        assert!(
            sun.as_area().is_some_and(|l| l.check().is_ok() && l.shape.center().is_none()) && sun.as_new().is_none()
        );
        let spot =
            r#"{"on": true, "position": [0,1,0], "direction": [0,-1,0], "intensity": [5,5,4], "cutoff_angle": 30}"#;
        assert!(matches!(light(spot).as_area().unwrap().shape, LightShape::Spot { .. }));
        let disk = r#"{"on": true, "position": [0,1,0], "normal": [0,-1,0], "radius": 1, "radiance": [5,5,4]}"#;
        assert!(matches!(light(disk).as_area().unwrap().shape, LightShape::Disk { .. }));
        assert!(light(r#"{"on": true, "position": [0,1,0]}"#).as_area().is_none());
        let sky = light(r#"{"on": true, "environment": "sky.exr", "position": [0,1,0], "intensity": [1,1,1]}"#);
        assert!(sky.as_area().is_none() && sky.as_new().is_none() && sky.window().is_none());
        assert_eq!(sky.environment(), Some((Path::new("sky.exr"), [1.0; 3])));
        let portal = r#"{"on": true, "environment": "sky.exr", "factor": [1,2,3], "corners": [[0,0,0],[2,0,0],[2,1,0],[0,1,0]]}"#;
        let pane = OpeningRow { corner: [0.0; 3], edge_u: [2.0, 0.0, 0.0], edge_v: [0.0, 1.0, 0.0] };
        assert_eq!((light(portal).window(), light(portal).environment().unwrap().1), (Some(pane), [1.0, 2.0, 3.0]));
    }
}
