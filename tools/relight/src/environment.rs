//! Edit of an environment map: of the published model, or of the one that windows show.

use crate::error::{RelightError, Result};
use glam::{DQuat, DVec3};
use serde::{Deserialize, Serialize};
use sgs_passes::shade::environment::cube::{Footprint, texel_direction};
use sgs_passes::transport::Sky;
use sgs_run::{Texels, read_sky};
use std::path::PathBuf;

/// Edit of the environment map.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct EnvironmentEdit {
    /// Removes the environment map.
    pub off: bool,
    /// Replacement: a latitude-longitude image.
    ///
    /// A relative path starts at the directory of the edit file.
    pub file: Option<PathBuf>,
    /// Factor on the radiance.
    pub scale: Option<f32>,
    /// Factors on red, green and blue.
    pub color: Option<[f32; 3]>,
    /// Rotation.
    pub rotate: Option<Turn>,
}

/// Right-handed rotation.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Turn {
    /// Axis, of any nonzero length.
    pub axis: [f64; 3],
    /// Angle in degrees.
    pub degrees: f64,
}

impl EnvironmentEdit {
    /// Checks the edit, whose key is `name`.
    pub(crate) fn check(&self, name: &str) -> std::result::Result<(), String> {
        if self.off && (self.file.is_some() || self.scale.is_some() || self.color.is_some() || self.rotate.is_some()) {
            return Err(format!("{name} is off and changed at once"));
        }
        let mut factors = self.scale.iter().chain(self.color.iter().flatten());
        if let Some(bad) = factors.find(|v| !(v.is_finite() && **v >= 0.0)) {
            return Err(format!("{name} holds {bad}, but must be finite and at least 0"));
        }
        if let Some(turn) = &self.rotate {
            let length: f64 = turn.axis.iter().map(|v| v * v).sum();
            if !(length.is_finite() && length > 0.0 && turn.degrees.is_finite()) {
                return Err(format!("{name}.rotate needs an axis that is not zero, and finite degrees"));
            }
        }
        Ok(())
    }

    /// Returns the factors on red, green and blue.
    pub(crate) fn factors(&self) -> [f32; 3] {
        self.color.unwrap_or([1.0; 3]).map(|c| c * self.scale.unwrap_or(1.0))
    }

    /// Returns whether the edit changes a map beyond its file.
    pub(crate) fn changes(&self) -> bool {
        self.scale.is_some() || self.color.is_some() || self.rotate.is_some()
    }
}

/// Applies an edit to the environment map of a run, if any.
///
/// A new map has `size` texels along an edge.
///
/// # Errors
/// If the edit changes an absent environment map, or its file is damaged.
pub fn edit_environment(edit: &EnvironmentEdit, current: Option<Texels>, size: u32) -> Result<Option<Texels>> {
    if edit.off {
        return Ok(None);
    }
    let current = match &edit.file {
        Some(file) => Some(Texels::read(file, size)?),
        None => current,
    };
    let Some(mut texels) = current else {
        if edit.changes() {
            let message = "The edit changes the environment, but the scene has none; name one with \"file\".";
            return Err(RelightError::Edit(message.into()));
        }
        return Ok(None);
    };
    let factor = edit.factors();
    texels.data.chunks_exact_mut(3).for_each(|t| t.iter_mut().zip(&factor).for_each(|(v, f)| *v *= f));
    Ok(Some(match &edit.rotate {
        Some(turn) => turned(&texels, turn),
        None => texels,
    }))
}

/// Applies an edit to the environment that windows show.
///
/// # Errors
/// If the edit changes an absent environment, or its file is damaged.
pub(crate) fn edit_sky(edit: &EnvironmentEdit, current: Option<Sky>) -> Result<Option<Sky>> {
    if edit.off {
        return Ok(None);
    }
    let current = match &edit.file {
        Some(file) => Some(read_sky(file)?),
        None => current,
    };
    let Some(sky) = current else {
        if edit.changes() {
            let message =
                "The edit changes the environment of the emitters, but the run has none; name one with \"file\".";
            return Err(RelightError::Edit(message.into()));
        }
        return Ok(None);
    };
    let sky = sky.tinted(edit.factors());
    let turn = |t: &Turn| DQuat::from_axis_angle(DVec3::from(t.axis).normalize(), t.degrees.to_radians());
    Ok(Some(edit.rotate.as_ref().map_or_else(|| sky.clone(), |t| sky.turned(turn(t)))))
}

/// Rotates the map: radiance from direction d then arrives from the rotated direction.
fn turned(texels: &Texels, turn: &Turn) -> Texels {
    let q = DQuat::from_axis_angle(DVec3::from(turn.axis).normalize(), turn.degrees.to_radians()).inverse();
    let n = texels.size;
    let at = |t: u32| Footprint::of((q * DVec3::from(texel_direction(n, t))).to_array(), n).apply(&texels.data);
    Texels { size: n, data: (0..6 * n * n).flat_map(at).map(|v| v as f32).collect() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn environment_edit_scales_and_rotates() {
        let size = 16;
        let of = |f: &dyn Fn(DVec3) -> f64| {
            let at = |t| f(DVec3::from(texel_direction(size, t)).normalize()) as f32;
            Texels { size, data: (0..6 * size * size).flat_map(|t| [at(t); 3]).collect() }
        };
        // Bright at +x; a quarter turn about +y maps that to -z.
        let edit = EnvironmentEdit {
            scale: Some(2.0),
            color: Some([1.0, 0.5, 0.0]),
            rotate: Some(Turn { axis: [0.0, 3.0, 0.0], degrees: 90.0 }),
            ..Default::default()
        };
        let found = edit_environment(&edit, Some(of(&|d| 1.0 + d.x)), size).unwrap().unwrap();
        let expected = of(&|d| 1.0 - d.z);
        for (a, b) in found.data.chunks(3).zip(expected.data.chunks(3)) {
            assert!((a[0] - 2.0 * b[0]).abs() < 0.02 && (a[1] - b[1]).abs() < 0.02 && a[2] == 0.0, "{a:?} {b:?}");
        }
        assert!(edit_environment(&edit, None, size).unwrap_err().to_string().contains("has none"));
        let sky = edit_sky(&edit, Some(Sky::uniform([1.0, 2.0, 3.0]))).unwrap().unwrap();
        assert_eq!(sky, Sky::uniform([2.0, 2.0, 0.0]));
        assert!(edit_sky(&edit, None).unwrap_err().to_string().contains("the run has none"));
        let off = EnvironmentEdit { off: true, ..Default::default() };
        assert_eq!(edit_sky(&off, Some(sky)).unwrap(), None);
        assert!(edit_environment(&off, Some(expected), size).unwrap().is_none());
    }
}
