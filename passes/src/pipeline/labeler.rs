//! Classifies pixels by their blended features; features stay on the device, labels go to the host.
//!
//! Guarantees: equal features give equal labels and relevances. The caller decides which pixels show a surface:
//! features of an empty pixel get the class of the decoder's bias.

use super::Step;
use crate::Tuning;
use crate::loss::{Head, Relevance, SemanticLabels, semantic_labels, semantic_prepare};
use crate::scene::{Decoder, DecoderHandles, EMBEDDING};
use sgs_engine::exec::{ExecOptions, Executor};
use sgs_engine::graph::{Buffer, CompileOptions, Graph};
use sgs_engine::{Device, DeviceBuffer, Location, Result};
use std::sync::Arc;

/// Request for the relevance of one class at every pixel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Query {
    /// Class.
    pub class: u32,
    /// Definition of relevance.
    pub meaning: Relevance,
}

/// Blended features on the device.
#[derive(Clone, Copy, Debug)]
pub struct FeatureImage<'a> {
    /// `[pixels * channels]` floats, or more.
    pub buffer: &'a DeviceBuffer,
    /// Columns and rows.
    pub size: [u32; 2],
    /// Floats per pixel.
    pub channels: u32,
    /// Channel of the first of the 32 features.
    pub first: u32,
}

/// Classes of the pixels of an image.
#[derive(Clone, Debug, PartialEq)]
pub struct LabelMap {
    /// Class of each pixel; [`crate::loss::NO_LABEL`] if the pixel's features are not finite.
    pub labels: Vec<u32>,
    /// Relevance of each pixel, by query.
    pub relevance: Vec<Vec<f32>>,
}

/// Classifier of images, reusable; it is rebuilt if the layout of the feature buffer changes.
pub struct Labeler {
    device: Device,
    tuning: Tuning,
    embeddings: DeviceBuffer,
    classes: u32,
    /// Divisor of the logits before the softmax.
    temperature: f32,
    queries: Vec<Query>,
    state: Option<State>,
}

struct State {
    exec: Executor,
    step: Buffer,
    decoder: DecoderHandles,
    image: Buffer,
    labels: DeviceBuffer,
    relevance: Vec<DeviceBuffer>,
    /// Bytes of the feature buffer, floats per pixel, first feature channel.
    made_for: (u64, u32, u32),
}

impl Labeler {
    /// Prepares a classifier for these classes.
    ///
    /// `embeddings`: rows of 512 floats, each of length one.
    ///
    /// # Errors
    /// If memory runs out.
    pub fn new(
        device: &Device,
        tuning: Tuning,
        embeddings: &[f32],
        temperature: f32,
        queries: &[Query],
    ) -> Result<Labeler> {
        let buffer = device.buffer("text_embeddings", 4 * embeddings.len().max(1) as u64, Location::Device)?;
        device.upload(&buffer, 0, bytemuck::cast_slice(embeddings))?;
        Ok(Labeler {
            device: device.clone(),
            tuning,
            embeddings: buffer,
            classes: (embeddings.len() / EMBEDDING) as u32,
            temperature,
            queries: queries.to_vec(),
            state: None,
        })
    }

    /// Classifies the pixels of an image (waits for the device).
    ///
    /// # Errors
    /// If memory runs out or the device fails.
    pub fn label(&mut self, decoder: &Decoder, image: &FeatureImage<'_>) -> Result<LabelMap> {
        let kind = (image.buffer.bytes(), image.channels, image.first);
        let mut state = match self.state.take().filter(|s| s.made_for == kind) {
            Some(state) => state,
            None => self.build(decoder, image)?,
        };
        decoder.bind(&mut state.exec, &state.decoder)?;
        state.exec.bind(state.image, image.buffer)?;
        let mut step = Step { inverse_temperature: 1.0 / self.temperature, ..Default::default() };
        step.camera.size = image.size;
        state.exec.submit(&[(state.step, bytemuck::bytes_of(&step))])?;
        state.exec.finish()?;
        let pixels = image.size[0] as usize * image.size[1] as usize;
        let labels = self.device.download_as(&state.labels, pixels)?;
        let relevance = state.relevance.iter().map(|r| self.device.download_as(r, pixels)).collect::<Result<_>>()?;
        self.state = Some(state);
        Ok(LabelMap { labels, relevance })
    }

    fn build(&self, decoder: &Decoder, what: &FeatureImage<'_>) -> Result<State> {
        let mut g = Graph::new("labels");
        let bytes = what.buffer.bytes();
        let pixels = (bytes / (4 * u64::from(what.channels))).max(1);
        let step = g.uniform("step", size_of::<Step>() as u64);
        let handles = decoder.declare(&mut g, false);
        let embeddings = g.input("text_embeddings", self.embeddings.bytes());
        let image = g.input("image", bytes);
        let head = Head { decoder: handles.parameters, embeddings, classes: self.classes };
        let prepared = semantic_prepare(&mut g, self.tuning, &head)?;
        let labels = g.external("labels", 4 * pixels);
        // The kernel needs a query. Without one, a placeholder writes its relevance to a transient buffer.
        let unasked = [Query { class: 0, meaning: Relevance::Cosine }];
        let queries = if self.queries.is_empty() { &unasked[..] } else { &self.queries };
        let mut relevance = Vec::new();
        for (i, query) in queries.iter().enumerate() {
            let answer = match self.queries.is_empty() {
                true => g.transient("relevance", 4 * pixels),
                false => g.external(format!("relevance.{i}"), 4 * pixels),
            };
            let what = SemanticLabels {
                step,
                image,
                channels: what.channels,
                first: what.first,
                largest: [u32::try_from(pixels).unwrap_or(u32::MAX), 1],
                classes: self.classes,
                query: query.class,
                meaning: query.meaning,
            };
            let into = if i == 0 { labels } else { g.transient(format!("labels.{i}"), 4 * pixels) };
            semantic_labels(&mut g, &what, &prepared, into, answer)?;
            relevance.push(answer);
        }
        relevance.truncate(self.queries.len());
        let plan = Arc::new(g.compile(&CompileOptions::default())?);
        let mut exec = Executor::new(&self.device, plan, ExecOptions { frames_in_flight: 1, ..Default::default() })?;
        let memory = |name: &str| self.device.buffer(name, 4 * pixels, Location::Device);
        let label_memory = memory("labels")?;
        exec.bind(embeddings, &self.embeddings)?;
        exec.bind(labels, &label_memory)?;
        let mut answers = Vec::new();
        for handle in relevance {
            let answer = memory("relevance")?;
            exec.bind(handle, &answer)?;
            answers.push(answer);
        }
        let made_for = (bytes, what.channels, what.first);
        Ok(State { exec, step, decoder: handles, image, labels: label_memory, relevance: answers, made_for })
    }
}
