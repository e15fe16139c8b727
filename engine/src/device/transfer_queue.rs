//! Second queue of a device that only transfers, with a timeline of its own.
//!
//! Promises: its work starts after the work on the main queue that a caller names. Work on the main queue waits for it by
//! [`TransferQueue::point`]. The device closes after both queues are done.

use super::fault::Gate;
use super::objects::ObjectKind;
use super::{Shared, Ticket, semaphore};
use crate::error::{Error, Result};
use ash::vk;
use std::sync::{Mutex, PoisonError};

/// Queue of a family without kernels and graphics.
pub(crate) struct TransferQueue {
    /// Queue family.
    pub family: u32,
    raw: vk::Queue,
    timeline: vk::Semaphore,
    submitted: Mutex<u64>,
}

/// Point on the timeline of the transfer queue.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct TransferTicket(u64);

/// Returns the family of queues that only transfer, if the device has one.
pub(super) fn family(families: &[vk::QueueFamilyProperties]) -> Option<u32> {
    let others = vk::QueueFlags::GRAPHICS | vk::QueueFlags::COMPUTE;
    let of = |f: &vk::QueueFamilyProperties| {
        f.queue_flags.contains(vk::QueueFlags::TRANSFER) && !f.queue_flags.intersects(others) && f.queue_count > 0
    };
    // Families of video may transfer, too, but are not made for it.
    let plain = |f: &vk::QueueFamilyProperties| {
        let video = vk::QueueFlags::VIDEO_DECODE_KHR | vk::QueueFlags::VIDEO_ENCODE_KHR;
        of(f) && !f.queue_flags.intersects(video)
    };
    families.iter().position(plain).map(|index| index as u32)
}

impl TransferQueue {
    /// Takes the first queue of a family, and creates its timeline.
    pub fn new(raw: &ash::Device, gate: &Gate, family: u32) -> Result<TransferQueue> {
        let mut kind = vk::SemaphoreTypeCreateInfo::default().semaphore_type(vk::SemaphoreType::TIMELINE);
        let info = vk::SemaphoreCreateInfo::default().push_next(&mut kind);
        // SAFETY: the device is alive and has timeline semaphores.
        let timeline = gate.make(ObjectKind::Semaphore, "vkCreateSemaphore", "transfer timeline", || unsafe {
            raw.create_semaphore(&info, None)
        })?;
        // SAFETY: the device was created with a queue of this family.
        let queue = unsafe { raw.get_device_queue(family, 0) };
        Ok(TransferQueue { family, raw: queue, timeline, submitted: Mutex::new(0) })
    }

    /// Returns a wait for a ticket, for a submission to the main queue.
    pub fn point(&self, ticket: TransferTicket) -> vk::SemaphoreSubmitInfo<'static> {
        semaphore(self.timeline, ticket.0)
    }

    /// Destroys the timeline. All work is done.
    pub fn destroy(&self, raw: &ash::Device, gate: &Gate) {
        // SAFETY: nothing uses the semaphore any more.
        unsafe { raw.destroy_semaphore(self.timeline, None) };
        gate.count_destroyed(ObjectKind::Semaphore);
    }
}

impl Shared {
    /// Submits a command buffer to the transfer queue. It starts after a ticket of the main queue.
    pub fn submit_transfer(
        &self,
        queue: &TransferQueue,
        commands: vk::CommandBuffer,
        after: Ticket,
        what: &str,
    ) -> Result<TransferTicket> {
        let mut submitted = queue.submitted.lock().unwrap_or_else(PoisonError::into_inner);
        let value = *submitted + 1;
        let buffers = [vk::CommandBufferSubmitInfo::default().command_buffer(commands)];
        let (waits, signals) = ([semaphore(self.timeline, after.0)], [semaphore(queue.timeline, value)]);
        let submit = [vk::SubmitInfo2::default()
            .wait_semaphore_infos(&waits)
            .command_buffer_infos(&buffers)
            .signal_semaphore_infos(&signals)];
        // SAFETY: the command buffer is recorded for this family and not pending. The lock serializes the queue, and its
        // timeline only grows.
        self.gate.call("vkQueueSubmit2", what, || unsafe {
            self.raw.queue_submit2(queue.raw, &submit, vk::Fence::null())
        })?;
        *submitted = value;
        Ok(TransferTicket(value))
    }

    /// Returns whether the transfer queue has passed a ticket.
    pub fn is_transferred(&self, queue: &TransferQueue, ticket: TransferTicket) -> Result<bool> {
        // SAFETY: the semaphore belongs to this device.
        let value = self.gate.call("vkGetSemaphoreCounterValue", "transfer timeline", || unsafe {
            self.raw.get_semaphore_counter_value(queue.timeline)
        })?;
        Ok(value >= ticket.0)
    }

    /// Waits for a ticket of the transfer queue.
    pub fn wait_transfer(&self, queue: &TransferQueue, ticket: TransferTicket, what: &str) -> Result<()> {
        let limit = self.timeout;
        let wait = || self.wait_semaphore(queue.timeline, ticket.0, limit);
        match self.gate.call("vkWaitSemaphores", what, wait) {
            Err(Error::Vulkan { result: vk::Result::TIMEOUT, .. }) => {
                Err(Error::Timeout { what: what.to_owned(), limit, pass: None })
            }
            other => other,
        }
    }

    /// Waits for all work of the transfer queue, if there is one. Returns false if work still runs at the time limit.
    ///
    /// Bypasses the gate, as [`Shared::wait_idle`].
    pub fn transfers_done(&self) -> bool {
        let Some(queue) = &self.transfer_queue else { return true };
        let last = *queue.submitted.lock().unwrap_or_else(PoisonError::into_inner);
        let done = self.wait_semaphore(queue.timeline, last, self.close_timeout);
        matches!(done, Ok(()) | Err(vk::Result::ERROR_DEVICE_LOST))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn family_without_kernels_is_found() {
        use vk::QueueFlags as Of;
        let of = |all: &[Of]| {
            let families = all.iter().map(|flags| vk::QueueFamilyProperties {
                queue_flags: *flags,
                queue_count: 1,
                ..Default::default()
            });
            family(&families.collect::<Vec<_>>())
        };
        let all = Of::GRAPHICS | Of::COMPUTE | Of::TRANSFER;
        assert_eq!(of(&[all]), None);
        assert_eq!(of(&[all, Of::COMPUTE | Of::TRANSFER]), None);
        assert_eq!(of(&[all, Of::COMPUTE | Of::TRANSFER, Of::TRANSFER | Of::SPARSE_BINDING]), Some(2));
        assert_eq!(of(&[all, Of::TRANSFER | Of::VIDEO_DECODE_KHR, Of::TRANSFER]), Some(2));
        assert_eq!(of(&[all, Of::SPARSE_BINDING]), None);
        assert_eq!(of(&[]), None);
    }
}
