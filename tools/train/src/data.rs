//! Training views on the GPU: packed photographs and normal priors, and their cameras.
//! Photographs and priors of all views are stored consecutively.

use crate::error::{Requirement, Result};
use rayon::prelude::*;
use sgs_engine::{Device, DeviceBuffer, Location};
use sgs_passes::pipeline::Camera;
use sgs_run::{camera, pack_image, pack_normals};
use sgs_scene::{Image, Scene};

/// Training views in device memory.
pub struct TrainingData {
    /// Photographs, RGBA8. Alpha is 0 at invalid pixels.
    pub targets: DeviceBuffer,
    /// Normal priors, if any training view has one.
    pub normals: Option<DeviceBuffer>,
    /// Camera and first pixel of each training view, in the order of the split.
    pub views: Vec<(Camera, u32)>,
    /// Upper bounds of the width and height of all views.
    pub largest: [u32; 2],
}

/// Training views on the host, packed for upload.
pub(crate) struct Packed {
    images: Vec<Vec<u32>>,
    normals: Option<Vec<Vec<u32>>>,
    views: Vec<(Camera, u32)>,
    /// Upper bounds of the width and height of all views.
    pub largest: [u32; 2],
}

impl Packed {
    /// Reads the training views of a scene. Reads the priors, if any, only with `normals`.
    pub fn read(scene: &Scene, normals: bool) -> Result<Packed> {
        let train = &scene.split.train;
        let pack = |&i: &usize| Ok(pack_image(&scene.load_image(i)?, scene.load_mask(i)?.as_ref()));
        let images: Vec<Vec<u32>> = train.par_iter().map(pack).collect::<Result<_>>()?;
        let mut packed = Packed { images, normals: None, views: Vec::new(), largest: [1, 1] };
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
        let mut packed = Packed { images, normals: None, views: Vec::new(), largest: [1, 1] };
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
        Ok(())
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

    /// Returns the number of bytes of the photographs.
    pub fn image_bytes(&self) -> u64 {
        bytes(&self.images)
    }

    /// Returns the number of bytes of the normal priors, if there are any.
    pub fn normal_bytes(&self) -> Option<u64> {
        self.normals.as_deref().map(bytes)
    }

    /// Uploads photographs and priors to the device.
    pub fn upload(self, device: &Device) -> Result<TrainingData> {
        let targets = upload(device, "targets", &self.images)?;
        let normals = self.normals.map(|maps| upload(device, "normal_priors", &maps)).transpose()?;
        Ok(TrainingData { targets, normals, views: self.views, largest: self.largest })
    }
}

impl TrainingData {
    /// Loads the training views of a scene. Loads the priors, if any, only with `normals`.
    ///
    /// # Errors
    /// If an image or prior cannot be read, or memory runs out.
    pub fn load(device: &Device, scene: &Scene, normals: bool) -> Result<TrainingData> {
        Packed::read(scene, normals)?.upload(device)
    }
}

fn bytes(parts: &[Vec<u32>]) -> u64 {
    4 * parts.iter().map(|p| p.len() as u64).sum::<u64>()
}

fn upload(device: &Device, name: &str, parts: &[Vec<u32>]) -> Result<DeviceBuffer> {
    let buffer = device.buffer(name, bytes(parts), Location::Device)?;
    let mut offset = 0;
    for part in parts {
        device.upload(&buffer, offset, bytemuck::cast_slice(part))?;
        offset += 4 * part.len() as u64;
    }
    Ok(buffer)
}
