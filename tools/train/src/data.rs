//! Training views on the GPU: packed photographs, prior normals and prior depths, and their cameras.
//!
//! Photographs and priors of all views are stored consecutively. If they exceed what a device binds at once, they take
//! several buffers of equal size. The first steps may use smaller photographs; these follow the full one of their view.

use crate::error::{Requirement, Result};
use crate::reduce::{halved_depths, halved_image, halved_normals, halved_size};
use rayon::prelude::*;
use sgs_engine::{Device, DeviceBuffer, Location, Piece};
use sgs_passes::loss::Fit;
use sgs_passes::pipeline::Camera;
use sgs_run::{camera, pack_depths, pack_image, pack_normals};
use sgs_scene::{DepthMeaning, Image, Scene};

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
    /// Number of smaller photographs of each view. Each has half the width and height of the one before.
    pub halvings: u32,
    /// Relation of prior depths to depth.
    pub fit: Fit,
}

/// Photographs and priors of some views.
pub struct Photographs {
    /// Photographs, RGBA8. Alpha is 0 at invalid pixels.
    pub targets: DeviceBuffer,
    /// Normal priors, if any training view has one.
    pub normals: Option<DeviceBuffer>,
    /// Prior depths, if any training view has one.
    pub depths: Option<DeviceBuffer>,
}

/// Kinds of priors that are read with the photographs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PixelPriors {
    /// Normals.
    pub normals: bool,
    /// Depths.
    pub depths: bool,
}

/// Training views on the host, packed for upload.
pub(crate) struct Packed {
    /// By view, each followed by its smaller copies.
    images: Vec<Vec<u32>>,
    /// Like `images`.
    normals: Option<Vec<Vec<u32>>>,
    /// Like `images`.
    depths: Option<Vec<Vec<u32>>>,
    fit: Fit,
    halvings: u32,
    views: Vec<(Camera, u32)>,
    part_of: Vec<usize>,
    /// Upper bounds of the width and height of all views.
    pub largest: [u32; 2],
}

impl Packed {
    /// Reads the training views of a scene, and the wanted priors that exist.
    pub fn read(scene: &Scene, wanted: PixelPriors) -> Result<Packed> {
        let train = &scene.split.train;
        let pack = |&i: &usize| Ok(pack_image(&scene.load_image(i)?, scene.load_mask(i)?.as_ref()));
        let images: Vec<Vec<u32>> = train.par_iter().map(pack).collect::<Result<_>>()?;
        let mut packed = Packed::without_priors(images);
        let mut offset = 0_u64;
        for &i in train {
            packed.add(camera(&scene.views[i].camera), &mut offset)?;
        }
        if wanted.normals {
            packed.normals = packed.priors(train, |i| Ok(scene.normal_prior(i)?.map(|n| pack_normals(&n))))?;
        }
        if wanted.depths {
            let meaning = scene.depth_meaning();
            packed.depths = packed.priors(train, |i| Ok(scene.depth_prior(i)?.map(|d| pack_depths(&d, meaning))))?;
            packed.fit = match meaning {
                DepthMeaning::Metric if scene.depth_is_of_sensor() => Fit::Sensor,
                DepthMeaning::Metric => Fit::Metric,
                DepthMeaning::Scale => Fit::Scale,
                DepthMeaning::InverseScaleShift => Fit::ScaleShift,
            };
        }
        Ok(packed)
    }

    fn without_priors(images: Vec<Vec<u32>>) -> Packed {
        Packed {
            images,
            normals: None,
            depths: None,
            fit: Fit::Metric,
            halvings: 0,
            views: Vec::new(),
            part_of: Vec::new(),
            largest: [1, 1],
        }
    }

    /// Reads priors of all training views. Returns none if no view has one.
    fn priors(
        &self,
        train: &[usize],
        read: impl Fn(usize) -> Result<Option<Vec<u32>>> + Sync,
    ) -> Result<Option<Vec<Vec<u32>>>> {
        let maps: Vec<Option<Vec<u32>>> = train.par_iter().map(|&i| read(i)).collect::<Result<_>>()?;
        if maps.iter().all(Option::is_none) {
            return Ok(None);
        }
        // A view without a prior is trained without one: a word of zero means an unknown value.
        let filled = maps.into_iter().zip(&self.images).map(|(map, image)| {
            let mut map = map.unwrap_or_else(|| vec![0; image.len()]);
            // Invalid pixels of the photograph have no prior either.
            map.iter_mut().zip(image).filter(|(_, i)| *i >> 24 == 0).for_each(|(n, _)| *n = 0);
            map
        });
        Ok(Some(filled.collect()))
    }

    /// Packs display-referred images that are no photographs, with their cameras.
    pub fn of(renderings: &[(&sgs_scene::Camera, Image)]) -> Result<Packed> {
        let images = renderings.par_iter().map(|(_, image)| pack_image(image, None)).collect();
        let mut packed = Packed::without_priors(images);
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

    /// Adds smaller copies of all photographs and priors.
    ///
    /// Each has half the width and height of the one before. There are `most` at most, and none that no view has with `least`
    /// pixels across and down. Call it once, before [`Packed::split`].
    pub fn reduce(&mut self, most: u32, least: u32) {
        let useful = |k: &u32| self.views.iter().any(|(c, _)| c.size.iter().all(|n| n >> k >= least));
        let halvings = (1..=most).take_while(useful).last().unwrap_or(0);
        let add = |data: &mut Vec<Vec<u32>>, halved: fn(&[u32], [u32; 2]) -> Vec<u32>| {
            data.par_iter_mut().zip(&self.views).for_each(|(data, (camera, _))| {
                let (mut size, mut first) = (camera.size, 0);
                for _ in 0..halvings {
                    let smaller = halved(&data[first..], size);
                    (first, size) = (data.len(), halved_size(size));
                    data.extend(smaller);
                }
            });
        };
        add(&mut self.images, halved_image);
        if let Some(normals) = &mut self.normals {
            add(normals, halved_normals);
        }
        if let Some(depths) = &mut self.depths {
            add(depths, halved_depths);
        }
        self.halvings = halvings;
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
        parts_of(&self.part_of)
    }

    /// Returns the part of each view.
    pub fn part_of(&self) -> &[usize] {
        &self.part_of
    }

    /// Returns the normal priors, by training view.
    pub fn normals(&self) -> Option<Vec<&[u32]>> {
        let maps = self.normals.as_ref()?;
        Some(maps.iter().zip(&self.views).map(|(map, (camera, _))| &map[..pixels(camera.size)]).collect())
    }

    /// Returns all photographs.
    pub fn images(&self) -> impl Iterator<Item = &[u32]> {
        (0..self.images.len()).map(|view| self.image(view))
    }

    /// Returns the photograph of a view.
    pub fn image(&self, view: usize) -> &[u32] {
        &self.images[view][..pixels(self.views[view].0.size)]
    }

    /// Returns the camera and the first pixel of each view.
    pub fn views(&self) -> &[(Camera, u32)] {
        &self.views
    }

    /// Returns each photograph's difference from the best single color.
    /// The difference is the mean absolute one.
    pub fn plain(&self) -> Vec<f64> {
        self.images().collect::<Vec<_>>().into_par_iter().map(crate::divergence::plain).collect()
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

    /// Returns the bytes of the prior depths of the largest part, if there are any.
    ///
    /// Also returns their relation to depth.
    pub fn depth_bytes(&self) -> Option<(u64, Fit)> {
        self.depths.as_ref().map(|_| (self.image_bytes(), self.fit))
    }

    /// Uploads photographs and priors to the device.
    pub fn upload(self, device: &Device) -> Result<TrainingData> {
        let size = self.image_bytes();
        let up = |name: &str, images: &[Vec<u32>]| upload(device, name, images, &self.part_of, size);
        let targets = up("targets", &self.images)?;
        let normals = self.normals.as_ref().map(|maps| up("normal_priors", maps)).transpose()?;
        let depths = self.depths.as_ref().map(|maps| up("depth_priors", maps)).transpose()?;
        let (mut normals, mut depths) = (normals.into_iter().flatten(), depths.into_iter().flatten());
        let part = |targets| Photographs { targets, normals: normals.next(), depths: depths.next() };
        let parts = targets.into_iter().map(part).collect();
        let Packed { views, part_of, largest, halvings, fit, .. } = self;
        Ok(TrainingData { parts, views, part_of, largest, halvings, fit })
    }
}

impl TrainingData {
    /// Loads the training views of a scene, and the wanted priors that exist.
    ///
    /// # Errors
    /// If an image or prior cannot be read, or memory runs out.
    pub fn load(device: &Device, scene: &Scene, wanted: PixelPriors) -> Result<TrainingData> {
        let mut packed = Packed::read(scene, wanted)?;
        packed.split(device.info().largest_binding());
        packed.upload(device)
    }

    /// Returns the camera and the first pixel of a halved photograph of a view.
    pub fn reduced(&self, view: usize, halvings: u32) -> (Camera, u32) {
        let (mut camera, mut first) = self.views[view];
        for _ in 0..halvings.min(self.halvings) {
            first += camera.size[0] * camera.size[1];
            camera.size = halved_size(camera.size);
            camera.focal = camera.focal.map(|f| 0.5 * f);
            camera.center = camera.center.map(|c| 0.5 * c);
        }
        (camera, first)
    }

    /// Returns the photographs and priors of a view's part.
    pub fn part(&self, view: usize) -> &Photographs {
        &self.parts[self.part_of[view]]
    }
}

/// Uploads maps of all views, packed like the photographs. Each part has a buffer of this size.
pub(crate) fn upload(
    device: &Device,
    name: &str,
    maps: &[Vec<u32>],
    part_of: &[usize],
    size: u64,
) -> Result<Vec<DeviceBuffer>> {
    let part = |part: usize| -> Result<DeviceBuffer> {
        let buffer = device.buffer(name, size, Location::Device)?;
        let mut offset = 0;
        let mut pieces: Vec<Piece<'_>> = Vec::new();
        for (map, _) in maps.iter().zip(part_of).filter(|(_, of)| **of == part) {
            pieces.push((&buffer, offset, bytemuck::cast_slice(map)));
            offset += 4 * map.len() as u64;
        }
        device.upload_all(&pieces)?;
        drop(pieces);
        Ok(buffer)
    };
    (0..parts_of(part_of)).map(part).collect()
}

fn parts_of(part_of: &[usize]) -> usize {
    part_of.last().map_or(1, |last| last + 1)
}

fn pixels(size: [u32; 2]) -> usize {
    size[0] as usize * size[1] as usize
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
        Packed { views, part_of: vec![0; sizes.len()], ..Packed::without_priors(images) }
    }

    #[test]
    fn smaller_photographs_follow_the_full_one() {
        let camera = Camera { size: [5, 4], focal: [8.0, 6.0], center: [2.5, 2.0], ..Camera::default() };
        let white = vec![u32::MAX; 20];
        let mut data = Packed {
            normals: Some(vec![vec![7; 20]; 2]),
            depths: Some(vec![vec![0x3c00_4000; 20]; 2]),
            views: vec![(camera, 0), (camera, 20)],
            part_of: vec![0; 2],
            largest: [5, 4],
            ..Packed::without_priors(vec![white.clone(); 2])
        };
        data.reduce(2, 3);
        assert_eq!((data.halvings, data.image_bytes()), (0, 2 * 4 * 20));
        data.reduce(2, 1);
        data.split(1000);
        // 5 x 4, 2 x 2 and 1 x 1 pixels.
        assert_eq!((data.image_bytes(), data.image(1), data.views[1].1), (2 * 4 * 25, &white[..], 25));
        assert!(data.normals.as_ref().unwrap().iter().all(|map| map.len() == 25));
        assert_eq!(data.depths, Some(vec![vec![0x3c00_4000; 25]; 2]));
        assert_eq!(data.normals().unwrap()[0], vec![7; 20]);
        let Packed { views, part_of, largest, halvings, fit, .. } = data;
        let data = TrainingData { parts: Vec::new(), views, part_of, largest, halvings, fit };
        let of = |halvings| {
            let (camera, first) = data.reduced(1, halvings);
            (camera.size, camera.focal, camera.center, first)
        };
        assert_eq!(of(0), ([5, 4], [8.0, 6.0], [2.5, 2.0], 25));
        assert_eq!(of(1), ([2, 2], [4.0, 3.0], [1.25, 1.0], 45));
        assert_eq!(of(2), ([1, 1], [2.0, 1.5], [0.625, 0.5], 49));
        assert_eq!(of(3), of(2));
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
