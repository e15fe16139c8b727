//! Training views on the GPU: packed photographs and normal priors, and their cameras.
//!
//! Photographs and priors of all views are stored consecutively. If they exceed what a device binds at once, they take
//! several buffers of equal size.

use crate::error::{Requirement, Result};
use rayon::prelude::*;
use sgs_engine::{Device, DeviceBuffer, Location, Piece};
use sgs_passes::pipeline::Camera;
use sgs_run::{camera, pack_image, pack_normals};
use sgs_scene::{Image, Scene};

/// Training views in device memory.
pub struct TrainingData {
    /// Photographs and priors; at least one part.
    pub parts: Vec<Photographs>,
    /// Camera and first pixel in its part of each training view, as in the split.
    pub views: Vec<(Camera, u32)>,
    /// Part of each view.
    pub part_of: Vec<usize>,
    /// Upper bounds of the width and height of all views.
    pub largest: [u32; 2],
}

/// Photographs and priors of some views.
pub struct Photographs {
    /// Photographs, RGBA8. Alpha is 0 at invalid pixels.
    pub targets: DeviceBuffer,
    /// Normal priors, if any training view has one.
    pub normals: Option<DeviceBuffer>,
}

/// Training views on the host, packed for upload.
pub(crate) struct Packed {
    images: Vec<Vec<u32>>,
    normals: Option<Vec<Vec<u32>>>,
    views: Vec<(Camera, u32)>,
    part_of: Vec<usize>,
    /// Upper bounds of the width and height of all views.
    pub largest: [u32; 2],
}

impl Packed {
    /// Reads the training views of a scene. Reads the priors, if any, only with `normals`.
    pub fn read(scene: &Scene, normals: bool) -> Result<Packed> {
        let train = &scene.split.train;
        let pack = |&i: &usize| Ok(pack_image(&scene.load_image(i)?, scene.load_mask(i)?.as_ref()));
        let images: Vec<Vec<u32>> = train.par_iter().map(pack).collect::<Result<_>>()?;
        let mut packed = Packed { images, normals: None, views: Vec::new(), part_of: Vec::new(), largest: [1, 1] };
        let mut offset = 0_u64;
        for &i in train {
            packed.add(camera(&scene.views[i].camera), &mut offset)?;
        }
        if normals {
            let maps: Vec<Option<Vec<u32>>> = train
                .par_iter()
                .map(|&i| Ok(scene.normal_prior(i)?.map(|n| pack_normals(&n))))
                .collect::<Result<_>>()?;
            // A view without a prior is trained without one: a word of zero means an unknown normal.
            if maps.iter().any(Option::is_some) {
                let filled = maps.into_iter().zip(&packed.images).map(|(map, image)| {
                    let mut map = map.unwrap_or_else(|| vec![0; image.len()]);
                    // Invalid pixels of the photograph have no normal either.
                    map.iter_mut().zip(image).filter(|(_, i)| *i >> 24 == 0).for_each(|(n, _)| *n = 0);
                    map
                });
                packed.normals = Some(filled.collect());
            }
        }
        Ok(packed)
    }

    /// Packs display-referred images that are no photographs, with their cameras.
    pub fn of(renderings: &[(&sgs_scene::Camera, Image)]) -> Result<Packed> {
        let images = renderings.par_iter().map(|(_, image)| pack_image(image, None)).collect();
        let mut packed = Packed { images, normals: None, views: Vec::new(), part_of: Vec::new(), largest: [1, 1] };
        let mut offset = 0_u64;
        for (c, _) in renderings {
            packed.add(camera(c), &mut offset)?;
        }
        Ok(packed)
    }

    /// Appends a view after the others.
    fn add(&mut self, c: Camera, offset: &mut u64) -> Result<()> {
        self.largest = [self.largest[0].max(c.size[0]), self.largest[1].max(c.size[1])];
        let many = Requirement::FewerPixels { what: "The training views", remedy: "--scale" };
        let first = u32::try_from(*offset).map_err(|_| many)?;
        *offset += u64::from(c.size[0]) * u64::from(c.size[1]);
        self.views.push((c, first));
        self.part_of.push(0);
        Ok(())
    }

    /// Distributes the views over parts of at most `most` bytes.
    ///
    /// Parts have about equal sizes. A larger photograph has a part of its own.
    pub fn split(&mut self, most: u64) {
        let of = |image: &Vec<u32>| 4 * image.len() as u64;
        let total = bytes(&self.images);
        let largest = self.images.iter().map(of).max().unwrap_or(0);
        let full = most.min(total.div_ceil(total.div_ceil(most.max(1)).max(1)) + largest);
        let (mut part, mut used) = (0, 0);
        for ((view, part_of), image) in self.views.iter_mut().zip(&mut self.part_of).zip(&self.images) {
            if used > 0 && total > most && used + of(image) > full {
                (part, used) = (part + 1, 0);
            }
            (view.1, *part_of) = ((used / 4) as u32, part);
            used += of(image);
        }
    }

    /// Returns the number of parts.
    pub fn parts(&self) -> usize {
        self.part_of.last().map_or(1, |last| last + 1)
    }

    /// Returns the normal priors, by training view.
    pub fn normals(&self) -> Option<&[Vec<u32>]> {
        self.normals.as_deref()
    }

    /// Returns all photographs.
    pub fn images(&self) -> &[Vec<u32>] {
        &self.images
    }

    /// Returns the photograph of a view.
    pub fn image(&self, view: usize) -> &[u32] {
        &self.images[view]
    }

    /// Returns the camera and the first pixel of each view.
    pub fn views(&self) -> &[(Camera, u32)] {
        &self.views
    }

    /// Returns each photograph's difference from the best single color.
    /// The difference is the mean absolute one.
    pub fn plain(&self) -> Vec<f64> {
        self.images.par_iter().map(|image| crate::divergence::plain(image)).collect()
    }

    /// Returns the number of bytes of the photographs of the largest part.
    pub fn image_bytes(&self) -> u64 {
        let mut sizes = vec![0; self.parts()];
        for (part, image) in self.part_of.iter().zip(&self.images) {
            sizes[*part] += 4 * image.len() as u64;
        }
        sizes.into_iter().max().unwrap_or(0)
    }

    /// Returns the bytes of the normal priors of the largest part, if there are any.
    pub fn normal_bytes(&self) -> Option<u64> {
        self.normals.as_ref().map(|_| self.image_bytes())
    }

    /// Uploads photographs and priors to the device.
    pub fn upload(self, device: &Device) -> Result<TrainingData> {
        let size = self.image_bytes();
        let part = |name: &str, images: &[Vec<u32>], part: usize| -> Result<DeviceBuffer> {
            let buffer = device.buffer(name, size, Location::Device)?;
            let mut offset = 0;
            let mut pieces: Vec<Piece<'_>> = Vec::new();
            for (image, _) in images.iter().zip(&self.part_of).filter(|(_, of)| **of == part) {
                pieces.push((&buffer, offset, bytemuck::cast_slice(image)));
                offset += 4 * image.len() as u64;
            }
            device.upload_all(&pieces)?;
            drop(pieces);
            Ok(buffer)
        };
        let mut parts = Vec::new();
        for k in 0..self.parts() {
            let targets = part("targets", &self.images, k)?;
            let normals = self.normals.as_ref().map(|maps| part("normal_priors", maps, k)).transpose()?;
            parts.push(Photographs { targets, normals });
        }
        Ok(TrainingData { parts, views: self.views, part_of: self.part_of, largest: self.largest })
    }
}

impl TrainingData {
    /// Loads the training views of a scene. Loads the priors, if any, only with `normals`.
    ///
    /// # Errors
    /// If an image or prior cannot be read, or memory runs out.
    pub fn load(device: &Device, scene: &Scene, normals: bool) -> Result<TrainingData> {
        let mut packed = Packed::read(scene, normals)?;
        packed.split(device.info().largest_binding());
        packed.upload(device)
    }

    /// Returns the photographs and priors of a view's part.
    pub fn part(&self, view: usize) -> &Photographs {
        &self.parts[self.part_of[view]]
    }
}

fn bytes(parts: &[Vec<u32>]) -> u64 {
    4 * parts.iter().map(|p| p.len() as u64).sum::<u64>()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn packed(sizes: &[usize]) -> Packed {
        let images = sizes.iter().map(|size| vec![0; *size]).collect();
        let views = vec![(Camera::default(), 0); sizes.len()];
        Packed { images, normals: None, views, part_of: vec![0; sizes.len()], largest: [1, 1] }
    }

    #[test]
    fn parts_hold_all_views_within_the_limit() {
        for (sizes, most, parts, largest) in [
            (vec![10; 6], 240, 1, 240),
            (vec![10; 6], 239, 2, 160),
            (vec![10; 6], 40, 6, 40),
            (vec![10; 7], 100, 4, 80),
            (vec![3, 50, 3, 3], 100, 3, 200),
            (vec![], 100, 1, 0),
        ] {
            let mut data = packed(&sizes);
            data.split(most);
            assert_eq!((data.parts(), data.image_bytes()), (parts, largest), "{sizes:?} {most}");
            // Views of a part follow one another.
            let mut next = vec![0; parts];
            for (i, size) in sizes.iter().enumerate() {
                assert_eq!(data.views[i].1, next[data.part_of[i]]);
                next[data.part_of[i]] += *size as u32;
            }
        }
    }
}
