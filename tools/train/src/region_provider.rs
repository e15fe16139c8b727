//! Region masks from a provider.
//! Each question shows the provider three rendered frames of a step. The provider returns, for each frame, the mask of
//! the object at a point of the first frame. The frames are a pseudo-view, the training view and another pseudo-view,
//! as in SGS-Intrinsic with SAM 2. In stage II the frames are shaded.
//!
//! The frames show the Gaussians before the step, so the step waits for all earlier steps. A question costs this wait
//! and the time of the network. The point depends on the seed and the step only.

use crate::error::{Requirement, Result};
use crate::schedule::hash;
use crate::uniforms::uniform;
use sgs_config::ProviderSettings;
use sgs_engine::{Device, DeviceBuffer, Location};
use sgs_passes::Tuning;
use sgs_passes::loss::pack_mask;
use sgs_passes::pipeline::Renderer;
use sgs_passes::scene::{Gaussians, Layout};
use sgs_passes::splat::{Channels, wanted_words};
use sgs_provider::{Encoding, Helper, ProviderImage, ProviderOptions};
use sgs_run::camera;
use sgs_scene::{Camera, Image};

/// Number of frames of a question: a pseudo-view, the training view, the other pseudo-view.
pub(crate) const FRAMES: usize = 3;

/// Settings of the images that a provider is shown.
pub struct FrameRendering {
    /// Number of bands of spherical harmonics.
    pub sh_degree: u32,
    /// Background color.
    pub background: [f32; 3],
    /// Upper bounds of the width and height of all views.
    pub largest: [u32; 2],
    /// Initial capacity for tile entries.
    pub entries: u32,
}

/// Frames of a question, display-referred.
pub(crate) struct Frames<'a> {
    /// Image of each frame.
    pub images: &'a [Image; FRAMES],
    /// Camera of each frame.
    pub cameras: [&'a Camera; FRAMES],
    /// Flags of the frames that show a training view of the scene.
    pub views: [bool; FRAMES],
}

/// Provider of masks, with the device memory for its answers.
pub(crate) struct RegionProvider {
    /// Provider process. None where training is only planned.
    helper: Option<Helper>,
    /// Renderer of the frames, and the layout of the Gaussians that it was built for.
    renderer: Option<(Renderer, Layout)>,
    /// Packed masks of the three frames, consecutive, one bit per pixel.
    pub masks: DeviceBuffer,
    /// Number of 32-bit words of a frame.
    pub words: u32,
}

impl RegionProvider {
    /// Starts the provider, unless training is only planned.
    /// Returns none if the provider fails and the settings allow training to continue without it.
    pub fn start(
        device: &Device,
        largest: [u32; 2],
        s: &ProviderSettings,
        planned: bool,
    ) -> Result<Option<RegionProvider>> {
        let helper = if planned { None } else { RegionProvider::helper(s)? };
        if helper.is_none() && !planned {
            return Ok(None);
        }
        let words = wanted_words(u64::from(largest[0]) * u64::from(largest[1]));
        let masks = device.buffer("asked_masks", 4 * words * FRAMES as u64, Location::Device)?;
        Ok(Some(RegionProvider { helper, renderer: None, masks, words: words as u32 }))
    }

    fn helper(s: &ProviderSettings) -> Result<Option<Helper>> {
        let options = ProviderOptions {
            command: s.command.clone(),
            start_seconds: s.seconds[0],
            answer_seconds: s.seconds[1],
            ..ProviderOptions::default()
        };
        let mut helper = Helper::start(&options, s.on_failure)?;
        // Rejects a provider without support for masks before training instead of in the middle of it.
        let offers = helper.ask(|p| Ok((p.offers("masks"), p.about().list())))?;
        match offers {
            None => Ok(None),
            Some((true, _)) => Ok(Some(helper)),
            Some((false, offers)) => Err(Requirement::ProviderOffer {
                setting: "provider.command",
                missing: "masks".into(),
                offers,
                remedy: "Choose another, or leave it empty to carry regions by depth",
            }
            .into()),
        }
    }

    /// Returns the number of bytes that rendering the frames takes.
    /// `entries`: capacity for tile entries.
    pub fn rendering(device: &Device, layout: &Layout, largest: [u32; 2], entries: u32) -> Result<u64> {
        let tuning = Tuning::for_device(device.info());
        Ok(uniform(device) + Renderer::bytes(&tuning, layout, largest, Channels::default(), entries)?)
    }

    /// Renders the frames. Returns none if memory does not suffice.
    fn frames(
        &mut self,
        device: &Device,
        gaussians: &Gaussians,
        cameras: &[Camera; FRAMES],
        poll: &FrameRendering,
    ) -> Result<Option<[Image; FRAMES]>> {
        // Drops a renderer of another layout before a new one is built: both may not fit.
        self.renderer = self.renderer.take().filter(|(_, layout)| *layout == gaussians.layout());
        let mut render = || -> Result<[Image; FRAMES]> {
            let (renderer, _) = match &mut self.renderer {
                Some(renderer) => renderer,
                none => {
                    let tuning = Tuning::for_device(device.info());
                    let (channels, entries) = (Channels::default(), poll.entries);
                    let made = Renderer::with_entries(device, tuning, gaussians, poll.largest, channels, entries)?;
                    none.insert((made, gaussians.layout()))
                }
            };
            let mut images = <[Image; FRAMES]>::default();
            for (c, image) in cameras.iter().zip(&mut images) {
                let rendered = renderer.render(gaussians, &camera(c), poll.sh_degree, poll.background)?;
                let data = rendered.image.iter().map(|v| v.clamp(0.0, 1.0)).collect();
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

    /// Renders the Gaussians' own colors and queries the provider.
    /// Stores the masks in [`RegionProvider::masks`].
    /// Returns false if the provider is no longer available.
    pub fn ask(
        &mut self,
        device: &Device,
        gaussians: &Gaussians,
        cameras: &[Camera; FRAMES],
        poll: &FrameRendering,
        seed: u64,
        step: u32,
    ) -> Result<bool> {
        let Some(images) = self.frames(device, gaussians, cameras, poll)? else { return Ok(false) };
        let views = [false, true, false];
        self.ask_about(device, &Frames { images: &images, cameras: cameras.each_ref(), views }, seed, step)
            .map(|n| n.is_some())
    }

    /// Queries the provider about given frames.
    /// Stores the masks in [`RegionProvider::masks`].
    /// Returns the number of pixels of each mask, or none if the provider is no longer available.
    pub fn ask_about(
        &mut self,
        device: &Device,
        frames: &Frames<'_>,
        seed: u64,
        step: u32,
    ) -> Result<Option<[usize; FRAMES]>> {
        let cameras = frames.cameras;
        let shown: [ProviderImage<'_>; FRAMES] = std::array::from_fn(|i| ProviderImage {
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
