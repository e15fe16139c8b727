//! Source of regions for both stages.

use super::{PseudoMaps, RegionMaps};
use crate::error::Result;
use crate::pseudo::PseudoViews;
use crate::region_provider::RegionProvider;
use crate::semantics::SemanticLabels;
use sgs_config::ProviderSettings;
use sgs_engine::{Device, DeviceBuffer};
use sgs_passes::pipeline::Masks;
use sgs_scene::Scene;

/// Source of regions. The first that exists of: a mask provider, `priors/masks`, and the classes of semantic priors.
pub(crate) enum Regions {
    /// Region ids of pixels. The training views have them, and the pseudo-views where `priors/masks/pseudo` does.
    Numbered {
        /// Ids on the host.
        maps: RegionMaps,
        /// Ids on the device.
        ids: DeviceBuffer,
        /// Ids of the pseudo-views, on host and device.
        pseudo: Option<(PseudoMaps, DeviceBuffer)>,
    },
    /// Network that receives the frames of each step.
    Provider(Box<RegionProvider>),
}

/// Inputs of the search for regions.
pub(crate) struct RegionInputs<'a> {
    /// Device that holds the regions.
    pub device: &'a Device,
    /// Scene with training views and priors.
    pub scene: &'a Scene,
    /// Mask provider, if its command is not empty.
    pub provider: &'a ProviderSettings,
    /// Pseudo-views in which regions are compared.
    pub pseudo: &'a PseudoViews,
    /// Upper bound of the columns and rows of all views.
    pub largest: [u32; 2],
    /// Whether training is only planned. No provider is started then.
    pub planned: bool,
}

impl Regions {
    /// Loads the regions of a scene. Returns none if there are none, or if the provider fails and training may continue
    /// without it. `labels` returns the classes of the semantic priors.
    ///
    /// # Errors
    /// If a file cannot be used, the provider fails, or memory runs out.
    pub fn load(
        inputs: &RegionInputs<'_>,
        labels: impl FnOnce() -> Result<Option<SemanticLabels>>,
    ) -> Result<Option<Regions>> {
        let &RegionInputs { device, scene, provider, pseudo, largest, planned } = inputs;
        if !provider.command.trim().is_empty() {
            let requested = RegionProvider::start(device, largest, provider, planned)?;
            return Ok(requested.map(|a| Regions::Provider(Box::new(a))));
        }
        let Some(maps) = RegionMaps::of_scene(scene, labels)? else { return Ok(None) };
        let pseudo = match PseudoMaps::load(scene, pseudo)? {
            Some(maps) => Some((maps.upload(device)?, maps)).map(|(memory, maps)| (maps, memory)),
            None => None,
        };
        let ids = maps.upload(device)?;
        Ok(Some(Regions::Numbered { maps, ids, pseudo }))
    }

    /// Returns how a step finds its region.
    pub fn masks(&self) -> Masks {
        match self {
            Regions::Numbered { pseudo: None, .. } => Masks::Carried,
            Regions::Numbered { .. } => Masks::Numbered,
            Regions::Provider(_) => Masks::Provided,
        }
    }

    /// Returns the region ids of the training views' pixels. With a provider, returns the masks of the frames of the
    /// step.
    pub fn ids(&self) -> &DeviceBuffer {
        match self {
            Regions::Numbered { ids, .. } => ids,
            Regions::Provider(requested) => &requested.masks,
        }
    }

    /// Returns the region ids of the pseudo-views' pixels.
    pub fn pseudo_ids(&self) -> Option<&DeviceBuffer> {
        match self {
            Regions::Numbered { pseudo, .. } => pseudo.as_ref().map(|(_, memory)| memory),
            Regions::Provider(_) => None,
        }
    }

    /// Returns the number of bytes of device memory.
    pub fn bytes(&self) -> u64 {
        self.ids().bytes() + self.pseudo_ids().map_or(0, DeviceBuffer::bytes)
    }
}
