//! Images that the intrinsic stage shows to providers, and their answers.

use super::consistency::{Consistency, StepKind};
use super::{Intrinsic, IntrinsicStepValues};
use crate::error::Result;
use crate::region_provider::{FRAMES, Frames};
use sgs_engine::Device;
use sgs_passes::pipeline::{RelitView, Surface};
use sgs_scene::{Camera, Image, linear_to_srgb, srgb_to_linear};

/// Shades a view over the background. Returns linear images, one per set of lights.
pub(super) fn shaded(
    device: &Device,
    shader: &mut RelitView,
    surface: &Surface,
    values: &IntrinsicStepValues,
    background: [f32; 3],
) -> Result<Vec<Image>> {
    let [width, height] = values.shaded.camera.size;
    let lights = shader.shade(device, surface, values)?;
    let [_, _, coverage] = surface.download(device)?;
    let behind = background.map(srgb_to_linear);
    let composed = |light: &Vec<f32>| {
        let over = |(p, covered): (&[f32], &f32)| -> [f32; 3] {
            std::array::from_fn(|i| {
                let light = if p[i].is_finite() { p[i] } else { 0.0 };
                covered * light + (1.0 - covered) * behind[i]
            })
        };
        let data = light.chunks_exact(3).zip(&coverage).flat_map(over).collect();
        Image { width, height, channels: 3, data }
    };
    Ok(lights.iter().map(composed).collect())
}

/// Converts a linear image to a display-referred one.
fn displayed(mut image: Image) -> Image {
    image.data.iter_mut().for_each(|v| *v = linear_to_srgb(v.clamp(0.0, 1.0)));
    image
}

impl Intrinsic {
    /// Chooses what a step compares, and queries the providers.
    /// Returns false if the step can compare nothing because a provider is no longer available.
    pub(super) fn choose(&mut self, kind: StepKind, view: usize, values: &mut IntrinsicStepValues) -> Result<bool> {
        let Some(mut consistency) = self.consistency.take() else { return Ok(false) };
        consistency.fill(self.required.seed, view, values);
        let there = !consistency.queries_provider() || self.ask_masks(&mut consistency, kind, view, values)?;
        self.consistency = there.then_some(consistency);
        if there && kind == StepKind::Relight {
            self.estimated(view, values)?;
        }
        Ok(there && (kind != StepKind::Relight || self.options.relight || self.options.own_prior))
    }

    /// Shows a provider of masks the shaded frames of a step.
    /// The frames use the parameters before the step.
    fn ask_masks(
        &mut self,
        consistency: &mut Consistency,
        kind: StepKind,
        view: usize,
        values: &mut IntrinsicStepValues,
    ) -> Result<bool> {
        self.finish()?;
        let seed = self.required.seed;
        let others = consistency.pseudo_cameras(seed, view, values.shaded.step);
        let trained = consistency.camera(view).clone();
        let images = match self.frames_of(kind, view, values) {
            Err(error) if error.is_out_of_memory() => {
                tracing::warn!(
                    "There is no memory to show a network what it is asked about: regions are not compared any more."
                );
                return Ok(false);
            }
            other => other?,
        };
        let [first, last] = &others;
        // Under other lights all frames show the training view; the first mask counts, as published.
        let (cameras, views, counts): ([&Camera; FRAMES], _, _) = match kind {
            StepKind::CrossView => ([first, &trained, last], [false, true, false], 1),
            _ => ([&trained; FRAMES], [true; FRAMES], 0),
        };
        consistency.ask(&self.device, &Frames { images: &images, cameras, views }, counts, seed, values)
    }

    /// Returns the frames of a step.
    /// A cross-view step has a pseudo-view, the training view and the other pseudo-view. A relight step has the
    /// training view under other lights, under the current lights, and under other lights again.
    fn frames_of(&mut self, kind: StepKind, view: usize, values: &IntrinsicStepValues) -> Result<[Image; FRAMES]> {
        let relit = match (kind, &mut self.relit) {
            (StepKind::Relight, Some(_)) => self.relit_images(view, values)?,
            _ => Vec::new(),
        };
        if self.shown.is_none() {
            let inputs = self.inputs(StepKind::Plain);
            self.shown = Some(RelitView::new(&self.device, &self.tuning, &inputs, &self.options, &Consistency::SHOWN)?);
        }
        let (device, background) = (&self.device, self.required.geometry.background);
        let Some(shader) = &mut self.shown else { return Ok(Default::default()) };
        let mut of = |surface: &Surface, values: &IntrinsicStepValues| -> Result<Image> {
            let mut images = shaded(device, shader, surface, values, background)?;
            Ok(displayed(images.swap_remove(0)))
        };
        let camera = &self.data.views[view].0;
        let as_it_is = of(self.surfaces.of_view(&self.gaussians, camera, view)?, values)?;
        if kind != StepKind::CrossView {
            let under =
                |i: usize| relit.get(i).or(relit.first()).map_or_else(|| as_it_is.clone(), |r| displayed(r.clone()));
            let (first, last) = (under(0), under(1));
            return Ok([first, as_it_is, last]);
        }
        let mut pseudo = |i: usize| -> Result<Image> {
            let mut other = *values;
            other.shaded.camera = values.pseudo[i].camera;
            let [width, height] = other.shaded.camera.size;
            other.field.pixels = width * height;
            of(self.surfaces.other(&self.gaussians, &other.shaded.camera, i)?, &other)
        };
        let (first, last) = (pseudo(0)?, pseudo(1)?);
        Ok([first, as_it_is, last])
    }
}
