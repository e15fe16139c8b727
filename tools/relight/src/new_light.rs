//! New lights of an edit of the published model.

use super::emitters::NewEmitter;
use super::numbers::{finite, positive};
use crate::error::RelightError;
use serde::de::Error as _;
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use serde_json::{Map, Value};
use sgs_passes::transport::LightShape;
use sgs_run::{ListedLight, LobeRow};

/// New light: a light of `lights.json` with its type, a position with an intensity or lobes, or a rectangle.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct NewLight {
    /// Light of any type. Excludes the other fields. Amplitudes of lobes are in the units of the images.
    pub light: Option<ListedLight>,
    /// Position.
    pub position: Option<[f32; 3]>,
    /// Radiant intensity, equal in all directions.
    pub intensity: Option<[f32; 3]>,
    /// Radiant intensity as spherical Gaussians; axes point from the lit surface to the light.
    pub lobes: Option<Vec<LobeRow>>,
    /// Corners of a rectangle, in order around it.
    ///
    /// The rectangle emits to the side from which they run counterclockwise.
    pub corners: Option<[[f32; 3]; 4]>,
    /// Radiance of the rectangle.
    pub radiance: Option<[f32; 3]>,
    /// Patches along each side of the rectangle; default 4.
    pub patches: Option<u32>,
}

/// Fields of a light without a type.
#[derive(Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
struct Fields {
    position: Option<[f32; 3]>,
    intensity: Option<[f32; 3]>,
    lobes: Option<Vec<LobeRow>>,
    corners: Option<[[f32; 3]; 4]>,
    radiance: Option<[f32; 3]>,
    patches: Option<u32>,
}

impl<'de> Deserialize<'de> for NewLight {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<NewLight, D::Error> {
        let fields = Map::deserialize(from)?;
        let typed = fields.contains_key("type");
        let value = Value::Object(fields);
        if typed {
            let light = serde_json::from_value(value).map_err(D::Error::custom)?;
            return Ok(NewLight { light: Some(light), ..NewLight::default() });
        }
        let Fields { position, intensity, lobes, corners, radiance, patches } =
            serde_json::from_value(value).map_err(D::Error::custom)?;
        Ok(NewLight { light: None, position, intensity, lobes, corners, radiance, patches })
    }
}

impl Serialize for NewLight {
    fn serialize<S: Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
        let NewLight { light, position, intensity, lobes, corners, radiance, patches } = self.clone();
        match light {
            Some(light) => light.serialize(to),
            None => Fields { position, intensity, lobes, corners, radiance, patches }.serialize(to),
        }
    }
}

impl NewLight {
    /// Returns a point or one lobe as an emitter.
    ///
    /// # Errors
    /// If the light is another one or invalid.
    pub(crate) fn emitter(&self) -> crate::error::Result<NewEmitter> {
        let (shape, color) = match (&self.light, self.position, self.intensity, self.lobes.as_deref()) {
            (None, Some(position), Some(color), None) => (LightShape::Point { position }, color),
            (None, Some(position), None, Some([lobe])) => {
                // Axes of lobes point to the light, those of emitters follow it.
                let axis = lobe.axis.map(|x| -x);
                (LightShape::Lobe { position, axis, sharpness: lobe.sharpness }, lobe.amplitude)
            }
            _ => {
                let text = "Emitters light the scene; add a point, one lobe, or an emitter.";
                return Err(RelightError::Edit(text.to_owned()));
            }
        };
        Ok(NewEmitter { name: None, shape, color })
    }

    pub(super) fn check(&self, name: &str) -> std::result::Result<(), String> {
        if let Some(light) = &self.light {
            light.check().map_err(|e| format!("{name} {e}"))?;
            if *self != (NewLight { light: self.light.clone(), ..NewLight::default() }) {
                return Err(format!("{name} has a type and fields of a light without one"));
            }
            if let ListedLight::Lobes(row) = light
                && !(1..=32).contains(&row.lobes.len())
            {
                return Err(format!("{name} must have 1 to 32 lobes"));
            }
            return Ok(());
        }
        let place = self.position.is_some();
        let sends = usize::from(self.intensity.is_some()) + usize::from(self.lobes.is_some());
        let rectangle = self.corners.is_some() && self.radiance.is_some();
        let parts = self.corners.is_some() || self.radiance.is_some() || self.patches.is_some();
        let point = place && sends == 1 && !parts;
        if !(point || rectangle && !place && sends == 0) {
            return Err(format!(
                "{name} must have either \"position\" and one of \"intensity\" and \"lobes\", or \"corners\" and \"radiance\""
            ));
        }
        finite(name, self.position.iter().flatten())?;
        finite(name, self.corners.iter().flatten().flatten())?;
        positive(name, self.intensity.iter().chain(&self.radiance).flatten())?;
        let lobes = self.lobes.iter().flatten();
        positive(name, lobes.clone().flat_map(|l| l.amplitude.iter().chain([&l.sharpness])))?;
        if lobes.clone().any(|l| !l.axis.iter().all(|v| v.is_finite()) || l.axis == [0.0; 3]) {
            return Err(format!("{name} has a lobe whose axis is no direction"));
        }
        if self.lobes.as_ref().is_some_and(|l| l.is_empty() || l.len() > 32) {
            return Err(format!("{name} must have 1 to 32 lobes"));
        }
        match self.patches {
            Some(n) if !(1..=64).contains(&n) => Err(format!("{name}.patches is {n}, but must be 1 to 64")),
            _ => Ok(()),
        }
    }
}
