//! From a picture's features to its classes, on the host.

use super::{Picture, Step};
use crate::Tuning;
use crate::loss::{Head, Relevance, SemanticLabels, semantic_labels, semantic_prepare};
use crate::scene::{Decoder, DecoderHandles, EMBEDDING};
use sgs_engine::graph::exec::{ExecOptions, Executor};
use sgs_engine::graph::{Buffer, CompileOptions, Graph};
use sgs_engine::{Device, DeviceBuffer, Location, Result};
use std::sync::Arc;

/// What is asked of every picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Query {
    /// The class whose relevance is wanted.
    pub class: u32,
    /// What relevance is.
    pub meaning: Relevance,
    /// Logits are divided by it before the softmax.
    pub temperature: f32,
}

/// The classes of a picture.
#[derive(Clone, Debug, PartialEq)]
pub struct LabelMap {
    /// Class of each pixel; [`crate::loss::NO_LABEL`] where its features are not finite.
    pub labels: Vec<u32>,
    /// How much each pixel has of the queried class.
    pub relevance: Vec<f32>,
}

/// Classifies pictures of one kind, of any size up to the first one's number of pixels; larger ones rebuild it.
pub struct Labeler {
    device: Device,
    tuning: Tuning,
    embeddings: DeviceBuffer,
    classes: u32,
    query: Query,
    state: Option<State>,
}

struct State {
    exec: Executor,
    step: Buffer,
    decoder: DecoderHandles,
    image: DeviceBuffer,
    labels: DeviceBuffer,
    relevance: DeviceBuffer,
    /// Pixels, floats of a pixel, first feature.
    made_for: (usize, u32, u32),
}

impl Labeler {
    /// For these classes: rows of 512, each of length one.
    ///
    /// # Errors
    /// If memory runs out.
    pub fn new(device: &Device, tuning: Tuning, embeddings: &[f32], query: Query) -> Result<Labeler> {
        let buffer = device.buffer("text_embeddings", 4 * embeddings.len().max(1) as u64, Location::Device)?;
        device.upload(&buffer, 0, bytemuck::cast_slice(embeddings))?;
        let classes = (embeddings.len() / EMBEDDING) as u32;
        Ok(Labeler { device: device.clone(), tuning, embeddings: buffer, classes, query, state: None })
    }

    /// Classifies a picture whose features begin at channel `first`.
    ///
    /// # Errors
    /// If memory runs out or the device fails.
    pub fn label(&mut self, decoder: &Decoder, picture: &Picture, first: u32) -> Result<LabelMap> {
        let pixels = picture.size[0] as usize * picture.size[1] as usize;
        let fits = |s: &State| s.made_for.0 >= pixels && (s.made_for.1, s.made_for.2) == (picture.channels, first);
        let mut state = match self.state.take().filter(fits) {
            Some(state) => state,
            None => self.build(decoder, pixels, picture.channels, first)?,
        };
        decoder.bind(&mut state.exec, &state.decoder)?;
        self.device.upload(&state.image, 0, bytemuck::cast_slice(&picture.image))?;
        let mut step = Step { inverse_temperature: 1.0 / self.query.temperature, ..Default::default() };
        step.camera.size = picture.size;
        state.exec.submit(&[(state.step, bytemuck::bytes_of(&step))])?;
        state.exec.finish()?;
        let labels = self.device.download_as(&state.labels, pixels)?;
        let relevance = self.device.download_as(&state.relevance, pixels)?;
        self.state = Some(state);
        Ok(LabelMap { labels, relevance })
    }

    fn build(&self, decoder: &Decoder, pixels: usize, channels: u32, first: u32) -> Result<State> {
        let mut g = Graph::new("labels");
        let words = 4 * pixels.max(1) as u64;
        let step = g.uniform("step", size_of::<Step>() as u64);
        let handles = decoder.declare(&mut g, false);
        let embeddings = g.input("text_embeddings", self.embeddings.bytes());
        let image = g.input("image", words * u64::from(channels));
        let (labels, relevance) = (g.external("labels", words), g.external("relevance", words));
        let head = Head { decoder: handles.parameters, embeddings, classes: self.classes };
        let prepared = semantic_prepare(&mut g, self.tuning, &head)?;
        let what = SemanticLabels {
            step,
            image,
            channels,
            first,
            largest: [pixels.max(1) as u32, 1],
            classes: self.classes,
            query: self.query.class,
            meaning: self.query.meaning,
        };
        semantic_labels(&mut g, &what, &prepared, labels, relevance)?;
        let plan = Arc::new(g.compile(&CompileOptions::default())?);
        let mut exec = Executor::new(&self.device, plan, ExecOptions { frames_in_flight: 1, ..Default::default() })?;
        let memory = |name: &str, bytes: u64| self.device.buffer(name, bytes, Location::Device);
        let state_image = memory("labeled_image", words * u64::from(channels))?;
        let (state_labels, state_relevance) = (memory("labels", words)?, memory("relevance", words)?);
        exec.bind(embeddings, &self.embeddings)?;
        exec.bind(image, &state_image)?;
        exec.bind(labels, &state_labels)?;
        exec.bind(relevance, &state_relevance)?;
        Ok(State {
            exec,
            step,
            decoder: handles,
            image: state_image,
            labels: state_labels,
            relevance: state_relevance,
            made_for: (pixels, channels, first),
        })
    }
}
