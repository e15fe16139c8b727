//! Differentiable functions: rendering of Gaussians and shading of pixels.

mod render;
mod shade;

pub use render::Splatter;
pub use shade::LightShader;

use numpy::PyReadonlyArrayDyn;
use sgs_engine::exec::{ExecOptions, Executor};
use sgs_engine::graph::{Buffer, CompileOptions, Graph};
use sgs_engine::{Device, DeviceBuffer, Location, Result};
use std::sync::Arc;

/// Compiled graph with memory for its external buffers.
struct Replay {
    device: Device,
    exec: Executor,
    buffers: Vec<(Buffer, DeviceBuffer)>,
}

impl Replay {
    fn new(device: &Device, graph: Graph, external: &[Buffer]) -> Result<Replay> {
        let plan = Arc::new(graph.compile(&CompileOptions::default())?);
        let mut exec = Executor::new(device, plan.clone(), ExecOptions { frames_in_flight: 1, ..Default::default() })?;
        let mut buffers = Vec::new();
        for &handle in external {
            let declared = &plan.buffers[handle.index()];
            let memory = device.buffer(&declared.name, declared.bytes, Location::Device)?;
            exec.bind(handle, &memory)?;
            buffers.push((handle, memory));
        }
        Ok(Replay { device: device.clone(), exec, buffers })
    }

    fn memory(&self, handle: Buffer) -> &DeviceBuffer {
        let found = self.buffers.iter().find(|(h, _)| *h == handle);
        &found.unwrap_or_else(|| unreachable!("invariant: every external buffer has memory")).1
    }

    fn upload(&self, handle: Buffer, values: &[f32]) -> Result<()> {
        self.device.upload(self.memory(handle), 0, bytemuck::cast_slice(values))
    }

    fn download(&self, handle: Buffer, count: usize) -> Result<Vec<f32>> {
        self.device.download_as(self.memory(handle), count)
    }

    /// Replays the graph with the contents of its uniform, and waits.
    fn run(&mut self, uniform: (Buffer, &[u8])) -> Result<()> {
        self.exec.submit(&[uniform])?;
        self.exec.finish()
    }
}

/// Copies arrays to vectors, for computing without the interpreter's lock.
fn vectors(arrays: &[PyReadonlyArrayDyn<'_, f32>]) -> Vec<Vec<f32>> {
    arrays.iter().map(|a| a.as_array().iter().copied().collect()).collect()
}
