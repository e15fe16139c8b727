//! Albedo under other lights, estimated by a provider of materials.
//! A training view is rendered with its lights randomly moved, dimmed and switched off. The provider estimates the
//! materials of the image (SGS-Intrinsic, stage II: RGB→X).
//!
//! Guarantees: a request depends only on the parameters before the step, the seed and the step. An answer is reused
//! until it is too old, and checkpoints store it. A request waits for all earlier steps. Pixels that the provider does
//! not know are not compared.

use super::Intrinsic;
use super::consistency::StepKind;
use super::data::{Material, pack};
use super::frames::shaded;
use crate::data::Packed;
use crate::error::{Requirement, Result};
use rayon::prelude::*;
use sgs_config::Settings;
use sgs_engine::{Device, DeviceBuffer, Location};
use sgs_passes::Tuning;
use sgs_passes::pipeline::{
    COPIES, IntrinsicInputs, IntrinsicOptions, IntrinsicStepValues, RelitOptions, RelitView, Surface,
};
use sgs_provider::{Encoding, Helper, Materials, ProviderImage, ProviderOptions};
use sgs_scene::{Camera, Image, MaskedMap, Scene, resize_valid, srgb_to_linear};

/// Provider of materials, and its latest estimates of each training view.
pub(super) struct Relit {
    /// Provider process. None where training is only planned.
    helper: Option<Helper>,
    view: Option<RelitView>,
    options: RelitOptions,
    /// Whether the provider estimates roughness too.
    roughness: bool,
    every: u32,
    background: [f32; 3],
    /// Cameras of the training views; then masks of valid pixels, and parts and first pixels in them.
    cameras: Vec<Camera>,
    counts: Vec<Option<Image>>,
    places: Vec<(usize, u32)>,
    /// Albedo of each copy, then roughness of each copy, packed like priors: a buffer per part.
    estimates: Vec<Vec<DeviceBuffer>>,
    /// Step of the latest request for each view; 0 means none.
    pub requested_at: Vec<u32>,
    /// Images of the latest rendered step.
    rendered: Option<(u32, Vec<Image>)>,
}

impl Relit {
    /// Returns the number of estimates of each view.
    pub fn count(settings: &Settings) -> usize {
        let r = &settings.intrinsic.relight;
        COPIES * if r.roughness > 0.0 { 2 } else { 1 }
    }

    /// Returns the number of copies and the spacing, for lights that started in a box.
    pub fn options(bounds: &[[f32; 3]; 2]) -> RelitOptions {
        // The published unit is the one in which the box has side 3.
        let spacing = (0..3).map(|i| bounds[1][i] - bounds[0][i]).fold(0.0, f32::max) / 3.0;
        RelitOptions { as_is: false, copies: COPIES as u32, spacing }
    }

    /// Starts the provider.
    /// Returns none if the provider fails and the settings allow training to continue without it.
    pub fn helper(settings: &Settings, command: &str) -> Result<Option<Helper>> {
        let s = &settings.provider;
        let options = ProviderOptions {
            command: command.to_owned(),
            start_seconds: s.seconds[0],
            answer_seconds: s.seconds[1],
            ..ProviderOptions::default()
        };
        let mut helper = Helper::start(&options, s.on_failure)?;
        let roughness = settings.intrinsic.relight.roughness > 0.0;
        // Rejects a provider without the required maps before training instead of in the middle of it.
        let offers = helper.ask(|p| {
            let maps = p.about().offers.get("materials").map(|o| o.maps.clone());
            Ok((maps, p.about().list()))
        })?;
        let offer = |missing, offers| Requirement::ProviderOffer {
            setting: "intrinsic.relight.provider",
            missing,
            offers,
            remedy: "Choose another, or \"own\"",
        };
        let wanted: &[&str] = if roughness { &["albedo", "roughness"] } else { &["albedo"] };
        match offers {
            None => return Ok(None),
            Some((None, list)) => {
                return Err(offer("materials".into(), list).into());
            }
            Some((Some(maps), _)) => {
                if let Some(missing) = wanted.iter().find(|w| !maps.iter().any(|m| m == *w)) {
                    let maps = if maps.is_empty() { "no map at all".to_owned() } else { maps.join(", ") };
                    return Err(offer(format!("map of {missing}"), maps).into());
                }
            }
        }
        Ok(Some(helper))
    }

    /// Allocates memory for the estimates, in parts like the photographs.
    pub fn new(
        device: &Device,
        scene: &Scene,
        settings: &Settings,
        helper: Option<Helper>,
        bounds: &[[f32; 3]; 2],
        photographs: &Packed,
    ) -> Result<Relit> {
        let roughness = settings.intrinsic.relight.roughness > 0.0;
        let train = &scene.split.train;
        let counts = train.par_iter().map(|&i| Ok(scene.load_mask(i)?)).collect::<Result<Vec<_>>>()?;
        let make = |_| {
            let buffer = device.buffer("relit_estimates", photographs.image_bytes().max(4), Location::Device)?;
            device.fill(&buffer, 0)?;
            Ok(buffer)
        };
        let of_all = |_| (0..photographs.parts()).map(make).collect::<Result<_>>();
        let first = photographs.views().iter().map(|v| v.1);
        Ok(Relit {
            helper,
            view: None,
            options: Relit::options(bounds),
            roughness,
            every: settings.intrinsic.relight.every,
            background: settings.geometry.background,
            cameras: train.iter().map(|&i| scene.views[i].camera.clone()).collect(),
            counts,
            places: photographs.part_of().iter().copied().zip(first).collect(),
            estimates: (0..Relit::count(settings)).map(of_all).collect::<Result<_>>()?,
            requested_at: vec![0; train.len()],
            rendered: None,
        })
    }

    /// Returns the estimates of a part in the order in which a step binds them.
    pub fn bound(&self, part: usize) -> [Option<&DeviceBuffer>; 2 * COPIES] {
        let copies = self.options.copies as usize;
        let of = |(first, copy): (bool, usize)| match first {
            true => self.estimates[..copies].get(copy),
            false => self.estimates[copies..].get(copy),
        };
        std::array::from_fn(|i| of((i < COPIES, i % COPIES)).and_then(|parts| parts.get(part)))
    }

    /// Returns the number of kinds of estimates: albedo and roughness of each copy.
    pub fn kinds(&self) -> usize {
        self.estimates.len()
    }

    /// Returns the number of pixels of each part.
    fn pixels(&self) -> Vec<usize> {
        let mut pixels = vec![0; self.estimates.first().map_or(0, Vec::len)];
        for (camera, (part, _)) in self.cameras.iter().zip(&self.places) {
            pixels[*part] += camera.width as usize * camera.height as usize;
        }
        pixels
    }

    /// Returns the number of pixels of all training views.
    pub fn all_pixels(&self) -> usize {
        self.pixels().iter().sum()
    }

    /// Returns the estimates of a kind, view after view. They do not depend on the number of parts.
    pub fn download(&self, device: &Device, kind: usize) -> Result<Vec<u32>> {
        let mut words = Vec::new();
        for (buffer, pixels) in self.estimates[kind].iter().zip(self.pixels()) {
            words.extend(device.download_as::<u32>(buffer, pixels)?);
        }
        Ok(words)
    }

    /// Uploads the estimates of a kind, as downloaded.
    pub fn upload(&self, device: &Device, kind: usize, mut words: &[u32]) -> Result<()> {
        for (buffer, pixels) in self.estimates[kind].iter().zip(self.pixels()) {
            let (part, others) = words.split_at(pixels.min(words.len()));
            device.upload(buffer, 0, bytemuck::cast_slice(part))?;
            words = others;
        }
        Ok(())
    }

    /// Returns whether the estimates of a view must be requested before a step.
    pub fn is_due(&self, view: usize, step: u32) -> bool {
        let before = self.requested_at[view];
        before == 0 || step.saturating_sub(before) >= self.every
    }

    /// Renders a view under other lights. Requires that no work is in flight.
    fn images(
        &mut self,
        device: &Device,
        tuning: &Tuning,
        inputs: &IntrinsicInputs<'_>,
        options: &IntrinsicOptions,
        surface: &Surface,
        values: &IntrinsicStepValues,
    ) -> Result<Vec<Image>> {
        let mut shader = match self.view.take() {
            Some(shader) => shader,
            None => RelitView::new(device, tuning, inputs, options, &self.options)?,
        };
        let images = shaded(device, &mut shader, surface, values, self.background)?;
        self.view = Some(shader);
        Ok(images)
    }

    /// Requests and stores estimates for images of a view under other lights.
    /// Returns false if the provider is no longer available.
    fn ask(&mut self, device: &Device, view: usize, step: u32, images: &[Image]) -> Result<bool> {
        let camera = &self.cameras[view];
        let copies = self.options.copies as usize;
        for (copy, image) in images.iter().enumerate() {
            let rendering = ProviderImage {
                image,
                encoding: Encoding::Linear,
                view: Some(camera.name.as_str()),
                camera: Some(camera),
            };
            let maps: &[&str] = if self.roughness { &["albedo", "roughness"] } else { &["albedo"] };
            let Some(helper) = &mut self.helper else { return Ok(false) };
            let Some(found) = helper.ask(|p| p.materials(&rendering, maps))? else { return Ok(false) };
            let Materials { albedo, albedo_is_linear, roughness, .. } = found;
            let counts = self.counts[view].as_ref();
            let (part, first) = self.places[view];
            let offset = 4 * u64::from(first);
            let answers = [(albedo, Material::Albedo, copy), (roughness, Material::Roughness, copies + copy)];
            for (map, kind, into) in answers {
                let (Some(map), Some(buffer)) = (map, self.estimates.get(into).and_then(|parts| parts.get(part)))
                else {
                    continue;
                };
                let encoded = kind == Material::Albedo && !albedo_is_linear;
                let words = pack(&brought(map, encoded, camera), kind, counts);
                device.upload(buffer, offset, bytemuck::cast_slice(&words))?;
            }
        }
        self.requested_at[view] = step;
        Ok(true)
    }
}

impl Intrinsic {
    /// Requests estimates of a view under other lights, if they are due.
    /// Switches L_relight off if the provider is no longer available.
    pub(super) fn estimated(&mut self, view: usize, values: &IntrinsicStepValues) -> Result<()> {
        let step = values.shaded.step;
        let Some(relit) = &self.relit else { return Ok(()) };
        // Without a region the step compares nothing.
        if values.shaded.region == 0 || !relit.is_due(view, step) {
            return Ok(());
        }
        self.finish()?;
        let images = self.relit_images(view, values)?;
        let Some(mut relit) = self.relit.take() else { return Ok(()) };
        if relit.ask(&self.device, view, step, &images)? {
            self.relit = Some(relit);
        } else {
            self.options.relight = false;
            self.execs[StepKind::Relight as usize] = None;
        }
        Ok(())
    }

    /// Returns linear images of a training view under the perturbed lights of a step.
    /// The images of a step are rendered once.
    pub(super) fn relit_images(&mut self, view: usize, values: &IntrinsicStepValues) -> Result<Vec<Image>> {
        let step = values.shaded.step;
        let Some(mut relit) = self.relit.take() else { return Ok(Vec::new()) };
        if let Some((_, images)) = relit.rendered.take().filter(|(of, _)| *of == step) {
            self.relit = Some(relit);
            return Ok(images);
        }
        let surface = self.surfaces.of_view(&self.gaussians, &self.data.views[view].0, view)?.clone();
        let inputs = self.inputs(StepKind::Plain);
        let images = relit.images(&self.device, &self.tuning, &inputs, &self.options, &surface, values)?;
        relit.rendered = Some((step, images.clone()));
        self.relit = Some(relit);
        Ok(images)
    }
}

/// Converts an answer to linear light at the size of the view.
/// Pixels that are not finite become invalid.
fn brought(mut image: Image, encoded: bool, camera: &Camera) -> MaskedMap {
    let mut valid = Image::new(image.width, image.height, 1);
    for (pixel, v) in image.data.chunks_exact_mut(image.channels as usize).zip(&mut valid.data) {
        let known = pixel.iter().all(|x| x.is_finite());
        *v = f32::from(u8::from(known));
        for x in pixel {
            *x = match (known, encoded) {
                (false, _) => 0.0,
                (true, true) => srgb_to_linear(x.clamp(0.0, 1.0)),
                (true, false) => *x,
            };
        }
    }
    let (image, valid) = resize_valid(&image, &valid, camera.width, camera.height);
    MaskedMap { image, valid }
}
