//! COLMAP camera models that are a pinhole with OpenCV distortion.

use crate::camera::Distortion;

/// Pinhole camera with lens distortion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Model {
    pub(super) fx: f64,
    pub(super) fy: f64,
    pub(super) cx: f64,
    pub(super) cy: f64,
    pub(super) lens: Distortion,
}

/// Model names in the order of COLMAP's ids, with their numbers of parameters. Unsupported models have 0.
const MODELS: [(&str, usize); 11] = [
    ("SIMPLE_PINHOLE", 3),
    ("PINHOLE", 4),
    ("SIMPLE_RADIAL", 4),
    ("RADIAL", 5),
    ("OPENCV", 8),
    ("OPENCV_FISHEYE", 0),
    ("FULL_OPENCV", 0),
    ("FOV", 0),
    ("SIMPLE_RADIAL_FISHEYE", 0),
    ("RADIAL_FISHEYE", 0),
    ("THIN_PRISM_FISHEYE", 0),
];

fn unsupported(name: &str) -> String {
    format!(
        "the camera model is {name}, but only SIMPLE_PINHOLE, PINHOLE, SIMPLE_RADIAL, RADIAL and OPENCV are read; run \
         COLMAP's image_undistorter first"
    )
}

/// Returns the name and the number of parameters of the model with this id.
pub(super) fn by_number(number: i32) -> Result<(&'static str, usize), String> {
    match usize::try_from(number).ok().and_then(|n| MODELS.get(n)) {
        Some(&(name, 0)) => Err(unsupported(name)),
        Some(&model) => Ok(model),
        None => Err(unsupported(&format!("number {number}"))),
    }
}

/// Returns the model with this name and these parameters.
pub(super) fn from_parameters(name: &str, parameters: &[f64]) -> Result<Model, String> {
    let expected = match MODELS.iter().find(|(known, _)| *known == name) {
        Some(&(_, n)) if n > 0 => n,
        _ => return Err(unsupported(name)),
    };
    if parameters.len() != expected {
        return Err(format!("the model {name} has {} parameters; it must have {expected}", parameters.len()));
    }
    let none = Distortion::default();
    Ok(match *parameters {
        [f, cx, cy] => Model { fx: f, fy: f, cx, cy, lens: none },
        [f, cx, cy, k1] if name == "SIMPLE_RADIAL" => Model { fx: f, fy: f, cx, cy, lens: Distortion { k1, ..none } },
        [fx, fy, cx, cy] => Model { fx, fy, cx, cy, lens: none },
        [f, cx, cy, k1, k2] => Model { fx: f, fy: f, cx, cy, lens: Distortion { k1, k2, ..none } },
        [fx, fy, cx, cy, k1, k2, p1, p2] => Model { fx, fy, cx, cy, lens: Distortion { k1, k2, p1, p2, ..none } },
        _ => return Err(unsupported(name)),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parameters_follow_colmap_order() {
        let model = |name, p: &[f64]| from_parameters(name, p).unwrap();
        let values = |m: Model| [m.fx, m.fy, m.cx, m.cy, m.lens.k1, m.lens.k2, m.lens.p1, m.lens.p2];
        assert_eq!(values(model("SIMPLE_PINHOLE", &[1., 2., 3.])), [1., 1., 2., 3., 0., 0., 0., 0.]);
        assert_eq!(values(model("PINHOLE", &[1., 2., 3., 4.])), [1., 2., 3., 4., 0., 0., 0., 0.]);
        assert_eq!(values(model("SIMPLE_RADIAL", &[1., 2., 3., 4.])), [1., 1., 2., 3., 4., 0., 0., 0.]);
        assert_eq!(values(model("RADIAL", &[1., 2., 3., 4., 5.])), [1., 1., 2., 3., 4., 5., 0., 0.]);
        let opencv = model("OPENCV", &[1., 2., 3., 4., 5., 6., 7., 8.]);
        assert_eq!(values(opencv), [1., 2., 3., 4., 5., 6., 7., 8.]);
    }

    #[test]
    fn unsupported_models_are_rejected_by_name() {
        assert!(from_parameters("FOV", &[0.0; 5]).unwrap_err().contains("camera model is FOV, but only"));
        assert!(from_parameters("NEW", &[]).unwrap_err().contains("camera model is NEW"));
        assert!(by_number(5).unwrap_err().contains("camera model is OPENCV_FISHEYE"));
        assert!(by_number(-1).unwrap_err().contains("number -1"));
        assert!(by_number(99).unwrap_err().contains("number 99"));
        assert_eq!(by_number(4), Ok(("OPENCV", 8)));
        let error = from_parameters("PINHOLE", &[1.0]).unwrap_err();
        assert_eq!(error, "the model PINHOLE has 1 parameters; it must have 4");
    }
}
