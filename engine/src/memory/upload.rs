//! Uploads through a ring of staging memory.
//!
//! Promises: while the device copies one chunk, the host fills the next. Large uploads use the queue that only transfers,
//! where the device has one: copies start after all earlier work on the main queue, and the ranges pass to the family of
//! the main queue before its next work. Memory that pending copies use is freed after them, also after an error.

use super::{DeviceBuffer, Location, STAGING_BYTES};
use crate::device::{DeferredObject, Device, ObjectKind, Ticket, TransferQueue, TransferTicket};
use crate::error::Result;
use ash::vk;

/// Chunks of staging memory.
const SLOTS: u64 = 4;

/// Least bytes of a chunk, except in uploads of less.
const LEAST_CHUNK: u64 = 64 << 10;

/// Least bytes for the queue that only transfers. Below, the order of two queues costs more than it gains.
const LEAST_TRANSFER: u64 = 1 << 20;

/// Data and its place in a buffer.
pub type Piece<'a> = (&'a DeviceBuffer, u64, &'a [u8]);

impl Device {
    /// Writes `data` into a device buffer and waits.
    ///
    /// # Errors
    /// If the range exceeds the buffer, memory runs out or the device fails.
    pub fn upload(&self, buffer: &DeviceBuffer, offset: u64, data: &[u8]) -> Result<()> {
        self.upload_all(&[(buffer, offset, data)])
    }

    /// Writes several pieces of data into device buffers and waits once. Pieces do not overlap.
    ///
    /// # Errors
    /// As [`Device::upload`].
    pub fn upload_all(&self, pieces: &[Piece<'_>]) -> Result<()> {
        for (buffer, offset, data) in pieces {
            buffer.check_range(*offset, data.len() as u64)?;
        }
        self.0.memory.lock().activity.uploads += pieces.len() as u64;
        let total = pieces.iter().map(|(_, _, data)| (data.len() as u64).next_multiple_of(4)).sum();
        if total == 0 {
            return Ok(());
        }
        let mut ring = Ring::new(self, total)?;
        let written = ring.write(pieces);
        ring.close(pieces, written)
    }
}

/// End of a chunk's copy.
#[derive(Clone, Copy)]
enum Copied {
    Main(Ticket),
    Transfer(TransferTicket),
}

/// Staging memory and command buffers of one upload.
struct Ring<'d> {
    device: &'d Device,
    queue: Option<&'d TransferQueue>,
    staging: DeviceBuffer,
    /// Bytes of a chunk.
    chunk: u64,
    pool: vk::CommandPool,
    commands: Vec<vk::CommandBuffer>,
    /// By chunk of staging memory: the last copy from it, unless the host knows that it is done.
    copied: Vec<Option<Copied>>,
    /// Number of submitted chunks.
    submitted: u64,
    /// Last submission.
    last: Option<Copied>,
    /// Last work on the main queue before the upload.
    after: Ticket,
}

impl<'d> Ring<'d> {
    fn new(device: &'d Device, total: u64) -> Result<Ring<'d>> {
        let shared = &device.0;
        let queue = shared.transfer_queue.as_ref().filter(|_| total >= LEAST_TRANSFER);
        let bytes = STAGING_BYTES.min(total);
        let slots = (bytes / LEAST_CHUNK).clamp(1, SLOTS);
        let staging = device.buffer("staging (upload)", bytes, Location::Upload)?;
        let family = queue.map_or(shared.queue_family, |queue| queue.family);
        let info = vk::CommandPoolCreateInfo::default()
            .flags(vk::CommandPoolCreateFlags::RESET_COMMAND_BUFFER)
            .queue_family_index(family);
        // SAFETY: the device is alive.
        let pool = shared.gate.make(ObjectKind::CommandPool, "vkCreateCommandPool", "upload", || unsafe {
            shared.raw.create_command_pool(&info, None)
        })?;
        let info = vk::CommandBufferAllocateInfo::default()
            .command_pool(pool)
            .level(vk::CommandBufferLevel::PRIMARY)
            .command_buffer_count(slots as u32);
        // SAFETY: the pool was just created.
        let commands = shared
            .gate
            .call("vkAllocateCommandBuffers", "upload", || unsafe { shared.raw.allocate_command_buffers(&info) })
            .inspect_err(|_| shared.dispose(Ticket(0), DeferredObject::CommandPool(pool)))?;
        Ok(Ring {
            device,
            queue,
            staging,
            chunk: bytes / slots / 4 * 4,
            pool,
            copied: vec![None; slots as usize],
            commands,
            submitted: 0,
            last: None,
            after: device.last_ticket(),
        })
    }

    /// Fills and submits all chunks.
    fn write(&mut self, pieces: &[Piece<'_>]) -> Result<()> {
        let mut regions = Vec::new();
        let mut used = 0;
        for (buffer, offset, data) in pieces {
            let (mut to, mut left) = (*offset, *data);
            while !left.is_empty() {
                if used == self.chunk {
                    self.submit(&regions, None)?;
                    regions.clear();
                    used = 0;
                }
                if used == 0 {
                    self.wait_for_slot()?;
                }
                let (now, rest) = left.split_at(left.len().min((self.chunk - used) as usize));
                let from = self.slot() as u64 * self.chunk + used;
                self.staging.write(from, now)?;
                let bytes = now.len() as u64;
                regions.push((buffer.0.raw, vk::BufferCopy { src_offset: from, dst_offset: to, size: bytes }));
                // A piece of odd length leaves up to three bytes unused.
                used = (used + bytes).next_multiple_of(4).min(self.chunk);
                (to, left) = (to + bytes, rest);
            }
        }
        self.submit(&regions, Some(pieces))
    }

    /// Returns the chunk of staging memory that is filled next.
    fn slot(&self) -> usize {
        (self.submitted % self.copied.len() as u64) as usize
    }

    /// Waits for the copy from the next chunk of staging memory, unless it is done.
    fn wait_for_slot(&mut self) -> Result<()> {
        let slot = self.slot();
        match self.copied[slot].take() {
            Some(copied) if !self.is_done(copied)? => self.wait(copied),
            _ => Ok(()),
        }
    }

    fn is_done(&self, copied: Copied) -> Result<bool> {
        match (copied, self.queue) {
            (Copied::Transfer(ticket), Some(queue)) => self.device.0.is_transferred(queue, ticket),
            (Copied::Main(ticket), _) => self.device.is_done(ticket),
            (Copied::Transfer(_), None) => Ok(true),
        }
    }

    fn wait(&self, copied: Copied) -> Result<()> {
        self.device.0.memory.lock().activity.upload_waits += 1;
        match (copied, self.queue) {
            (Copied::Transfer(ticket), Some(queue)) => self.device.0.wait_transfer(queue, ticket, "upload"),
            (Copied::Main(ticket), _) => self.device.wait(ticket, "upload"),
            (Copied::Transfer(_), None) => Ok(()),
        }
    }

    /// Submits the copies of a chunk. The last one, which has all pieces, releases them to later work.
    fn submit(&mut self, regions: &[(vk::Buffer, vk::BufferCopy)], end: Option<&[Piece<'_>]>) -> Result<()> {
        let shared = &self.device.0;
        let (raw, gate, slot) = (&shared.raw, &shared.gate, self.slot());
        let commands = self.commands[slot];
        let begin = vk::CommandBufferBeginInfo::default().flags(vk::CommandBufferUsageFlags::ONE_TIME_SUBMIT);
        // SAFETY: the chunk's earlier copy is done, so that its command buffer may be recorded again.
        gate.call("vkBeginCommandBuffer", "upload", || unsafe { raw.begin_command_buffer(commands, &begin) })?;
        let all = [super::transfer::everything()];
        let around = vk::DependencyInfo::default().memory_barriers(&all);
        let release = end.zip(self.queue).map(|(pieces, queue)| passed(pieces, queue.family, shared.queue_family));
        let release: Vec<_> = release.into_iter().flatten().map(released).collect();
        // SAFETY: the command buffer is being recorded; all ranges were checked against their buffers.
        unsafe {
            if self.queue.is_none() && self.submitted == 0 {
                raw.cmd_pipeline_barrier2(commands, &around);
            }
            for (to, region) in regions {
                raw.cmd_copy_buffer(commands, self.staging.0.raw, *to, &[*region]);
            }
            match (end, self.queue) {
                (None, _) => {}
                (Some(_), None) => raw.cmd_pipeline_barrier2(commands, &around),
                (Some(_), Some(_)) => {
                    raw.cmd_pipeline_barrier2(
                        commands,
                        &vk::DependencyInfo::default().buffer_memory_barriers(&release),
                    );
                }
            }
        }
        // SAFETY: recording began above.
        gate.call("vkEndCommandBuffer", "upload", || unsafe { raw.end_command_buffer(commands) })?;
        let copied = match self.queue {
            Some(queue) => Copied::Transfer(shared.submit_transfer(queue, commands, self.after, "upload")?),
            None => Copied::Main(shared.submit(commands, "upload")?),
        };
        self.copied[slot] = Some(copied);
        self.last = Some(copied);
        self.submitted += 1;
        let in_flight = self.copied.iter().flatten().count() as u64;
        let activity = &mut shared.memory.lock().activity;
        activity.upload_chunks += 1;
        activity.most_chunks_in_flight = activity.most_chunks_in_flight.max(in_flight);
        Ok(())
    }

    /// Waits for all chunks. The main queue takes the ranges over.
    fn finish(&self, pieces: &[Piece<'_>]) -> Result<()> {
        let (Some(Copied::Transfer(ticket)), Some(queue)) = (self.last, self.queue) else {
            return self.last.map_or(Ok(()), |copied| self.wait(copied));
        };
        let shared = &self.device.0;
        shared.memory.lock().activity.upload_waits += 1;
        let barriers: Vec<_> = passed(pieces, queue.family, shared.queue_family).into_iter().map(acquired).collect();
        self.device.run_after("upload", &[queue.point(ticket)], &[], |device, commands| {
            let acquire = vk::DependencyInfo::default().buffer_memory_barriers(&barriers);
            // SAFETY: the command buffer is being recorded; the buffers are alive.
            unsafe { device.cmd_pipeline_barrier2(commands, &acquire) }
        })
    }

    /// Ends the upload. After an error, resources stay until pending copies are done.
    fn close(self, pieces: &[Piece<'_>], written: Result<()>) -> Result<()> {
        let result = written.and_then(|()| self.finish(pieces));
        let shared = &self.device.0;
        let until = match (&result, self.last) {
            (Ok(()), _) | (_, None) => Ticket(0),
            (Err(_), Some(Copied::Main(ticket))) => ticket,
            // The timeline of the main queue, by which resources are freed, does not order these copies. If they do not end,
            // resources stay until the device closes.
            (Err(_), Some(Copied::Transfer(_))) if shared.transfers_done() => shared.last_ticket(),
            (Err(_), Some(Copied::Transfer(_))) => Ticket(u64::MAX),
        };
        self.staging.0.busy.until(until);
        pieces.iter().for_each(|(buffer, ..)| buffer.0.busy.until(until));
        shared.dispose(until, DeferredObject::CommandPool(self.pool));
        result
    }
}

/// Returns barriers that pass ranges to another queue family.
///
/// Each queue completes its half of them.
fn passed(pieces: &[Piece<'_>], from: u32, to: u32) -> Vec<vk::BufferMemoryBarrier2<'static>> {
    let written = pieces.iter().filter(|(_, _, data)| !data.is_empty());
    let barrier = |(buffer, offset, data): &Piece<'_>| {
        vk::BufferMemoryBarrier2::default()
            .src_queue_family_index(from)
            .dst_queue_family_index(to)
            .buffer(buffer.0.raw)
            .offset(*offset)
            .size(data.len() as u64)
    };
    written.map(barrier).collect()
}

/// Completes the half of a barrier on the queue that has written.
fn released(barrier: vk::BufferMemoryBarrier2<'static>) -> vk::BufferMemoryBarrier2<'static> {
    barrier.src_stage_mask(vk::PipelineStageFlags2::COPY).src_access_mask(vk::AccessFlags2::TRANSFER_WRITE)
}

/// Completes the half of a barrier on the main queue. Its wait for the other queue covers all commands.
fn acquired(barrier: vk::BufferMemoryBarrier2<'static>) -> vk::BufferMemoryBarrier2<'static> {
    let all = vk::PipelineStageFlags2::ALL_COMMANDS;
    let access = vk::AccessFlags2::MEMORY_READ | vk::AccessFlags2::MEMORY_WRITE;
    barrier.src_stage_mask(all).dst_stage_mask(all).dst_access_mask(access)
}
