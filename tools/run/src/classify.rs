//! Classification of rendered views by the semantic head of a run.
//!
//! Guarantees: pixels with less than 0.5 opacity have no class, whatever the decoder returns.

use crate::error::{Result, RunError};
use crate::head::SemanticHead;
use sgs_engine::Device;
use sgs_passes::Tuning;
use sgs_passes::loss::{NO_LABEL, Relevance, normalize_embeddings};
use sgs_passes::pipeline::{FeatureImage, Labeler, Query, RenderedImage, Renderer};
use sgs_passes::scene::{Decoder, FEATURES};

/// Relevance of pixels that show nothing.
pub const NO_RELEVANCE: f32 = -1.0;

/// Maximum transmittance of a pixel that has a class.
const MOST_TRANSMITTANCE: f32 = 0.5;

/// Semantic classes of a view.
#[derive(Clone, Debug, PartialEq)]
pub struct Classes {
    /// Index of the class in the head's list for each pixel; `None` where the view shows nothing.
    pub labels: Vec<Option<u32>>,
    /// Softmax probability for each queried class and pixel.
    ///
    /// [`NO_RELEVANCE`] where the view shows nothing.
    pub relevance: Vec<Vec<f32>>,
}

/// Classifier of views on a device.
pub struct Classifier {
    decoder: Decoder,
    labeler: Labeler,
}

impl Classifier {
    /// Creates a classifier for a head.
    ///
    /// Also computes the relevance of each class in `queries`, given as indices.
    ///
    /// # Errors
    /// If a class does not exist or memory runs out.
    pub fn new(device: &Device, head: &SemanticHead, queries: &[usize]) -> Result<Classifier> {
        let classes = head.text.labels.len();
        if let Some(query) = queries.iter().find(|q| **q >= classes) {
            return Err(RunError::Refused(format!("There is no class {query}: there are {classes}.")));
        }
        let decoder = Decoder::new(device, 0, false)?;
        decoder.upload(device, &head.decoder)?;
        let text = normalize_embeddings(&head.text.data);
        let query = |class: &usize| Query { class: *class as u32, meaning: Relevance::Probability };
        let queries: Vec<Query> = queries.iter().map(query).collect();
        let tuning = Tuning::for_device(device.info());
        let labeler = Labeler::new(device, tuning, &text, head.temperature, &queries)?;
        Ok(Classifier { decoder, labeler })
    }

    /// Classifies the image that `renderer` rendered last. The renderer must blend features.
    ///
    /// # Errors
    /// If the renderer does not blend features, memory runs out, or the device fails.
    pub fn classify(&mut self, renderer: &Renderer, rendered: &RenderedImage) -> Result<Classes> {
        let Some(buffer) = renderer.features() else {
            return Err(RunError::Refused("The image has no semantic features to classify.".into()));
        };
        let image = FeatureImage { buffer, size: rendered.size, channels: FEATURES as u32, first: 0 };
        let mut map = self.labeler.label(&self.decoder, &image)?;
        let shows = |i: usize| rendered.transmittance[i] <= MOST_TRANSMITTANCE && map.labels[i] != NO_LABEL;
        for relevance in &mut map.relevance {
            relevance.iter_mut().enumerate().filter(|(i, _)| !shows(*i)).for_each(|(_, r)| *r = NO_RELEVANCE);
        }
        let labels = map.labels.iter().enumerate().map(|(i, label)| shows(i).then_some(*label)).collect();
        Ok(Classes { labels, relevance: map.relevance })
    }
}
