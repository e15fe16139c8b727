//! What a step compares with its training view: two pseudo-views, and one region.
//!
//! Everything is drawn from the seed and the number of the step, so that resuming needs nothing but the number.

use crate::asked::{Asked, Look};
use crate::error::Result;
use crate::pseudo::PseudoViews;
use crate::regions::{RegionInputs, Regions};
use crate::semantics::SemanticData;
use sgs_config::Settings;
use sgs_engine::Device;
use sgs_passes::pipeline::{Inputs, Masks, PSEUDO_VIEWS, Step};
use sgs_passes::scene::{Gaussians, Layout};
use sgs_run::camera;
use sgs_scene::{Camera, Scene};

/// Pseudo-views and regions of a scene, on the device.
pub struct Correspondence {
    pseudo: PseudoViews,
    /// The training views.
    views: Vec<Camera>,
    regions: Regions,
}

impl Correspondence {
    /// None if the scene has no regions. `largest`: columns and rows that no view exceeds.
    ///
    /// # Errors
    /// If a file cannot be used, the provider of the settings fails, or memory runs out.
    pub fn load(
        device: &Device,
        scene: &Scene,
        semantic: &SemanticData,
        settings: &Settings,
        largest: [u32; 2],
    ) -> Result<Option<Correspondence>> {
        let pseudo = PseudoViews::new(scene, &settings.geometry.pseudo)?;
        let views = scene.split.train.iter().map(|&i| scene.views[i].camera.clone()).collect();
        let inputs =
            RegionInputs { device, scene, provider: &settings.provider, pseudo: &pseudo, largest, planned: false };
        let regions = Regions::load(&inputs, || semantic.labels(device).map(Some))?;
        Ok(regions.map(|regions| Correspondence { pseudo, views, regions }))
    }

    /// What says where a region is in pseudo-views.
    pub fn masks(&self) -> Masks {
        self.regions.masks()
    }

    /// Whether a step can only be made up when those before it are done.
    pub fn looks(&self) -> bool {
        matches!(self.regions, Regions::Asked(_))
    }

    /// Adds what a step is bound to.
    pub fn bind<'a>(&'a self, inputs: &mut Inputs<'a>) {
        inputs.regions = Some(self.regions.ids());
        inputs.pseudo_regions = self.regions.pseudo_ids();
    }

    /// Chooses the region of a step, and makes the uniforms of its pseudo-views. None if there is nobody to ask any more.
    /// `look`: how what a network is shown is rendered.
    ///
    /// # Errors
    /// If the provider fails and training may not go on without.
    pub fn steps(
        &mut self,
        device: &Device,
        gaussians: &Gaussians,
        look: &Look,
        seed: u64,
        view: usize,
        values: &mut Step,
    ) -> Result<Option<[Step; PSEUDO_VIEWS]>> {
        let [first, second] = self.pseudo.draw(seed, values.step);
        let drawn = [(0, first), (1, second)];
        let cameras = drawn.map(|(which, index)| self.pseudo.camera(view, which, index));
        let mut steps = cameras.each_ref().map(|c| Step {
            camera: camera(c),
            step: values.step,
            weight_correspondence: values.weight_correspondence,
            inverse_temperature: values.inverse_temperature,
            ..Step::default()
        });
        match &mut self.regions {
            Regions::Numbered { maps, pseudo, .. } => {
                values.region = maps.draw(view, seed, values.step);
                for (step, (which, index)) in steps.iter_mut().zip(drawn) {
                    step.region = values.region;
                    step.target_offset = pseudo.as_ref().map_or(0, |(maps, _)| maps.first(view, which, index));
                }
            }
            Regions::Asked(asked) => {
                let [a, b] = cameras;
                let frames = [a, self.views[view].clone(), b];
                if !asked.ask(device, gaussians, &frames, look, seed, values.step)? {
                    return Ok(None);
                }
                values.mask_offset = asked.words;
                steps[1].mask_offset = 2 * asked.words;
            }
        }
        Ok(Some(steps))
    }

    /// Bytes that showing a network the Gaussians takes, with room for so many tile entries; none where nobody is asked.
    ///
    /// # Errors
    /// If so many make no graph.
    pub fn looking(&self, device: &Device, layout: &Layout, largest: [u32; 2], entries: u32) -> Result<u64> {
        if self.looks() { Asked::rendering(device, layout, largest, entries) } else { Ok(0) }
    }

    /// Bytes of device memory.
    pub fn bytes(&self) -> u64 {
        self.regions.bytes()
    }
}
