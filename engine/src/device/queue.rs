//! Main queue of a device: submissions and waits, ordered by one timeline.

use super::external::{Locked, QueueLock};
use super::{Shared, Ticket};
use crate::error::{Error, Result};
use ash::vk;
use std::sync::MutexGuard;
use std::time::Duration;

/// Queue of a device, and the number of its submissions.
pub(crate) struct Queue {
    /// Null if the host submits all work.
    pub raw: vk::Queue,
    /// Host's lock of its queue.
    lock: Option<Box<dyn QueueLock>>,
    submitted: u64,
}

impl Queue {
    pub fn new(raw: vk::Queue, lock: Option<Box<dyn QueueLock>>) -> Queue {
        Queue { raw, lock, submitted: 0 }
    }
}

/// Number of shorter waits that make up one wait.
///
/// The clock runs while a process is stopped (Ctrl-Z), but its GPU work does not. A stop then uses up at most one
/// part of the limit.
const WAIT_SLICES: u32 = 16;

impl Shared {
    /// Locks the queue.
    pub fn queue(&self) -> MutexGuard<'_, Queue> {
        self.queue.lock().unwrap_or_else(|e| e.into_inner())
    }

    /// Returns the ticket of the last submission.
    pub fn last_ticket(&self) -> Ticket {
        Ticket(self.queue().submitted)
    }

    /// Waits for a ticket, at most for `limit`.
    pub fn wait(&self, ticket: Ticket, what: &str, limit: Duration) -> Result<()> {
        match self.gate.call("vkWaitSemaphores", what, || self.wait_raw(ticket, limit)) {
            Err(Error::Vulkan { result: vk::Result::TIMEOUT, .. }) => {
                Err(Error::Timeout { what: what.to_owned(), limit, pass: None })
            }
            other => other,
        }
    }

    pub(super) fn wait_raw(&self, ticket: Ticket, limit: Duration) -> std::result::Result<(), vk::Result> {
        self.wait_semaphore(self.timeline, ticket.0, limit)
    }

    pub(super) fn wait_semaphore(
        &self,
        semaphore: vk::Semaphore,
        value: u64,
        limit: Duration,
    ) -> std::result::Result<(), vk::Result> {
        let semaphores = [semaphore];
        let values = [value];
        let info = vk::SemaphoreWaitInfo::default().semaphores(&semaphores).values(&values);
        let slice = u64::try_from(limit.as_nanos().div_ceil(u128::from(WAIT_SLICES))).unwrap_or(u64::MAX);
        for _ in 1..WAIT_SLICES {
            // SAFETY: the semaphore belongs to this device and the arrays outlive the call.
            match unsafe { self.raw.wait_semaphores(&info, slice) } {
                Err(vk::Result::TIMEOUT) => {}
                other => return other,
            }
        }
        // SAFETY: as before.
        unsafe { self.raw.wait_semaphores(&info, slice) }
    }

    /// Waits for all submitted work. Returns false if work still runs at the time limit.
    ///
    /// Bypasses the gate: after an injected or real device loss, the caller must still know that nothing runs.
    pub(super) fn wait_idle(&self) -> bool {
        let last = Ticket(self.queue().submitted);
        // A lost device runs nothing.
        let done = matches!(self.wait_raw(last, self.close_timeout), Ok(()) | Err(vk::Result::ERROR_DEVICE_LOST));
        done && self.transfers_done()
    }

    /// Submits one recorded command buffer; returns the ticket of its end.
    pub fn submit(&self, commands: vk::CommandBuffer, what: &str) -> Result<Ticket> {
        self.submit_between(commands, &[], &[], what)
    }

    /// Like [`Shared::submit`], with wait and signal semaphores of a host.
    pub fn submit_between(
        &self,
        commands: vk::CommandBuffer,
        waits: &[vk::SemaphoreSubmitInfo<'_>],
        signals: &[vk::SemaphoreSubmitInfo<'_>],
        what: &str,
    ) -> Result<Ticket> {
        let mut queue = self.queue();
        let value = queue.submitted + 1;
        let mut all = Vec::with_capacity(signals.len() + 1);
        all.push(semaphore(self.timeline, value));
        all.extend_from_slice(signals);
        if queue.raw == vk::Queue::null() {
            return Err(Error::NoQueue(what.to_owned()));
        }
        let buffers = [vk::CommandBufferSubmitInfo::default().command_buffer(commands)];
        let submit = [vk::SubmitInfo2::default()
            .wait_semaphore_infos(waits)
            .command_buffer_infos(&buffers)
            .signal_semaphore_infos(&all)];
        let locked = queue.lock.as_deref().map(Locked::new);
        // SAFETY: the command buffer is recorded and not pending (its owner waits for its ticket first). The queue is
        // locked, a host's queue by the host's own lock too. The timeline only grows; the caller orders all other
        // semaphores.
        self.gate.call("vkQueueSubmit2", what, || unsafe {
            self.raw.queue_submit2(queue.raw, &submit, vk::Fence::null())
        })?;
        drop(locked);
        queue.submitted = value;
        Ok(Ticket(value))
    }
}

/// Returns a semaphore value for all stages.
pub(crate) fn semaphore(semaphore: vk::Semaphore, value: u64) -> vk::SemaphoreSubmitInfo<'static> {
    vk::SemaphoreSubmitInfo::default()
        .semaphore(semaphore)
        .value(value)
        .stage_mask(vk::PipelineStageFlags2::ALL_COMMANDS)
}
