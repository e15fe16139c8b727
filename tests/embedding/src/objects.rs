//! Buffers and images of a host, with memory of their own.

use super::Host;
use ash::vk;

/// Object of the host with its memory.
pub struct Owned<T> {
    /// Vulkan handle of the object.
    pub raw: T,
    memory: vk::DeviceMemory,
}

/// Subresource range that covers a color image.
pub const COLOR: vk::ImageSubresourceRange = vk::ImageSubresourceRange {
    aspect_mask: vk::ImageAspectFlags::COLOR,
    base_mip_level: 0,
    level_count: 1,
    base_array_layer: 0,
    layer_count: 1,
};

impl Host {
    fn memory(&self, needs: vk::MemoryRequirements, flags: vk::MemoryPropertyFlags) -> vk::DeviceMemory {
        // SAFETY: the device is alive.
        unsafe {
            let all = self.instance.get_physical_device_memory_properties(self.physical);
            let kind = (0..all.memory_type_count).find(|i| {
                needs.memory_type_bits & (1 << i) != 0 && all.memory_types[*i as usize].property_flags.contains(flags)
            });
            let info = vk::MemoryAllocateInfo::default()
                .allocation_size(needs.size)
                .memory_type_index(kind.expect("memory of the kind"));
            self.device.allocate_memory(&info, None).expect("memory")
        }
    }

    /// Creates a buffer of the host in host-visible memory.
    pub fn buffer(&self, bytes: u64) -> Owned<vk::Buffer> {
        let usage = vk::BufferUsageFlags::STORAGE_BUFFER
            | vk::BufferUsageFlags::TRANSFER_SRC
            | vk::BufferUsageFlags::TRANSFER_DST;
        let info = vk::BufferCreateInfo::default().size(bytes).usage(usage);
        // SAFETY: the device is alive; the memory is made for the buffer.
        unsafe {
            let raw = self.device.create_buffer(&info, None).expect("a buffer");
            let needs = self.device.get_buffer_memory_requirements(raw);
            let visible = vk::MemoryPropertyFlags::HOST_VISIBLE | vk::MemoryPropertyFlags::HOST_COHERENT;
            let memory = self.memory(needs, visible);
            self.device.bind_buffer_memory(raw, memory, 0).expect("bound");
            Owned { raw, memory }
        }
    }

    /// Returns the contents of a buffer of [`Host::buffer`].
    ///
    /// The device must no longer use the buffer.
    pub fn read(&self, buffer: &Owned<vk::Buffer>, bytes: u64) -> Vec<u8> {
        let mut data = vec![0; bytes as usize];
        // SAFETY: the memory is host-visible and at least as long.
        unsafe {
            let all = self.device.map_memory(buffer.memory, 0, bytes, vk::MemoryMapFlags::empty()).expect("mapped");
            std::ptr::copy_nonoverlapping(all.cast(), data.as_mut_ptr(), data.len());
            self.device.unmap_memory(buffer.memory);
        }
        data
    }

    /// Fills a buffer of [`Host::buffer`] that the device does not use.
    pub fn write(&self, buffer: &Owned<vk::Buffer>, data: &[u8]) {
        // SAFETY: the memory is host-visible and at least as long.
        unsafe {
            let flags = vk::MemoryMapFlags::empty();
            let all = self.device.map_memory(buffer.memory, 0, data.len() as u64, flags).expect("mapped");
            std::ptr::copy_nonoverlapping(data.as_ptr(), all.cast(), data.len());
            self.device.unmap_memory(buffer.memory);
        }
    }

    /// Creates an image of the host that supports copies both ways and clears.
    pub fn image(&self, size: [u32; 2], format: vk::Format) -> Owned<vk::Image> {
        let info = vk::ImageCreateInfo::default()
            .image_type(vk::ImageType::TYPE_2D)
            .format(format)
            .extent(vk::Extent3D { width: size[0], height: size[1], depth: 1 })
            .mip_levels(1)
            .array_layers(1)
            .samples(vk::SampleCountFlags::TYPE_1)
            .usage(vk::ImageUsageFlags::TRANSFER_SRC | vk::ImageUsageFlags::TRANSFER_DST);
        // SAFETY: the device is alive; the memory is made for the image.
        unsafe {
            let raw = self.device.create_image(&info, None).expect("an image");
            let memory = self.memory(self.device.get_image_memory_requirements(raw), Default::default());
            self.device.bind_image_memory(raw, memory, 0).expect("bound");
            Owned { raw, memory }
        }
    }

    /// Records a layout transition with a full barrier.
    pub fn transition(
        &self,
        commands: vk::CommandBuffer,
        image: vk::Image,
        from: vk::ImageLayout,
        to: vk::ImageLayout,
    ) {
        let barrier = [vk::ImageMemoryBarrier2::default()
            .src_stage_mask(vk::PipelineStageFlags2::ALL_COMMANDS)
            .src_access_mask(vk::AccessFlags2::MEMORY_WRITE)
            .dst_stage_mask(vk::PipelineStageFlags2::ALL_COMMANDS)
            .dst_access_mask(vk::AccessFlags2::MEMORY_READ | vk::AccessFlags2::MEMORY_WRITE)
            .old_layout(from)
            .new_layout(to)
            .src_queue_family_index(vk::QUEUE_FAMILY_IGNORED)
            .dst_queue_family_index(vk::QUEUE_FAMILY_IGNORED)
            .image(image)
            .subresource_range(COLOR)];
        let info = vk::DependencyInfo::default().image_memory_barriers(&barrier);
        // SAFETY: the commands are being recorded.
        unsafe { self.device.cmd_pipeline_barrier2(commands, &info) };
    }

    /// Records a clear of an image in the layout for transfer destinations.
    pub fn clear(&self, commands: vk::CommandBuffer, image: vk::Image, color: [f32; 4]) {
        let value = vk::ClearColorValue { float32: color };
        let layout = vk::ImageLayout::TRANSFER_DST_OPTIMAL;
        // SAFETY: the commands are being recorded; the image is in that layout.
        unsafe { self.device.cmd_clear_color_image(commands, image, layout, &value, &[COLOR]) };
    }

    /// Records a copy into a buffer from an image in the layout for transfer sources.
    pub fn read_image(&self, commands: vk::CommandBuffer, image: vk::Image, size: [u32; 2], into: vk::Buffer) {
        let region = [vk::BufferImageCopy {
            image_subresource: vk::ImageSubresourceLayers {
                aspect_mask: vk::ImageAspectFlags::COLOR,
                mip_level: 0,
                base_array_layer: 0,
                layer_count: 1,
            },
            image_extent: vk::Extent3D { width: size[0], height: size[1], depth: 1 },
            ..Default::default()
        }];
        let layout = vk::ImageLayout::TRANSFER_SRC_OPTIMAL;
        // SAFETY: the commands are being recorded; the buffer is large enough for the image.
        unsafe { self.device.cmd_copy_image_to_buffer(commands, image, layout, into, &region) };
        let barrier = [vk::MemoryBarrier2::default()
            .src_stage_mask(vk::PipelineStageFlags2::COPY)
            .src_access_mask(vk::AccessFlags2::TRANSFER_WRITE)
            .dst_stage_mask(vk::PipelineStageFlags2::HOST)
            .dst_access_mask(vk::AccessFlags2::HOST_READ)];
        // SAFETY: as above.
        unsafe {
            self.device.cmd_pipeline_barrier2(commands, &vk::DependencyInfo::default().memory_barriers(&barrier));
        }
    }

    /// Destroys an image.
    pub fn destroy_image(&self, image: Owned<vk::Image>) {
        // SAFETY: the caller no longer uses the image.
        unsafe {
            self.device.destroy_image(image.raw, None);
            self.device.free_memory(image.memory, None);
        }
    }

    /// Destroys a buffer.
    pub fn destroy_buffer(&self, buffer: Owned<vk::Buffer>) {
        // SAFETY: the caller no longer uses the buffer.
        unsafe {
            self.device.destroy_buffer(buffer.raw, None);
            self.device.free_memory(buffer.memory, None);
        }
    }
}
