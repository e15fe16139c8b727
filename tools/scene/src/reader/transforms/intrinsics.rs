//! Fields at the top of a `transforms.json`, in a frame, or in both.

use glam::{DMat3, DVec3};
use serde::Deserialize;

use crate::camera::{Camera, Distortion, Projection};
use crate::reader::pose::{self, Axes};

/// Top level of the file or one of its frames. All fields are optional; frames inherit missing fields from the top
/// level.
///
/// A flat structure serves both, because nested structures would lose the line of an invalid value.
#[derive(Clone, Debug, Default, Deserialize)]
pub(super) struct Entry {
    pub(super) file_path: Option<String>,
    pub(super) transform_matrix: Option<Vec<Vec<f64>>>,
    pub(super) split: Option<String>,
    pub(super) mask_path: Option<String>,
    pub(super) depth_file_path: Option<String>,
    depth_unit_scale_factor: Option<f64>,
    camera_model: Option<String>,
    is_fisheye: Option<bool>,
    fl_x: Option<f64>,
    fl_y: Option<f64>,
    camera_angle_x: Option<f64>,
    camera_angle_y: Option<f64>,
    cx: Option<f64>,
    cy: Option<f64>,
    w: Option<f64>,
    h: Option<f64>,
    width: Option<f64>,
    height: Option<f64>,
    k1: Option<f64>,
    k2: Option<f64>,
    k3: Option<f64>,
    k4: Option<f64>,
    p1: Option<f64>,
    p2: Option<f64>,
}

impl Entry {
    /// Returns a frame's intrinsic values, completed with those of the file.
    pub(super) fn or(&self, all: &Self) -> Self {
        // A focal length in a frame overrides both of the file's representations.
        let own_focal = self.fl_x.is_some() || self.camera_angle_x.is_some();
        let focal = if own_focal { self } else { all };
        Self {
            file_path: None,
            transform_matrix: None,
            split: None,
            mask_path: None,
            depth_file_path: None,
            depth_unit_scale_factor: self.depth_unit_scale_factor.or(all.depth_unit_scale_factor),
            camera_model: self.camera_model.clone().or_else(|| all.camera_model.clone()),
            is_fisheye: self.is_fisheye.or(all.is_fisheye),
            fl_x: focal.fl_x,
            fl_y: self.fl_y.or(focal.fl_y),
            camera_angle_x: focal.camera_angle_x,
            camera_angle_y: self.camera_angle_y.or(focal.camera_angle_y),
            cx: self.cx.or(all.cx),
            cy: self.cy.or(all.cy),
            w: self.w.or(self.width).or(all.w).or(all.width),
            h: self.h.or(self.height).or(all.h).or(all.height),
            width: None,
            height: None,
            k1: self.k1.or(all.k1),
            k2: self.k2.or(all.k2),
            k3: self.k3.or(all.k3),
            k4: self.k4.or(all.k4),
            p1: self.p1.or(all.p1),
            p2: self.p2.or(all.p2),
        }
    }

    /// Returns the image size if the file states it.
    pub(super) fn size(&self) -> Result<Option<(u32, u32)>, String> {
        let (Some(w), Some(h)) = (self.w, self.h) else {
            return Ok(None);
        };
        let side = |v: f64| (v.fract() == 0.0 && v > 0.0 && v <= f64::from(u32::MAX)).then_some(v as u32);
        match (side(w), side(h)) {
            (Some(w), Some(h)) => Ok(Some((w, h))),
            _ => Err(format!("the image size is {w}×{h}; w and h must be whole positive numbers of pixels")),
        }
    }

    /// Returns whether the frame's `split` marks it as a test view.
    pub(super) fn test(&self) -> Option<bool> {
        match self.split.as_deref()? {
            "train" => Some(false),
            "test" | "val" => Some(true),
            _ => None,
        }
    }

    /// Returns the length of a step of depth files in units of the scene. nerfstudio takes a thousandth by default.
    pub(super) fn depth_unit(&self) -> Result<f64, String> {
        let unit = self.depth_unit_scale_factor.unwrap_or(1e-3);
        if unit.is_finite() && unit > 0.0 {
            return Ok(unit);
        }
        Err(format!("depth_unit_scale_factor is {unit}; it must be a positive number"))
    }

    /// Returns the lens distortion.
    pub(super) fn lens(&self) -> Result<Distortion, String> {
        let value = |k: Option<f64>| k.unwrap_or(0.0);
        let lens = Distortion {
            k1: value(self.k1),
            k2: value(self.k2),
            k3: value(self.k3),
            k4: value(self.k4),
            p1: value(self.p1),
            p2: value(self.p2),
            projection: if self.is_fisheye_lens() { Projection::Equidistant } else { Projection::Perspective },
            ..Distortion::default()
        };
        lens.problem().map_or(Ok(lens), Err)
    }

    /// Returns the camera of an image with this size.
    pub(super) fn camera(
        &self,
        name: String,
        (width, height): (u32, u32),
        rotation: DMat3,
        translation: DVec3,
    ) -> Result<Camera, String> {
        self.check_model()?;
        let from_angle = |angle: f64, side: u32| 0.5 * f64::from(side) / (0.5 * angle).tan();
        let (fx, fy) = match (self.fl_x, self.camera_angle_x) {
            (Some(fx), _) => (fx, self.fl_y.unwrap_or(fx)),
            (None, Some(angle)) => {
                for angle in [Some(angle), self.camera_angle_y].into_iter().flatten() {
                    if !(angle > 0.0 && angle < std::f64::consts::PI) {
                        return Err(format!("the field of view is {angle} radians; it must lie between 0 and π"));
                    }
                }
                let fx = from_angle(angle, width);
                (fx, self.fl_y.or(self.camera_angle_y.map(|angle| from_angle(angle, height))).unwrap_or(fx))
            }
            (None, None) => {
                return Err("there is no focal length; add fl_x or camera_angle_x".into());
            }
        };
        let cx = self.cx.unwrap_or(0.5 * f64::from(width));
        let cy = self.cy.unwrap_or(0.5 * f64::from(height));
        let camera = Camera { name, width, height, fx, fy, cx, cy, rotation, translation, near: crate::camera::NEAR };
        match camera.problem() {
            None => Ok(camera),
            Some(problem) => Err(problem),
        }
    }

    /// Returns the name of the frame in error messages.
    pub(super) fn place(&self, index: usize) -> String {
        match &self.file_path {
            Some(path) => format!("frame {index} ({path})"),
            None => format!("frame {index}"),
        }
    }

    /// Returns the world-to-camera pose.
    pub(super) fn pose(&self, axes: Axes) -> Result<(DMat3, DVec3), String> {
        let rows = self.transform_matrix.as_ref().ok_or("there is no transform_matrix; every frame needs one")?;
        pose::from_matrix(rows, axes)
    }

    /// Returns whether the coefficients are those of OpenCV's fisheye model.
    fn is_fisheye_lens(&self) -> bool {
        self.is_fisheye == Some(true)
            || self.camera_model.as_ref().is_some_and(|model| model.eq_ignore_ascii_case("OPENCV_FISHEYE"))
    }

    fn check_model(&self) -> Result<(), String> {
        let model = self.camera_model.as_deref().unwrap_or("OPENCV");
        let known = ["OPENCV", "OPENCV_FISHEYE", "PERSPECTIVE", "PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL"];
        if known.contains(&model.to_uppercase().as_str()) {
            return Ok(());
        }
        Err(format!("the camera model is {model}, which is not supported; undistort the images to a pinhole camera"))
    }
}
