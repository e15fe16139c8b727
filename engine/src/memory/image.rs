//! Two-dimensional images: one mip level, one layer, used by copies and as storage images.
//!
//! Promises: an image created here starts in the general layout with undefined contents, and lives until its last
//! handle is dropped. A wrapped image is never destroyed here. The engine does not track layouts at run time: a graph
//! declares entry and exit layouts.

use super::{DeviceBuffer, Location};
use crate::allocator::Backing;
use crate::device::{Busy, DeferredObject, Device, ObjectKind};
use crate::error::{Error, Result};
use crate::format::ImageFormat;
use ash::vk;
use gpu_allocator::MemoryLocation;
use gpu_allocator::vulkan::{Allocation, AllocationCreateDesc, AllocationScheme};
use std::sync::Arc;

/// Image handle; clones share the image.
#[derive(Clone)]
pub struct DeviceImage(pub(crate) Arc<ImageInner>);

/// Vulkan objects of an image. A wrapper of a host's image has no `allocation`.
pub(crate) struct ImageInner {
    pub raw: vk::Image,
    /// Storage image view; absent if the format or usage does not support it.
    pub view: Option<vk::ImageView>,
    /// Width and height.
    pub size: [u32; 2],
    pub format: ImageFormat,
    pub name: String,
    pub allocation: Option<Allocation>,
    /// Owner of image and memory. A host's image is not destroyed with the last handle, but its view is.
    pub backing: Backing,
    pub busy: Busy,
    pub device: Device,
}

impl std::fmt::Debug for DeviceImage {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let [width, height] = self.0.size;
        write!(f, "DeviceImage({:?}, {width}x{height} {})", self.0.name, self.0.format)
    }
}

/// Subresource range of a whole color image.
pub(crate) const WHOLE: vk::ImageSubresourceRange = vk::ImageSubresourceRange {
    aspect_mask: vk::ImageAspectFlags::COLOR,
    base_mip_level: 0,
    level_count: 1,
    base_array_layer: 0,
    layer_count: 1,
};

/// Returns a copy between a whole image and tightly packed bytes.
pub(crate) fn packed_copy(offset: u64, [width, height]: [u32; 2]) -> vk::BufferImageCopy {
    vk::BufferImageCopy {
        buffer_offset: offset,
        image_subresource: vk::ImageSubresourceLayers {
            aspect_mask: vk::ImageAspectFlags::COLOR,
            mip_level: 0,
            base_array_layer: 0,
            layer_count: 1,
        },
        image_extent: vk::Extent3D { width, height, depth: 1 },
        ..Default::default()
    }
}

impl Device {
    /// Returns whether kernels can read and write images of this format.
    pub fn supports_storage_image(&self, format: ImageFormat) -> bool {
        self.info().storage_formats.contains(&format)
    }

    /// Creates an image of `[width, height]` texels in the general layout.
    ///
    /// It supports copies, and storage access if the device supports that for the format ([`DeviceImage::storage`]).
    ///
    /// # Errors
    /// [`Error::ImageSize`] for an unsupported size; [`Error::OutOfMemory`] with name and size.
    pub fn image(&self, name: &str, size: [u32; 2], format: ImageFormat) -> Result<DeviceImage> {
        let shared = &self.0;
        let storage = self.supports_storage_image(format);
        let info = self.image_info(name, size, format)?;
        // SAFETY: the device is alive.
        let raw = shared
            .gate
            .make(ObjectKind::Image, "vkCreateImage", name, || unsafe { shared.raw.create_image(&info, None) })?;
        // From here on, dropping `made` releases everything if a later step fails.
        let mut made = ImageInner {
            raw,
            view: None,
            size,
            format,
            name: name.to_owned(),
            allocation: None,
            backing: Backing::Allocator,
            busy: Busy::default(),
            device: self.clone(),
        };
        shared.memory.count_image();
        made.allocate()?;
        if storage {
            made.make_view()?;
        }
        shared.name(raw, name);
        let image = DeviceImage(Arc::new(made));
        self.to_general(&image)?;
        Ok(image)
    }

    /// Returns the create info of engine images.
    pub(super) fn image_info(
        &self,
        name: &str,
        size: [u32; 2],
        format: ImageFormat,
    ) -> Result<vk::ImageCreateInfo<'static>> {
        let limit = self.info().max_image_size;
        if size.contains(&0) || size.iter().any(|&texels| texels > limit) {
            return Err(Error::ImageSize { what: name.to_owned(), size, limit });
        }
        let mut usage = vk::ImageUsageFlags::TRANSFER_SRC | vk::ImageUsageFlags::TRANSFER_DST;
        if self.supports_storage_image(format) {
            usage |= vk::ImageUsageFlags::STORAGE;
        }
        Ok(vk::ImageCreateInfo::default()
            .image_type(vk::ImageType::TYPE_2D)
            .format(crate::format::raw(format))
            .extent(vk::Extent3D { width: size[0], height: size[1], depth: 1 })
            .mip_levels(1)
            .array_layers(1)
            .samples(vk::SampleCountFlags::TYPE_1)
            .tiling(vk::ImageTiling::OPTIMAL)
            .usage(usage)
            .sharing_mode(vk::SharingMode::EXCLUSIVE)
            .initial_layout(vk::ImageLayout::UNDEFINED))
    }

    /// Transitions a new image to the general layout and waits.
    pub(super) fn to_general(&self, image: &DeviceImage) -> Result<()> {
        let raw = image.0.raw;
        let barrier = [vk::ImageMemoryBarrier2::default()
            .src_stage_mask(vk::PipelineStageFlags2::ALL_COMMANDS)
            // The memory may have been written before.
            .src_access_mask(vk::AccessFlags2::MEMORY_WRITE)
            .dst_stage_mask(vk::PipelineStageFlags2::ALL_COMMANDS)
            .dst_access_mask(vk::AccessFlags2::MEMORY_READ | vk::AccessFlags2::MEMORY_WRITE)
            .old_layout(vk::ImageLayout::UNDEFINED)
            .new_layout(vk::ImageLayout::GENERAL)
            .src_queue_family_index(vk::QUEUE_FAMILY_IGNORED)
            .dst_queue_family_index(vk::QUEUE_FAMILY_IGNORED)
            .image(raw)
            .subresource_range(WHOLE)];
        self.run_now("image layout", &[&image.0.busy], |device, commands| {
            let dependency = vk::DependencyInfo::default().image_memory_barriers(&barrier);
            // SAFETY: the command buffer is being recorded; nothing uses the image yet.
            unsafe { device.cmd_pipeline_barrier2(commands, &dependency) }
        })
    }

    /// Uploads tightly packed texels to a whole image in the general layout and waits.
    ///
    /// # Errors
    /// [`Error::ImageBytes`] if the length of `texels` differs from the image's size; if memory runs out or the
    /// device fails.
    pub fn upload_image(&self, image: &DeviceImage, texels: &[u8]) -> Result<()> {
        if texels.len() as u64 != image.packed_bytes() {
            let (image, expected) = (image.name().to_owned(), image.packed_bytes());
            return Err(Error::ImageBytes { image, provided: texels.len() as u64, expected });
        }
        self.0.memory.lock().activity.uploads += 1;
        let staging = self.buffer("staging (image upload)", image.packed_bytes(), Location::Upload)?;
        staging.write(0, texels)?;
        self.image_copy(image, &staging, true)
    }

    /// Downloads the tightly packed texels of a whole image and waits. The image is in the general layout.
    ///
    /// # Errors
    /// If memory runs out or the device fails.
    pub fn download_image(&self, image: &DeviceImage) -> Result<Vec<u8>> {
        self.0.memory.lock().activity.downloads += 1;
        let staging = self.buffer("staging (image download)", image.packed_bytes(), Location::Readback)?;
        self.image_copy(image, &staging, false)?;
        let mut texels = vec![0; image.packed_bytes() as usize];
        staging.read(0, &mut texels)?;
        Ok(texels)
    }

    fn image_copy(&self, image: &DeviceImage, buffer: &DeviceBuffer, upload: bool) -> Result<()> {
        let busy = [&image.0.busy, &buffer.0.busy];
        let (image, buffer, region) = (&image.0, buffer.0.raw, [packed_copy(0, image.0.size)]);
        self.run_now("image copy", &busy, |device, commands| {
            let layout = vk::ImageLayout::GENERAL;
            // SAFETY: the command buffer is being recorded; the buffer holds the whole packed image, which is in the
            // general layout by the caller's promise.
            unsafe {
                if upload {
                    device.cmd_copy_buffer_to_image(commands, buffer, image.raw, layout, &region);
                } else {
                    device.cmd_copy_image_to_buffer(commands, image.raw, layout, buffer, &region);
                }
            }
        })
    }
}

impl DeviceImage {
    /// Returns width and height.
    pub fn size(&self) -> [u32; 2] {
        self.0.size
    }

    /// Returns the texel format.
    pub fn format(&self) -> ImageFormat {
        self.0.format
    }

    /// Returns the name.
    pub fn name(&self) -> &str {
        &self.0.name
    }

    /// Returns whether kernels can read and write the image.
    pub fn storage(&self) -> bool {
        self.0.view.is_some()
    }

    /// Returns the size of all texels, tightly packed, in bytes.
    pub fn packed_bytes(&self) -> u64 {
        self.0.format.packed_bytes(self.0.size)
    }
}

impl ImageInner {
    /// Allocates and binds memory for the image.
    fn allocate(&mut self) -> Result<()> {
        let shared = &self.device.0;
        // SAFETY: the image was just created from this device.
        let requirements = unsafe { shared.raw.get_image_memory_requirements(self.raw) };
        let desc = AllocationCreateDesc {
            name: &self.name,
            requirements,
            location: MemoryLocation::GpuOnly,
            linear: false,
            allocation_scheme: if requirements.size >= 1 << 20 {
                AllocationScheme::DedicatedImage(self.raw)
            } else {
                AllocationScheme::GpuAllocatorManaged
            },
        };
        let allocation = shared.allocate(&desc)?;
        // SAFETY: the allocation matches this image's requirements and is used by nothing else.
        let bound = shared.gate.call("vkBindImageMemory", &self.name, || unsafe {
            shared.raw.bind_image_memory(self.raw, allocation.memory(), allocation.offset())
        });
        if let Err(error) = bound {
            shared.free(allocation);
            return Err(error);
        }
        shared.memory.lock().add(allocation.size());
        self.allocation = Some(allocation);
        Ok(())
    }

    /// Creates the storage image view.
    pub fn make_view(&mut self) -> Result<()> {
        let info = vk::ImageViewCreateInfo::default()
            .image(self.raw)
            .view_type(vk::ImageViewType::TYPE_2D)
            .format(crate::format::raw(self.format))
            .subresource_range(WHOLE);
        // SAFETY: the image is alive, has this format and storage usage.
        let view = self.device.0.gate.make(ObjectKind::ImageView, "vkCreateImageView", &self.name, || unsafe {
            self.device.0.raw.create_image_view(&info, None)
        })?;
        self.view = Some(view);
        Ok(())
    }
}

impl Drop for ImageInner {
    fn drop(&mut self) {
        // A host's image is not destroyed; the view was created here in any case.
        let raw = (self.backing != Backing::Host).then_some(self.raw);
        let (view, allocation) = (self.view.take(), self.allocation.take());
        let object = DeferredObject::Image { raw, view, allocation, backing: self.backing };
        // As for buffers: busy only if a wait failed.
        self.device.0.dispose(self.busy.ticket(), object);
    }
}
