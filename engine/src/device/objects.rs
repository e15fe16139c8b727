//! Counts of live Vulkan objects by kind.
//!
//! Promises: the counts outlive the device, so leaked objects remain visible. The validation layer names the leaked
//! objects.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// Kinds of counted objects.
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
    /// Memory allocations, dedicated or sub-allocated.
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

/// Counters of live objects, shared by clones.
///
/// Pass a clone as [`super::DeviceOptions::objects`] to find leaks after the device is dropped.
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

    /// Returns the number of live objects of a kind.
    pub fn count(&self, kind: ObjectKind) -> u64 {
        self.0[kind as usize].load(Ordering::Relaxed)
    }

    /// Returns the number of live objects of all kinds.
    pub fn total(&self) -> u64 {
        ObjectKind::ALL.into_iter().map(|k| self.count(k)).sum()
    }

    /// Returns the kinds with live objects, and their counts.
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
    fn leaked_objects_stay_counted() {
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
