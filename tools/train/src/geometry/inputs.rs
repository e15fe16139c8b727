//! Training data of the geometry stage. Photographs and priors of a scene, or images without a scene.

use super::lens::{self, SensorFindings};
use crate::correspondence::Correspondence;
use crate::data::{Packed, PixelPriors};
use crate::error::Result;
use crate::semantics::{SemanticData, SemanticMaps};
use sgs_config::{GeometrySettings, Settings, ViewRates};
use sgs_engine::Device;
use sgs_passes::scene::Decoder;
use sgs_scene::{Camera, Image, Scene};

/// Training data.
pub(crate) enum GeometryInputs<'a> {
    /// Training views of a scene.
    Scene(&'a Scene),
    /// Display-referred images with their cameras. They have no priors and no scene.
    Renderings(&'a [(&'a Camera, Image)]),
}

impl GeometryInputs<'_> {
    /// Reads the images and the requested priors. Semantic maps are none without `semantics` or without priors.
    pub fn read(&self, priors: PixelPriors, semantics: bool) -> Result<(Packed, Option<SemanticMaps>)> {
        match self {
            GeometryInputs::Scene(scene) => {
                let maps = if semantics { SemanticMaps::read(scene)? } else { None };
                Ok((Packed::read(scene, priors)?, maps))
            }
            GeometryInputs::Renderings(images) => Ok((Packed::of(images)?, None)),
        }
    }

    /// Returns the rates of what is learned of the views, and what a sensor shows.
    ///
    /// Renderings have exact cameras.
    pub fn view_rates(&self, g: &GeometrySettings) -> Result<([f64; 4], Option<SensorFindings>)> {
        let GeometryInputs::Scene(scene) = self else { return Ok(([0.0; 4], None)) };
        let fixed = g.rates.views.fixed();
        let free = fixed.map_or([true; 2], |rates| [rates[2] > 0.0, rates[3] > 0.0]);
        let found = if free.contains(&true) { lens::from_depth(scene, free)? } else { None };
        let differ = found.as_ref().is_some_and(SensorFindings::differs);
        let measured = if differ { ViewRates::RECORDING } else { [0.0; 4] };
        Ok((fixed.unwrap_or(measured), found))
    }

    /// Returns the unit of lengths.
    pub fn extent(&self) -> f64 {
        match self {
            GeometryInputs::Scene(scene) => scene.extent(),
            // Means do not move where there is no scene.
            GeometryInputs::Renderings(_) => 1.0,
        }
    }

    /// Returns the cameras of the training views.
    pub fn cameras(&self) -> Vec<&Camera> {
        match self {
            GeometryInputs::Scene(scene) => scene.split.train.iter().map(|&i| &scene.views[i].camera).collect(),
            GeometryInputs::Renderings(images) => images.iter().map(|p| p.0).collect(),
        }
    }

    /// Uploads semantic targets and creates the decoder of the features.
    pub fn semantics(
        &self,
        device: &Device,
        maps: Option<SemanticMaps>,
        seed: u64,
    ) -> Result<Option<(SemanticData, Decoder)>> {
        match (self, maps) {
            (GeometryInputs::Scene(scene), Some(maps)) => {
                Ok(Some((maps.upload(device, scene)?, Decoder::new(device, seed as u32, true)?)))
            }
            _ => Ok(None),
        }
    }

    /// Loads the pseudo-views and regions that are compared between views.
    pub fn correspondence(
        &self,
        device: &Device,
        data: &SemanticData,
        settings: &Settings,
        largest: [u32; 2],
    ) -> Result<Option<Correspondence>> {
        match self {
            GeometryInputs::Scene(scene) => Correspondence::load(device, scene, data, settings, largest),
            GeometryInputs::Renderings(_) => Ok(None),
        }
    }
}
