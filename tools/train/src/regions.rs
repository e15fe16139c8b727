//! Regions of the training views: sets of pixels of one object or class.
//! Both stages compare regions between views.
//!
//! A provider of masks has priority ([`Regions`]). Otherwise regions come from `priors/masks`, if any training view has
//! a map there. Otherwise they come from the semantic targets: a pixel's region is then the class of the nearest sample
//! of the map, plus one. Invalid pixels of the photograph belong to no region.
//!
//! A step uses one region of its training view. The step draws a pixel uniformly among those in an eligible region,
//! like a point prompt, and takes its region. Regions of fewer than [`LEAST_PIXELS`] pixels are never chosen: they are
//! no evidence. One warning names the views without any region; their steps compare none.
//!
//! Masks of pseudo-views from files ([`PseudoMaps`]) use the same region numbers, so one kernel handles both. Without
//! these masks, depth carries regions to the pseudo-views.

use crate::error::{Requirement, Result, TrainError};
use crate::pseudo::PseudoViews;
use crate::schedule::hash;
use crate::semantics::{SemanticData, SemanticLabels, SemanticView};
use rayon::prelude::*;
use sgs_engine::{Device, DeviceBuffer, Location};
use sgs_passes::loss::{NO_LABEL, pack_regions};
use sgs_scene::Scene;
pub(crate) use source::{RegionInputs, Regions};

/// Least number of pixels of a region that may be chosen.
/// The loss would ignore smaller regions.
pub const LEAST_PIXELS: u32 = 16;

/// Source of regions.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RegionSource {
    /// Maps in `priors/masks`.
    Masks,
    /// Classes of the semantic targets.
    Labels,
}

/// Regions of one training view.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RegionView {
    /// First pixel among those of all views; equals the first pixel of the photograph.
    pub first: u32,
    /// Region number and pixel count of each eligible region, in ascending order.
    pub regions: Vec<(u16, u32)>,
}

/// Regions of the training views on the host, in the order of the split.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RegionMaps {
    /// Source of the regions.
    pub source: RegionSource,
    /// Regions by training view.
    pub views: Vec<RegionView>,
    ids: Vec<u16>,
}

impl RegionMaps {
    /// Loads the regions of a scene's training views.
    /// Returns none without masks and semantic targets, or if no view has any region.
    ///
    /// # Errors
    /// If a mask cannot be read, or the views hold too many pixels.
    pub fn load(device: &Device, scene: &Scene, semantic: Option<&SemanticData>) -> Result<Option<RegionMaps>> {
        RegionMaps::of_scene(scene, || semantic.map(|s| s.labels(device)).transpose())
    }

    /// Loads regions like [`RegionMaps::load`], with lazily computed classes.
    /// `labels` is called only if no masks exist.
    ///
    /// # Errors
    /// If a file cannot be read, or the views hold too many pixels.
    pub(crate) fn of_scene(
        scene: &Scene,
        labels: impl FnOnce() -> Result<Option<SemanticLabels>>,
    ) -> Result<Option<RegionMaps>> {
        if let Some(maps) = RegionMaps::from_masks(scene)? {
            return Ok(maps.known(scene));
        }
        let Some(answer) = labels()? else { return Ok(None) };
        Ok(RegionMaps::from_labels(scene, &answer.views, &answer.labels)?.known(scene))
    }

    /// Reads regions from `priors/masks`. Returns none if no training view has a map there.
    ///
    /// # Errors
    /// If a map cannot be read, or the views hold too many pixels.
    pub fn from_masks(scene: &Scene) -> Result<Option<RegionMaps>> {
        let train = &scene.split.train;
        let read = |&i: &usize| Ok(scene.region_prior(i)?.map(|m| m.ids));
        let maps: Vec<Option<Vec<u16>>> = train.par_iter().map(read).collect::<Result<_>>()?;
        if maps.iter().all(Option::is_none) {
            return Ok(None);
        }
        let ids = |view: usize| -> Result<Vec<u16>> { Ok(maps[view].clone().unwrap_or_default()) };
        RegionMaps::collect(scene, RegionSource::Masks, ids).map(Some)
    }

    /// Builds regions from the classes of semantic targets.
    /// `labels`: class by sample, with the maps of the views stored consecutively.
    ///
    /// # Errors
    /// If the views hold too many pixels.
    pub fn from_labels(scene: &Scene, views: &[SemanticView], labels: &[u32]) -> Result<RegionMaps> {
        let ids = |view: usize| {
            let camera = &scene.view(scene.split.train[view])?.camera;
            let map = views[view];
            let [w, h] = map.size;
            let samples = &labels[map.offset as usize..][..w as usize * h as usize];
            Ok(if samples.is_empty() { vec![] } else { classes(samples, [w, h], [camera.width, camera.height]) })
        };
        RegionMaps::collect(scene, RegionSource::Labels, ids)
    }

    /// Concatenates the region numbers of all views. An empty list is a view without regions.
    fn collect(scene: &Scene, source: RegionSource, of: impl Fn(usize) -> Result<Vec<u16>>) -> Result<RegionMaps> {
        let mut maps = RegionMaps { source, views: Vec::new(), ids: Vec::new() };
        for (view, &i) in scene.split.train.iter().enumerate() {
            let camera = &scene.view(i)?.camera;
            let first = maps.ids.len();
            let mut ids = of(view)?;
            ids.resize(camera.width as usize * camera.height as usize, 0);
            if let Some(counts) = scene.load_mask(i)? {
                ids.iter_mut().zip(&counts.data).filter(|(_, counts)| **counts <= 0.5).for_each(|(id, _)| *id = 0);
            }
            maps.views.push(RegionView { first: first_pixel(first)?, regions: regions_of(&ids) });
            maps.ids.extend(ids);
        }
        Ok(maps)
    }

    /// Returns none if no view has a region. Warns about views without any.
    fn known(self, scene: &Scene) -> Option<RegionMaps> {
        let without: Vec<&str> = scene
            .split
            .train
            .iter()
            .zip(&self.views)
            .filter(|(_, v)| v.regions.is_empty())
            .map(|(&i, _)| scene.views[i].camera.name.as_str())
            .collect();
        if !without.is_empty() {
            let (n, all) = (without.len(), self.views.len());
            let names = without[..n.min(5)].join(", ") + if n > 5 { ", …" } else { "" };
            let what = if self.source == RegionSource::Masks { "priors/masks" } else { "the semantic maps" };
            tracing::warn!(
                "{n} of {all} training views have no region of {LEAST_PIXELS} pixels in {what} ({names}); their steps \
                 compare none"
            );
        }
        (without.len() < self.views.len()).then_some(self)
    }

    /// Returns the number of bytes of device memory.
    pub fn bytes(&self) -> u64 {
        packed_bytes(&self.ids)
    }

    /// Uploads the region numbers in the format of the kernel `region_mask`.
    /// The numbers of a view begin at its first pixel.
    ///
    /// # Errors
    /// If memory runs out or the device fails.
    pub fn upload(&self, device: &Device) -> Result<DeviceBuffer> {
        upload(device, "regions", &self.ids)
    }

    /// Draws the region for a step at a training view; 0 if the view has none.
    /// The result depends on view, seed and step only.
    pub fn draw(&self, view: usize, seed: u64, step: u32) -> u32 {
        let regions = &self.views[view].regions;
        let pixels: u64 = regions.iter().map(|r| u64::from(r.1)).sum();
        let mut pixel = hash(seed ^ 0x7265_6769_6f6e, u64::from(step)) % pixels.max(1);
        for &(id, count) in regions {
            if pixel < u64::from(count) {
                return u32::from(id);
            }
            pixel -= u64::from(count);
        }
        0
    }

    /// Returns the first pixel of a training view.
    /// This is the step's `region_offset` for the kernel `region_mask`.
    pub fn first(&self, view: usize) -> u32 {
        self.views[view].first
    }

    /// Returns the region numbers of a view's pixels.
    pub fn ids(&self, view: usize) -> &[u16] {
        let first = self.views[view].first as usize;
        let end = self.views.get(view + 1).map_or(self.ids.len(), |v| v.first as usize);
        &self.ids[first..end]
    }
}

/// Masks of all pseudo-views, segmented by an external tool.
/// Files: `priors/masks/pseudo/STEM_{0|1}_{index:02}.png`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PseudoMaps {
    poses: u32,
    /// First pixel and pixels per pseudo-view, by training view.
    views: Vec<(u32, u32)>,
    ids: Vec<u16>,
}

impl PseudoMaps {
    /// Reads the masks of all pseudo-views. Returns none if no mask exists.
    /// If any mask exists, all must exist.
    ///
    /// # Errors
    /// If a mask is missing or cannot be read, or the masks hold too many pixels.
    pub fn load(scene: &Scene, pseudo: &PseudoViews) -> Result<Option<PseudoMaps>> {
        let cameras = pseudo.cameras();
        let read = |c: &sgs_scene::Camera| Ok(scene.pseudo_region_prior(c)?.map(|m| m.ids));
        let found: Vec<Option<Vec<u16>>> = cameras.par_iter().map(read).collect::<Result<_>>()?;
        let missing = found.iter().filter(|f| f.is_none()).count();
        if missing == found.len() {
            return Ok(None);
        }
        if let Some((camera, _)) = cameras.iter().zip(&found).find(|(_, f)| f.is_none()) {
            return Err(TrainError::File {
                path: scene.root.join("priors/masks/pseudo").join(format!("{}.png", camera.name)),
                reason: format!(
                    "the mask is missing, as are {missing} of {} for pseudo-views; make all, or remove the folder to have \
                     regions carried by depth",
                    found.len()
                ),
            });
        }
        let mut maps = PseudoMaps { poses: pseudo.poses(), views: Vec::new(), ids: Vec::new() };
        let per_view = 2 * pseudo.poses() as usize;
        for (i, ids) in found.into_iter().flatten().enumerate() {
            if i % per_view == 0 {
                maps.views.push((first_pixel(maps.ids.len())?, ids.len() as u32));
            }
            maps.ids.extend(ids);
        }
        first_pixel(maps.ids.len())?;
        Ok(Some(maps))
    }

    /// Returns the first pixel of a pseudo-view.
    /// This is the step's `region_offset` for the kernel `region_mask`.
    pub fn first(&self, view: usize, which: usize, index: u32) -> u32 {
        let (first, pixels) = self.views[view];
        first + (which as u32 * self.poses + index) * pixels
    }

    /// Returns the number of bytes of device memory: two per pixel of each pseudo-view.
    pub fn bytes(&self) -> u64 {
        packed_bytes(&self.ids)
    }

    /// Uploads the masks to the device.
    ///
    /// # Errors
    /// If memory runs out or the device fails.
    pub fn upload(&self, device: &Device) -> Result<DeviceBuffer> {
        upload(device, "pseudo_regions", &self.ids)
    }

    /// Returns the region numbers of all views.
    pub fn ids(&self) -> &[u16] {
        &self.ids
    }
}

/// Returns, for each pixel, the class of the nearest sample plus one, or 0.
/// The layout matches the semantic loss: the first and last samples lie on the first and last pixels.
fn classes(samples: &[u32], map: [u32; 2], size: [u32; 2]) -> Vec<u16> {
    let nearest = |at: u32, k: usize| {
        let (last, steps) = (u64::from(size[k].max(2) - 1), u64::from(map[k] - 1));
        ((2 * u64::from(at) * steps + last) / (2 * last)).min(steps) as usize
    };
    let one = |label: u32| if label == NO_LABEL { 0 } else { u16::try_from(label + 1).unwrap_or(0) };
    let row = |y: u32| {
        let line = nearest(y, 1) * map[0] as usize;
        (0..size[0]).map(move |x| one(samples[line + nearest(x, 0)]))
    };
    (0..size[1]).flat_map(row).collect()
}

/// Returns the regions of at least [`LEAST_PIXELS`] pixels, with pixel counts.
fn regions_of(ids: &[u16]) -> Vec<(u16, u32)> {
    let mut counts = vec![0_u32; 1 << 16];
    ids.iter().for_each(|id| counts[usize::from(*id)] += 1);
    let all = (1..=u16::MAX).map(|id| (id, counts[usize::from(id)]));
    all.filter(|(_, count)| *count >= LEAST_PIXELS).collect()
}

fn first_pixel(pixels: usize) -> Result<u32> {
    let many = Requirement::FewerPixels { what: "Region maps", remedy: "--scale" };
    Ok(u32::try_from(pixels).map_err(|_| many)?)
}

fn packed_bytes(ids: &[u16]) -> u64 {
    4 * (ids.len() as u64).div_ceil(2).max(1)
}

fn upload(device: &Device, name: &str, ids: &[u16]) -> Result<DeviceBuffer> {
    let buffer = device.buffer(name, packed_bytes(ids), Location::Device)?;
    // Uploads in chunks, so that the host does not hold a second copy of everything.
    const PIECE: usize = 1 << 20;
    for (i, piece) in ids.chunks(PIECE).enumerate() {
        device.upload(&buffer, (2 * i * PIECE) as u64, bytemuck::cast_slice(&pack_regions(piece)))?;
    }
    Ok(buffer)
}

mod source;

#[cfg(test)]
mod tests;
