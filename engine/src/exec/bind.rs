//! Descriptor sets of a plan: slices resolved to Vulkan buffer ranges.

use super::{Executor, Slot};
use crate::device::{ObjectKind, Pipeline, descriptor_type};
use crate::error::{Error, Result};
use crate::graph::{BufferKind, Image, ImageMemory, PassKind, Slice};
use crate::memory::DeviceImage;
use crate::shader::BindingKind;
use ash::vk;

impl Executor {
    /// Creates a pool with exactly as many descriptors as the plan needs.
    pub(super) fn descriptor_pool(&self) -> Result<vk::DescriptorPool> {
        let (mut sets, mut storage, mut uniform, mut image) = (0, 0, 0, 0);
        for pass in &self.plan.passes {
            if let PassKind::Compute { shader, .. } = &pass.kind {
                sets += 1;
                for binding in &shader.bindings {
                    match binding.kind {
                        BindingKind::Storage => storage += 1,
                        BindingKind::Uniform => uniform += 1,
                        BindingKind::Image(_) => image += 1,
                    }
                }
            }
        }
        let sizes = [
            vk::DescriptorPoolSize { ty: vk::DescriptorType::STORAGE_BUFFER, descriptor_count: storage.max(1) },
            vk::DescriptorPoolSize { ty: vk::DescriptorType::UNIFORM_BUFFER, descriptor_count: uniform.max(1) },
            vk::DescriptorPoolSize { ty: vk::DescriptorType::STORAGE_IMAGE, descriptor_count: image.max(1) },
        ];
        let info = vk::DescriptorPoolCreateInfo::default().max_sets(sets.max(1)).pool_sizes(&sizes);
        // SAFETY: the device is alive.
        self.device.0.gate.make(ObjectKind::DescriptorPool, "vkCreateDescriptorPool", &self.plan.name, || unsafe {
            self.device.0.raw.create_descriptor_pool(&info, None)
        })
    }

    /// Returns the Vulkan buffer and byte offset of a slice.
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

    /// Returns the image of a handle.
    pub(super) fn image(&self, image: Image) -> Result<&DeviceImage> {
        let info = &self.plan.buffers[image.index()];
        let found = match (info.kind, self.plan.placements[image.index()]) {
            (BufferKind::Transient, Some(slot)) => self.slot_images.get(slot as usize),
            (BufferKind::Transient, None) => None,
            _ => self.images[image.index()].as_ref(),
        };
        found.ok_or_else(|| Error::Unbound { buffer: info.name.clone(), plan: self.plan.name.clone() })
    }

    /// Returns the image of a transition.
    pub(super) fn image_memory(&self, memory: ImageMemory) -> Result<&DeviceImage> {
        match memory {
            ImageMemory::External(image) => self.image(image),
            ImageMemory::Slot(slot) => Ok(&self.slot_images[slot as usize]),
        }
    }

    /// Allocates and writes the descriptor set of a pass, from a pool.
    pub(super) fn descriptor_set(
        &self,
        (slot, pool): (&Slot, vk::DescriptorPool),
        pipeline: &Pipeline,
        shader: &crate::shader::Shader,
        bindings: &[(u32, Slice)],
    ) -> Result<vk::DescriptorSet> {
        let raw = &self.device.0.raw;
        let layouts = [pipeline.set_layout];
        let info = vk::DescriptorSetAllocateInfo::default().descriptor_pool(pool).set_layouts(&layouts);
        // SAFETY: the pool has one set for every pass and was reset before recording.
        let set = self
            .device
            .0
            .gate
            .call("vkAllocateDescriptorSets", &shader.name, || unsafe { raw.allocate_descriptor_sets(&info) })?[0];
        let mut buffers = Vec::with_capacity(bindings.len());
        let mut images = Vec::with_capacity(bindings.len());
        for (_, slice) in bindings {
            let (mut buffer, mut image) = (vk::DescriptorBufferInfo::default(), vk::DescriptorImageInfo::default());
            if self.plan.buffers[slice.buffer.index()].image.is_some() {
                let bound = self.image(Image(slice.buffer))?;
                let refused = || Error::NotStorageImage { image: bound.name().to_owned(), format: bound.format() };
                image.image_view = bound.0.view.ok_or_else(refused)?;
                image.image_layout = vk::ImageLayout::GENERAL;
            } else {
                (buffer.buffer, buffer.offset) = self.resolve(slot, slice)?;
                buffer.range = slice.bytes;
            }
            buffers.push([buffer]);
            images.push([image]);
        }
        let writes: Vec<_> = bindings
            .iter()
            .zip(buffers.iter().zip(&images))
            .map(|((number, _), (buffer, image))| {
                let kind =
                    shader.bindings.iter().find(|b| b.number == *number).map_or(BindingKind::Storage, |b| b.kind);
                vk::WriteDescriptorSet::default()
                    .dst_set(set)
                    .dst_binding(*number)
                    .descriptor_type(descriptor_type(kind))
                    .buffer_info(buffer)
                    .image_info(image)
            })
            .collect();
        // SAFETY: the set is not in use; every range lies inside a live buffer, as the plan and `bind` checked.
        unsafe { raw.update_descriptor_sets(&writes, &[]) };
        Ok(set)
    }
}
