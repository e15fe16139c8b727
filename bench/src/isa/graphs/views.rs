//! Graphs of renders, views, classified images and the window.

use super::SIZE;
use sgs_engine::graph::ImageState;
use sgs_engine::{Device, ImageFormat, Location};
use sgs_passes::Tuning;
use sgs_passes::loss::Relevance;
use sgs_passes::pipeline::{Display, DisplayRoom, FeatureImage, Font, Labeler, Query, Renderer, View, ViewOptions};
use sgs_passes::scene::{Decoder, EMBEDDING, Gaussians, Model};
use sgs_passes::splat::{Channels, Encoding, Layer, Letters, Presented, TexelFormat};

/// Number of Gaussians.
const GAUSSIANS: u32 = 1000;

/// Builds all.
pub fn build(device: &Device) -> anyhow::Result<()> {
    let tuning = Tuning::for_device(device.info());
    for (normals, semantics, mip) in [(false, false, false), (true, true, false), (false, false, true)] {
        let model = Model { sh_degree: 3, normals, semantics, mip };
        let gaussians = Gaussians::new(device, model, GAUSSIANS, false)?;
        for depth in [false, true] {
            let channels = Channels { colors: true, normals, depth };
            Renderer::new(device, tuning, &gaussians, SIZE, channels)?;
            if semantics {
                Renderer::with_features(device, tuning, &gaussians, SIZE, channels)?;
            }
        }
        let layers = [Layer::Color, Layer::Depth, Layer::Alpha, Layer::Normal];
        for layer in layers.into_iter().filter(|layer| normals || *layer != Layer::Normal) {
            let format = TexelFormat::Rgba8Unorm;
            let presented = Presented { layer, format, encoding: Encoding::Display, depth_scale: 1.0 };
            let (entry, exit) = (ImageState::Undefined, ImageState::General);
            let options = ViewOptions { size: SIZE, presented, entry, exit, frames_in_flight: 1, entry_capacity: 0 };
            View::new(device, tuning, &gaussians, options)?;
        }
    }
    labels(device, tuning)?;
    let letters = Letters { cell: [8, 16], first: 32, count: 96 };
    let font = Font::new(device, letters, &vec![0; 8 * 16 * 96])?;
    Display::new(device, &font, SIZE, ImageFormat::Rgba8Unorm, DisplayRoom { columns: 80, rows: 24, marks: 64 })?;
    Ok(())
}

/// Builds the classification of pixels, with and without a query.
fn labels(device: &Device, tuning: Tuning) -> anyhow::Result<()> {
    const CHANNELS: u32 = 32;
    const CLASSES: usize = 22;
    let decoder = Decoder::new(device, 0, false)?;
    let pixels = u64::from(SIZE[0] * SIZE[1]);
    let buffer = device.buffer("features", 4 * u64::from(CHANNELS) * pixels, Location::Device)?;
    for queries in [vec![], vec![Query { class: 0, meaning: Relevance::Probability }]] {
        let mut labeler = Labeler::new(device, tuning, &vec![0.0; CLASSES * EMBEDDING], 1.0, &queries)?;
        labeler.label(&decoder, &FeatureImage { buffer: &buffer, size: SIZE, channels: CHANNELS, first: 0 })?;
    }
    Ok(())
}
