//! Selection of the Gaussians that an edit changes.

use super::edit::{Region, Where};
use crate::error::{RelightError, Result};
use sgs_engine::{Device, Location};
use sgs_passes::Tuning;
use sgs_passes::loss::normalize_embeddings;
use sgs_passes::pipeline::{FeatureImage, Labeler, Renderer, Surface, SurfaceBuilder};
use sgs_passes::scene::{Decoder, Gaussians, Model};
use sgs_passes::splat::Channels;
use sgs_run::{SemanticHead, camera, gaussian_data};
use sgs_scene::{Scene, Splats};

/// Maximum distance of a visible center behind the surface, relative to its depth.
///
/// The surface is that of the pixel.
const BEHIND: f32 = 0.05;

/// Selector of Gaussians, with the data of a run.
pub struct Selector<'a> {
    /// Device that classifies features.
    pub device: &'a Device,
    /// Semantic head, for classes.
    pub head: Option<SemanticHead>,
    /// Scene, for regions.
    pub scene: Option<&'a Scene>,
}

impl Selector<'_> {
    /// Returns whether each Gaussian is selected.
    ///
    /// # Errors
    /// If the selection is empty, or names something that does not exist.
    pub fn choose(&mut self, which: &Where, splats: &Splats) -> Result<Vec<bool>> {
        let mut chosen = vec![true; splats.len()];
        let mut also = |holds: &dyn Fn(usize) -> bool| {
            chosen.iter_mut().enumerate().for_each(|(i, c)| *c &= holds(i));
        };
        if let Some([low, high]) = which.within {
            also(&|i| (0..3).all(|c| (low[c]..=high[c]).contains(&splats.means[i][c])));
        }
        if let Some(numbers) = &which.gaussians {
            if let Some(far) = numbers.iter().find(|n| **n >= splats.len()) {
                let message = format!("The edit names Gaussian {far}, but there are {}.", splats.len());
                return Err(RelightError::Edit(message));
            }
            let mut named = vec![false; splats.len()];
            numbers.iter().for_each(|n| named[*n] = true);
            also(&|i| named[i]);
        }
        if let Some(name) = &which.class {
            let of_class = self.of_class(name, splats)?;
            also(&|i| of_class[i]);
        }
        if let Some(region) = &which.region {
            let of_region = self.of_region(region, splats)?;
            also(&|i| of_region[i]);
        }
        if !chosen.contains(&true) {
            let selection = serde_json::to_string(&without_null(which)).unwrap_or_default();
            return Err(RelightError::Edit(format!("The edit chooses Gaussians by {selection}, but there are none.")));
        }
        Ok(chosen)
    }

    /// Selects Gaussians of a class by their own features.
    fn of_class(&self, name: &str, splats: &Splats) -> Result<Vec<bool>> {
        let missing = || RelightError::Edit(format!("The edit names class \"{name}\", but the run has no classes."));
        let head = self.head.as_ref().ok_or_else(missing)?;
        let (channels, values) = splats.semantic.as_ref().ok_or_else(missing)?;
        let class = head.class(name)? as u32;
        let decoder = Decoder::new(self.device, 0, false)?;
        decoder.upload(self.device, &head.decoder)?;
        let buffer = self.device.buffer("features", 4 * values.len().max(1) as u64, Location::Device)?;
        self.device.upload(&buffer, 0, bytemuck::cast_slice(values))?;
        let text = normalize_embeddings(&head.text.data);
        let tuning = Tuning::for_device(self.device.info());
        let mut labeler = Labeler::new(self.device, tuning, &text, head.temperature, &[])?;
        let size = [splats.len() as u32, 1];
        let image = FeatureImage { buffer: &buffer, size, channels: *channels as u32, first: 0 };
        Ok(labeler.label(&decoder, &image)?.labels.iter().map(|l| *l == class).collect())
    }

    /// Selects Gaussians whose centers are visible in a region of a view.
    fn of_region(&self, region: &Region, splats: &Splats) -> Result<Vec<bool>> {
        let (name, id) = (&region.view, region.id);
        let wrong = |reason: String| {
            RelightError::Edit(format!("The edit names region {id} of view \"{name}\", but {reason}."))
        };
        let scene = self.scene.ok_or_else(|| wrong("there is no scene".into()))?;
        let view = scene.split.train.iter().copied().find(|v| scene.views[*v].camera.name == *name);
        let view = view.ok_or_else(|| wrong("there is no training view of that name".into()))?;
        let map = scene.region_prior(view)?.ok_or_else(|| wrong("it has no map in priors/masks".into()))?;
        if id == 0 || !map.ids.contains(&id) {
            return Err(wrong("no pixel of its map is in it".into()));
        }
        let inside: Vec<bool> = map.ids.iter().map(|i| *i == id).collect();
        seen(self.device, splats, &scene.views[view].camera, &inside)
    }
}

/// Returns whether each Gaussian's center is visible in the given pixels of a view.
///
/// # Errors
/// If memory runs out or the device fails.
pub fn seen(device: &Device, splats: &Splats, view: &sgs_scene::Camera, inside: &[bool]) -> Result<Vec<bool>> {
    let model = Model { sh_degree: 0, normals: false, semantics: false, mip: splats.antialiased };
    let gaussians = Gaussians::with(device, model, splats.len() as u32, false, false)?;
    gaussians.upload(device, &gaussian_data(splats, model))?;
    let channels = Channels { colors: true, normals: false, depth: true };
    let mut renderer = Renderer::new(device, Tuning::for_device(device.info()), &gaussians, [1, 1], channels)?;
    let rendered = renderer.render(&gaussians, &camera(view), 0, [0.0; 3])?;
    let width = rendered.channels as usize;
    let shows = |mean: &[f32; 3]| {
        let point = glam::DVec3::from(mean.map(f64::from));
        let depth = (view.rotation * point + view.translation).z as f32;
        let Some(at) = view.project(point) else { return false };
        let (x, y) = (at.x.floor(), at.y.floor());
        if depth <= 0.0 || x < 0.0 || y < 0.0 || x >= f64::from(view.width) || y >= f64::from(view.height) {
            return false;
        }
        let pixel = y as usize * view.width as usize + x as usize;
        // Blended depth is weighted by opacity.
        let opacity = 1.0 - rendered.transmittance[pixel];
        inside[pixel] && depth * opacity <= (1.0 + BEHIND) * rendered.image[pixel * width + 3]
    };
    Ok(splats.means.iter().map(shows).collect())
}

/// Selects the Gaussians of a region that has the same id in all training views.
///
/// A Gaussian belongs to the region if its blending weight inside exceeds that in other regions. Views without a map
/// and pixels without a region do not count. The Gaussians must have normals.
///
/// # Errors
/// If a map is damaged, memory runs out or the device fails.
pub fn of_region_everywhere(device: &Device, scene: &Scene, splats: &Splats, id: u16) -> Result<Vec<usize>> {
    let model = Model { sh_degree: 0, normals: true, semantics: false, mip: splats.antialiased };
    let gaussians = Gaussians::with(device, model, splats.len() as u32, false, false)?;
    gaussians.upload(device, &gaussian_data(splats, model))?;
    let cameras: Vec<_> = scene.split.train.iter().map(|v| camera(&scene.views[*v].camera)).collect();
    let largest = cameras.iter().fold([1; 2], |l, c| [l[0].max(c.size[0]), l[1].max(c.size[1])]);
    let mut builder = SurfaceBuilder::new(device, Tuning::for_device(device.info()), &gaussians, largest)?;
    let mut votes = vec![0.0_f64; splats.len()];
    for (&view, camera) in scene.split.train.iter().zip(&cameras) {
        let Some(map) = scene.region_prior(view)? else { continue };
        builder.measure(&gaussians, camera)?;
        let surface = Surface::new(device, builder.shape())?;
        builder.fill(&gaussians, camera, &surface)?;
        builder.finish()?;
        let columns = surface.weights(device)?;
        for (i, vote) in votes.iter_mut().enumerate() {
            for (pixel, weight) in columns.of(i) {
                *vote += match map.ids[pixel] {
                    0 => 0.0,
                    found if found == id => f64::from(weight),
                    _ => -f64::from(weight),
                };
            }
        }
    }
    Ok((0..splats.len()).filter(|i| votes[*i] > 0.0).collect())
}

fn without_null(which: &Where) -> serde_json::Value {
    let mut value = serde_json::to_value(which).unwrap_or_default();
    if let Some(fields) = value.as_object_mut() {
        fields.retain(|_, v| !v.is_null());
        if let Some(serde_json::Value::Array(all)) = fields.get_mut("gaussians") {
            all.truncate(3);
        }
    }
    value
}
