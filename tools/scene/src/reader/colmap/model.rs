//! COLMAP camera models that [`Distortion`] expresses.

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
    ("OPENCV_FISHEYE", 8),
    ("FULL_OPENCV", 12),
    ("FOV", 0),
    ("SIMPLE_RADIAL_FISHEYE", 4),
    ("RADIAL_FISHEYE", 5),
    ("THIN_PRISM_FISHEYE", 12),
];

fn unsupported(name: &str) -> String {
    let known: Vec<&str> = MODELS.iter().filter(|(_, n)| *n > 0).map(|(known, _)| *known).collect();
    format!("the camera model is {name}, but only {} are read; run COLMAP's image_undistorter first", known.join(", "))
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
    let fisheye = name.ends_with("FISHEYE");
    let none = Distortion { fisheye, ..Distortion::default() };
    // Models whose names begin with these have one focal length.
    let shared = ["SIMPLE", "RADIAL"].iter().any(|start| name.starts_with(start));
    let (fx, fy, rest) = match *parameters {
        [f, ref rest @ ..] if shared => (f, f, rest),
        [fx, fy, ref rest @ ..] => (fx, fy, rest),
        _ => return Err(unsupported(name)),
    };
    let (cx, cy, rest) = match *rest {
        [cx, cy, ref rest @ ..] => (cx, cy, rest),
        _ => return Err(unsupported(name)),
    };
    let lens = match *rest {
        [] => none,
        [k1] => Distortion { k1, ..none },
        [k1, k2] => Distortion { k1, k2, ..none },
        [k1, k2, k3, k4] if fisheye => Distortion { k1, k2, k3, k4, ..none },
        [k1, k2, p1, p2] => Distortion { k1, k2, p1, p2, ..none },
        [k1, k2, p1, p2, k3, k4, sx, sy] if fisheye => Distortion { k1, k2, p1, p2, k3, k4, prism: [sx, sy], ..none },
        [k1, k2, p1, p2, k3, k4, k5, k6] => Distortion { k1, k2, p1, p2, k3, rational: [k4, k5, k6], ..none },
        _ => return Err(unsupported(name)),
    };
    Ok(Model { fx, fy, cx, cy, lens })
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
        let numbers: Vec<f64> = (1..=12).map(f64::from).collect();
        let lens = |name, n| model(name, &numbers[..n]).lens;
        let fisheye = Distortion { fisheye: true, ..Distortion::default() };
        assert_eq!(lens("SIMPLE_RADIAL_FISHEYE", 4), Distortion { k1: 4., ..fisheye });
        assert_eq!(lens("RADIAL_FISHEYE", 5), Distortion { k1: 4., k2: 5., ..fisheye });
        assert_eq!(lens("OPENCV_FISHEYE", 8), Distortion { k1: 5., k2: 6., k3: 7., k4: 8., ..fisheye });
        let four = Distortion { k1: 5., k2: 6., p1: 7., p2: 8., k3: 9., ..Distortion::default() };
        assert_eq!(lens("FULL_OPENCV", 12), Distortion { rational: [10., 11., 12.], ..four });
        let prism = Distortion { k4: 10., prism: [11., 12.], fisheye: true, ..four };
        assert_eq!(lens("THIN_PRISM_FISHEYE", 12), prism);
    }

    #[test]
    fn unsupported_models_are_rejected_by_name() {
        assert!(from_parameters("FOV", &[0.0; 5]).unwrap_err().contains("camera model is FOV, but only"));
        assert!(from_parameters("NEW", &[]).unwrap_err().contains("camera model is NEW"));
        assert!(by_number(7).unwrap_err().contains("camera model is FOV"));
        assert!(by_number(-1).unwrap_err().contains("number -1"));
        assert!(by_number(99).unwrap_err().contains("number 99"));
        assert_eq!(by_number(4), Ok(("OPENCV", 8)));
        let error = from_parameters("PINHOLE", &[1.0]).unwrap_err();
        assert_eq!(error, "the model PINHOLE has 1 parameters; it must have 4");
    }
}
