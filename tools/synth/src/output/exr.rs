//! OpenEXR files in the usual form: scan lines, ZIP, channels R G B or a single Y.

use std::path::Path;

use exr::prelude::{
    AnyChannel, AnyChannels, Blocks, Compression, Encoding, FlatSamples, Image, Layer, LayerAttributes, LineOrder,
    WritableImage,
};
use glam::Vec3;
use half::f16;

use crate::error::SynthError;

const ENCODING: Encoding =
    Encoding { compression: Compression::ZIP16, blocks: Blocks::ScanLines, line_order: LineOrder::Increasing };

/// Writes three half-precision channels.
pub(crate) fn rgb(path: &Path, width: usize, height: usize, map: &[Vec3]) -> Result<(), SynthError> {
    let plane = |channel: usize| FlatSamples::F16(map.iter().map(|c| f16::from_f32(c[channel])).collect());
    let planes = [("R", plane(0)), ("G", plane(1)), ("B", plane(2))];
    write(path, width, height, planes)
}

/// Writes one half-precision channel.
pub(crate) fn half(path: &Path, width: usize, height: usize, map: &[f32]) -> Result<(), SynthError> {
    let samples = FlatSamples::F16(map.iter().map(|v| f16::from_f32(*v)).collect());
    write(path, width, height, [("Y", samples)])
}

/// Writes one single-precision channel.
pub(crate) fn single(path: &Path, width: usize, height: usize, map: &[f32]) -> Result<(), SynthError> {
    write(path, width, height, [("Y", FlatSamples::F32(map.to_vec()))])
}

fn write<const N: usize>(
    path: &Path,
    width: usize,
    height: usize,
    planes: [(&'static str, FlatSamples); N],
) -> Result<(), SynthError> {
    let channels = planes.into_iter().map(|(name, samples)| AnyChannel::new(name, samples));
    let layer =
        Layer::new((width, height), LayerAttributes::default(), ENCODING, AnyChannels::sort(channels.collect()));
    Image::from_layer(layer).write().non_parallel().to_file(path).map_err(|e| SynthError::encode(path, e))
}
