//! Deferred destruction of objects that the GPU may still use after a failed wait.
//!
//! Promises: an object is destroyed only after the timeline has passed its last use, and at the latest when the
//! device closes. A successful wait defers nothing; the check then costs one relaxed load. See
//! docs/adr/0012-failure-on-purpose.md.

use super::{Device, ObjectKind, Shared, Ticket};
use crate::allocator::Backing;
use ash::vk;
use gpu_allocator::vulkan::Allocation;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};

/// Vulkan object whose owner is gone.
pub(crate) enum DeferredObject {
    Buffer { raw: vk::Buffer, allocation: Option<Allocation>, bytes: u64, backing: Backing },
    Image { raw: Option<vk::Image>, view: Option<vk::ImageView>, allocation: Option<Allocation>, backing: Backing },
    CommandPool(vk::CommandPool),
    DescriptorPool(vk::DescriptorPool),
    QueryPool(vk::QueryPool),
}

/// Objects that wait for a point on the timeline.
#[derive(Default)]
pub(crate) struct DeferredDestruction {
    entries: Mutex<Vec<(Ticket, DeferredObject)>>,
    count: AtomicUsize,
}

/// Last possible use of a buffer or image. Set only after a failed wait; otherwise the owner knows.
#[derive(Debug, Default)]
pub(crate) struct Busy(AtomicU64);

impl Busy {
    /// Extends the possible use to `ticket`.
    pub fn until(&self, ticket: Ticket) {
        self.0.fetch_max(ticket.0, Ordering::Relaxed);
    }

    pub fn ticket(&self) -> Ticket {
        Ticket(self.0.load(Ordering::Relaxed))
    }
}

impl Device {
    /// Destroys deferred objects whose work is done. Returns the number of objects still deferred.
    ///
    /// Creating a buffer calls this.
    pub fn collect(&self) -> usize {
        self.0.collect()
    }
}

impl Shared {
    /// Destroys an object whose last use is at most `ticket`: now, or once the timeline has passed it.
    pub fn dispose(&self, ticket: Ticket, object: DeferredObject) {
        if ticket == Ticket(0) || self.has_passed(ticket) {
            self.destroy(object);
            return;
        }
        let mut entries = self.deferred.entries.lock().unwrap_or_else(PoisonError::into_inner);
        entries.push((ticket, object));
        self.deferred.count.store(entries.len(), Ordering::Relaxed);
    }

    pub fn collect(&self) -> usize {
        if self.deferred.count.load(Ordering::Relaxed) == 0 {
            return 0;
        }
        let mut entries = self.deferred.entries.lock().unwrap_or_else(PoisonError::into_inner);
        let latest = entries.iter().map(|(ticket, _)| *ticket).max();
        // Usually all work is done, which takes one query.
        let all = latest.is_some_and(|t| self.has_passed(t));
        let (done, wait): (Vec<_>, Vec<_>) = entries.drain(..).partition(|(t, _)| all || self.has_passed(*t));
        *entries = wait;
        let left = entries.len();
        self.deferred.count.store(left, Ordering::Relaxed);
        drop(entries);
        for (_, object) in done {
            self.destroy(object);
        }
        left
    }

    /// Destroys all deferred objects. All work is done.
    pub(super) fn clear_deferred(&self) {
        let entries = std::mem::take(&mut *self.deferred.entries.lock().unwrap_or_else(PoisonError::into_inner));
        self.deferred.count.store(0, Ordering::Relaxed);
        for (_, object) in entries {
            self.destroy(object);
        }
    }

    /// Returns whether the timeline has passed a ticket; false if unknown.
    fn has_passed(&self, ticket: Ticket) -> bool {
        // SAFETY: the semaphore belongs to this device.
        let value = self.gate.call("vkGetSemaphoreCounterValue", "parked objects", || unsafe {
            self.raw.get_semaphore_counter_value(self.timeline)
        });
        value.is_ok_and(|value| value >= ticket.0)
    }

    fn destroy(&self, object: DeferredObject) {
        let count_destroyed = |kind| self.gate.count_destroyed(kind);
        // SAFETY: the objects were created from this device; the caller knows that no work uses them, and this value
        // is their only owner.
        unsafe {
            match object {
                DeferredObject::Buffer { raw, allocation, bytes, backing } => {
                    self.raw.destroy_buffer(raw, None);
                    count_destroyed(ObjectKind::Buffer);
                    self.memory.count_destroyed_buffer(bytes);
                    self.free_backing(backing);
                    allocation.into_iter().for_each(|a| self.free(a));
                }
                DeferredObject::Image { raw, view, allocation, backing } => {
                    if let Some(view) = view {
                        self.raw.destroy_image_view(view, None);
                        count_destroyed(ObjectKind::ImageView);
                    }
                    if let Some(raw) = raw {
                        self.raw.destroy_image(raw, None);
                        count_destroyed(ObjectKind::Image);
                        let shared = if let Backing::Shared(_, bytes) = backing { bytes } else { 0 };
                        self.memory.count_destroyed_image(allocation.as_ref().map_or(shared, Allocation::size));
                        self.free_backing(backing);
                    }
                    allocation.into_iter().for_each(|a| self.free(a));
                }
                DeferredObject::CommandPool(raw) => {
                    self.raw.destroy_command_pool(raw, None);
                    count_destroyed(ObjectKind::CommandPool);
                }
                DeferredObject::DescriptorPool(raw) => {
                    self.raw.destroy_descriptor_pool(raw, None);
                    count_destroyed(ObjectKind::DescriptorPool);
                }
                DeferredObject::QueryPool(raw) => {
                    self.raw.destroy_query_pool(raw, None);
                    count_destroyed(ObjectKind::QueryPool);
                }
            }
        }
    }
}
