//! Pinhole camera with a known pose.
//!
//! Axes follow OpenCV: x right, y down, z forward. The pose is stored world-to-camera. The image origin is the upper
//! left corner, and the center of pixel `(i, j)` is at `(i + 0.5, j + 0.5)`. The principal point may be anywhere.
//! Cameras have no lens distortion: images are undistorted on load ([`Distortion`]).

mod distortion;
mod residual;

use glam::{DMat3, DMat4, DQuat, DVec2, DVec3};

pub use distortion::{Distortion, Projection};
pub use residual::Residual;

/// Largest accepted image side in pixels; larger values indicate a damaged file.
pub const MAX_IMAGE_SIDE: u32 = 65_536;

/// Largest accepted absolute value of a camera's numbers. Bounds the distance of a camera from the origin in scene
/// units, and focal lengths and principal points in pixels. Squares of such numbers still fit a 32-bit float.
pub const MAX_CAMERA_NUMBER: f64 = 1e15;

/// Default [`Camera::near`] in scene units.
pub const NEAR: f64 = 0.01;

/// Pinhole camera with its pose.
#[derive(Clone, Debug, PartialEq)]
pub struct Camera {
    /// Stem of the image's file name; identifies the view in priors, ground truth and splits.
    pub name: String,
    /// Image width in pixels.
    pub width: u32,
    /// Image height in pixels.
    pub height: u32,
    /// Horizontal focal length in pixels.
    pub fx: f64,
    /// Vertical focal length in pixels.
    pub fy: f64,
    /// Horizontal position of the principal point in pixels from the left edge.
    pub cx: f64,
    /// Vertical position of the principal point in pixels from the upper edge.
    pub cy: f64,
    /// World-to-camera rotation.
    pub rotation: DMat3,
    /// World-to-camera translation.
    pub translation: DVec3,
    /// Near plane: the depth in scene units below which nothing is rendered.
    pub near: f64,
}

impl Camera {
    /// Returns the camera center in world space.
    pub fn position(&self) -> DVec3 {
        -(self.rotation.transpose() * self.translation)
    }

    /// Returns the viewing direction in world space as a unit vector.
    pub fn forward(&self) -> DVec3 {
        self.rotation.transpose() * DVec3::Z
    }

    /// Returns the world-to-camera pose as one matrix.
    pub fn world_to_camera(&self) -> DMat4 {
        let mut matrix = DMat4::from_mat3(self.rotation);
        matrix.w_axis = self.translation.extend(1.0);
        matrix
    }

    /// Returns the camera after a shift of its center and a turn about it.
    ///
    /// Both are in world axes; `turn` is a rotation vector in radians.
    #[must_use]
    pub fn moved(&self, turn: DVec3, shift: DVec3) -> Self {
        let rotation = self.rotation * DMat3::from_quat(DQuat::from_scaled_axis(-turn));
        Self { rotation, translation: -(rotation * (self.position() + shift)), ..self.clone() }
    }

    /// Returns the camera for the image resized to `width`×`height`. The field of view is unchanged; each axis scales
    /// separately.
    pub fn scaled(&self, width: u32, height: u32) -> Self {
        let sx = f64::from(width) / f64::from(self.width.max(1));
        let sy = f64::from(height) / f64::from(self.height.max(1));
        Self { width, height, fx: self.fx * sx, fy: self.fy * sy, cx: self.cx * sx, cy: self.cy * sy, ..self.clone() }
    }

    /// Projects a world point to pixel coordinates. Returns `None` if the point is not in front of the camera.
    pub fn project(&self, point: DVec3) -> Option<DVec2> {
        let p = self.rotation * point + self.translation;
        (p.z > 0.0).then(|| DVec2::new(self.fx * p.x / p.z + self.cx, self.fy * p.y / p.z + self.cy))
    }

    /// Returns the world point at `pixel` and camera depth `depth`. `pixel` is in continuous coordinates.
    pub fn unproject(&self, pixel: DVec2, depth: f64) -> DVec3 {
        let ray = DVec3::new((pixel.x - self.cx) / self.fx, (pixel.y - self.cy) / self.fy, 1.0);
        self.rotation.transpose() * (ray * depth - self.translation)
    }

    /// Describes why the camera is invalid, or returns `None` if it is valid. The text is the end of a sentence about
    /// the camera.
    pub fn problem(&self) -> Option<String> {
        let Self { width, height, fx, fy, cx, cy, .. } = *self;
        if width == 0 || height == 0 {
            return Some(format!("the image size is {width}×{height}; both sides must be at least one pixel"));
        }
        if width > MAX_IMAGE_SIDE || height > MAX_IMAGE_SIDE {
            return Some(format!("the image size is {width}×{height}; no side may exceed {MAX_IMAGE_SIDE} pixels"));
        }
        if !(fx.is_finite() && fy.is_finite() && fx > 0.0 && fy > 0.0) {
            return Some(format!("the focal lengths are {fx} and {fy} pixels; both must be positive numbers"));
        }
        if !(cx.is_finite() && cy.is_finite()) {
            return Some(format!("the principal point is ({cx}, {cy}); both must be finite numbers"));
        }
        let few = 1.0 / MAX_CAMERA_NUMBER;
        if [fx, fy].iter().any(|f| !(few..=MAX_CAMERA_NUMBER).contains(f)) || cx.abs().max(cy.abs()) > MAX_CAMERA_NUMBER
        {
            return Some(format!(
                "the focal lengths are {fx:e} and {fy:e} pixels, the principal point is ({cx:e}, {cy:e}); nothing is computed with such numbers"
            ));
        }
        if !(self.rotation.is_finite() && self.translation.is_finite()) {
            return Some("the pose holds values that are not finite; correct or remove it".into());
        }
        let distance = self.translation.abs().max_element();
        if distance > MAX_CAMERA_NUMBER {
            return Some(format!(
                "the camera stands {distance:e} units from the origin, where single precision ends; rescale the scene"
            ));
        }
        None
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    pub(crate) fn camera() -> Camera {
        Camera {
            name: "000".into(),
            width: 160,
            height: 120,
            fx: 110.0,
            fy: 115.0,
            cx: 79.0,
            cy: 62.5,
            rotation: DMat3::from_rotation_y(0.4) * DMat3::from_rotation_x(-0.2),
            translation: DVec3::new(0.3, -1.0, 2.0),
            near: NEAR,
        }
    }

    #[test]
    fn camera_center_maps_to_the_origin() {
        let camera = camera();
        let center = camera.rotation * camera.position() + camera.translation;
        assert!(center.length() < 1e-12);
        let through_matrix = camera.world_to_camera().transform_point3(camera.position());
        assert!(through_matrix.length() < 1e-12);
    }

    #[test]
    fn forward_is_the_principal_ray() {
        let camera = camera();
        let pixel = camera.project(camera.position() + 3.0 * camera.forward()).unwrap();
        assert!((pixel - DVec2::new(79.0, 62.5)).length() < 1e-9, "{pixel}");
        assert!(camera.project(camera.position() - camera.forward()).is_none());
    }

    #[test]
    fn unproject_inverts_project() {
        let camera = camera();
        let pixel = DVec2::new(12.25, 101.5);
        let back = camera.project(camera.unproject(pixel, 2.5)).unwrap();
        assert!((back - pixel).length() < 1e-9, "{back}");
    }

    #[test]
    fn scaling_keeps_the_field_of_view() {
        let camera = camera();
        let point = camera.unproject(DVec2::new(40.0, 30.0), 2.0);
        let half = camera.scaled(80, 61);
        let expected = DVec2::new(40.0 * 80.0 / 160.0, 30.0 * 61.0 / 120.0);
        assert!((half.project(point).unwrap() - expected).length() < 1e-9);
    }

    #[test]
    fn moved_cameras_turn_about_their_center() {
        let (camera, turn, shift) = (camera(), DVec3::new(0.1, -0.3, 0.2), DVec3::new(1.0, 2.0, -0.5));
        let moved = camera.moved(turn, shift);
        assert!((moved.position() - camera.position() - shift).length() < 1e-12);
        let expected = DQuat::from_scaled_axis(turn) * camera.forward();
        assert!((moved.forward() - expected).length() < 1e-12);
        assert!((camera.moved(DVec3::ZERO, DVec3::ZERO).translation - camera.translation).length() < 1e-12);
    }

    #[test]
    fn invalid_cameras_are_described() {
        let describe = |change: fn(&mut Camera)| {
            let mut camera = camera();
            change(&mut camera);
            camera.problem().unwrap_or_default()
        };
        assert_eq!(camera().problem(), None);
        assert!(describe(|c| c.width = 0).contains("0×120"));
        assert!(describe(|c| c.height = 70_000).contains("70000"));
        assert!(describe(|c| c.fx = 0.0).contains("focal lengths are 0"));
        assert!(describe(|c| c.fy = f64::NAN).contains("NaN"));
        assert!(describe(|c| c.cx = f64::INFINITY).contains("principal point is (inf"));
        assert!(describe(|c| c.fx = 1e300).contains("focal lengths are 1e300"));
        assert!(describe(|c| c.fy = 1e-300).contains("and 1e-300 pixels"));
        assert!(describe(|c| c.cy = -1e300).contains("-1e300); nothing is computed"));
        assert!(describe(|c| c.translation.y = f64::NAN).contains("pose"));
        assert!(describe(|c| c.translation.x = 1e300).contains("stands 1e300 units from the origin"));
        assert!(describe(|c| c.rotation.x_axis.y = f64::NAN).contains("pose"));
    }
}
