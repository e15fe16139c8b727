//! How many Vulkan objects of each kind a device has alive.
//!
//! Promises: the counts outlive the device, so that what was never given back shows. Leaves naming the culprits to the
//! validation layer.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// Kinds of objects that are counted.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[allow(missing_docs)] // The names are Vulkan's.
#[repr(usize)]
pub enum ObjectKind {
    Instance,
    Messenger,
    Device,
    Semaphore,
    Fence,
    Buffer,
    Image,
    ImageView,
    Sampler,
    /// Allocations of memory, whether they have a block of their own or share one.
    Memory,
    PipelineCache,
    Pipeline,
    PipelineLayout,
    SetLayout,
    ShaderModule,
    CommandPool,
    DescriptorPool,
    QueryPool,
    Surface,
    Swapchain,
}

impl ObjectKind {
    /// All kinds.
    pub const ALL: [ObjectKind; 20] = [
        ObjectKind::Instance,
        ObjectKind::Messenger,
        ObjectKind::Device,
        ObjectKind::Semaphore,
        ObjectKind::Fence,
        ObjectKind::Buffer,
        ObjectKind::Image,
        ObjectKind::ImageView,
        ObjectKind::Sampler,
        ObjectKind::Memory,
        ObjectKind::PipelineCache,
        ObjectKind::Pipeline,
        ObjectKind::PipelineLayout,
        ObjectKind::SetLayout,
        ObjectKind::ShaderModule,
        ObjectKind::CommandPool,
        ObjectKind::DescriptorPool,
        ObjectKind::QueryPool,
        ObjectKind::Surface,
        ObjectKind::Swapchain,
    ];
}

/// Counts of live objects; clones count together. Give one to [`super::DeviceOptions::objects`] to see what is left after
/// the device is gone.
#[derive(Clone, Debug, Default)]
pub struct Objects(Arc<[AtomicU64; ObjectKind::ALL.len()]>);

impl Objects {
    pub(crate) fn add(&self, kind: ObjectKind) {
        self.0[kind as usize].fetch_add(1, Ordering::Relaxed);
    }

    pub(crate) fn remove(&self, kind: ObjectKind) {
        let before = self.0[kind as usize].fetch_sub(1, Ordering::Relaxed);
        debug_assert!(before > 0, "{kind:?} destroyed more often than made");
    }

    /// How many of a kind are alive.
    pub fn count(&self, kind: ObjectKind) -> u64 {
        self.0[kind as usize].load(Ordering::Relaxed)
    }

    /// How many are alive in all.
    pub fn total(&self) -> u64 {
        ObjectKind::ALL.into_iter().map(|k| self.count(k)).sum()
    }

    /// The kinds of which any are alive, with their counts.
    pub fn alive(&self) -> Vec<(ObjectKind, u64)> {
        ObjectKind::ALL.into_iter().map(|k| (k, self.count(k))).filter(|(_, n)| *n > 0).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn kinds_are_numbered_in_order() {
        for (i, kind) in ObjectKind::ALL.into_iter().enumerate() {
            assert_eq!(kind as usize, i);
        }
    }

    #[test]
    fn what_is_not_given_back_shows() {
        let objects = Objects::default();
        let seen = objects.clone();
        objects.add(ObjectKind::Buffer);
        objects.add(ObjectKind::Memory);
        objects.remove(ObjectKind::Buffer);
        drop(objects);
        assert_eq!(seen.alive(), [(ObjectKind::Memory, 1)]);
        assert_eq!(seen.total(), 1);
    }
}
