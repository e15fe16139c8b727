//! What a step compares with its training view: two pseudo-views, and one region.
//!
//! Everything is drawn from the seed and the number of the step, so that resuming needs nothing but the number.

use crate::convert::camera;
use crate::error::Result;
use crate::pseudo::{PseudoOptions, PseudoViews};
use crate::regions::{PseudoMaps, RegionMaps};
use crate::semantics::SemanticData;
use sgs_engine::{Device, DeviceBuffer};
use sgs_passes::pipeline::{Inputs, Masks, PSEUDO_VIEWS, Step};
use sgs_scene::Scene;

/// Pseudo-views and regions of a scene, on the device.
pub(crate) struct Correspondence {
    pseudo: PseudoViews,
    regions: RegionMaps,
    ids: DeviceBuffer,
    /// Regions of pseudo-views, segmented outside.
    given: Option<(PseudoMaps, DeviceBuffer)>,
}

impl Correspondence {
    /// None where nothing says what a region is.
    pub fn load(
        device: &Device,
        scene: &Scene,
        semantic: &SemanticData,
        options: &PseudoOptions,
    ) -> Result<Option<Correspondence>> {
        let Some(regions) = RegionMaps::load(device, scene, Some(semantic))? else { return Ok(None) };
        let pseudo = PseudoViews::new(scene, options)?;
        let given = match PseudoMaps::load(scene, &pseudo)? {
            Some(maps) => {
                let memory = maps.upload(device)?;
                Some((maps, memory))
            }
            None => None,
        };
        let ids = regions.upload(device)?;
        Ok(Some(Correspondence { pseudo, regions, ids, given }))
    }

    /// What says where a region is in pseudo-views.
    pub fn masks(&self) -> Masks {
        if self.given.is_some() { Masks::Numbered } else { Masks::Carried }
    }

    /// Adds what a step is bound to.
    pub fn bind<'a>(&'a self, inputs: &mut Inputs<'a>) {
        inputs.regions = Some(&self.ids);
        inputs.pseudo_regions = self.given.as_ref().map(|(_, memory)| memory);
    }

    /// Chooses the region of a step, and makes the uniforms of its pseudo-views.
    pub fn steps(&self, seed: u64, view: usize, values: &mut Step) -> [Step; PSEUDO_VIEWS] {
        values.region = self.regions.draw(view, seed, values.step);
        let drawn = self.pseudo.draw(seed, values.step);
        let mut which = 0;
        drawn.map(|index| {
            let mut step = Step {
                camera: camera(&self.pseudo.camera(view, which, index)),
                step: values.step,
                region: values.region,
                weight_correspondence: values.weight_correspondence,
                inverse_temperature: values.inverse_temperature,
                ..Step::default()
            };
            if let Some((maps, _)) = &self.given {
                step.target_offset = maps.first(view, which, index);
            }
            which += 1;
            step
        })
    }

    /// Bytes of device memory.
    pub fn bytes(&self) -> u64 {
        self.ids.bytes() + self.given.as_ref().map_or(0, |(_, memory)| memory.bytes())
    }
}
