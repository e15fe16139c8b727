//! Priors from pretrained networks on the photographs, in `priors/`.
//!
//! Priors may guide training. They never come from ground truth, which is in another folder and has another type
//! ([`GroundTruth`](crate::GroundTruth)). Every kind is optional, as a whole or for single views.

use std::collections::HashSet;
use std::path::PathBuf;

use serde::Deserialize;

use crate::camera::{Camera, Distortion};
use crate::error::{Result, SceneError};
use crate::image::{Image, NpyArray};
use crate::json::read_json;
use crate::map_file::Meaning;
use crate::maps::{self, FeatureMap, MaskedMap, RegionMap};
use crate::prior_settings::NormalSettings;
use crate::scene::Scene;
use crate::view::View;

const NORMAL_EXTENSIONS: [&str; 3] = ["exr", "npy", "png"];
const MAP_EXTENSIONS: [&str; 3] = ["exr", "npy", "png"];

/// Text embeddings of the semantic classes, one per class.
#[derive(Clone, Debug, PartialEq)]
pub struct TextEmbeddings {
    /// Names of the classes.
    pub labels: Vec<String>,
    /// Length of an embedding.
    pub channels: usize,
    /// Embeddings, class by class.
    pub data: Vec<f32>,
}

impl TextEmbeddings {
    /// Returns the index of a class by name.
    ///
    /// # Errors
    /// Fails if the class is unknown; the message lists the known classes.
    pub fn class(&self, name: &str) -> std::result::Result<usize, UnknownClass> {
        let at = self.labels.iter().position(|l| l == name);
        at.ok_or_else(|| UnknownClass { name: name.to_owned(), known: self.labels.join(", ") })
    }
}

/// Class without a text embedding.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("there is no class \"{name}\"; there are {known}")]
pub struct UnknownClass {
    name: String,
    known: String,
}

/// Content of `labels.json`.
#[derive(Deserialize)]
pub(crate) struct Labels {
    pub(crate) labels: Vec<String>,
}

impl Scene {
    pub(crate) fn prior_path(&self, kind: &str, view: &View, extensions: &[&str]) -> Option<PathBuf> {
        maps::find(&self.root.join("priors").join(kind), &view.camera.name, extensions)
    }

    /// Loads the normal prior of a view; `None` if it does not exist. The result has the size of the view's camera and
    /// holds world-space unit vectors, zero where the prior is invalid.
    pub fn normal_prior(&self, view: usize) -> Result<Option<Image>> {
        let (number, view) = (view, self.view(view)?);
        let Some(path) = self.prior_path("normal", view, &NORMAL_EXTENSIONS) else {
            return Ok(None);
        };
        let Some(NormalSettings { frame }) = self.prior_settings.normal else {
            return Err(SceneError::image(&path, "the frame of the normals is unknown; name it in priors/priors.json"));
        };
        let mut normals = maps::load_normals(&path, view, frame)?;
        self.noise.turn_normals(number, &mut normals);
        Ok(Some(normals))
    }

    /// Loads the albedo prior of a view: linear RGB.
    pub fn albedo_prior(&self, view: usize) -> Result<Option<MaskedMap>> {
        self.map_prior("albedo", view, Meaning::Color)
    }

    /// Loads the roughness prior of a view: one channel.
    pub fn roughness_prior(&self, view: usize) -> Result<Option<MaskedMap>> {
        self.map_prior("roughness", view, Meaning::Scalar)
    }

    /// Loads the metallic prior of a view: one channel.
    pub fn metallic_prior(&self, view: usize) -> Result<Option<MaskedMap>> {
        self.map_prior("metallic", view, Meaning::Scalar)
    }

    fn map_prior(&self, kind: &str, view: usize, meaning: Meaning) -> Result<Option<MaskedMap>> {
        let view = self.view(view)?;
        match self.prior_path(kind, view, &MAP_EXTENSIONS) {
            Some(path) => maps::load(&path, view, meaning).map(Some),
            None => Ok(None),
        }
    }

    /// Loads the regions of a view, at the size of the view's camera. The same id is the same region in every view; 0
    /// means none.
    pub fn region_prior(&self, view: usize) -> Result<Option<RegionMap>> {
        let view = self.view(view)?;
        match self.prior_path("masks", view, &["png"]) {
            Some(path) => maps::load_numbers(&path, view).map(Some),
            None => Ok(None),
        }
    }

    /// Loads the regions of a pseudo-view, at the size of its camera. The file in `priors/masks/pseudo` has the
    /// camera's name. Ids are those of [`Scene::region_prior`]. The segmented image is a render and has no distortion.
    pub fn pseudo_region_prior(&self, camera: &Camera) -> Result<Option<RegionMap>> {
        match maps::find(&self.root.join("priors/masks/pseudo"), &camera.name, &["png"]) {
            Some(path) => maps::load_numbers_seen(&path, camera, &Distortion::default()).map(Some),
            None => Ok(None),
        }
    }

    /// Loads the semantic features of a view, at their stored size. Undistortion takes the nearest stored cell, because
    /// features are directions and cannot be averaged. Cells with non-finite values or zeros carry no information.
    pub fn semantic_prior(&self, view: usize) -> Result<Option<FeatureMap>> {
        let mut map = self.stored_features(self.view(view)?)?;
        map.iter_mut().for_each(|map| self.noise.mix_features(view, map));
        Ok(map)
    }

    fn stored_features(&self, view: &View) -> Result<Option<FeatureMap>> {
        let Some(path) = self.prior_path("semantic", view, &["npy"]) else {
            return Ok(None);
        };
        let array = NpyArray::read(&path)?;
        let [height, width, channels] = array.dimensions3()?;
        if let Some(text) = self.text_embeddings()?
            && text.channels != channels
        {
            let problem = format!(
                "the map has {channels} features a cell, but text_embeddings.npy beside it has {} for each class; compute \
                 both with the same network",
                text.channels
            );
            return Err(SceneError::image(&path, problem));
        }
        let stored = array.to_f16();
        if view.distortion.is_none() {
            return Ok(Some(FeatureMap { width, height, channels, data: stored }));
        }
        let mut data = Vec::with_capacity(stored.len());
        for [column, row] in maps::cells(view, width, height) {
            let at = (row * width + column) * channels;
            data.extend_from_slice(stored.get(at..at + channels).unwrap_or_default());
        }
        Ok(Some(FeatureMap { width, height, channels, data }))
    }

    /// Loads the text embeddings of the semantic classes from `priors/semantic`.
    pub fn text_embeddings(&self) -> Result<Option<TextEmbeddings>> {
        let folder = self.root.join("priors/semantic");
        let path = folder.join("text_embeddings.npy");
        if !path.is_file() {
            return Ok(None);
        }
        let array = NpyArray::read(&path)?;
        let Labels { labels } = read_json(&folder.join("labels.json"))?;
        let data = array.to_f32();
        match array.shape[..] {
            [classes, channels]
                if classes == labels.len() && classes * channels > 0 && data.iter().all(|v| v.is_finite()) =>
            {
                let mut seen = HashSet::new();
                if let Some(label) = labels.iter().find(|label| !seen.insert(*label)) {
                    let problem = format!("\"{label}\" occurs twice; every class needs a name of its own");
                    return Err(SceneError::image(&folder.join("labels.json"), problem));
                }
                Ok(Some(TextEmbeddings { labels, channels, data }))
            }
            _ => {
                let problem = format!(
                    "the array has the shape {:?}; it must hold one finite embedding for each of the {} classes in \
                     labels.json",
                    array.shape,
                    labels.len()
                );
                Err(SceneError::image(&path, problem))
            }
        }
    }
}
