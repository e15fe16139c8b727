//! Semantic decoder: a linear map with bias from 32 blended features to 512-wide embeddings.
//!
//! It is a 1 x 1 convolution (SGS-Intrinsic, stage I), trained with the Gaussians; the embeddings are those of a
//! pretrained network. It is stored as one matrix A = [W b] of 512 rows, each of 32 weights and a bias. One row is one
//! output, and one Adam pass updates all.
//!
//! Guarantees: initial parameters depend only on the seed. A raised flag stops its steps as it does those of the
//! Gaussians. The tools read and write files.

use crate::rng::{random_bits, uniform_from};
use sgs_engine::exec::Executor;
use sgs_engine::graph::{Buffer, Graph};
use sgs_engine::{Device, DeviceBuffer, Location, Result};
use sgs_shaders::structs::Work;

/// Number of blended features per pixel.
pub const FEATURES: usize = 32;

/// Number of features plus the constant 1 that multiplies the bias.
pub const AUGMENTED: usize = FEATURES + 1;

/// Width of targets, text embeddings and decoded vectors.
pub const EMBEDDING: usize = 512;

const PARAMETER_BYTES: u64 = 4 * (EMBEDDING * AUGMENTED) as u64;

/// Decoder in device memory.
#[derive(Debug)]
pub struct Decoder {
    parameters: DeviceBuffer,
    /// Pairs of first and second moments; only for training.
    moments: Option<DeviceBuffer>,
    work: DeviceBuffer,
}

/// Buffers of a decoder in one graph.
#[derive(Clone, Copy, Debug)]
pub struct DecoderHandles {
    /// `[512 * 33]` floats.
    pub parameters: Buffer,
    /// `[512 * 33]` pairs of moments.
    pub moments: Option<Buffer>,
    /// A `Work` of 512 rows.
    pub work: Buffer,
}

impl Decoder {
    /// Creates a decoder with random parameters ([`Decoder::initial`]). `training` adds moments.
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

    /// Returns the initial parameters. Every weight and bias is uniform within 1/sqrt(32) of zero, as in PyTorch for a
    /// 1 x 1 convolution with 32 inputs. Each value is a function of the seed and its index.
    pub fn initial(seed: u32) -> Vec<f32> {
        let bound = 1.0 / (FEATURES as f64).sqrt();
        let number = |i: usize| bound * (2.0 * uniform_from(random_bits(seed, i as u32, 0x6465_636f)) - 1.0);
        (0..EMBEDDING * AUGMENTED).map(|i| number(i) as f32).collect()
    }

    /// Replaces the parameters, 512 rows of 33, and resets the optimizer.
    ///
    /// # Errors
    /// If the device fails, or there are more parameters than fit.
    pub fn upload(&self, device: &Device, parameters: &[f32]) -> Result<()> {
        device.upload(&self.parameters, 0, bytemuck::cast_slice(parameters))?;
        match &self.moments {
            Some(moments) => device.fill(moments, 0),
            None => Ok(()),
        }
    }

    /// Returns the current parameters.
    ///
    /// # Errors
    /// If the device fails.
    pub fn download(&self, device: &Device) -> Result<Vec<f32>> {
        device.download_as(&self.parameters, EMBEDDING * AUGMENTED)
    }

    /// Returns Adam's moments as pairs, for checkpoints. Empty without training.
    ///
    /// # Errors
    /// If the device fails.
    pub fn download_moments(&self, device: &Device) -> Result<Vec<f32>> {
        match &self.moments {
            Some(moments) => device.download_as(moments, 2 * EMBEDDING * AUGMENTED),
            None => Ok(Vec::new()),
        }
    }

    /// Restores moments from [`Decoder::download_moments`].
    ///
    /// # Errors
    /// If the device fails, or there are more moments than fit.
    pub fn upload_moments(&self, device: &Device, moments: &[f32]) -> Result<()> {
        match &self.moments {
            Some(buffer) => device.upload(buffer, 0, bytemuck::cast_slice(moments)),
            None => Ok(()),
        }
    }

    /// Returns the bytes of device memory for parameters and moments.
    pub fn bytes(&self) -> u64 {
        self.parameters.bytes() + self.moments.as_ref().map_or(0, DeviceBuffer::bytes)
    }

    /// Declares the buffers in a graph. Kernels may write them if `training`.
    pub fn declare(&self, g: &mut Graph, training: bool) -> DecoderHandles {
        Decoder::handles(g, training && self.moments.is_some())
    }

    /// Declares the buffers of a decoder that need not exist yet. With `training` the decoder must have moments.
    pub fn handles(g: &mut Graph, training: bool) -> DecoderHandles {
        let bytes = PARAMETER_BYTES;
        DecoderHandles {
            parameters: if training { g.external("decoder", bytes) } else { g.input("decoder", bytes) },
            moments: training.then(|| g.external("decoder_moments", 2 * bytes)),
            work: g.input("decoder_rows", size_of::<Work>() as u64),
        }
    }

    /// Bytes of device memory of a decoder in training.
    pub const TRAINING_BYTES: u64 = 3 * PARAMETER_BYTES + size_of::<Work>() as u64;

    /// Binds the buffers to their handles.
    ///
    /// # Errors
    /// If the plan was compiled for larger buffers.
    pub fn bind(&self, exec: &mut Executor, handles: &DecoderHandles) -> Result<()> {
        exec.bind(handles.parameters, &self.parameters)?;
        if let (Some(handle), Some(moments)) = (handles.moments, &self.moments) {
            exec.bind(handle, moments)?;
        }
        exec.bind(handles.work, &self.work)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn initial_parameters_are_uniform_and_depend_on_seed() {
        let a = Decoder::initial(1);
        assert_eq!(a, Decoder::initial(1));
        assert_ne!(a, Decoder::initial(2));
        let bound = 1.0 / 32.0_f32.sqrt();
        assert!(a.iter().all(|x| x.abs() <= bound));
        let n = a.len() as f64;
        let mean = a.iter().map(|&x| f64::from(x)).sum::<f64>() / n;
        let square = a.iter().map(|&x| f64::from(x).powi(2)).sum::<f64>() / n;
        // Uniform distribution: mean 0, mean square a third of the squared bound.
        assert!(mean.abs() < 3.0 * (1.0 / 96.0 / n).sqrt(), "{mean}");
        assert!((square * 96.0 - 1.0).abs() < 0.03, "{square}");
    }
}
