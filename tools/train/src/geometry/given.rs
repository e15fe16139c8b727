//! What the geometry stage is trained on: a scene's photographs and priors, or pictures that somebody made.

use crate::correspondence::Correspondence;
use crate::data::Packed;
use crate::error::Result;
use crate::semantics::{SemanticData, SemanticMaps};
use sgs_config::Settings;
use sgs_engine::Device;
use sgs_passes::scene::Decoder;
use sgs_scene::{Camera, Image, Scene};

/// What is trained on.
pub(crate) enum Given<'a> {
    /// A scene's training views.
    Scene(&'a Scene),
    /// Pictures, display-referred, with their cameras; nothing else is known of them.
    Pictures(&'a [(&'a Camera, Image)]),
}

impl Given<'_> {
    /// Pictures, and priors of normals and of meaning where they are wanted and there are some.
    pub fn read(&self, normals: bool, semantics: bool) -> Result<(Packed, Option<SemanticMaps>)> {
        match self {
            Given::Scene(scene) => {
                let maps = if semantics { SemanticMaps::read(scene)? } else { None };
                Ok((Packed::read(scene, normals)?, maps))
            }
            Given::Pictures(pictures) => Ok((Packed::of(pictures)?, None)),
        }
    }

    /// The unit of lengths.
    pub fn extent(&self) -> f64 {
        match self {
            Given::Scene(scene) => scene.extent(),
            // Nothing moves where there is no scene.
            Given::Pictures(_) => 1.0,
        }
    }

    /// The cameras of the training views.
    pub fn cameras(&self) -> Vec<&Camera> {
        match self {
            Given::Scene(scene) => scene.split.train.iter().map(|&i| &scene.views[i].camera).collect(),
            Given::Pictures(pictures) => pictures.iter().map(|p| p.0).collect(),
        }
    }

    /// What gives features a meaning.
    pub fn semantics(
        &self,
        device: &Device,
        maps: Option<SemanticMaps>,
        seed: u64,
    ) -> Result<Option<(SemanticData, Decoder)>> {
        match (self, maps) {
            (Given::Scene(scene), Some(maps)) => {
                Ok(Some((maps.upload(device, scene)?, Decoder::new(device, seed as u32, true)?)))
            }
            _ => Ok(None),
        }
    }

    /// What is compared between views.
    pub fn correspondence(
        &self,
        device: &Device,
        data: &SemanticData,
        settings: &Settings,
        largest: [u32; 2],
    ) -> Result<Option<Correspondence>> {
        match self {
            Given::Scene(scene) => Correspondence::load(device, scene, data, settings, largest),
            Given::Pictures(_) => Ok(None),
        }
    }
}
