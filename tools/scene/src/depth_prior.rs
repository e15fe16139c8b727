//! Prior depths of the photographs: from a sensor or a network.

use std::path::{Path, PathBuf};

use crate::beside::SensorDepth;
use crate::camera::{Camera, Distortion};
use crate::error::Result;
use crate::image::{Image, read_ids};
use crate::map_file::{self, Meaning};
use crate::maps::{self, MaskedMap, stored_pixels};
use crate::points::{Pcg, PointCloud};
use crate::prior_settings::DepthMeaning;
use crate::scene::Scene;
use crate::view::View;

impl Scene {
    /// Returns what the scene's prior depths mean. Those of a sensor are metric.
    pub fn depth_meaning(&self) -> DepthMeaning {
        match self.prior_settings.depth {
            Some(settings) if self.has_depth_folder() => settings.meaning,
            _ => DepthMeaning::Metric,
        }
    }

    /// Loads the prior depth of a view and its confidence from 0 to 1. Returns `None` if there is none. The size is that
    /// of the view's camera. Values mean what [`Scene::depth_meaning`] says.
    ///
    /// Maps in `priors/depth` replace those of a sensor, which the layout names (`depth_file_path`). The folder
    /// `priors/depth/confidence` may hold maps of confidence. Depths are not averaged, because a mean of two surfaces
    /// is on neither: each pixel takes the depth at its center.
    pub fn depth_prior(&self, view: usize) -> Result<Option<MaskedMap>> {
        let view = self.view(view)?;
        let Some(file) = self.depth_file(view) else { return Ok(None) };
        let mut map = match self.depth_is_of_sensor() {
            true => seen_by(self.load_depth(&file, view, self.depth_meaning(), &view.distortion.given())?, view),
            false => self.load_depth(&file, view, self.depth_meaning(), &view.distortion)?,
        };
        if let Some(path) = self.prior_path("depth/confidence", view, &["exr", "npy", "png"]) {
            let confidence = maps::load(&path, view, Meaning::Scalar)?;
            let both = confidence.image.data.iter().zip(&confidence.valid.data);
            for (known, (confidence, valid)) in map.valid.data.iter_mut().zip(both) {
                *known *= (confidence * valid).clamp(0.0, 1.0);
            }
        }
        Ok(Some(map))
    }

    /// Loads the depth that a sensor measured in a view, like [`Scene::depth_prior`]. Returns `None` if there is none.
    pub fn sensor_depth(&self, view: usize) -> Result<Option<MaskedMap>> {
        let view = self.view(view)?;
        let Some(file) = &view.beside.depth else { return Ok(None) };
        let map = self.load_depth(file, view, DepthMeaning::Metric, &view.distortion.given())?;
        Ok(Some(seen_by(map, view)))
    }

    /// Returns whether prior depths are those of a sensor. They belong to the rays of the cameras that the scene gives.
    pub fn depth_is_of_sensor(&self) -> bool {
        !self.has_depth_folder()
    }

    /// Reads a view's depth as stored, in the unit of the file, and its path. Zero depths are unknown.
    pub(crate) fn stored_depth(&self, view: &View) -> Result<Option<(PathBuf, Image)>> {
        let Some(SensorDepth { path, .. }) = self.depth_file(view) else { return Ok(None) };
        let depth = read(&path)?;
        Ok(Some((path, depth)))
    }

    fn load_depth(
        &self,
        file: &SensorDepth,
        view: &View,
        meaning: DepthMeaning,
        lens: &Distortion,
    ) -> Result<MaskedMap> {
        let SensorDepth { path, unit } = file;
        let stored = read(path)?;
        // With a shift, inverse depths may be negative.
        let relative = meaning == DepthMeaning::InverseScaleShift;
        let unit = unit / self.length;
        let camera = &view.camera;
        let mut image = Image::new(camera.width, camera.height, 1);
        let mut valid = Image::new(camera.width, camera.height, 1);
        let given = view.given_camera();
        let pixels = stored_pixels(&given, lens, (stored.width, stored.height));
        for ((z, known), at) in image.data.iter_mut().zip(&mut valid.data).zip(pixels) {
            let depth = (f64::from(stored.data.get(at).copied().unwrap_or(0.0)) * unit) as f32;
            if depth.is_finite() && depth != 0.0 && (relative || depth > 0.0) {
                (*z, *known) = (depth, 1.0);
            }
        }
        Ok(MaskedMap { image, valid })
    }

    fn depth_file(&self, view: &View) -> Option<SensorDepth> {
        if !self.has_depth_folder() {
            return view.beside.depth.clone();
        }
        let unit = self.prior_settings.depth.map_or(1.0, |settings| settings.unit);
        self.prior_path("depth", view, &["exr", "npy", "png"]).map(|path| SensorDepth { path, unit })
    }

    fn has_depth_folder(&self) -> bool {
        self.root.join("priors/depth").is_dir()
    }

    /// Returns up to `count` points on the surfaces of the training views' depths. They have the colors of the
    /// photographs. Pixels are drawn uniformly; `seed` chooses them. Returns `None` if there are no metric depths.
    pub fn depth_points(&self, count: usize, seed: u64) -> Result<Option<PointCloud>> {
        if self.depth_meaning() != DepthMeaning::Metric {
            return Ok(None);
        }
        let mut rng = Pcg::new(seed);
        let mut points = PointCloud { colors: Some(Vec::new()), ..PointCloud::default() };
        let mut pixels = Vec::new();
        let mut views = Vec::new();
        for &i in &self.split.train {
            let Some(depth) = self.depth_prior(i)? else { continue };
            let mask = self.load_mask(i)?;
            let known = |at: usize| depth.valid.data[at] > 0.0 && mask.as_ref().is_none_or(|m| m.data[at] > 0.5);
            pixels.extend((0..depth.valid.data.len()).filter(|at| known(*at)).map(|at| (views.len(), at)));
            views.push((i, depth));
        }
        // The first items of a random order, which Fisher and Yates draw one by one.
        let count = count.min(pixels.len());
        for i in 0..count {
            let left = (pixels.len() - i) as u64;
            pixels.swap(i, i + ((u64::from(rng.next_u32()) * left) >> 32) as usize);
        }
        let mut chosen = vec![Vec::new(); views.len()];
        pixels.iter().take(count).for_each(|(view, at)| chosen[*view].push(*at));
        for ((i, depth), mut chosen) in views.into_iter().zip(chosen) {
            chosen.sort_unstable();
            let image = self.load_image(i)?;
            let camera = &self.view(i)?.camera;
            for at in chosen {
                points.positions.push(point_at(camera, at, depth.image.data[at]));
                let color = &image.data[3 * at..3 * at + 3];
                points.colors.as_mut().expect("invariant: colors").push([color[0], color[1], color[2]]);
            }
        }
        Ok((!points.is_empty()).then_some(points))
    }
}

/// Returns what a sensor measured along the rays of a view's pixels. They differ from the sensor's own if training
/// learned the intrinsics. Each pixel takes the depth of the nearest ray.
fn seen_by(map: MaskedMap, view: &View) -> MaskedMap {
    let (camera, sensor) = (&view.camera, view.given_camera());
    let numbers = |c: &Camera| [c.fx, c.fy, c.cx, c.cy];
    if numbers(camera) == numbers(&sensor) {
        return map;
    }
    let mut seen = MaskedMap {
        image: Image::new(camera.width, camera.height, 1),
        valid: Image::new(camera.width, camera.height, 1),
    };
    for y in 0..camera.height {
        for x in 0..camera.width {
            let u = (f64::from(x) + 0.5 - camera.cx) / camera.fx * sensor.fx + sensor.cx;
            let v = (f64::from(y) + 0.5 - camera.cy) / camera.fy * sensor.fy + sensor.cy;
            if (0.0..f64::from(camera.width)).contains(&u) && (0.0..f64::from(camera.height)).contains(&v) {
                let (u, v) = (u as u32, v as u32);
                seen.image.pixel_mut(x, y)[0] = map.image.pixel(u, v)[0];
                seen.valid.pixel_mut(x, y)[0] = map.valid.pixel(u, v)[0];
            }
        }
    }
    seen
}

/// Returns the position of a pixel's center at a depth.
fn point_at(camera: &Camera, at: usize, depth: f32) -> [f32; 3] {
    let (x, y) = (at % camera.width as usize, at / camera.width as usize);
    let pixel = glam::DVec2::new(x as f64 + 0.5, y as f64 + 0.5);
    camera.unproject(pixel, f64::from(depth)).as_vec3().to_array()
}

/// Reads a map of depths as stored. Pixels without a depth are 0.
fn read(path: &Path) -> Result<Image> {
    if path.extension().is_some_and(|e| e.eq_ignore_ascii_case("png")) {
        let (width, height, values) = read_ids(path)?;
        // Sensors write the largest number where they measured nothing, too.
        let values = values.into_iter().map(|v| if v == u16::MAX { 0.0 } else { f32::from(v) }).collect();
        return Image::from_data(width, height, 1, values);
    }
    let (mut image, valid) = map_file::read(path, Meaning::Scalar)?;
    image.data.iter_mut().zip(&valid.data).filter(|(_, known)| **known == 0.0).for_each(|(z, _)| *z = 0.0);
    Ok(image)
}

#[cfg(test)]
mod tests;
