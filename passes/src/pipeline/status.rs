//! Status that training steps report to the host, some steps late: a flag, a counter and a ring of reports.

use sgs_engine::exec::Executor;
use sgs_engine::graph::{Buffer, Graph};
use sgs_engine::{Device, DeviceBuffer, Location, Result};
use sgs_shaders::structs::StepReport;

/// Number of reports in the ring.
pub const RING: u32 = 64;

/// Bit of the flag that only the host sets.
const HELD: u32 = 1 << 31;

/// Status buffers that outlive the executors of a training run.
#[derive(Debug)]
pub struct Status {
    flags: DeviceBuffer,
    skipped: DeviceBuffer,
    reports: DeviceBuffer,
}

/// Handles of the status buffers in a graph.
#[derive(Clone, Copy, Debug)]
pub struct StatusHandles {
    /// One word: nonzero after an overflow.
    pub flags: Buffer,
    /// One word: number of splats with non-finite gradients.
    pub skipped: Buffer,
    /// Ring of reports.
    pub reports: Buffer,
}

impl Status {
    /// Allocates the buffers and clears them.
    ///
    /// # Errors
    /// If memory runs out.
    pub fn new(device: &Device) -> Result<Status> {
        let flags = device.buffer("flags", 4, Location::Device)?;
        let skipped = device.buffer("skipped", 4, Location::Device)?;
        let bytes = u64::from(RING) * size_of::<StepReport>() as u64;
        let reports = device.buffer("reports", bytes, Location::Readback)?;
        for buffer in [&flags, &skipped, &reports] {
            device.fill(buffer, 0)?;
        }
        Ok(Status { flags, skipped, reports })
    }

    /// Sets the flag: later steps change no parameter until it is cleared.
    ///
    /// # Errors
    /// If the device fails.
    pub fn hold(&self, device: &Device) -> Result<()> {
        device.fill(&self.flags, HELD)
    }

    /// Clears the flag, after its cause was removed.
    ///
    /// # Errors
    /// If the device fails.
    pub fn clear_flags(&self, device: &Device) -> Result<()> {
        device.fill(&self.flags, 0)
    }

    /// Returns the report of a completed step.
    ///
    /// # Errors
    /// If the memory is not host-visible, which indicates a bug.
    pub fn report(&self, step: u32) -> Result<StepReport> {
        let bytes = size_of::<StepReport>() as u64;
        let mut report = StepReport::default();
        self.reports.read(u64::from(step % RING) * bytes, bytemuck::bytes_of_mut(&mut report))?;
        Ok(report)
    }

    /// Returns the ring of reports. A step has the place of its number, modulo the length of the ring.
    ///
    /// Drivers that run no kernels report nothing; their callers write reports themselves.
    pub fn reports(&self) -> &DeviceBuffer {
        &self.reports
    }

    /// Bytes of all status buffers.
    pub const BYTES: u64 = 8 + RING as u64 * size_of::<StepReport>() as u64;

    pub(crate) fn declare(g: &mut Graph) -> StatusHandles {
        StatusHandles {
            flags: g.external("flags", 4),
            skipped: g.external("skipped", 4),
            reports: g.external("reports", Status::BYTES - 8),
        }
    }

    pub(crate) fn bind(&self, exec: &mut Executor, handles: &StatusHandles) -> Result<()> {
        exec.bind(handles.flags, &self.flags)?;
        exec.bind(handles.skipped, &self.skipped)?;
        exec.bind(handles.reports, &self.reports)
    }
}
