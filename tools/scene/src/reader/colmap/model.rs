//! COLMAP camera models that [`Distortion`] expresses.

use crate::camera::{Distortion, Projection};

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
const MODELS: [(&str, usize); 18] = [
    ("SIMPLE_PINHOLE", 3),
    ("PINHOLE", 4),
    ("SIMPLE_RADIAL", 4),
    ("RADIAL", 5),
    ("OPENCV", 8),
    ("OPENCV_FISHEYE", 8),
    ("FULL_OPENCV", 12),
    ("FOV", 5),
    ("SIMPLE_RADIAL_FISHEYE", 4),
    ("RADIAL_FISHEYE", 5),
    ("THIN_PRISM_FISHEYE", 12),
    ("RAD_TAN_THIN_PRISM_FISHEYE", 16),
    ("SIMPLE_DIVISION", 4),
    ("DIVISION", 5),
    ("SIMPLE_FISHEYE", 3),
    ("FISHEYE", 4),
    ("EUCM", 6),
    (PANORAMA, 0),
];

/// Model of panoramas, which no pinhole camera shows.
const PANORAMA: &str = "EQUIRECTANGULAR";

fn unsupported(name: &str) -> String {
    if name == PANORAMA {
        return format!(
            "the camera model is {name}, a panorama; render perspective images from it and reconstruct from them, as \
             COLMAP's panorama_sfm does"
        );
    }
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
    // Models whose names begin with these have one focal length.
    let shared = ["SIMPLE_", "RADIAL"].iter().any(|start| name.starts_with(start));
    let (fx, fy, rest) = match *parameters {
        [f, ref rest @ ..] if shared => (f, f, rest),
        [fx, fy, ref rest @ ..] => (fx, fy, rest),
        _ => return Err(unsupported(name)),
    };
    let (cx, cy, rest) = match *rest {
        [cx, cy, ref rest @ ..] => (cx, cy, rest),
        _ => return Err(unsupported(name)),
    };
    let lens = lens(name, rest).ok_or_else(|| unsupported(name))?;
    Ok(Model { fx, fy, cx, cy, lens })
}

/// Returns the lens of a model with these parameters after the principal point.
fn lens(name: &str, parameters: &[f64]) -> Option<Distortion> {
    let fisheye = name.ends_with("FISHEYE");
    let projection = if fisheye { Projection::Equidistant } else { Projection::Perspective };
    let none = Distortion { projection, ..Distortion::NONE };
    let only = |projection| Distortion { projection, ..Distortion::NONE };
    Some(match *parameters {
        [omega] if name == "FOV" => only(Projection::FieldOfView(omega)),
        [k] if name.ends_with("DIVISION") => only(Projection::Division(k)),
        [alpha, beta] if name == "EUCM" => only(Projection::Unified { alpha, beta }),
        [] => none,
        [k1] => Distortion { k1, ..none },
        [k1, k2] => Distortion { k1, k2, ..none },
        [k1, k2, k3, k4] if fisheye => Distortion { k1, k2, k3, k4, ..none },
        [k1, k2, p1, p2] => Distortion { k1, k2, p1, p2, ..none },
        [k1, k2, p1, p2, k3, k4, sx, sy] if fisheye => {
            Distortion { k1, k2, p1, p2, k3, k4, prism: [sx, 0.0, sy, 0.0], ..none }
        }
        [k1, k2, p1, p2, k3, k4, k5, k6] => Distortion { k1, k2, p1, p2, k3, rational: [k4, k5, k6], ..none },
        // The first tangential coefficient belongs to the horizontal axis, unlike OpenCV's.
        [k1, k2, k3, k4, k5, k6, p2, p1, ref prism @ ..] => {
            let prism = prism.try_into().ok()?;
            Distortion { k1, k2, k3, k4, higher: [k5, k6], p1, p2, prism, after_radial: true, ..none }
        }
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::super::{binary, text};
    use super::*;
    use std::path::Path;

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
        let only = |projection| Distortion { projection, ..Distortion::NONE };
        let fisheye = only(Projection::Equidistant);
        assert_eq!(lens("SIMPLE_RADIAL_FISHEYE", 4), Distortion { k1: 4., ..fisheye });
        assert_eq!(lens("RADIAL_FISHEYE", 5), Distortion { k1: 4., k2: 5., ..fisheye });
        assert_eq!(lens("OPENCV_FISHEYE", 8), Distortion { k1: 5., k2: 6., k3: 7., k4: 8., ..fisheye });
        let four = Distortion { k1: 5., k2: 6., p1: 7., p2: 8., k3: 9., ..Distortion::default() };
        assert_eq!(lens("FULL_OPENCV", 12), Distortion { rational: [10., 11., 12.], ..four });
        let prism = [11., 0., 12., 0.];
        let thin = Distortion { k4: 10., prism, projection: Projection::Equidistant, ..four };
        assert_eq!(lens("THIN_PRISM_FISHEYE", 12), thin);
        assert_eq!(lens("FOV", 5), only(Projection::FieldOfView(5.)));
        assert_eq!(lens("SIMPLE_DIVISION", 4), only(Projection::Division(4.)));
        assert_eq!(lens("DIVISION", 5), only(Projection::Division(5.)));
        assert_eq!(lens("EUCM", 6), only(Projection::Unified { alpha: 5., beta: 6. }));
        assert_eq!((lens("SIMPLE_FISHEYE", 3), lens("FISHEYE", 4)), (fisheye, fisheye));
        assert_eq!(values(model("SIMPLE_FISHEYE", &[1., 2., 3.]))[..4], [1., 1., 2., 3.]);
        let numbers: Vec<f64> = (1..=16).map(f64::from).collect();
        let radial = Distortion { k1: 5., k2: 6., k3: 7., k4: 8., higher: [9., 10.], after_radial: true, ..fisheye };
        let expected = Distortion { p2: 11., p1: 12., prism: [13., 14., 15., 16.], ..radial };
        assert_eq!(model("RAD_TAN_THIN_PRISM_FISHEYE", &numbers).lens, expected);
    }

    /// Compares all models with COLMAP 4.2.1: `foreign/colmap` has its cameras and its projections of points.
    #[test]
    fn projections_match_colmap() {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/foreign/colmap");
        let cameras = binary::read_cameras(&folder.join("cameras.bin")).unwrap();
        assert_eq!(cameras, text::read_cameras(&folder.join("cameras.txt")).unwrap());
        let mut compared = [0; MODELS.len()];
        for line in std::fs::read_to_string(folder.join("projections.txt")).unwrap().lines().skip(1) {
            let (name, rest) = line.split_once(' ').unwrap();
            let numbers: Vec<f64> = rest.split(' ').map(|word| word.parse().unwrap()).collect();
            let [u, v, x, y] = numbers[..] else { panic!("{line}") };
            let number = MODELS.iter().position(|(known, _)| *known == name).unwrap();
            // The cameras are numbered from 1 in the order of the models.
            let camera = cameras.iter().find(|camera| camera.id as usize == number + 1).unwrap();
            let Model { fx, fy, cx, cy, lens } = camera.model;
            let (a, b) = lens.distort(u, v);
            let found = (fx * a + cx, fy * b + cy);
            assert!((found.0 - x).hypot(found.1 - y) < 1e-9, "{line}: {found:?}");
            assert!(lens.is_one_to_one_at(u, v) && lens.problem().is_none(), "{line}");
            compared[number] += 1;
        }
        assert_eq!(compared, MODELS.map(|(_, n)| if n > 0 { 8 } else { 0 }));
    }

    #[test]
    fn unsupported_models_are_rejected_by_name() {
        assert!(from_parameters("NEW", &[]).unwrap_err().contains("camera model is NEW, but only SIMPLE_PINHOLE"));
        for error in [from_parameters(PANORAMA, &[8.0, 6.0]).unwrap_err(), by_number(17).unwrap_err()] {
            assert!(error.contains("model is EQUIRECTANGULAR, a panorama; render perspective images"), "{error}");
        }
        assert!(by_number(-1).unwrap_err().contains("number -1"));
        assert!(by_number(99).unwrap_err().contains("number 99"));
        assert_eq!(by_number(4), Ok(("OPENCV", 8)));
        let error = from_parameters("PINHOLE", &[1.0]).unwrap_err();
        assert_eq!(error, "the model PINHOLE has 1 parameters; it must have 4");
    }
}
