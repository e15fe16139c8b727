//! A flat array of parameters that Adam moves: materials, lights, texels, weights of a network.
//!
//! Promises: a raised flag stops its steps as it does the Gaussians'. Leaves gradients to others.

use crate::Tuning;
use crate::optim::{Adam, Rate, adam};
use sgs_engine::graph::exec::Executor;
use sgs_engine::graph::{Buffer, Graph, GraphError};
use sgs_engine::{Device, DeviceBuffer, Location, Result};
use sgs_shaders::structs::Work;

/// Parameters in device memory.
#[derive(Debug)]
pub struct Trainable {
    name: &'static str,
    floats: u32,
    parameters: DeviceBuffer,
    /// First and second moments, pairs; only when training.
    moments: Option<DeviceBuffer>,
    work: DeviceBuffer,
}

/// Its buffers in one graph.
#[derive(Clone, Copy, Debug)]
pub struct TrainableHandles {
    name: &'static str,
    floats: u32,
    /// The parameters.
    pub parameters: Buffer,
    moments: Option<Buffer>,
    work: Option<Buffer>,
}

/// What stops a step, and what counts gradients that are not finite.
#[derive(Clone, Copy, Debug)]
pub struct StepWords {
    /// Uniform `Step`: bias corrections.
    pub step: Buffer,
    /// A word that is not zero when the step must change nothing.
    pub flags: Buffer,
    /// A counter.
    pub skipped: Buffer,
}

impl Trainable {
    /// Makes it with a start; `training` adds moments. Nothing takes a word, as kernels cannot be bound to less.
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

    /// Bytes that so many floats take.
    pub fn bytes(floats: u64, training: bool) -> u64 {
        4 * floats.max(1) * if training { 3 } else { 1 } + size_of::<Work>() as u64
    }

    /// Its name.
    pub fn name(&self) -> &'static str {
        self.name
    }

    /// How many numbers.
    pub fn floats(&self) -> u32 {
        self.floats
    }

    /// Replaces the parameters and starts the optimizer afresh.
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

    /// The parameters as they are (waits for the device).
    ///
    /// # Errors
    /// If the device fails.
    pub fn download(&self, device: &Device) -> Result<Vec<f32>> {
        device.download_as(&self.parameters, self.floats as usize)
    }

    /// Adam's moments, pairs; empty without training.
    ///
    /// # Errors
    /// If the device fails.
    pub fn download_moments(&self, device: &Device) -> Result<Vec<f32>> {
        match &self.moments {
            Some(moments) => device.download_as(moments, 2 * self.floats as usize),
            None => Ok(Vec::new()),
        }
    }

    /// Puts back what [`Trainable::download_moments`] gave.
    ///
    /// # Errors
    /// If the device fails.
    pub fn upload_moments(&self, device: &Device, moments: &[f32]) -> Result<()> {
        match &self.moments {
            Some(buffer) => device.upload(buffer, 0, bytemuck::cast_slice(moments)),
            None => Ok(()),
        }
    }

    /// Declares the buffers of so many floats in a graph; kernels may write them if `training`.
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

    /// As [`Trainable::handles`], of this one.
    pub fn declare(&self, g: &mut Graph, training: bool) -> TrainableHandles {
        Trainable::handles(g, self.name, self.floats, training)
    }

    /// Puts the buffers behind their handles.
    ///
    /// # Errors
    /// If the plan was made for larger ones.
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
    /// Room for its gradient in the arena.
    pub fn gradient(&self, g: &mut Graph) -> Buffer {
        g.transient(format!("grad_{}", self.name), 4 * u64::from(self.floats.max(1)))
    }

    /// Adds the pass of Adam that follows `gradient`. Does nothing where the graph was declared without training.
    ///
    /// # Errors
    /// If the graph refuses the pass.
    pub fn follow(
        &self,
        g: &mut Graph,
        t: &Tuning,
        words: &StepWords,
        gradient: Buffer,
        rate: Rate,
        epsilon: f32,
        skip_zero: bool,
    ) -> std::result::Result<(), GraphError> {
        let (Some(moments), Some(live)) = (self.moments, self.work) else { return Ok(()) };
        let all = Adam {
            step: words.step,
            live,
            flags: words.flags,
            flag_words: 1,
            width: 1,
            capacity: u64::from(self.floats),
            rate,
            skip_zero,
            epsilon,
            gradients: gradient,
            parameters: self.parameters,
            moments,
            skipped: words.skipped,
        };
        adam(g, *t, &format!("adam.{}", self.name), &all)
    }
}
