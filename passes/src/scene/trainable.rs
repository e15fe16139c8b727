//! Flat array of parameters that Adam updates: materials, lights, texels, network weights.
//!
//! Guarantees: a raised flag stops its steps as it does those of the Gaussians. The caller computes gradients.

use sgs_engine::exec::Executor;
use sgs_engine::graph::{Buffer, Graph};
use sgs_engine::{Device, DeviceBuffer, Location, Result};
use sgs_shaders::structs::Work;

/// Parameters in device memory.
#[derive(Debug)]
pub struct Trainable {
    name: &'static str,
    floats: u32,
    parameters: DeviceBuffer,
    /// Pairs of first and second moments; only for training.
    moments: Option<DeviceBuffer>,
    work: DeviceBuffer,
}

/// Buffers of a parameter array in one graph.
#[derive(Clone, Copy, Debug)]
pub struct TrainableHandles {
    pub(crate) name: &'static str,
    pub(crate) floats: u32,
    /// Parameters.
    pub parameters: Buffer,
    /// Pairs of moments, and a `Work` of one row per value; only for training.
    pub(crate) moments: Option<Buffer>,
    pub(crate) work: Option<Buffer>,
}

impl Trainable {
    /// Creates an array with initial values; `training` adds moments. An empty array takes one word, the smallest
    /// binding.
    ///
    /// # Errors
    /// If memory runs out.
    pub fn new(device: &Device, name: &'static str, start: &[f32], training: bool) -> Result<Trainable> {
        let floats = start.len() as u32;
        let bytes = 4 * u64::from(floats.max(1));
        let parameters = device.buffer(name, bytes, Location::Device)?;
        let moments = match training {
            true => Some(device.buffer(&format!("{name}_moments"), 2 * bytes, Location::Device)?),
            false => None,
        };
        let work = device.buffer(&format!("{name}_count"), size_of::<Work>() as u64, Location::Device)?;
        let count = Work { x: 1, y: 1, z: 1, count: floats };
        device.upload(&work, 0, bytemuck::bytes_of(&count))?;
        let made = Trainable { name, floats, parameters, moments, work };
        made.upload(device, start)?;
        Ok(made)
    }

    /// Returns the bytes of an array of `floats` values.
    pub fn bytes(floats: u64, training: bool) -> u64 {
        4 * floats.max(1) * if training { 3 } else { 1 } + size_of::<Work>() as u64
    }

    /// Returns the name of the array.
    pub fn name(&self) -> &'static str {
        self.name
    }

    /// Returns the number of values.
    pub fn floats(&self) -> u32 {
        self.floats
    }

    /// Replaces the parameters and resets the optimizer.
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

    /// Returns the current parameters. Waits for the device.
    ///
    /// # Errors
    /// If the device fails.
    pub fn download(&self, device: &Device) -> Result<Vec<f32>> {
        device.download_as(&self.parameters, self.floats as usize)
    }

    /// Returns Adam's moments as pairs. Empty without training.
    ///
    /// # Errors
    /// If the device fails.
    pub fn download_moments(&self, device: &Device) -> Result<Vec<f32>> {
        match &self.moments {
            Some(moments) => device.download_as(moments, 2 * self.floats as usize),
            None => Ok(Vec::new()),
        }
    }

    /// Restores moments from [`Trainable::download_moments`].
    ///
    /// # Errors
    /// If the device fails.
    pub fn upload_moments(&self, device: &Device, moments: &[f32]) -> Result<()> {
        match &self.moments {
            Some(buffer) => device.upload(buffer, 0, bytemuck::cast_slice(moments)),
            None => Ok(()),
        }
    }

    /// Declares the buffers of `floats` values in a graph. Kernels may write them if `training`.
    pub fn handles(g: &mut Graph, name: &'static str, floats: u32, training: bool) -> TrainableHandles {
        let bytes = 4 * u64::from(floats.max(1));
        if !training {
            return TrainableHandles { name, floats, parameters: g.input(name, bytes), moments: None, work: None };
        }
        TrainableHandles {
            name,
            floats,
            parameters: g.external(name, bytes),
            moments: Some(g.external(format!("{name}_moments"), 2 * bytes)),
            work: Some(g.input(format!("{name}_count"), size_of::<Work>() as u64)),
        }
    }

    /// Declares the buffers of this array, like [`Trainable::handles`].
    pub fn declare(&self, g: &mut Graph, training: bool) -> TrainableHandles {
        Trainable::handles(g, self.name, self.floats, training)
    }

    /// Binds the buffers to their handles.
    ///
    /// # Errors
    /// If the plan was compiled for larger buffers.
    pub fn bind(&self, exec: &mut Executor, handles: &TrainableHandles) -> Result<()> {
        exec.bind(handles.parameters, &self.parameters)?;
        if let (Some(handle), Some(buffer)) = (handles.moments, &self.moments) {
            exec.bind(handle, buffer)?;
        }
        if let Some(handle) = handles.work {
            exec.bind(handle, &self.work)?;
        }
        Ok(())
    }
}

impl TrainableHandles {
    /// Declares a transient buffer for the gradient.
    pub fn gradient(&self, g: &mut Graph) -> Buffer {
        g.transient(format!("grad_{}", self.name), 4 * u64::from(self.floats.max(1)))
    }
}
