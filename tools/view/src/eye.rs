//! Viewpoint with orbit and walk navigation.
//!
//! Guarantees: a camera converted to a viewpoint and back is unchanged. Navigation keeps the roll of the horizon. Axes
//! are OpenCV's.

use glam::{DMat3, DVec2, DVec3};
use sgs_scene::{Camera, NEAR};

/// Steepest pitch, in radians.
const STEEPEST: f64 = 1.553;

/// Position and direction of the viewer.
#[derive(Clone, Debug)]
pub struct Eye {
    /// Position in the world.
    pub position: DVec3,
    /// Distance to the orbit center.
    pub distance: f64,
    /// Up direction of the world, a unit vector.
    up: DVec3,
    /// Rotation to the right about `up`, in radians.
    yaw: f64,
    /// Upward angle, in radians.
    pitch: f64,
    /// Clockwise rotation about the viewing direction, in radians.
    roll: f64,
    /// Focal lengths, in image heights.
    focal: DVec2,
    /// Near plane: depth below which nothing is drawn.
    near: f64,
}

/// Returns two horizontal axes. Yaw rotates from the first to the second.
fn level(up: DVec3) -> [DVec3; 2] {
    let front = up.any_orthonormal_vector();
    [front, front.cross(up)]
}

impl Eye {
    /// Creates a viewpoint from a camera, in a world with the given up direction.
    pub fn of(camera: &Camera, up: DVec3, distance: f64) -> Eye {
        let height = f64::from(camera.height);
        let focal = DVec2::new(camera.fx, camera.fy) / height;
        let near = camera.near;
        let mut eye = Eye { position: camera.position(), distance, up, yaw: 0.0, pitch: 0.0, roll: 0.0, focal, near };
        let forward = camera.forward().normalize_or(DVec3::Z);
        let [front, side] = level(up);
        eye.pitch = forward.dot(up).clamp(-1.0, 1.0).asin();
        eye.yaw = forward.dot(side).atan2(forward.dot(front));
        // The remaining rotation is a roll about the viewing direction.
        let [right, down, _] = eye.axes();
        let side_axis = camera.rotation.transpose() * DVec3::X;
        eye.roll = side_axis.dot(down).atan2(side_axis.dot(right));
        eye
    }

    /// Creates a viewpoint at `distance` from a target, looking slightly down.
    pub fn at(target: DVec3, up: DVec3, distance: f64) -> Eye {
        let focal = DVec2::splat(1.1);
        let near = NEAR.min(0.005 * distance);
        let mut eye = Eye { position: target, distance, up, yaw: 0.0, pitch: -0.3, roll: 0.0, focal, near };
        eye.position = target - distance * eye.forward();
        eye
    }

    /// Returns the right, down and forward axes.
    pub fn axes(&self) -> [DVec3; 3] {
        let forward = self.forward();
        let [front, side] = level(self.up);
        let right = (-self.yaw.sin() * front + self.yaw.cos() * side).normalize();
        let down = forward.cross(right);
        let (sin, cos) = self.roll.sin_cos();
        [cos * right + sin * down, cos * down - sin * right, forward]
    }

    /// Returns the viewing direction.
    pub fn forward(&self) -> DVec3 {
        let [front, side] = level(self.up);
        self.pitch.cos() * (self.yaw.cos() * front + self.yaw.sin() * side) + self.pitch.sin() * self.up
    }

    /// Returns the orbit center.
    pub fn target(&self) -> DVec3 {
        self.position + self.distance * self.forward()
    }

    /// Rotates about the orbit center by `around` (yaw) and `over` (pitch), in radians.
    pub fn orbit(&mut self, around: f64, over: f64) {
        let target = self.target();
        self.turn(around, over);
        self.position = target - self.distance * self.forward();
    }

    /// Rotates in place, in radians.
    pub fn turn(&mut self, right: f64, up: f64) {
        self.yaw += right;
        // A camera may already be steeper; the limit must not snap it back.
        let most = STEEPEST.max(self.pitch.abs());
        self.pitch = (self.pitch + up).clamp(-most, most);
    }

    /// Moves to the right, down and forward.
    pub fn walk(&mut self, by: DVec3) {
        let [right, down, forward] = self.axes();
        self.position += by.x * right + by.y * down + by.z * forward;
    }

    /// Scales the distance to the orbit center, down to `least`.
    pub fn zoom(&mut self, factor: f64, least: f64) {
        let distance = (self.distance * factor).max(least);
        self.position += (self.distance - distance) * self.forward();
        self.distance = distance;
    }

    /// Returns the length of a pixel at the orbit center.
    pub fn pixel(&self, size: [u32; 2]) -> f64 {
        self.distance / (self.focal.y * f64::from(size[1].max(1)))
    }

    /// Returns the viewpoint as a camera of the given size.
    ///
    /// The vertical field of view is fixed; wider windows show more at the sides.
    pub fn camera(&self, name: &str, [width, height]: [u32; 2]) -> Camera {
        let [right, down, forward] = self.axes();
        let rotation = DMat3::from_cols(right, down, forward).transpose();
        let rows = f64::from(height);
        Camera {
            name: name.to_owned(),
            width,
            height,
            fx: self.focal.x * rows,
            fy: self.focal.y * rows,
            cx: 0.5 * f64::from(width),
            cy: 0.5 * rows,
            rotation,
            translation: -(rotation * self.position),
            near: self.near,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn camera() -> Camera {
        let rotation = DMat3::from_rotation_z(0.2) * DMat3::from_rotation_x(-0.5) * DMat3::from_rotation_y(2.4);
        let translation = DVec3::new(0.3, -1.0, 2.0);
        let (width, height) = (160, 120);
        let name = "a".to_owned();
        Camera { name, width, height, fx: 110.0, fy: 115.0, cx: 80.0, cy: 60.0, rotation, translation, near: NEAR }
    }

    #[test]
    fn camera_round_trips_through_viewpoint() {
        for up in [DVec3::Y, -DVec3::Y, DVec3::Z, DVec3::new(0.6, 0.0, 0.8)] {
            let original = camera();
            let back = Eye::of(&original, up, 2.0).camera("a", [160, 120]);
            assert!(back.rotation.abs_diff_eq(original.rotation, 1e-12), "{up}: {back:?}");
            assert!(back.translation.abs_diff_eq(original.translation, 1e-12) && (back.fx - original.fx).abs() < 1e-12);
        }
    }

    #[test]
    fn orbit_and_zoom_preserve_the_target() {
        let mut eye = Eye::of(&camera(), -DVec3::Y, 3.0);
        let target = eye.target();
        for k in 0..40 {
            eye.orbit(0.3, 0.2 * f64::from(k % 5 - 1));
            assert!((eye.target() - target).length() < 1e-9 && ((eye.position - target).length() - 3.0).abs() < 1e-9);
            let at = eye.camera("b", [64, 48]).project(target).expect("in front");
            assert!((at - DVec2::new(32.0, 24.0)).length() < 1e-6, "{at}");
        }
        eye.zoom(0.5, 0.1);
        assert!((eye.target() - target).length() < 1e-9 && (eye.distance - 1.5).abs() < 1e-12);
        eye.zoom(1e-9, 0.1);
        assert!((eye.distance - 0.1).abs() < 1e-12);
    }

    #[test]
    fn axes_are_right_handed_and_rotations_have_the_right_sign() {
        let mut eye = Eye::at(DVec3::new(1.0, 2.0, 3.0), DVec3::Z, 4.0);
        let [right, down, forward] = eye.axes();
        assert!(right.cross(down).abs_diff_eq(forward, 1e-12) && right.z.abs() < 1e-12 && down.z < 0.0);
        let seen = |eye: &Eye| eye.camera("c", [100, 100]).project(DVec3::new(1.0, 2.0, 3.0)).expect("in front");
        assert!((seen(&eye) - DVec2::splat(50.0)).length() < 1e-9);
        // A rotation to the right and up moves the target to the left and down in the image.
        eye.turn(0.1, 0.1);
        assert!(seen(&eye).x < 45.0 && seen(&eye).y > 55.0, "{}", seen(&eye));
        eye.turn(-0.1, -0.1);
        eye.walk(DVec3::new(0.5, 0.0, 0.0));
        assert!(seen(&eye).x < 45.0 && (seen(&eye).y - 50.0).abs() < 1e-9);
    }
}
