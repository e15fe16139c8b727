//! Uniform scale, rotation and translation.

use glam::{DMat4, DQuat, DVec3};
use serde::{Deserialize, Serialize};

/// Transform that scales uniformly, then rotates, then translates.
///
/// Files record the transform from the coordinates of the scene to theirs, so that a reader can return to the scene.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Placement {
    /// Scale factor of all lengths.
    pub scale: f64,
    /// Unit quaternion (w, x, y, z).
    pub rotation: [f64; 4],
    /// Position of the origin.
    pub translation: [f64; 3],
}

impl Placement {
    /// Identity transform.
    pub const NONE: Placement = Placement { scale: 1.0, rotation: [1.0, 0.0, 0.0, 0.0], translation: [0.0; 3] };

    /// Creates the transform that scales and turns the direction `from` to `to`.
    ///
    /// Opposite directions turn about the x axis if it is perpendicular to them.
    pub fn upright(from: DVec3, to: DVec3, scale: f64) -> Placement {
        let (from, to) = (from.normalize_or(DVec3::Y), to.normalize_or(DVec3::Y));
        let opposite = from.dot(to) < -1.0 + 1e-12 && from.x.abs() < 1e-6;
        let q = if opposite { DQuat::from_xyzw(1.0, 0.0, 0.0, 0.0) } else { DQuat::from_rotation_arc(from, to) };
        Placement { scale, rotation: [q.w, q.x, q.y, q.z], translation: [0.0; 3] }
    }

    /// Returns the inverse transform.
    #[must_use]
    pub fn inverse(&self) -> Placement {
        let q = self.turn().inverse();
        let translation = q * DVec3::from(self.translation) * (-1.0 / self.scale);
        Placement { scale: 1.0 / self.scale, rotation: [q.w, q.x, q.y, q.z], translation: translation.to_array() }
    }

    /// Checks the numbers of a transform that a file records.
    ///
    /// # Errors
    /// Description of the first number that no transform has.
    pub fn check(&self) -> Result<(), String> {
        if !(1e-9..=1e9).contains(&self.scale) {
            return Err(format!("its recorded scale is {}; use a number from 1e-9 to 1e9", self.scale));
        }
        let length = self.rotation.iter().map(|v| v * v).sum::<f64>();
        if !(0.99..=1.01).contains(&length) {
            return Err("its recorded rotation is no unit quaternion".into());
        }
        match self.translation.iter().find(|v| v.is_nan() || v.abs() > 1e12) {
            Some(bad) => Err(format!("its recorded translation holds {bad}; use numbers of at most 1e12")),
            None => Ok(()),
        }
    }

    fn turn(&self) -> DQuat {
        let [w, x, y, z] = self.rotation;
        DQuat::from_xyzw(x, y, z, w).normalize()
    }

    /// Returns the matrix of the transform.
    pub(crate) fn matrix(&self) -> DMat4 {
        let to = DVec3::from(self.translation);
        DMat4::from_scale_rotation_translation(DVec3::splat(self.scale), self.turn(), to)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn inverse_returns_to_the_start() {
        let place = Placement { scale: 2.0, rotation: [0.5, -0.5, 0.5, 0.5], translation: [1.0, 2.0, 3.0] };
        let both = place.matrix() * place.inverse().matrix();
        assert!(both.abs_diff_eq(DMat4::IDENTITY, 1e-12), "{both:?}");
    }

    #[test]
    fn upright_turns_every_axis_to_the_target() {
        for from in [DVec3::X, DVec3::Y, DVec3::Z, -DVec3::X, -DVec3::Y, -DVec3::Z, DVec3::new(0.1, 0.2, 0.9)] {
            for to in [DVec3::Y, -DVec3::Y] {
                let place = Placement::upright(from, to, 3.0);
                place.check().unwrap();
                let turned = place.matrix().transform_vector3(from.normalize());
                assert!(turned.abs_diff_eq(3.0 * to, 1e-12), "{from} {to} {turned}");
            }
        }
    }

    #[test]
    fn impossible_transforms_are_refused() {
        let with = |change: &dyn Fn(&mut Placement)| {
            let mut place = Placement::NONE;
            change(&mut place);
            place.check()
        };
        assert!(with(&|_| ()).is_ok());
        assert!(with(&|p| p.scale = 0.0).unwrap_err().contains("scale is 0"));
        assert!(with(&|p| p.scale = f64::NAN).is_err());
        assert!(with(&|p| p.rotation = [0.0; 4]).unwrap_err().contains("quaternion"));
        assert!(with(&|p| p.translation[1] = f64::INFINITY).unwrap_err().contains("inf"));
    }
}
