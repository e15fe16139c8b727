//! Two-dimensional images: one mip level, one layer, reached by kernels as storage images and by copies.
//!
//! Promises: an image that the engine makes is in the general layout from the start, holds nothing defined, and lives as
//! long as its last handle; one that wraps somebody else's is never destroyed here. The engine does not track layouts at
//! run time: a graph states the layout that it finds and the one that it leaves.

use super::{Backing, DeviceBuffer, Location};
use crate::device::{Busy, Device, ObjectKind, Parked};
use crate::error::{Error, Result};
use crate::format::ImageFormat;
use ash::vk;
use gpu_allocator::MemoryLocation;
use gpu_allocator::vulkan::{Allocation, AllocationCreateDesc, AllocationScheme};
use std::sync::Arc;

/// An image; clones share it.
#[derive(Clone)]
pub struct DeviceImage(pub(crate) Arc<ImageInner>);

/// The Vulkan side of an image. A wrapper around a host's image fills in what it knows and leaves `allocation` empty.
pub(crate) struct ImageInner {
    pub raw: vk::Image,
    /// For binding as a storage image; absent where the format or the image's usage forbids that.
    pub view: Option<vk::ImageView>,
    /// Width and height.
    pub size: [u32; 2],
    pub format: ImageFormat,
    pub name: String,
    pub allocation: Option<Allocation>,
    /// Whose image and memory are; a host's image is not destroyed with the last handle, its view is.
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

/// All of a color image.
pub(crate) const WHOLE: vk::ImageSubresourceRange = vk::ImageSubresourceRange {
    aspect_mask: vk::ImageAspectFlags::COLOR,
    base_mip_level: 0,
    level_count: 1,
    base_array_layer: 0,
    layer_count: 1,
};

/// A copy between all of an image and tightly packed bytes.
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
    /// Whether kernels can read and write images of this format.
    pub fn supports_storage_image(&self, format: ImageFormat) -> bool {
        self.info().storage_formats.contains(&format)
    }

    /// Makes an image of `[width, height]` texels in the general layout. It can be copied from and to, and bound as a
    /// storage image where the device has that for the format ([`DeviceImage::storage`]).
    ///
    /// # Errors
    /// [`Error::ImageSize`] for a size that the device does not have, [`Error::OutOfMemory`] with name and size.
    pub fn image(&self, name: &str, size: [u32; 2], format: ImageFormat) -> Result<DeviceImage> {
        let shared = &self.0;
        let storage = self.supports_storage_image(format);
        let info = self.image_info(name, size, format)?;
        // SAFETY: the device is alive.
        let raw = shared
            .gate
            .make(ObjectKind::Image, "vkCreateImage", name, || unsafe { shared.raw.create_image(&info, None) })?;
        // From here on `made` gives everything back if a later step fails.
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

    /// How our images are made.
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
            .format(format.raw())
            .extent(vk::Extent3D { width: size[0], height: size[1], depth: 1 })
            .mip_levels(1)
            .array_layers(1)
            .samples(vk::SampleCountFlags::TYPE_1)
            .tiling(vk::ImageTiling::OPTIMAL)
            .usage(usage)
            .sharing_mode(vk::SharingMode::EXCLUSIVE)
            .initial_layout(vk::ImageLayout::UNDEFINED))
    }

    /// Brings a new image into the general layout and waits.
    pub(super) fn to_general(&self, image: &DeviceImage) -> Result<()> {
        let raw = image.0.raw;
        let barrier = [vk::ImageMemoryBarrier2::default()
            .src_stage_mask(vk::PipelineStageFlags2::ALL_COMMANDS)
            // What was in this memory before may have been written.
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

    /// Writes tightly packed texels over a whole image in the general layout and waits.
    ///
    /// # Errors
    /// [`Error::ImageBytes`] unless `texels` is exactly as long as the image; if memory runs out or the device fails.
    pub fn upload_image(&self, image: &DeviceImage, texels: &[u8]) -> Result<()> {
        if texels.len() as u64 != image.packed_bytes() {
            let (image, expected) = (image.name().to_owned(), image.packed_bytes());
            return Err(Error::ImageBytes { image, given: texels.len() as u64, expected });
        }
        self.0.memory.lock().activity.uploads += 1;
        let staging = self.buffer("staging (image upload)", image.packed_bytes(), Location::Upload)?;
        staging.write(0, texels)?;
        self.image_copy(image, &staging, true)
    }

    /// Reads the tightly packed texels of a whole image in the general layout and waits.
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
            // general layout by the caller's word.
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
    /// Width and height.
    pub fn size(&self) -> [u32; 2] {
        self.0.size
    }

    /// What its texels are.
    pub fn format(&self) -> ImageFormat {
        self.0.format
    }

    /// Its name.
    pub fn name(&self) -> &str {
        &self.0.name
    }

    /// Whether kernels can read and write it; otherwise only copies can.
    pub fn storage(&self) -> bool {
        self.0.view.is_some()
    }

    /// Bytes of all its texels, tightly packed.
    pub fn packed_bytes(&self) -> u64 {
        self.0.format.packed_bytes(self.0.size)
    }
}

impl ImageInner {
    /// Puts memory of its own behind the image.
    fn allocate(&mut self) -> Result<()> {
        let shared = &self.device.0;
        // SAFETY: the image was just made from this device.
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
        // SAFETY: the allocation was made for this image's requirements and is used by nothing else.
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

    /// Makes the view through which kernels see the image.
    pub fn make_view(&mut self) -> Result<()> {
        let info = vk::ImageViewCreateInfo::default()
            .image(self.raw)
            .view_type(vk::ImageViewType::TYPE_2D)
            .format(self.format.raw())
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
        // An image that belongs to somebody else is left alone; the view was made here in any case.
        let raw = (self.backing != Backing::Host).then_some(self.raw);
        let (view, allocation) = (self.view.take(), self.allocation.take());
        let thing = Parked::Image { raw, view, allocation, backing: self.backing };
        // As for buffers: busy only if a wait failed.
        self.device.0.dispose(self.busy.ticket(), thing);
    }
}
