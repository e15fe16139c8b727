//! Ground truth: what a renderer knew, in `gt/`. For measuring only.
//!
//! It is a type of its own, so that code that trains cannot reach it through the scene it holds: whoever names
//! [`GroundTruth`] says that it measures.

use std::path::PathBuf;

use crate::error::Result;
use crate::image::Image;
use crate::maps::{self, Meaning, NormalFrame, RegionMap};
use crate::scene::Scene;

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
    pub fn load(&self, kind: GroundTruthKind, view: usize) -> Result<Option<Image>> {
        let view = self.scene.view(view)?;
        let folder = self.folder().join(kind.folder());
        let Some(path) = maps::find(&folder, &view.camera.name, &["exr", "png"]) else {
            return Ok(None);
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
        let Ok(entries) = std::fs::read_dir(self.folder().join("relit")) else {
            return Vec::new();
        };
        let folders = entries.flatten().filter(|entry| entry.path().is_dir());
        let mut names: Vec<_> = folders.filter_map(|entry| entry.file_name().into_string().ok()).collect();
        names.sort();
        names
    }

    /// The file that says which edit a relit set shows, where there is one.
    pub fn relit_edit(&self, name: &str) -> Option<PathBuf> {
        Some(self.folder().join("relit").join(format!("{name}.json"))).filter(|path| path.is_file())
    }

    /// A view under another lighting: linear RGB without an upper limit, at the size of the view's camera.
    pub fn relit(&self, name: &str, view: usize) -> Result<Option<Image>> {
        let view = self.scene.view(view)?;
        let folder = self.folder().join("relit").join(name);
        match maps::find(&folder, &view.camera.name, &["exr", "png"]) {
            Some(path) => Ok(Some(maps::load(&path, view, Meaning::Color)?.image)),
            None => Ok(None),
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
