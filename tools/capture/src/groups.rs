//! Groups of images that share a camera.

use crate::prepared::Prepared;

/// Fewest images from which COLMAP is to estimate four distortion coefficients.
const ENOUGH: usize = 10;

/// Images of one camera, at one size and focal length.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Group {
    /// File names.
    pub(crate) names: Vec<String>,
    size: (u32, u32),
    focal: Option<f64>,
    camera: String,
}

impl Group {
    /// Groups images by size, camera and focal length.
    pub(crate) fn of(images: &[Prepared]) -> Vec<Group> {
        let mut groups: Vec<Group> = Vec::new();
        for image in images {
            let same = |g: &&mut Group| g.size == image.size && g.focal == image.focal && g.camera == image.camera;
            match groups.iter_mut().find(same) {
                Some(group) => group.names.push(image.name.clone()),
                None => groups.push(Group {
                    names: vec![image.name.clone()],
                    size: image.size,
                    focal: image.focal,
                    camera: image.camera.clone(),
                }),
            }
        }
        groups
    }

    /// Returns COLMAP's camera model: one with few coefficients for few images.
    pub(crate) fn model(&self) -> &'static str {
        if self.names.len() < ENOUGH { "SIMPLE_RADIAL" } else { "OPENCV" }
    }

    /// Returns the initial parameters of the model, if the focal length is known.
    pub(crate) fn parameters(&self) -> Option<String> {
        let focal = self.focal?;
        let [cx, cy] = [self.size.0, self.size.1].map(|side| 0.5 * f64::from(side));
        Some(if self.names.len() < ENOUGH {
            format!("{focal},{cx},{cy},0")
        } else {
            format!("{focal},{focal},{cx},{cy},0,0,0,0")
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn images_of_one_camera_form_a_group() {
        let image = |i: usize, size, focal, camera: &str| Prepared {
            file: String::new(),
            name: format!("{i}.jpg"),
            size,
            focal,
            camera: camera.into(),
        };
        let mut images: Vec<Prepared> = (0..10).map(|i| image(i, (40, 30), Some(33.5), "Phone")).collect();
        images.push(image(10, (30, 40), Some(33.5), "Phone"));
        images.push(image(11, (40, 30), None, ""));
        images.push(image(12, (40, 30), None, ""));
        let groups = Group::of(&images);
        assert_eq!(groups.iter().map(|g| g.names.len()).collect::<Vec<_>>(), [10, 1, 2]);
        assert_eq!(
            (groups[0].model(), groups[0].parameters().unwrap().as_str()),
            ("OPENCV", "33.5,33.5,20,15,0,0,0,0")
        );
        assert_eq!((groups[1].model(), groups[1].parameters().unwrap().as_str()), ("SIMPLE_RADIAL", "33.5,15,20,0"));
        assert_eq!((groups[2].model(), groups[2].parameters()), ("SIMPLE_RADIAL", None));
    }
}
