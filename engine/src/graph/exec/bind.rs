//! Descriptor sets: from the plan's slices to Vulkan buffer ranges.

use super::{Executor, Slot};
use crate::device::{ObjectKind, Pipeline, descriptor_type};
use crate::error::{Error, Result};
use crate::graph::{BufferKind, PassKind, Slice};
use crate::shader::BindingKind;
use ash::vk;

impl Executor {
    /// A pool with exactly as many descriptors as the plan's passes need.
    pub(super) fn descriptor_pool(&self) -> Result<vk::DescriptorPool> {
        let (mut sets, mut storage, mut uniform) = (0, 0, 0);
        for pass in &self.plan.passes {
            if let PassKind::Compute { shader, .. } = &pass.kind {
                sets += 1;
                uniform += shader.bindings.iter().filter(|b| b.kind == BindingKind::Uniform).count() as u32;
                storage += shader.bindings.iter().filter(|b| b.kind == BindingKind::Storage).count() as u32;
            }
        }
        let sizes = [
            vk::DescriptorPoolSize { ty: vk::DescriptorType::STORAGE_BUFFER, descriptor_count: storage.max(1) },
            vk::DescriptorPoolSize { ty: vk::DescriptorType::UNIFORM_BUFFER, descriptor_count: uniform.max(1) },
        ];
        let info = vk::DescriptorPoolCreateInfo::default().max_sets(sets.max(1)).pool_sizes(&sizes);
        // SAFETY: the device is alive.
        self.device.0.gate.make(ObjectKind::DescriptorPool, "vkCreateDescriptorPool", &self.plan.name, || unsafe {
            self.device.0.raw.create_descriptor_pool(&info, None)
        })
    }

    /// The buffer and byte offset behind a slice.
    pub(super) fn resolve(&self, slot: &Slot, slice: &Slice) -> Result<(vk::Buffer, u64)> {
        let index = slice.buffer.index();
        let info = &self.plan.buffers[index];
        let unbound = || Error::Unbound { buffer: info.name.clone(), plan: self.plan.name.clone() };
        let (memory, base) = match info.kind {
            BufferKind::External => (self.externals[index].as_ref().ok_or_else(unbound)?, 0),
            BufferKind::Uniform => (slot.uniforms.as_ref().ok_or_else(unbound)?, self.uniform_offsets[index]),
            BufferKind::Transient => {
                (self.arena.as_ref().ok_or_else(unbound)?, self.plan.placements[index].ok_or_else(unbound)?)
            }
        };
        Ok((memory.0.raw, base + slice.offset))
    }

    /// A written descriptor set for one pass.
    pub(super) fn descriptor_set(
        &self,
        slot: &Slot,
        pipeline: &Pipeline,
        shader: &crate::shader::Shader,
        bindings: &[(u32, Slice)],
    ) -> Result<vk::DescriptorSet> {
        let raw = &self.device.0.raw;
        let layouts = [pipeline.set_layout];
        let info = vk::DescriptorSetAllocateInfo::default().descriptor_pool(slot.descriptors).set_layouts(&layouts);
        // SAFETY: the pool has room for one set of every pass and was reset before recording.
        let set = self
            .device
            .0
            .gate
            .call("vkAllocateDescriptorSets", &shader.name, || unsafe { raw.allocate_descriptor_sets(&info) })?[0];
        let mut buffers = Vec::with_capacity(bindings.len());
        for (_, slice) in bindings {
            let (buffer, offset) = self.resolve(slot, slice)?;
            buffers.push([vk::DescriptorBufferInfo { buffer, offset, range: slice.bytes }]);
        }
        let writes: Vec<_> = bindings
            .iter()
            .zip(&buffers)
            .map(|((number, _), info)| {
                let kind =
                    shader.bindings.iter().find(|b| b.number == *number).map_or(BindingKind::Storage, |b| b.kind);
                vk::WriteDescriptorSet::default()
                    .dst_set(set)
                    .dst_binding(*number)
                    .descriptor_type(descriptor_type(kind))
                    .buffer_info(info)
            })
            .collect();
        // SAFETY: the set is not in use; every range lies inside a live buffer, as the plan and `bind` checked.
        unsafe { raw.update_descriptor_sets(&writes, &[]) };
        Ok(set)
    }
}
