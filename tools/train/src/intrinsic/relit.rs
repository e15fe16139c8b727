//! Albedo under other lights from a network: a training view is rendered with its lights moved, dimmed and switched off at
//! random, and a provider of materials says what it is made of (SGS-Intrinsic, stage II: RGB→X).
//!
//! Promises: what is asked is a function of the parameters before the step, the seed and the step; an answer serves until it is
//! too old, and goes into checkpoints. Asking waits for the steps before. What the provider does not know is compared with
//! nothing.

use super::Intrinsic;
use super::consistency::StepKind;
use super::data::{Material, pack};
use super::frames::shaded;
use crate::error::{Result, TrainError};
use rayon::prelude::*;
use sgs_config::Settings;
use sgs_engine::{Device, DeviceBuffer, Location};
use sgs_passes::Tuning;
use sgs_passes::pipeline::{
    COPIES, IntrinsicInputs, IntrinsicOptions, IntrinsicStepValues, RelitOptions, RelitView, Surface,
};
use sgs_provider::{Encoding, Helper, Materials, Picture, ProviderOptions};
use sgs_scene::{Camera, Image, MaskedMap, Scene, resize_valid, srgb_to_linear};

/// A provider of materials, and what it has said of each training view.
pub(super) struct Relit {
    /// None where training is only planned.
    helper: Option<Helper>,
    view: Option<RelitView>,
    options: RelitOptions,
    /// Whether it is asked for roughness too.
    roughness: bool,
    every: u32,
    background: [f32; 3],
    /// Training views, which pixels of each count, and where its pixels begin.
    cameras: Vec<Camera>,
    counts: Vec<Option<Image>>,
    first: Vec<u32>,
    /// Albedo of each copy, then roughness, packed as priors are.
    pub estimates: Vec<DeviceBuffer>,
    /// The step at which each view was asked about; 0 is never.
    pub asked_at: Vec<u32>,
    /// Images of the step that they were last rendered for.
    rendered: Option<(u32, Vec<Image>)>,
}

impl Relit {
    /// How many estimates there are of each view.
    pub fn count(settings: &Settings) -> usize {
        let r = &settings.intrinsic.relight;
        r.copies as usize * if r.roughness > 0.0 { 2 } else { 1 }
    }

    /// Copies and distances, for lights that started in a box.
    pub fn options(settings: &Settings, bounds: &[[f32; 3]; 2]) -> RelitOptions {
        // The published unit is that of a box of side 3.
        let spacing = (0..3).map(|i| bounds[1][i] - bounds[0][i]).fold(0.0, f32::max) / 3.0;
        RelitOptions { as_is: false, copies: settings.intrinsic.relight.copies, spacing }
    }

    /// Starts the provider; none if it fails and training may go on without.
    pub fn helper(settings: &Settings, command: &str) -> Result<Option<Helper>> {
        let s = &settings.provider;
        let options = ProviderOptions {
            command: command.to_owned(),
            start_seconds: s.start_seconds,
            answer_seconds: s.answer_seconds,
            ..ProviderOptions::default()
        };
        let mut helper = Helper::start(&options, s.on_failure)?;
        let roughness = settings.intrinsic.relight.roughness > 0.0;
        // What it cannot answer is said before training, not in the middle of it.
        let offers = helper.ask(|p| {
            let maps = p.about().offers.get("materials").map(|o| o.maps.clone());
            Ok((maps, p.about().list()))
        })?;
        let wanted: &[&str] = if roughness { &["albedo", "roughness"] } else { &["albedo"] };
        match offers {
            None => return Ok(None),
            Some((None, list)) => {
                return Err(TrainError::Setting(format!(
                    "The provider of intrinsic.relight.provider answers no questions about materials, but about {list}; \
                     choose another, or \"own\"."
                )));
            }
            Some((Some(maps), _)) => {
                if let Some(missing) = wanted.iter().find(|w| !maps.iter().any(|m| m == *w)) {
                    let maps = if maps.is_empty() { "no map at all".to_owned() } else { maps.join(", ") };
                    return Err(TrainError::Setting(format!(
                        "The provider of intrinsic.relight.provider knows no {missing} of an image, but {maps}; choose \
                         another, or \"own\"."
                    )));
                }
            }
        }
        Ok(Some(helper))
    }

    /// Room for what a provider says. `pixels`: of all training views.
    pub fn new(
        device: &Device,
        scene: &Scene,
        settings: &Settings,
        helper: Option<Helper>,
        bounds: &[[f32; 3]; 2],
        first: Vec<u32>,
        pixels: u64,
    ) -> Result<Relit> {
        let roughness = settings.intrinsic.relight.roughness > 0.0;
        let train = &scene.split.train;
        let counts = train.par_iter().map(|&i| Ok(scene.load_mask(i)?)).collect::<Result<Vec<_>>>()?;
        let make = |_| {
            let buffer = device.buffer("relit_estimates", 4 * pixels.max(1), Location::Device)?;
            device.fill(&buffer, 0)?;
            Ok(buffer)
        };
        Ok(Relit {
            helper,
            view: None,
            options: Relit::options(settings, bounds),
            roughness,
            every: settings.intrinsic.relight.every,
            background: settings.geometry.background,
            cameras: train.iter().map(|&i| scene.views[i].camera.clone()).collect(),
            counts,
            first,
            estimates: (0..Relit::count(settings)).map(make).collect::<Result<_>>()?,
            asked_at: vec![0; train.len()],
            rendered: None,
        })
    }

    /// The estimates as a step is bound to them.
    pub fn bound(&self) -> [Option<&DeviceBuffer>; 2 * COPIES] {
        let copies = self.options.copies as usize;
        std::array::from_fn(|i| match (i < COPIES, i % COPIES) {
            (true, copy) => self.estimates[..copies].get(copy),
            (false, copy) => self.estimates[copies..].get(copy),
        })
    }

    /// Whether a view has to be asked about before a step.
    pub fn is_due(&self, view: usize, step: u32) -> bool {
        let before = self.asked_at[view];
        before == 0 || step.saturating_sub(before) >= self.every
    }

    /// Renders a view under other lights. Nothing may be in flight.
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

    /// Asks about images of a view under other lights, and keeps the answers. False if there is nobody to ask any more.
    fn ask(&mut self, device: &Device, view: usize, step: u32, images: &[Image]) -> Result<bool> {
        let camera = &self.cameras[view];
        let copies = self.options.copies as usize;
        for (copy, image) in images.iter().enumerate() {
            let picture =
                Picture { image, encoding: Encoding::Linear, view: Some(camera.name.as_str()), camera: Some(camera) };
            let maps: &[&str] = if self.roughness { &["albedo", "roughness"] } else { &["albedo"] };
            let Some(helper) = &mut self.helper else { return Ok(false) };
            let Some(found) = helper.ask(|p| p.materials(&picture, maps))? else { return Ok(false) };
            let Materials { albedo, albedo_is_linear, roughness, .. } = found;
            let counts = self.counts[view].as_ref();
            let offset = 4 * u64::from(self.first[view]);
            let told = [(albedo, Material::Albedo, copy), (roughness, Material::Roughness, copies + copy)];
            for (map, kind, into) in told {
                let (Some(map), Some(buffer)) = (map, self.estimates.get(into)) else { continue };
                let encoded = kind == Material::Albedo && !albedo_is_linear;
                let words = pack(&brought(map, encoded, camera), kind, counts);
                device.upload(buffer, offset, bytemuck::cast_slice(&words))?;
            }
        }
        self.asked_at[view] = step;
        Ok(true)
    }
}

impl Intrinsic {
    /// Asks what a view is made of under other lights, if that is due. L_relight ends where there is nobody to ask any more.
    pub(super) fn estimated(&mut self, view: usize, values: &IntrinsicStepValues) -> Result<()> {
        let step = values.shaded.step;
        let Some(relit) = &self.relit else { return Ok(()) };
        // Without a region there is nothing to compare.
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

    /// A training view under the perturbed lights of a step: linear images. Renders them once a step.
    pub(super) fn relit_images(&mut self, view: usize, values: &IntrinsicStepValues) -> Result<Vec<Image>> {
        let step = values.shaded.step;
        let Some(mut relit) = self.relit.take() else { return Ok(Vec::new()) };
        if let Some((_, images)) = relit.rendered.take().filter(|(of, _)| *of == step) {
            self.relit = Some(relit);
            return Ok(images);
        }
        let surface = self.surfaces.kept(&self.gaussians, &self.data.views[view].0, view)?.clone();
        let inputs = self.inputs(StepKind::Plain);
        let images = relit.images(&self.device, &self.tuning, &inputs, &self.options, &surface, values)?;
        relit.rendered = Some((step, images.clone()));
        self.relit = Some(relit);
        Ok(images)
    }
}

/// An answer in linear light, at the size of the view, without what is no number.
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
