//! Pinhole camera.
//!
//! The pose is an OpenGL camera-to-world transform (x right, y up, viewing along −z), as written to files. Pixel
//! coordinates have their origin at the top left corner. Pixel centers lie at half-integers.

use glam::{Mat3, Mat4, Vec2, Vec3};

/// Position, orientation and projection.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Camera {
    /// Center of projection.
    pub(crate) position: Vec3,
    /// Columns: right, up, backward.
    pub(crate) axes: Mat3,
    /// Focal length in pixels, the same in both directions.
    pub(crate) focal: f32,
    /// Image width in pixels.
    pub(crate) width: usize,
    /// Image height in pixels.
    pub(crate) height: usize,
}

impl Camera {
    /// Creates a camera at `position` that looks at `target`.
    ///
    /// `roll` turns the camera around its viewing axis, in radians. `fov_x` is the horizontal field of view in radians.
    pub(crate) fn look_at(position: Vec3, target: Vec3, roll: f32, fov_x: f32, width: usize, height: usize) -> Self {
        let back = (position - target).normalize_or(Vec3::Z);
        let right = Vec3::Y.cross(back).normalize_or(Vec3::X);
        let up = back.cross(right);
        let (s, c) = roll.sin_cos();
        Self {
            position,
            axes: Mat3::from_cols(right * c + up * s, up * c - right * s, back),
            focal: 0.5 * width as f32 / (0.5 * fov_x).tan(),
            width,
            height,
        }
    }

    /// Returns the camera with another resolution.
    pub(crate) fn resized(&self, width: usize, height: usize) -> Self {
        Self { focal: self.focal * width as f32 / self.width as f32, width, height, ..*self }
    }

    /// Returns the principal point.
    pub(crate) fn center(&self) -> Vec2 {
        Vec2::new(0.5 * self.width as f32, 0.5 * self.height as f32)
    }

    /// Returns the unit direction through a point of the image.
    pub(crate) fn direction(&self, pixel: Vec2) -> Vec3 {
        let p = (pixel - self.center()) / self.focal;
        (self.axes * Vec3::new(p.x, -p.y, -1.0)).normalize()
    }

    /// Projects a world point. Returns its pixel and its depth along the viewing axis.
    ///
    /// Returns none for a point behind the camera or outside the image.
    pub(crate) fn project(&self, world: Vec3) -> Option<(Vec2, f32)> {
        let local = self.axes.transpose() * (world - self.position);
        let depth = -local.z;
        if depth < 1e-3 {
            return None;
        }
        let pixel = self.center() + Vec2::new(local.x, -local.y) * (self.focal / depth);
        let inside = pixel.cmpge(Vec2::ZERO).all() && pixel.x < self.width as f32 && pixel.y < self.height as f32;
        inside.then_some((pixel, depth))
    }

    /// Returns the depth along the viewing axis at `distance` along a unit direction.
    pub(crate) fn depth(&self, direction: Vec3, distance: f32) -> f32 {
        -distance * direction.dot(self.axes.z_axis)
    }

    /// Rotates a world vector into the camera's OpenGL axes.
    pub(crate) fn local(&self, vector: Vec3) -> Vec3 {
        self.axes.transpose() * vector
    }

    /// Returns the camera-to-world matrix.
    pub(crate) fn matrix(&self) -> Mat4 {
        Mat4::from_cols(
            self.axes.x_axis.extend(0.0),
            self.axes.y_axis.extend(0.0),
            self.axes.z_axis.extend(0.0),
            self.position.extend(1.0),
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn projection_inverts_direction() {
        let camera = Camera::look_at(Vec3::new(1.0, 1.5, 2.0), Vec3::new(-0.3, 0.7, -0.4), 0.05, 1.2, 160, 120);
        for pixel in [Vec2::new(0.5, 0.5), Vec2::new(133.2, 17.9)] {
            let direction = camera.direction(pixel);
            let (back, depth) = camera.project(camera.position + 3.0 * direction).unwrap();
            assert!((back - pixel).length() < 1e-3);
            assert!((depth - camera.depth(direction, 3.0)).abs() < 1e-5);
        }
    }

    #[test]
    fn image_right_and_up_match_world_right_and_up() {
        let camera = Camera::look_at(Vec3::new(0.0, 1.0, 3.0), Vec3::Y, 0.0, 1.2, 100, 100);
        let (right, _) = camera.project(Vec3::new(0.5, 1.0, 0.0)).unwrap();
        let (up, _) = camera.project(Vec3::new(0.0, 1.5, 0.0)).unwrap();
        assert!(right.x > 50.0 && up.y < 50.0);
    }
}
