//! Harness that replays and times one graph, for stages measured in isolation.

use crate::ceiling::Ceiling;
use crate::report::{PassRow, Report};
use crate::stats::Summary;
use sgs_engine::exec::{ExecOptions, Executor, HostTimes, PassTime};
use sgs_engine::graph::{Buffer, BufferKind, CompileOptions, Graph, Plan};
use sgs_engine::{Device, DeviceBuffer, Location};
use sgs_passes::cost::{Counts, cost};
use std::sync::Arc;
use std::time::Instant;

/// Compiled graph with its memory.
pub struct Rig {
    device: Device,
    exec: Executor,
    memory: Vec<Option<DeviceBuffer>>,
    uniforms: Vec<(Buffer, Vec<u8>)>,
}

impl Rig {
    /// Compiles a graph and allocates its external buffers.
    ///
    /// Buffers have the content in `inputs`, or zeros.
    ///
    /// # Errors
    /// If the graph is invalid or memory runs out.
    pub fn new(device: &Device, graph: Graph, inputs: Vec<(Buffer, Vec<u8>)>, timestamps: bool) -> anyhow::Result<Rig> {
        let plan = Arc::new(graph.compile(&CompileOptions::default())?);
        let options = ExecOptions { timestamps, ..Default::default() };
        let mut exec = Executor::new(device, plan.clone(), options)?;
        let mut memory = Vec::new();
        for (handle, info) in plan.buffers() {
            if info.kind != BufferKind::External {
                memory.push(None);
                continue;
            }
            let buffer = device.buffer(&info.name, info.bytes, Location::Device)?;
            match inputs.iter().find(|(b, _)| *b == handle) {
                Some((_, data)) => device.upload(&buffer, 0, data)?,
                None => device.fill(&buffer, 0)?,
            }
            exec.bind(handle, &buffer)?;
            memory.push(Some(buffer));
        }
        let uniform = |b: &Buffer| plan.buffers[b.index()].kind == BufferKind::Uniform;
        let uniforms = inputs.into_iter().filter(|(b, _)| uniform(b)).collect();
        Ok(Rig { device: device.clone(), exec, memory, uniforms })
    }

    /// Submits one replay.
    ///
    /// # Errors
    /// If the device fails.
    pub fn submit(&mut self) -> anyhow::Result<()> {
        let uniforms: Vec<(Buffer, &[u8])> = self.uniforms.iter().map(|(b, d)| (*b, d.as_slice())).collect();
        self.exec.submit(&uniforms)?;
        Ok(())
    }

    /// Replays after a warm-up. Returns pass times and host nanoseconds of each replay.
    ///
    /// # Errors
    /// If the device fails.
    pub fn measure(&mut self, warmup: u32, repeats: u32) -> anyhow::Result<(Vec<PassTime>, Vec<f64>)> {
        for _ in 0..warmup.max(1) {
            self.submit()?;
        }
        self.exec.finish()?;
        self.exec.take_times();
        let mut wall = Vec::new();
        for _ in 0..repeats {
            let begin = Instant::now();
            self.submit()?;
            self.exec.finish()?;
            wall.push(begin.elapsed().as_nanos() as f64);
        }
        Ok((self.exec.take_times(), wall))
    }

    /// Returns the host times of the replays.
    pub fn host_times(&self) -> HostTimes {
        self.exec.host_times()
    }

    /// Returns the plan.
    pub fn plan(&self) -> &Plan {
        self.exec.plan()
    }

    /// Downloads an external buffer as values.
    ///
    /// # Errors
    /// If the device fails or the buffer is not external.
    pub fn get<T: bytemuck::Pod>(&self, buffer: Buffer) -> anyhow::Result<Vec<T>> {
        let memory = self.memory.get(buffer.index()).and_then(Option::as_ref);
        let memory = memory.ok_or_else(|| anyhow::anyhow!("A buffer that is not external cannot be read."))?;
        Ok(self.device.download_as(memory, memory.bytes() as usize / size_of::<T>())?)
    }
}

/// Adds the passes of a plan to a report, each relative to the device's ceiling.
///
/// Passes whose names begin with `out.` only transfer results to the host and are left out.
pub fn add_passes(report: &mut Report, plan: &Plan, times: &[PassTime], counts: &Counts, ceiling: &Ceiling) {
    for time in times.iter().filter(|t| !t.name.starts_with("out.") && !t.nanoseconds.is_empty()) {
        let nanoseconds = Summary::of(&time.nanoseconds);
        let cost = plan.passes.iter().find(|p| p.name == time.name).and_then(|p| cost(p, counts));
        let bound = cost.map(|c| ceiling.bound(&c));
        report.passes.push(PassRow {
            plan: plan.name.clone(),
            pass: time.name.clone(),
            nanoseconds,
            bytes: cost.map(|c| c.bytes),
            operations: cost.map(|c| c.operations),
            atomics: cost.map(|c| c.atomics).filter(|count| *count > 0.0),
            share: bound.filter(|_| nanoseconds.median > 0.0).map(|(s, _)| s * 1e9 / nanoseconds.median),
            bound: bound.map(|(_, memory)| if memory { "memory" } else { "arithmetic" }.to_owned()),
        });
    }
}

/// Returns the device time of each replay in nanoseconds.
///
/// The time is from the begin of the first pass to the end of the last.
pub fn spans(times: &[PassTime]) -> Vec<f64> {
    let replays = times.iter().map(|t| t.start.len()).min().unwrap_or(0);
    let end = |r: usize| times.iter().map(move |t| t.start[r] + t.nanoseconds[r]).fold(0.0, f64::max);
    (0..replays).map(end).collect()
}

/// Returns values as bytes.
pub fn bytes<T: bytemuck::NoUninit>(data: &[T]) -> Vec<u8> {
    bytemuck::cast_slice(data).to_vec()
}
