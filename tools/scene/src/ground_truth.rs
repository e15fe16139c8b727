//! Ground truth: what a renderer knew, in `gt/` or where a data set keeps it. For measuring only.
//!
//! It is a type of its own, so that code that trains cannot reach it through the scene it holds: whoever names
//! [`GroundTruth`] says that it measures.

use std::path::PathBuf;

use glam::DVec2;

use crate::beside::{Form, TruthFile, check_size};
use crate::depth::{self, DepthDefinition, Verdict};
use crate::error::Result;
use crate::image::Image;
use crate::json::read_json;
use crate::maps::{self, Meaning, NormalFrame, RegionMap};
use crate::priors::Labels;
use crate::scene::Scene;
use crate::view::View;

/// The maps that may be known.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum GroundTruthKind {
    /// Linear RGB.
    Albedo,
    /// Unit vectors in the world, zero where there is no surface.
    Normal,
    /// Camera z in the scene's unit, 0 where there is no surface.
    Depth,
    /// One channel.
    Roughness,
    /// One channel.
    Metallic,
    /// One channel: the share of the pixel in which the other maps mean something.
    Mask,
}

impl GroundTruthKind {
    /// All kinds.
    pub const ALL: [Self; 6] = [Self::Albedo, Self::Normal, Self::Depth, Self::Roughness, Self::Metallic, Self::Mask];

    /// The folder under `gt/`.
    pub fn folder(self) -> &'static str {
        match self {
            Self::Albedo => "albedo",
            Self::Normal => "normal",
            Self::Depth => "depth",
            Self::Roughness => "roughness",
            Self::Metallic => "metallic",
            Self::Mask => "mask",
        }
    }
}

/// The ground truth of a scene.
#[derive(Clone, Copy, Debug)]
pub struct GroundTruth<'a> {
    scene: &'a Scene,
}

impl<'a> GroundTruth<'a> {
    /// The ground truth that belongs to a scene. There may be none: then every map is `None`.
    pub fn of(scene: &'a Scene) -> Self {
        Self { scene }
    }

    fn folder(&self) -> PathBuf {
        self.scene.root.join("gt")
    }

    /// A map at the size of the view's camera, or `None` where there is none. Pixels without a value are 0.
    ///
    /// What lies in `gt/` comes before what the layout keeps beside its photographs. Depth of a definition that does not
    /// fit the cameras ([`GroundTruth::depth_definition`]) is none.
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

    /// A map that the layout keeps beside the photograph, of the photograph's size.
    fn load_beside(&self, file: &TruthFile, view: &View) -> Result<Option<Image>> {
        let meaning = match file.form {
            Form::Normal(_) | Form::LinearColor => Meaning::LinearColor,
            Form::Depth => Meaning::Depth,
            Form::Channel(number) => Meaning::Channel(number),
            Form::Alpha => Meaning::Alpha,
        };
        let (image, mut valid) = match file.form {
            Form::Normal(frame) => maps::stored_normals(&file.path, view, frame)?,
            _ => maps::stored(&file.path, meaning)?,
        };
        let size = (view.stored_camera.width, view.stored_camera.height);
        check_size(&file.path, (image.width, image.height), &view.image_path, size)?;
        if file.kind != GroundTruthKind::Mask
            && let Some(mask) = view.stored_mask()?
        {
            maps::exclude(&mut valid, &mask);
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

    /// What the depth maps mean that the layout keeps beside its photographs: found out once from pairs of views, for data
    /// sets do not agree on it. `None` if they fit the cameras under no definition or under several, or if there are none;
    /// maps that share too little to tell count as millimeters along the axis, as InteriorVerse documents.
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
            let (image, mut valid) = maps::stored(&file.path, Meaning::Depth)?;
            let size = (view.stored_camera.width, view.stored_camera.height);
            check_size(&file.path, (image.width, image.height), &view.image_path, size)?;
            if let Some(mask) = view.stored_mask()? {
                maps::exclude(&mut valid, &mask);
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

    /// Names of the classes by id: those in `gt/semantic/labels.json`, or in `priors/semantic/labels.json` where ground
    /// truth names none.
    pub fn semantic_labels(&self) -> Result<Option<Vec<String>>> {
        let folders = [self.folder(), self.scene.root.join("priors")];
        let paths = folders.map(|folder| folder.join("semantic/labels.json"));
        match paths.iter().find(|path| path.is_file()) {
            Some(path) => Ok(Some(read_json::<Labels>(path)?.labels)),
            None => Ok(None),
        }
    }

    /// The class of every pixel, at the size of the view's camera.
    pub fn semantic(&self, view: usize) -> Result<Option<RegionMap>> {
        let view = self.scene.view(view)?;
        match maps::find(&self.folder().join("semantic"), &view.camera.name, &["png"]) {
            Some(path) => maps::load_numbers(&path, view).map(Some),
            None => Ok(None),
        }
    }

    /// The file that describes the true lights, where there is one.
    pub fn lights(&self) -> Option<PathBuf> {
        Some(self.folder().join("lights.json")).filter(|path| path.is_file())
    }

    /// The names of the other lightings and edits that the scene was rendered under, in alphabetical order.
    pub fn relit_names(&self) -> Vec<String> {
        let entries = std::fs::read_dir(self.folder().join("relit")).into_iter().flatten().flatten();
        let folders = entries.filter(|entry| entry.path().is_dir());
        let mut names: Vec<_> = folders.filter_map(|entry| entry.file_name().into_string().ok()).collect();
        names.extend(self.scene.views.iter().flat_map(|view| &view.beside.relit).map(|(name, _)| name.clone()));
        names.sort();
        names.dedup();
        names
    }

    /// The file that says which edit a relit set shows, where there is one.
    pub fn relit_edit(&self, name: &str) -> Option<PathBuf> {
        Some(self.folder().join("relit").join(format!("{name}.json"))).filter(|path| path.is_file())
    }

    /// A view under another lighting: linear RGB without an upper limit, not exposed, at the size of the view's camera.
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

    /// The linear albedo of a view under an edit of materials, where the edit comes with one.
    pub fn relit_albedo(&self, name: &str, view: usize) -> Result<Option<Image>> {
        let view = self.scene.view(view)?;
        let folder = self.folder().join("relit").join(name);
        match maps::find(&folder, &format!("{}_albedo", view.camera.name), &["exr", "png"]) {
            Some(path) => Ok(Some(maps::load(&path, view, Meaning::Color)?.image)),
            None => Ok(None),
        }
    }
}
