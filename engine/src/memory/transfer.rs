//! Downloads through staging memory, copies and fills. For setup and inspection, not for training steps.

use super::{DeviceBuffer, Location};
use crate::device::{Busy, DeferredObject, Device, ObjectKind, Ticket};
use crate::error::Result;
use ash::vk;

/// Maximum staging memory of an upload or download in bytes, reused for its chunks.
pub const STAGING_BYTES: u64 = 4 << 20;

impl Device {
    /// Reads `bytes` from a device buffer and waits.
    ///
    /// # Errors
    /// If the range exceeds the buffer, memory runs out or the device fails.
    pub fn download(&self, buffer: &DeviceBuffer, offset: u64, bytes: u64) -> Result<Vec<u8>> {
        buffer.check_range(offset, bytes)?;
        self.0.memory.lock().activity.downloads += 1;
        let mut data = vec![0; bytes as usize];
        if data.is_empty() {
            return Ok(data);
        }
        let staging = self.buffer("staging (download)", STAGING_BYTES.min(bytes), Location::Readback)?;
        for (i, chunk) in data.chunks_mut(STAGING_BYTES as usize).enumerate() {
            let region = vk::BufferCopy {
                src_offset: offset + i as u64 * STAGING_BYTES,
                dst_offset: 0,
                size: chunk.len() as u64,
            };
            self.copy_now(buffer, &staging, region)?;
            staging.read(0, chunk)?;
        }
        Ok(data)
    }

    /// Reads `count` values from the start of a device buffer and waits.
    ///
    /// # Errors
    /// As [`Device::download`].
    pub fn download_as<T: bytemuck::Pod>(&self, buffer: &DeviceBuffer, count: usize) -> Result<Vec<T>> {
        let bytes = self.download(buffer, 0, (count * size_of::<T>()) as u64)?;
        let mut values = vec![T::zeroed(); count];
        bytemuck::cast_slice_mut(&mut values).copy_from_slice(&bytes);
        Ok(values)
    }

    /// Copies `bytes` from the start of one buffer to the start of another and waits.
    ///
    /// # Errors
    /// If a range exceeds its buffer, or the device fails.
    pub fn copy(&self, from: &DeviceBuffer, to: &DeviceBuffer, bytes: u64) -> Result<()> {
        from.check_range(0, bytes)?;
        to.check_range(0, bytes)?;
        if bytes == 0 {
            return Ok(());
        }
        self.copy_now(from, to, vk::BufferCopy { src_offset: 0, dst_offset: 0, size: bytes })
    }

    /// Fills a buffer with a repeated 32-bit word and waits.
    ///
    /// # Errors
    /// If the device fails.
    pub fn fill(&self, buffer: &DeviceBuffer, word: u32) -> Result<()> {
        let raw = buffer.0.raw;
        self.run_now("fill", &[&buffer.0.busy], |device, commands| {
            // SAFETY: the command buffer is being recorded and the buffer belongs to this device.
            unsafe { device.cmd_fill_buffer(commands, raw, 0, vk::WHOLE_SIZE, word) }
        })
    }

    fn copy_now(&self, from: &DeviceBuffer, to: &DeviceBuffer, region: vk::BufferCopy) -> Result<()> {
        let busy = [&from.0.busy, &to.0.busy];
        let (from, to) = (from.0.raw, to.0.raw);
        self.run_now("copy", &busy, |device, commands| {
            // SAFETY: the command buffer is being recorded; both ranges were checked against their buffers.
            unsafe { device.cmd_copy_buffer(commands, from, to, &[region]) }
        })
    }

    /// Records, submits and waits; ordered after all earlier work and before all later work.
    ///
    /// Marks the used resources as busy if the wait fails.
    pub(super) fn run_now(
        &self,
        what: &str,
        resources: &[&Busy],
        record: impl FnOnce(&ash::Device, vk::CommandBuffer),
    ) -> Result<()> {
        self.run_after(what, &[], resources, record)
    }

    /// Like [`Device::run_now`], after other semaphores, too.
    pub(super) fn run_after(
        &self,
        what: &str,
        waits: &[vk::SemaphoreSubmitInfo<'_>],
        resources: &[&Busy],
        record: impl FnOnce(&ash::Device, vk::CommandBuffer),
    ) -> Result<()> {
        let shared = &self.0;
        let raw = &shared.raw;
        let gate = &shared.gate;
        let pool = vk::CommandPoolCreateInfo::default().queue_family_index(shared.queue_family);
        // SAFETY: the device is alive.
        let pool = gate.make(ObjectKind::CommandPool, "vkCreateCommandPool", what, || unsafe {
            raw.create_command_pool(&pool, None)
        })?;
        let submitted = (|| {
            let info = vk::CommandBufferAllocateInfo::default()
                .command_pool(pool)
                .level(vk::CommandBufferLevel::PRIMARY)
                .command_buffer_count(1);
            // SAFETY: the pool was just created.
            let commands =
                gate.call("vkAllocateCommandBuffers", what, || unsafe { raw.allocate_command_buffers(&info) })?[0];
            let begin = vk::CommandBufferBeginInfo::default().flags(vk::CommandBufferUsageFlags::ONE_TIME_SUBMIT);
            let barrier = [everything()];
            let dependency = vk::DependencyInfo::default().memory_barriers(&barrier);
            // SAFETY: the command buffer is created here and recorded completely.
            unsafe {
                gate.call("vkBeginCommandBuffer", what, || raw.begin_command_buffer(commands, &begin))?;
                raw.cmd_pipeline_barrier2(commands, &dependency);
                record(raw, commands);
                raw.cmd_pipeline_barrier2(commands, &dependency);
                gate.call("vkEndCommandBuffer", what, || raw.end_command_buffer(commands))?;
            }
            shared.submit_between(commands, waits, &[], what)
        })();
        let (result, until) = match submitted {
            Err(error) => (Err(error), Ticket(0)),
            Ok(ticket) => {
                let waited = self.wait(ticket, what);
                let until = if waited.is_ok() { Ticket(0) } else { ticket };
                (waited, until)
            }
        };
        resources.iter().for_each(|busy| busy.until(until));
        shared.dispose(until, DeferredObject::CommandPool(pool));
        result
    }
}

/// Returns a barrier between everything before and everything after it.
pub(super) fn everything() -> vk::MemoryBarrier2<'static> {
    let all = vk::PipelineStageFlags2::ALL_COMMANDS | vk::PipelineStageFlags2::HOST;
    let access = vk::AccessFlags2::MEMORY_READ | vk::AccessFlags2::MEMORY_WRITE;
    vk::MemoryBarrier2::default()
        .src_stage_mask(all)
        .src_access_mask(access)
        .dst_stage_mask(all)
        .dst_access_mask(access)
}
