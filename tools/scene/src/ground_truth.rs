//! Ground truth for evaluation only, from `gt/` or from the data set's layout.
//!
//! Ground truth has a separate type so that training code cannot reach it through its scene. Code that names
//! [`GroundTruth`] declares that it evaluates.

use std::path::PathBuf;

use glam::DVec2;

use crate::beside::{Form, GroundTruthKind, TruthFile, check_size};
use crate::depth::{self, DepthDefinition, Verdict};
use crate::error::Result;
use crate::image::Image;
use crate::json::read_json;
use crate::map_file::{self, Meaning, NormalFrame};
use crate::maps::{self, RegionMap};
use crate::priors::Labels;
use crate::scene::Scene;
use crate::view::View;

/// Ground truth of a scene.
#[derive(Clone, Copy, Debug)]
pub struct GroundTruth<'a> {
    scene: &'a Scene,
}

impl<'a> GroundTruth<'a> {
    /// Returns the ground truth of a scene. Every map is `None` if the scene has none.
    pub fn of(scene: &'a Scene) -> Self {
        Self { scene }
    }

    fn folder(&self) -> PathBuf {
        self.scene.root.join("gt")
    }

    /// Loads a map at the size of the view's camera; `None` if it does not exist. Pixels without a value are 0.
    ///
    /// Files in `gt/` take precedence over those that the layout stores beside its photographs. Returns `None` for
    /// depth whose definition does not fit the cameras ([`GroundTruth::depth_definition`]).
    pub fn load(&self, kind: GroundTruthKind, view: usize) -> Result<Option<Image>> {
        let view = self.scene.view(view)?;
        let folder = self.folder().join(kind.folder());
        let Some(path) = maps::find(&folder, &view.camera.name, &["exr", "png"]) else {
            return match view.beside.truth.iter().find(|file| file.kind == kind) {
                Some(file) => self.load_beside(file, view),
                None => Ok(None),
            };
        };
        let image = match kind {
            GroundTruthKind::Normal => maps::load_normals(&path, view, NormalFrame::World)?,
            GroundTruthKind::Albedo => maps::load(&path, view, Meaning::Color)?.image,
            GroundTruthKind::Depth => maps::load(&path, view, Meaning::Depth)?.image,
            GroundTruthKind::Roughness | GroundTruthKind::Metallic | GroundTruthKind::Mask => {
                maps::load(&path, view, Meaning::Scalar)?.image
            }
        };
        Ok(Some(image))
    }

    /// Loads a map from beside the photograph. The map must have the photograph's size.
    fn load_beside(&self, file: &TruthFile, view: &View) -> Result<Option<Image>> {
        let meaning = match file.form {
            Form::Normal(_) | Form::LinearColor => Meaning::LinearColor,
            Form::Depth => Meaning::Depth,
            Form::Channel(number) => Meaning::Channel(number),
            Form::Alpha => Meaning::Alpha,
        };
        let (image, mut valid) = match file.form {
            Form::Normal(frame) => maps::stored_normals(&file.path, view, frame)?,
            _ => map_file::read(&file.path, meaning)?,
        };
        let size = (view.stored_camera.width, view.stored_camera.height);
        check_size(&file.path, (image.width, image.height), &view.image_path, size)?;
        if file.kind != GroundTruthKind::Mask
            && let Some(mask) = view.stored_mask()?
        {
            map_file::exclude(&mut valid, &mask);
        }
        if let Form::Normal(_) = file.form {
            return Ok(Some(maps::finish_normals(image, valid, view)));
        }
        let mut map = maps::bring(image, valid, view).image;
        if file.form == Form::Depth {
            let Some(definition) = self.depth_definition()? else {
                return Ok(None);
            };
            for (i, value) in map.data.iter_mut().enumerate() {
                let (x, y) = (i as u32 % map.width, i as u32 / map.width);
                let pixel = DVec2::new(f64::from(x) + 0.5, f64::from(y) + 0.5);
                *value = definition.z(&view.camera, pixel, f64::from(*value)) as f32;
            }
        }
        Ok(Some(map))
    }

    /// Returns the definition of the depth maps stored beside the photographs. The definition is detected once from
    /// pairs of views, because data sets differ. Returns `None` without such maps, or if no definition or more than one
    /// fits the cameras. Maps with too little overlap count as millimeters along the axis, as InteriorVerse documents.
    pub fn depth_definition(&self) -> Result<Option<DepthDefinition>> {
        if let Some(known) = self.scene.depth_definition.get() {
            return Ok(*known);
        }
        let file = |view: &View| view.beside.truth.iter().find(|f| f.form == Form::Depth).cloned();
        let found: Vec<(&View, TruthFile)> =
            self.scene.views.iter().filter_map(|view| Some((view, file(view)?))).collect();
        let cameras: Vec<_> = found.iter().map(|(view, _)| view.camera.clone()).collect();
        let load = |i: usize| {
            let (view, file): &(&View, TruthFile) = &found[i];
            let (image, mut valid) = map_file::read(&file.path, Meaning::Depth)?;
            let size = (view.stored_camera.width, view.stored_camera.height);
            check_size(&file.path, (image.width, image.height), &view.image_path, size)?;
            if let Some(mask) = view.stored_mask()? {
                map_file::exclude(&mut valid, &mask);
            }
            let mut map = image;
            map.data.iter_mut().zip(&valid.data).for_each(|(d, v)| *d = if *v > 0.0 { *d } else { 0.0 });
            Ok(Some(map))
        };
        let known = match depth::find(&cameras, load)? {
            Verdict::Clear(definition) => Some(definition),
            Verdict::Untested if !found.is_empty() => Some(DepthDefinition::INTERIORVERSE),
            Verdict::Untested | Verdict::Unclear => None,
        };
        Ok(*self.scene.depth_definition.get_or_init(|| known))
    }

    /// Returns the class names by id. They come from `gt/semantic/labels.json`, or from `priors/semantic/labels.json`
    /// if that file does not exist.
    pub fn semantic_labels(&self) -> Result<Option<Vec<String>>> {
        let folders = [self.folder(), self.scene.root.join("priors")];
        let paths = folders.map(|folder| folder.join("semantic/labels.json"));
        match paths.iter().find(|path| path.is_file()) {
            Some(path) => Ok(Some(read_json::<Labels>(path)?.labels)),
            None => Ok(None),
        }
    }

    /// Returns the class of every pixel, at the size of the view's camera.
    pub fn semantic(&self, view: usize) -> Result<Option<RegionMap>> {
        let view = self.scene.view(view)?;
        match maps::find(&self.folder().join("semantic"), &view.camera.name, &["png"]) {
            Some(path) => maps::load_numbers(&path, view).map(Some),
            None => Ok(None),
        }
    }

    /// Returns the file with the true lights if it exists.
    pub fn lights(&self) -> Option<PathBuf> {
        Some(self.folder().join("lights.json")).filter(|path| path.is_file())
    }

    /// Returns the names of the other lightings and edits of the scene, sorted.
    pub fn relit_names(&self) -> Vec<String> {
        let entries = std::fs::read_dir(self.folder().join("relit")).into_iter().flatten().flatten();
        let folders = entries.filter(|entry| entry.path().is_dir());
        let mut names: Vec<_> = folders.filter_map(|entry| entry.file_name().into_string().ok()).collect();
        names.extend(self.scene.views.iter().flat_map(|view| &view.beside.relit).map(|(name, _)| name.clone()));
        names.sort();
        names.dedup();
        names
    }

    /// Returns the file that describes the edit of a relit set, if it exists.
    pub fn relit_edit(&self, name: &str) -> Option<PathBuf> {
        Some(self.folder().join("relit").join(format!("{name}.json"))).filter(|path| path.is_file())
    }

    /// Loads a view under another lighting, at the size of the view's camera. The image is linear RGB without an upper
    /// limit and without exposure.
    pub fn relit(&self, name: &str, view: usize) -> Result<Option<Image>> {
        let view = self.scene.view(view)?;
        let folder = self.folder().join("relit").join(name);
        match maps::find(&folder, &view.camera.name, &["exr", "png"]) {
            Some(path) => Ok(Some(maps::load(&path, view, Meaning::Color)?.image)),
            None => match view.beside.relit.iter().find(|(known, _)| known == name) {
                Some((_, path)) => Ok(Some(maps::load(path, view, Meaning::Color)?.image)),
                None => Ok(None),
            },
        }
    }

    /// Loads the linear albedo of a view under a material edit, if it exists.
    pub fn relit_albedo(&self, name: &str, view: usize) -> Result<Option<Image>> {
        let view = self.scene.view(view)?;
        let folder = self.folder().join("relit").join(name);
        match maps::find(&folder, &format!("{}_albedo", view.camera.name), &["exr", "png"]) {
            Some(path) => Ok(Some(maps::load(&path, view, Meaning::Color)?.image)),
            None => Ok(None),
        }
    }
}
