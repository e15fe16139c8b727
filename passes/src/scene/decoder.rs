//! The semantic decoder: a linear map with bias from 32 blended features to the 512-wide vectors of a pretrained network.
//!
//! A 1 x 1 convolution (SGS-Intrinsic, stage I), learned beside the Gaussians. Kept as one matrix A = [W b] of 512 rows of
//! 32 weights and a bias, so that one row is one output and one Adam pass drives it all.
//!
//! Promises: the start depends on nothing but its seed; a raised flag stops its steps as it does the Gaussians'. Leaves
//! files to the tools.

use crate::Tuning;
use crate::optim::{Adam, Rate, adam};
use crate::reference::rng::{random_bits, uniform_from};
use sgs_engine::graph::exec::Executor;
use sgs_engine::graph::{Buffer, Graph, GraphError};
use sgs_engine::{Device, DeviceBuffer, Location, Result};
use sgs_shaders::structs::Work;

/// Blended features of a pixel.
pub const FEATURES: usize = 32;

/// The same and the one that the bias is multiplied by.
pub const AUGMENTED: usize = FEATURES + 1;

/// Width of targets, of text, and of what is decoded.
pub const EMBEDDING: usize = 512;

const PARAMETER_BYTES: u64 = 4 * (EMBEDDING * AUGMENTED) as u64;

/// Epsilon of its Adam.
const EPSILON: f32 = 1e-8;

/// The decoder in device memory.
#[derive(Debug)]
pub struct Decoder {
    parameters: DeviceBuffer,
    /// First and second moments, pairs; only when training.
    moments: Option<DeviceBuffer>,
    work: DeviceBuffer,
}

/// Its buffers in one graph.
#[derive(Clone, Copy, Debug)]
pub struct DecoderHandles {
    /// `[512 * 33]` floats.
    pub parameters: Buffer,
    /// Pairs, likewise.
    pub moments: Option<Buffer>,
    /// A `Work` of 512 rows.
    pub work: Buffer,
}

impl Decoder {
    /// Makes it with a random start ([`Decoder::initial`]); `training` adds moments.
    ///
    /// # Errors
    /// If memory runs out.
    pub fn new(device: &Device, seed: u32, training: bool) -> Result<Decoder> {
        let bytes = PARAMETER_BYTES;
        let parameters = device.buffer("decoder", bytes, Location::Device)?;
        let moments =
            if training { Some(device.buffer("decoder_moments", 2 * bytes, Location::Device)?) } else { None };
        let work = device.buffer("decoder_rows", size_of::<Work>() as u64, Location::Device)?;
        let rows = Work { x: 2, y: 1, z: 1, count: EMBEDDING as u32 };
        device.upload(&work, 0, bytemuck::bytes_of(&rows))?;
        let decoder = Decoder { parameters, moments, work };
        decoder.upload(device, &Decoder::initial(seed))?;
        Ok(decoder)
    }

    /// The start: every weight and bias uniform within 1/sqrt(32) of zero, as a 1 x 1 convolution with 32 inputs starts
    /// in PyTorch. Each number is a function of the seed and its place.
    pub fn initial(seed: u32) -> Vec<f32> {
        let bound = 1.0 / (FEATURES as f64).sqrt();
        let number = |i: usize| bound * (2.0 * uniform_from(random_bits(seed, i as u32, 0x6465_636f)) - 1.0);
        (0..EMBEDDING * AUGMENTED).map(|i| number(i) as f32).collect()
    }

    /// Replaces the parameters, 512 rows of 33, and starts the optimizer afresh.
    ///
    /// # Errors
    /// If the device fails, or there are more than fit.
    pub fn upload(&self, device: &Device, parameters: &[f32]) -> Result<()> {
        device.upload(&self.parameters, 0, bytemuck::cast_slice(parameters))?;
        match &self.moments {
            Some(moments) => device.fill(moments, 0),
            None => Ok(()),
        }
    }

    /// The parameters as they are.
    ///
    /// # Errors
    /// If the device fails.
    pub fn download(&self, device: &Device) -> Result<Vec<f32>> {
        device.download_as(&self.parameters, EMBEDDING * AUGMENTED)
    }

    /// Adam's moments, pairs, for checkpoints; empty without training.
    ///
    /// # Errors
    /// If the device fails.
    pub fn download_moments(&self, device: &Device) -> Result<Vec<f32>> {
        match &self.moments {
            Some(moments) => device.download_as(moments, 2 * EMBEDDING * AUGMENTED),
            None => Ok(Vec::new()),
        }
    }

    /// Puts back what [`Decoder::download_moments`] gave.
    ///
    /// # Errors
    /// If the device fails, or there are more than fit.
    pub fn upload_moments(&self, device: &Device, moments: &[f32]) -> Result<()> {
        match &self.moments {
            Some(buffer) => device.upload(buffer, 0, bytemuck::cast_slice(moments)),
            None => Ok(()),
        }
    }

    /// Bytes of device memory.
    pub fn bytes(&self) -> u64 {
        self.parameters.bytes() + self.moments.as_ref().map_or(0, DeviceBuffer::bytes)
    }

    /// Declares the buffers in a graph; kernels may write them if `training`.
    pub fn declare(&self, g: &mut Graph, training: bool) -> DecoderHandles {
        Decoder::handles(g, training && self.moments.is_some())
    }

    /// Declares the buffers of a decoder that need not exist yet. With `training` it must have moments.
    pub fn handles(g: &mut Graph, training: bool) -> DecoderHandles {
        let bytes = PARAMETER_BYTES;
        DecoderHandles {
            parameters: if training { g.external("decoder", bytes) } else { g.input("decoder", bytes) },
            moments: training.then(|| g.external("decoder_moments", 2 * bytes)),
            work: g.input("decoder_rows", size_of::<Work>() as u64),
        }
    }

    /// Bytes that a decoder in training takes.
    pub const TRAINING_BYTES: u64 = 3 * PARAMETER_BYTES + size_of::<Work>() as u64;

    /// Puts the buffers behind their handles.
    ///
    /// # Errors
    /// If the plan was made for larger ones.
    pub fn bind(&self, exec: &mut Executor, handles: &DecoderHandles) -> Result<()> {
        exec.bind(handles.parameters, &self.parameters)?;
        if let (Some(handle), Some(moments)) = (handles.moments, &self.moments) {
            exec.bind(handle, moments)?;
        }
        exec.bind(handles.work, &self.work)
    }
}

/// Adds the pass that moves a decoder by its gradient ([`crate::loss::decoder_gradient`]): Adam with `lr_decoder` of the
/// step and epsilon 1e-8. A decoder without moments is left alone. `flags`, `skipped`: as in [`Adam`].
///
/// # Errors
/// If a buffer does not belong to the graph or is too small to be bound.
pub fn decoder_step(
    g: &mut Graph,
    tuning: Tuning,
    step: Buffer,
    decoder: &DecoderHandles,
    gradients: Buffer,
    flags: Buffer,
    skipped: Buffer,
) -> std::result::Result<(), GraphError> {
    let Some(moments) = decoder.moments else { return Ok(()) };
    let what = Adam {
        step,
        live: decoder.work,
        flags,
        flag_words: 1,
        width: AUGMENTED as u32,
        capacity: (EMBEDDING * AUGMENTED) as u64,
        rate: Rate::Decoder,
        skip_zero: false,
        epsilon: EPSILON,
        gradients,
        parameters: decoder.parameters,
        moments,
        skipped,
    };
    adam(g, tuning, "adam.decoder", &what)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_start_is_uniform_and_a_function_of_its_seed() {
        let a = Decoder::initial(1);
        assert_eq!(a, Decoder::initial(1));
        assert_ne!(a, Decoder::initial(2));
        let bound = 1.0 / 32.0_f32.sqrt();
        assert!(a.iter().all(|x| x.abs() <= bound));
        let n = a.len() as f64;
        let mean = a.iter().map(|&x| f64::from(x)).sum::<f64>() / n;
        let square = a.iter().map(|&x| f64::from(x).powi(2)).sum::<f64>() / n;
        // Of a uniform distribution: 0, and a third of the bound's square.
        assert!(mean.abs() < 3.0 * (1.0 / 96.0 / n).sqrt(), "{mean}");
        assert!((square * 96.0 - 1.0).abs() < 0.03, "{square}");
    }
}
