//! What the GPU may still use after a wait for it has failed.
//!
//! Promises: nothing is destroyed before the work that uses it has passed on the timeline, and nothing is lost: what was
//! parked is destroyed at the next chance after that, at the latest when the device closes. A wait that succeeds parks
//! nothing, so that in good times this costs one relaxed load. See docs/adr/0012-failure-on-purpose.md.

use super::{Device, ObjectKind, Shared, Ticket};
use crate::memory::Backing;
use ash::vk;
use gpu_allocator::vulkan::Allocation;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};

/// A Vulkan object without its owner.
pub(crate) enum Parked {
    Buffer { raw: vk::Buffer, allocation: Option<Allocation>, bytes: u64, backing: Backing },
    Image { raw: Option<vk::Image>, view: Option<vk::ImageView>, allocation: Option<Allocation>, backing: Backing },
    CommandPool(vk::CommandPool),
    DescriptorPool(vk::DescriptorPool),
    QueryPool(vk::QueryPool),
}

/// Objects that wait for a point on the timeline.
#[derive(Default)]
pub(crate) struct Parking {
    things: Mutex<Vec<(Ticket, Parked)>>,
    count: AtomicUsize,
}

/// Until when a buffer or image may be in use. Set only when a wait has failed: as long as waits succeed, owners know.
#[derive(Debug, Default)]
pub(crate) struct Busy(AtomicU64);

impl Busy {
    /// It may be in use until then.
    pub fn until(&self, ticket: Ticket) {
        self.0.fetch_max(ticket.0, Ordering::Relaxed);
    }

    pub fn ticket(&self) -> Ticket {
        Ticket(self.0.load(Ordering::Relaxed))
    }
}

impl Device {
    /// Destroys what had to be kept because a wait failed, as far as its work is done by now. Returns how many objects
    /// still wait. Making a buffer does this by itself.
    pub fn collect(&self) -> usize {
        self.0.collect()
    }
}

impl Shared {
    /// Destroys a thing that is in use until `ticket` at the latest: now, or when that has passed.
    pub fn dispose(&self, ticket: Ticket, thing: Parked) {
        if ticket == Ticket(0) || self.passed(ticket) {
            self.destroy(thing);
            return;
        }
        let mut things = self.parking.things.lock().unwrap_or_else(PoisonError::into_inner);
        things.push((ticket, thing));
        self.parking.count.store(things.len(), Ordering::Relaxed);
    }

    pub fn collect(&self) -> usize {
        if self.parking.count.load(Ordering::Relaxed) == 0 {
            return 0;
        }
        let mut things = self.parking.things.lock().unwrap_or_else(PoisonError::into_inner);
        let latest = things.iter().map(|(ticket, _)| *ticket).max();
        // Mostly all of it is done, which takes one question.
        let all = latest.is_some_and(|t| self.passed(t));
        let (done, wait): (Vec<_>, Vec<_>) = things.drain(..).partition(|(t, _)| all || self.passed(*t));
        *things = wait;
        let left = things.len();
        self.parking.count.store(left, Ordering::Relaxed);
        drop(things);
        for (_, thing) in done {
            self.destroy(thing);
        }
        left
    }

    /// Destroys everything parked. All work is done.
    pub(super) fn clear_parking(&self) {
        let things = std::mem::take(&mut *self.parking.things.lock().unwrap_or_else(PoisonError::into_inner));
        self.parking.count.store(0, Ordering::Relaxed);
        for (_, thing) in things {
            self.destroy(thing);
        }
    }

    /// Whether the timeline has certainly passed a ticket. When in doubt it has not.
    fn passed(&self, ticket: Ticket) -> bool {
        // SAFETY: the semaphore belongs to this device.
        let value = self.gate.call("vkGetSemaphoreCounterValue", "parked objects", || unsafe {
            self.raw.get_semaphore_counter_value(self.timeline)
        });
        value.is_ok_and(|value| value >= ticket.0)
    }

    fn destroy(&self, thing: Parked) {
        let gone = |kind| self.gate.gone(kind);
        // SAFETY: the things were made from this device; the caller knows that no work uses them any more, and `Parked`
        // is their only owner.
        unsafe {
            match thing {
                Parked::Buffer { raw, allocation, bytes, backing } => {
                    self.raw.destroy_buffer(raw, None);
                    gone(ObjectKind::Buffer);
                    self.memory.buffer_gone(bytes);
                    self.free_backing(backing);
                    allocation.into_iter().for_each(|a| self.free(a));
                }
                Parked::Image { raw, view, allocation, backing } => {
                    if let Some(view) = view {
                        self.raw.destroy_image_view(view, None);
                        gone(ObjectKind::ImageView);
                    }
                    if let Some(raw) = raw {
                        self.raw.destroy_image(raw, None);
                        gone(ObjectKind::Image);
                        let shared = if let Backing::Shared(_, bytes) = backing { bytes } else { 0 };
                        self.memory.image_gone(allocation.as_ref().map_or(shared, Allocation::size));
                        self.free_backing(backing);
                    }
                    allocation.into_iter().for_each(|a| self.free(a));
                }
                Parked::CommandPool(raw) => {
                    self.raw.destroy_command_pool(raw, None);
                    gone(ObjectKind::CommandPool);
                }
                Parked::DescriptorPool(raw) => {
                    self.raw.destroy_descriptor_pool(raw, None);
                    gone(ObjectKind::DescriptorPool);
                }
                Parked::QueryPool(raw) => {
                    self.raw.destroy_query_pool(raw, None);
                    gone(ObjectKind::QueryPool);
                }
            }
        }
    }
}
