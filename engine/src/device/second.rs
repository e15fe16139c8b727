//! A second queue for compute, where the device has one.
//!
//! Promises nothing about what runs on it: plans say when either queue waits for the other. Work on it is always waited
//! for by something on the first queue, so that the device's timeline covers it.

use super::external::{Locked, QueueLock};
use super::{ObjectKind, Shared, Ticket};
use crate::error::{Error, Result};
use ash::vk;
use std::sync::{Mutex, PoisonError};

/// What submissions of second lanes signal. It belongs to the device and not to executors: some drivers still touch a
/// semaphore for a moment after the work that waited for it has been seen to end.
#[derive(Default)]
pub(crate) struct SecondTimeline {
    made: Mutex<Option<vk::Semaphore>>,
    submitted: Mutex<u64>,
}

/// The queue itself.
pub(crate) struct Second {
    pub family: u32,
    queue: Mutex<vk::Queue>,
}

/// Where a device would find a second queue: another family that computes, best one that does not draw, or another queue
/// of the first family.
pub(super) fn place(families: &[vk::QueueFamilyProperties], first: u32) -> Option<(u32, u32)> {
    let other = |(index, family): &(usize, &vk::QueueFamilyProperties)| {
        // Passes are timed on both.
        let fits = family.queue_flags.contains(vk::QueueFlags::COMPUTE) && family.timestamp_valid_bits > 0;
        fits && *index as u32 != first
    };
    let mut others: Vec<_> = families.iter().enumerate().filter(other).collect();
    others.sort_by_key(|(_, family)| family.queue_flags.contains(vk::QueueFlags::GRAPHICS));
    let same = families.get(first as usize).filter(|family| family.queue_count > 1).map(|_| (first, 1));
    others.first().map(|(index, _)| (*index as u32, 0)).or(same)
}

/// The queues to make a device with.
pub(super) fn queues(first: u32, second: Option<(u32, u32)>) -> Vec<vk::DeviceQueueCreateInfo<'static>> {
    let of = |family, priorities| {
        vk::DeviceQueueCreateInfo::default().queue_family_index(family).queue_priorities(priorities)
    };
    match second {
        Some((family, _)) if family != first => vec![of(first, &[1.0]), of(family, &[1.0])],
        Some(_) => vec![of(first, &[1.0, 1.0])],
        None => vec![of(first, &[1.0])],
    }
}

impl Second {
    /// Takes the queue that the device was made with.
    pub(super) fn new(device: &ash::Device, (family, index): (u32, u32)) -> Second {
        // SAFETY: the queue was created with the device.
        Second { family, queue: Mutex::new(unsafe { device.get_device_queue(family, index) }) }
    }
}

impl Shared {
    /// The families that buffers are shared between.
    pub fn families(&self) -> Vec<u32> {
        let second = self.second.iter().map(|second| second.family).filter(|&family| family != self.queue_family);
        std::iter::once(self.queue_family).chain(second).collect()
    }

    /// The timeline of second lanes, made when it is first asked for.
    pub fn second_timeline(&self) -> Result<vk::Semaphore> {
        let mut made = self.second_timeline.made.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(timeline) = *made {
            return Ok(timeline);
        }
        let mut kind = vk::SemaphoreTypeCreateInfo::default().semaphore_type(vk::SemaphoreType::TIMELINE);
        let info = vk::SemaphoreCreateInfo::default().push_next(&mut kind);
        // SAFETY: the device is alive and has timeline semaphores.
        let timeline = self.gate.make(ObjectKind::Semaphore, "vkCreateSemaphore", "second timeline", || unsafe {
            self.raw.create_semaphore(&info, None)
        })?;
        self.name(timeline, "second timeline");
        *made = Some(timeline);
        Ok(timeline)
    }

    /// Gives it back; all work is done.
    pub(super) fn destroy_second_timeline(&self) {
        let made = self.second_timeline.made.lock().unwrap_or_else(PoisonError::into_inner).take();
        if let Some(timeline) = made {
            // SAFETY: nothing uses it any more.
            unsafe { self.raw.destroy_semaphore(timeline, None) };
            self.gate.gone(ObjectKind::Semaphore);
        }
    }

    /// Submits to the second queue, or to the first in its place; returns the value of the second timeline at its end.
    pub fn submit_second(
        &self,
        commands: vk::CommandBuffer,
        waits: &[vk::SemaphoreSubmitInfo<'_>],
        what: &str,
    ) -> Result<u64> {
        let timeline = self.second_timeline()?;
        let mut submitted = self.second_timeline.submitted.lock().unwrap_or_else(PoisonError::into_inner);
        let value = *submitted + 1;
        let signal = semaphore(timeline, value);
        let result = match &self.second {
            Some(second) => {
                let queue = second.queue.lock().unwrap_or_else(PoisonError::into_inner);
                self.submit_to(*queue, None, commands, waits, &[signal], what)
            }
            None => {
                let queue = self.queue();
                self.submit_to(queue.raw, queue.lock.as_deref(), commands, waits, &[signal], what)
            }
        };
        result?;
        *submitted = value;
        Ok(value)
    }

    /// Submits to a queue that the caller has locked; `lock` is its host's, if it is a host's.
    pub(super) fn submit_to(
        &self,
        queue: vk::Queue,
        lock: Option<&dyn QueueLock>,
        commands: vk::CommandBuffer,
        waits: &[vk::SemaphoreSubmitInfo<'_>],
        signals: &[vk::SemaphoreSubmitInfo<'_>],
        what: &str,
    ) -> Result<()> {
        if queue == vk::Queue::null() {
            return Err(Error::NoQueue(what.to_owned()));
        }
        let buffers = [vk::CommandBufferSubmitInfo::default().command_buffer(commands)];
        let submit = [vk::SubmitInfo2::default()
            .wait_semaphore_infos(waits)
            .command_buffer_infos(&buffers)
            .signal_semaphore_infos(signals)];
        let _locked = lock.map(Locked::new);
        // SAFETY: the command buffer is recorded and not pending (its owner waits for its ticket first); the queue is
        // locked, a host's by the host's own lock too. What our own timelines are waited for was submitted before, and they
        // only grow; other semaphores are in order by the word of whoever gave them.
        self.gate.call("vkQueueSubmit2", what, || unsafe { self.raw.queue_submit2(queue, &submit, vk::Fence::null()) })
    }

    /// A point on the timeline, to be waited for by other submissions.
    pub fn point(&self, ticket: Ticket) -> vk::SemaphoreSubmitInfo<'static> {
        semaphore(self.timeline, ticket.0)
    }
}

/// A value of a timeline semaphore, for everything.
pub(crate) fn semaphore(semaphore: vk::Semaphore, value: u64) -> vk::SemaphoreSubmitInfo<'static> {
    vk::SemaphoreSubmitInfo::default()
        .semaphore(semaphore)
        .value(value)
        .stage_mask(vk::PipelineStageFlags2::ALL_COMMANDS)
}

#[cfg(test)]
mod tests {
    use super::place;
    use ash::vk;

    fn family(queue_flags: vk::QueueFlags, queue_count: u32, timestamp_valid_bits: u32) -> vk::QueueFamilyProperties {
        vk::QueueFamilyProperties { queue_flags, queue_count, timestamp_valid_bits, ..Default::default() }
    }

    #[test]
    fn a_family_of_its_own_is_best() {
        let (all, compute) = (vk::QueueFlags::GRAPHICS | vk::QueueFlags::COMPUTE, vk::QueueFlags::COMPUTE);
        let transfer = family(vk::QueueFlags::TRANSFER, 2, 64);
        assert_eq!(place(&[family(all, 16, 64), transfer, family(compute, 8, 64)], 0), Some((2, 0)));
        assert_eq!(place(&[family(all, 16, 64), transfer, family(compute, 8, 0)], 0), Some((0, 1)), "it has no clock");
        assert_eq!(place(&[family(all, 1, 64)], 0), None);
        assert_eq!(place(&[family(all, 1, 64), family(all, 1, 64)], 1), Some((0, 0)));
    }
}
