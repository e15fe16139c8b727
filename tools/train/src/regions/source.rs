//! Where regions come from, for both stages.

use super::{PseudoMaps, RegionMaps};
use crate::asked::Asked;
use crate::error::Result;
use crate::pseudo::PseudoViews;
use crate::semantics::SemanticLabels;
use sgs_config::ProviderSettings;
use sgs_engine::{Device, DeviceBuffer};
use sgs_passes::pipeline::Masks;
use sgs_scene::Scene;

/// Source of regions: the first that exists of a provider of masks, `priors/masks`, and the classes of semantic priors.
pub(crate) enum Regions {
    /// Numbers of the training views' pixels, and of the pseudo-views' where `priors/masks/pseudo` has them.
    Numbered {
        /// On the host.
        maps: RegionMaps,
        /// On the device.
        ids: DeviceBuffer,
        /// Of the pseudo-views.
        pseudo: Option<(PseudoMaps, DeviceBuffer)>,
    },
    /// A network that is shown the frames of each step.
    Asked(Box<Asked>),
}

/// What regions are looked for in.
pub(crate) struct RegionInputs<'a> {
    /// Holds the regions.
    pub device: &'a Device,
    /// Its training views and its priors.
    pub scene: &'a Scene,
    /// Provider of masks, if there is a command.
    pub provider: &'a ProviderSettings,
    /// Views that regions are compared in.
    pub pseudo: &'a PseudoViews,
    /// Columns and rows that no view exceeds.
    pub largest: [u32; 2],
    /// Whether training is only planned: no provider is started.
    pub planned: bool,
}

impl Regions {
    /// Finds the regions of a scene. None if there are none. `labels` gives the classes of the semantic priors.
    ///
    /// # Errors
    /// If a file cannot be used, the provider fails, or memory runs out.
    pub fn load(
        inputs: &RegionInputs<'_>,
        labels: impl FnOnce() -> Result<Option<SemanticLabels>>,
    ) -> Result<Option<Regions>> {
        let &RegionInputs { device, scene, provider, pseudo, largest, planned } = inputs;
        if !provider.command.trim().is_empty() {
            let asked = Asked::start(device, largest, provider, planned)?;
            return Ok(asked.map(|a| Regions::Asked(Box::new(a))));
        }
        let Some(maps) = RegionMaps::of_scene(scene, labels)? else { return Ok(None) };
        let pseudo = match PseudoMaps::load(scene, pseudo)? {
            Some(maps) => Some((maps.upload(device)?, maps)).map(|(memory, maps)| (maps, memory)),
            None => None,
        };
        let ids = maps.upload(device)?;
        Ok(Some(Regions::Numbered { maps, ids, pseudo }))
    }

    /// How a step finds its region.
    pub fn masks(&self) -> Masks {
        match self {
            Regions::Numbered { pseudo: None, .. } => Masks::Carried,
            Regions::Numbered { .. } => Masks::Numbered,
            Regions::Asked(_) => Masks::Given,
        }
    }

    /// Numbers of the training views' pixels; masks of the step's frames where a provider is asked.
    pub fn ids(&self) -> &DeviceBuffer {
        match self {
            Regions::Numbered { ids, .. } => ids,
            Regions::Asked(asked) => &asked.masks,
        }
    }

    /// Numbers of the pseudo-views' pixels.
    pub fn pseudo_ids(&self) -> Option<&DeviceBuffer> {
        match self {
            Regions::Numbered { pseudo, .. } => pseudo.as_ref().map(|(_, memory)| memory),
            Regions::Asked(_) => None,
        }
    }

    /// Bytes of device memory.
    pub fn bytes(&self) -> u64 {
        self.ids().bytes() + self.pseudo_ids().map_or(0, DeviceBuffer::bytes)
    }
}
