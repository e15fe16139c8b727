//! Recordings of a slot: one for each combination of alternating memory.

use super::Executor;
use crate::device::{DeferredObject, ObjectKind, Ticket};
use crate::error::Result;
use crate::graph::Buffer;
use crate::memory::DeviceBuffer;
use ash::vk;
use std::sync::Arc;

/// Command buffer of a slot for one combination of alternating memory.
pub(super) struct Recorded {
    pub pool: vk::CommandPool,
    pub commands: vk::CommandBuffer,
    pub descriptors: vk::DescriptorPool,
    /// Alternating memory that it was recorded with, which it keeps alive; `None` if nothing is recorded.
    pub memory: Option<Vec<DeviceBuffer>>,
    /// Number of the replay that used it last.
    used: u64,
}

impl Executor {
    /// Most recordings of a slot. Beyond, the least recently used one makes room.
    pub const MOST_RECORDINGS: usize = 512;

    /// Binds memory to an external buffer whose memory alternates between replays.
    ///
    /// An example is the data of views. Unlike [`Executor::bind`], it does not wait, and memory that was used before is not recorded again. Recordings
    /// keep the memory alive until [`Executor::bind`] binds other memory to any buffer.
    ///
    /// # Errors
    /// As [`Executor::bind`].
    pub fn alternate(&mut self, buffer: Buffer, memory: &DeviceBuffer) -> Result<()> {
        let index = buffer.index();
        if !self.alternating.contains(&index) {
            self.bind(buffer, memory)?;
            self.finish()?;
            self.forget_recordings();
            self.alternating.push(index);
            return Ok(());
        }
        memory.check_range(0, self.plan.buffers[index].bytes)?;
        self.externals[index] = Some(memory.clone());
        Ok(())
    }

    /// Forgets all recordings. Their replays must be done.
    pub(super) fn forget_recordings(&mut self) {
        self.slots.iter_mut().flat_map(|slot| &mut slot.recorded).for_each(|recorded| recorded.memory = None);
    }

    /// Returns the command buffer of a slot for the bound memory. Records it if there is none.
    pub(super) fn recorded(&mut self, slot: usize) -> Result<vk::CommandBuffer> {
        let replay = self.host.replays;
        let bound = |i: usize| self.externals[i].as_ref();
        let same = |recorded: &Recorded| {
            recorded.memory.as_ref().is_some_and(|memory| {
                let mut pairs = memory.iter().zip(&self.alternating);
                pairs.all(|(old, i)| bound(*i).is_some_and(|new| Arc::ptr_eq(&old.0, &new.0)))
            })
        };
        if let Some(at) = self.slots[slot].recorded.iter().position(same) {
            let recorded = &mut self.slots[slot].recorded[at];
            recorded.used = replay;
            return Ok(recorded.commands);
        }
        let at = match self.slots[slot].recorded.iter().position(|recorded| recorded.memory.is_none()) {
            Some(free) => free,
            None if self.slots[slot].recorded.len() < Self::MOST_RECORDINGS => {
                let new = self.new_recording()?;
                self.slots[slot].recorded.push(new);
                self.slots[slot].recorded.len() - 1
            }
            None => {
                let ages = self.slots[slot].recorded.iter().enumerate().min_by_key(|(_, recorded)| recorded.used);
                ages.map_or(0, |(oldest, _)| oldest)
            }
        };
        self.compile()?;
        self.slots[slot].recorded[at].memory = None;
        self.record(slot, at)?;
        self.host.recordings += 1;
        let memory = self.alternating.iter().filter_map(|i| self.externals[*i].clone()).collect();
        let recorded = &mut self.slots[slot].recorded[at];
        (recorded.memory, recorded.used) = (Some(memory), replay);
        Ok(recorded.commands)
    }

    /// Creates pools and a command buffer.
    pub(super) fn new_recording(&self) -> Result<Recorded> {
        let shared = &self.device.0;
        let name = &self.plan.name;
        let info = vk::CommandPoolCreateInfo::default().queue_family_index(shared.queue_family);
        // SAFETY: the device is alive.
        let pool = shared.gate.make(ObjectKind::CommandPool, "vkCreateCommandPool", name, || unsafe {
            shared.raw.create_command_pool(&info, None)
        })?;
        let (commands, descriptors) = (vk::CommandBuffer::null(), vk::DescriptorPool::null());
        let mut recorded = Recorded { pool, commands, descriptors, memory: None, used: 0 };
        let mut fill = || -> Result<()> {
            let info = vk::CommandBufferAllocateInfo::default()
                .command_pool(pool)
                .level(vk::CommandBufferLevel::PRIMARY)
                .command_buffer_count(1);
            let allocate = "vkAllocateCommandBuffers";
            // SAFETY: the pool was created from this device.
            recorded.commands =
                shared.gate.call(allocate, name, || unsafe { shared.raw.allocate_command_buffers(&info) })?[0];
            shared.name(recorded.commands, name);
            recorded.descriptors = self.descriptor_pool()?;
            Ok(())
        };
        if let Err(error) = fill() {
            self.destroy_recording(&recorded, Ticket(0));
            return Err(error);
        }
        Ok(recorded)
    }

    /// Destroys the pools of a recording once the timeline has passed `until`.
    pub(super) fn destroy_recording(&self, recorded: &Recorded, until: Ticket) {
        let shared = &self.device.0;
        if recorded.descriptors != vk::DescriptorPool::null() {
            shared.dispose(until, DeferredObject::DescriptorPool(recorded.descriptors));
        }
        shared.dispose(until, DeferredObject::CommandPool(recorded.pool));
    }
}
