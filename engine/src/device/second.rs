//! Second compute queue, where the device has one.
//!
//! Plans state when either queue waits for the other. The first queue always waits for work on the second, so that
//! the device's timeline covers both.

use super::external::{Locked, QueueLock};
use super::{ObjectKind, Shared, Ticket};
use crate::error::{Error, Result};
use ash::vk;
use std::sync::{Mutex, PoisonError};

/// Timeline that submissions to the second lane signal.
///
/// Belongs to the device, not to executors: some drivers still access a semaphore shortly after the work that waited
/// for it has ended.
#[derive(Default)]
pub(crate) struct SecondTimeline {
    handle: Mutex<Option<vk::Semaphore>>,
    submitted: Mutex<u64>,
}

/// Second queue of a device.
pub(crate) struct SecondQueue {
    pub family: u32,
    queue: Mutex<vk::Queue>,
}

/// Finds family and index of a second queue.
///
/// Prefers another compute family, without graphics if possible; otherwise another queue of the first family.
pub(super) fn find_second_queue(families: &[vk::QueueFamilyProperties], first: u32) -> Option<(u32, u32)> {
    let other = |(index, family): &(usize, &vk::QueueFamilyProperties)| {
        // Passes are timed on both queues.
        let fits = family.queue_flags.contains(vk::QueueFlags::COMPUTE) && family.timestamp_valid_bits > 0;
        fits && *index as u32 != first
    };
    let mut others: Vec<_> = families.iter().enumerate().filter(other).collect();
    others.sort_by_key(|(_, family)| family.queue_flags.contains(vk::QueueFlags::GRAPHICS));
    let same = families.get(first as usize).filter(|family| family.queue_count > 1).map(|_| (first, 1));
    others.first().map(|(index, _)| (*index as u32, 0)).or(same)
}

/// Returns the queue create infos of a device.
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

impl SecondQueue {
    /// Takes the queue that was created with the device.
    pub(super) fn new(device: &ash::Device, (family, index): (u32, u32)) -> SecondQueue {
        // SAFETY: the queue was created with the device.
        SecondQueue { family, queue: Mutex::new(unsafe { device.get_device_queue(family, index) }) }
    }
}

impl Shared {
    /// Returns the queue families that share buffers.
    pub fn families(&self) -> Vec<u32> {
        let second = self.second.iter().map(|second| second.family).filter(|&family| family != self.queue_family);
        std::iter::once(self.queue_family).chain(second).collect()
    }

    /// Returns the timeline of second lanes; creates it on first use.
    pub fn second_timeline(&self) -> Result<vk::Semaphore> {
        let mut handle = self.second_timeline.handle.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(timeline) = *handle {
            return Ok(timeline);
        }
        let mut kind = vk::SemaphoreTypeCreateInfo::default().semaphore_type(vk::SemaphoreType::TIMELINE);
        let info = vk::SemaphoreCreateInfo::default().push_next(&mut kind);
        // SAFETY: the device is alive and has timeline semaphores.
        let timeline = self.gate.make(ObjectKind::Semaphore, "vkCreateSemaphore", "second timeline", || unsafe {
            self.raw.create_semaphore(&info, None)
        })?;
        self.name(timeline, "second timeline");
        *handle = Some(timeline);
        Ok(timeline)
    }

    /// Destroys the second timeline; all work is done.
    pub(super) fn destroy_second_timeline(&self) {
        let handle = self.second_timeline.handle.lock().unwrap_or_else(PoisonError::into_inner).take();
        if let Some(timeline) = handle {
            // SAFETY: nothing uses it any more.
            unsafe { self.raw.destroy_semaphore(timeline, None) };
            self.gate.count_destroyed(ObjectKind::Semaphore);
        }
    }

    /// Submits to the second queue, or to the first if there is no second. Returns the value of the second timeline
    /// at its end.
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

    /// Submits to a queue that the caller has locked; `lock` is the host's lock of a shared queue.
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
        // SAFETY: the command buffer is recorded and not pending (its owner waits for its ticket first). The queue is
        // locked, a host's queue by the host's own lock too. Awaited values of our timelines were submitted before,
        // and timelines only grow; the caller orders all other semaphores.
        self.gate.call("vkQueueSubmit2", what, || unsafe { self.raw.queue_submit2(queue, &submit, vk::Fence::null()) })
    }

    /// Returns a wait for a point on the timeline.
    pub fn point(&self, ticket: Ticket) -> vk::SemaphoreSubmitInfo<'static> {
        semaphore(self.timeline, ticket.0)
    }
}

/// Returns a semaphore value for all stages.
pub(crate) fn semaphore(semaphore: vk::Semaphore, value: u64) -> vk::SemaphoreSubmitInfo<'static> {
    vk::SemaphoreSubmitInfo::default()
        .semaphore(semaphore)
        .value(value)
        .stage_mask(vk::PipelineStageFlags2::ALL_COMMANDS)
}

#[cfg(test)]
mod tests {
    use super::find_second_queue;
    use ash::vk;

    fn family(queue_flags: vk::QueueFlags, queue_count: u32, timestamp_valid_bits: u32) -> vk::QueueFamilyProperties {
        vk::QueueFamilyProperties { queue_flags, queue_count, timestamp_valid_bits, ..Default::default() }
    }

    #[test]
    fn separate_compute_family_is_preferred() {
        let (all, compute) = (vk::QueueFlags::GRAPHICS | vk::QueueFlags::COMPUTE, vk::QueueFlags::COMPUTE);
        let transfer = family(vk::QueueFlags::TRANSFER, 2, 64);
        assert_eq!(find_second_queue(&[family(all, 16, 64), transfer, family(compute, 8, 64)], 0), Some((2, 0)));
        assert_eq!(
            find_second_queue(&[family(all, 16, 64), transfer, family(compute, 8, 0)], 0),
            Some((0, 1)),
            "no timestamps"
        );
        assert_eq!(find_second_queue(&[family(all, 1, 64)], 0), None);
        assert_eq!(find_second_queue(&[family(all, 1, 64), family(all, 1, 64)], 1), Some((0, 0)));
    }
}
