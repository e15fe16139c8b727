//! Masks of a region from a network: three rendered frames of a step are shown to a provider, which says where the thing at
//! a point of the first one is in each of them (SGS-Intrinsic: SAM 2 over pseudo-view, training view, pseudo-view; in stage
//! II the frames are shaded).
//!
//! The frames show the Gaussians as they are before the step, so the step waits for all before it: asking costs what the
//! network costs, and this. The point is drawn from seed and step.

use crate::error::{Result, TrainError};
use crate::schedule::hash;
use crate::uniforms::uniform;
use sgs_config::ProviderSettings;
use sgs_engine::{Device, DeviceBuffer, Location};
use sgs_passes::Tuning;
use sgs_passes::loss::pack_mask;
use sgs_passes::pipeline::Renderer;
use sgs_passes::scene::{Gaussians, Layout};
use sgs_passes::splat::{Channels, wanted_words};
use sgs_provider::{Encoding, Helper, Picture, ProviderOptions};
use sgs_run::camera;
use sgs_scene::{Camera, Image};

/// Frames of a question: a pseudo-view, the training view, the other pseudo-view.
pub(crate) const FRAMES: usize = 3;

/// How what a network is shown is rendered.
pub struct Look {
    /// Bands of harmonics.
    pub sh_degree: u32,
    /// What is behind everything.
    pub background: [f32; 3],
    /// Columns and rows that no view exceeds.
    pub largest: [u32; 2],
    /// Room for tile entries at first.
    pub entries: u32,
}

/// Frames of a question, as they are displayed.
pub(crate) struct Frames<'a> {
    /// By frame.
    pub images: &'a [Image; FRAMES],
    /// By frame.
    pub cameras: [&'a Camera; FRAMES],
    /// Which frames show a training view of the scene.
    pub views: [bool; FRAMES],
}

/// A provider of masks.
pub(crate) struct Asked {
    /// None where training is only planned.
    helper: Option<Helper>,
    /// What renders the frames, and for which Gaussians it was made.
    renderer: Option<(Renderer, Layout)>,
    /// Bits of the three frames, one behind the other.
    pub masks: DeviceBuffer,
    /// Words of a frame.
    pub words: u32,
}

impl Asked {
    /// Starts the provider, unless training is only planned. None if it fails and training may go on without.
    pub fn start(device: &Device, largest: [u32; 2], s: &ProviderSettings, planned: bool) -> Result<Option<Asked>> {
        let helper = if planned { None } else { Asked::helper(s)? };
        if helper.is_none() && !planned {
            return Ok(None);
        }
        let words = wanted_words(u64::from(largest[0]) * u64::from(largest[1]));
        let masks = device.buffer("asked_masks", 4 * words * FRAMES as u64, Location::Device)?;
        Ok(Some(Asked { helper, renderer: None, masks, words: words as u32 }))
    }

    fn helper(s: &ProviderSettings) -> Result<Option<Helper>> {
        let options = ProviderOptions {
            command: s.command.clone(),
            start_seconds: s.start_seconds,
            answer_seconds: s.answer_seconds,
            ..ProviderOptions::default()
        };
        let mut helper = Helper::start(&options, s.on_failure)?;
        // One that answers other questions alone is said before training, not in the middle of it.
        let offers = helper.ask(|p| Ok((p.offers("masks"), p.about().list())))?;
        match offers {
            None => Ok(None),
            Some((true, _)) => Ok(Some(helper)),
            Some((false, list)) => Err(TrainError::Setting(format!(
                "The provider answers no questions about masks, but about {list}; choose another, or leave \
                 provider.command empty to carry regions by depth."
            ))),
        }
    }

    /// Bytes that rendering the frames takes, with room for so many tile entries.
    pub fn rendering(device: &Device, layout: &Layout, largest: [u32; 2], entries: u32) -> Result<u64> {
        let tuning = Tuning::for_device(device.info());
        Ok(uniform(device) + Renderer::bytes(&tuning, layout, largest, Channels::default(), entries)?)
    }

    /// The frames; none where memory does not suffice.
    fn frames(
        &mut self,
        device: &Device,
        gaussians: &Gaussians,
        cameras: &[Camera; FRAMES],
        look: &Look,
    ) -> Result<Option<[Image; FRAMES]>> {
        // One of other Gaussians goes before another comes: two may not fit.
        self.renderer = self.renderer.take().filter(|(_, layout)| *layout == gaussians.layout());
        let mut render = || -> Result<[Image; FRAMES]> {
            let (renderer, _) = match &mut self.renderer {
                Some(renderer) => renderer,
                none => {
                    let tuning = Tuning::for_device(device.info());
                    let (channels, entries) = (Channels::default(), look.entries);
                    let made = Renderer::with_entries(device, tuning, gaussians, look.largest, channels, entries)?;
                    none.insert((made, gaussians.layout()))
                }
            };
            let mut images = <[Image; FRAMES]>::default();
            for (c, image) in cameras.iter().zip(&mut images) {
                let picture = renderer.render(gaussians, &camera(c), look.sh_degree, look.background)?;
                let data = picture.image.iter().map(|v| v.clamp(0.0, 1.0)).collect();
                *image = Image { width: c.width, height: c.height, channels: 3, data };
            }
            Ok(images)
        };
        match render() {
            Err(error) if error.is_out_of_memory() => {
                tracing::warn!(
                    "There is no memory to show a network what it is asked about: regions are not compared any more."
                );
                Ok(None)
            }
            other => other.map(Some),
        }
    }

    /// Renders the Gaussians' own colors, asks, and leaves the masks in [`Asked::masks`]. False if there is nobody to ask any more.
    pub fn ask(
        &mut self,
        device: &Device,
        gaussians: &Gaussians,
        cameras: &[Camera; FRAMES],
        look: &Look,
        seed: u64,
        step: u32,
    ) -> Result<bool> {
        let Some(images) = self.frames(device, gaussians, cameras, look)? else { return Ok(false) };
        let views = [false, true, false];
        self.ask_about(device, &Frames { images: &images, cameras: cameras.each_ref(), views }, seed, step)
            .map(|n| n.is_some())
    }

    /// Asks about frames, and leaves the masks in [`Asked::masks`]. Returns the pixels of each mask; none if there is nobody to
    /// ask any more.
    pub fn ask_about(
        &mut self,
        device: &Device,
        frames: &Frames<'_>,
        seed: u64,
        step: u32,
    ) -> Result<Option<[usize; FRAMES]>> {
        let cameras = frames.cameras;
        let shown: [Picture<'_>; FRAMES] = std::array::from_fn(|i| Picture {
            image: &frames.images[i],
            encoding: Encoding::Srgb,
            view: frames.views[i].then_some(cameras[i].name.as_str()),
            camera: Some(cameras[i]),
        });
        let at = |axis: u64, size: u32| {
            (hash(seed ^ (0x706f_696e_7400 + axis), u64::from(step)) % u64::from(size)) as f64 + 0.5
        };
        let point = [at(0, cameras[0].width), at(1, cameras[0].height)];
        let Some(helper) = &mut self.helper else { return Ok(None) };
        let Some(answer) = helper.ask(|p| p.masks(&shown, Some(point)))? else { return Ok(None) };
        for (i, mask) in answer.frames.iter().enumerate() {
            let bits = pack_mask(mask);
            let words = u64::from(self.words);
            device.upload(&self.masks, 4 * words * i as u64, bytemuck::cast_slice(&bits))?;
        }
        Ok(Some(answer.frames.each_ref().map(|mask| mask.iter().filter(|inside| **inside).count())))
    }
}
