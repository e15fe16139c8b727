//! Comparison of a training view with two pseudo-views in one region.
//!
//! All random choices depend on the seed and the step only, so resuming needs nothing but the step.

use crate::error::Result;
use crate::pseudo::PseudoViews;
use crate::region_provider::{FrameRendering, RegionProvider};
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
    /// Cameras of the training views.
    views: Vec<Camera>,
    regions: Regions,
}

impl Correspondence {
    /// Loads the regions and builds the pseudo-views. Returns none if the scene has no regions.
    /// `largest`: upper bounds of the width and height of all views.
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

    /// Returns the source of the region masks of pseudo-views.
    pub fn masks(&self) -> Masks {
        self.regions.masks()
    }

    /// Returns whether preparing a step requires that all earlier steps are done.
    pub fn polls(&self) -> bool {
        matches!(self.regions, Regions::Provider(_))
    }

    /// Adds the region buffers to the inputs of a step.
    pub fn bind<'a>(&'a self, inputs: &mut Inputs<'a>) {
        inputs.regions = Some(self.regions.ids());
        inputs.pseudo_regions = self.regions.pseudo_ids();
    }

    /// Chooses the region of a step and returns the uniforms of its pseudo-views.
    /// Returns none if the provider is no longer available. `poll`: settings of the images that the provider is shown.
    ///
    /// # Errors
    /// If the provider fails and the settings do not allow training without it.
    pub fn steps(
        &mut self,
        device: &Device,
        gaussians: &Gaussians,
        poll: &FrameRendering,
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
                values.region_offset = maps.first(view);
                for (step, (which, index)) in steps.iter_mut().zip(drawn) {
                    step.region = values.region;
                    step.region_offset = pseudo.as_ref().map_or(0, |(maps, _)| maps.first(view, which, index));
                }
            }
            Regions::Provider(requested) => {
                let [a, b] = cameras;
                let frames = [a, self.views[view].clone(), b];
                if !requested.ask(device, gaussians, &frames, poll, seed, values.step)? {
                    return Ok(None);
                }
                values.mask_offset = requested.words;
                steps[1].mask_offset = 2 * requested.words;
            }
        }
        Ok(Some(steps))
    }

    /// Returns the number of bytes that rendering images for the provider takes.
    /// `entries`: capacity for tile entries. The result is 0 without a provider of masks.
    ///
    /// # Errors
    /// If no graph can be compiled for this capacity.
    pub fn rendering_bytes(&self, device: &Device, layout: &Layout, largest: [u32; 2], entries: u32) -> Result<u64> {
        if self.polls() { RegionProvider::rendering(device, layout, largest, entries) } else { Ok(0) }
    }

    /// Returns the number of bytes of device memory.
    pub fn bytes(&self) -> u64 {
        self.regions.bytes()
    }
}
