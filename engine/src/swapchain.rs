//! Presentation of images in a window.
//!
//! Promises: copies an image into the window after all earlier submissions. The host waits for the device only if all
//! frame slots are in flight. A resized window is reported as a status, never as an error. Presenting allocates
//! nothing. Plans render into an engine-owned image: swapchain images change with the window size and would each need
//! a recorded plan.

use crate::device::{Device, ObjectKind, Surface, Ticket, semaphore};
use crate::error::{Error, Result};
use crate::format::ImageFormat;
use crate::memory::DeviceImage;
use crate::memory::image::WHOLE;
use ash::{khr, vk};
use std::sync::Arc;

/// Frames in flight.
const FRAMES_IN_FLIGHT: usize = 2;

/// Supported surface formats, best first.
const FORMATS: [ImageFormat; 4] =
    [ImageFormat::Bgra8Unorm, ImageFormat::Rgba8Unorm, ImageFormat::Bgra8Srgb, ImageFormat::Rgba8Srgb];

/// Outcome of [`Swapchain::present`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PresentStatus {
    /// The image is queued for presentation.
    Presented,
    /// The window has changed: call [`Swapchain::recreate`], then present the image again.
    Outdated,
}

/// Swapchain of a window.
pub struct Swapchain {
    device: Device,
    surface: Arc<Surface>,
    api: khr::swapchain::Device,
    format: vk::SurfaceFormatKHR,
    texel_format: ImageFormat,
    size: [u32; 2],
    /// Null while the window has no size.
    raw: vk::SwapchainKHR,
    /// Swapchain images, each with the semaphore of its finished copy.
    images: Vec<(vk::Image, vk::Semaphore)>,
    slots: Vec<Slot>,
    next: usize,
    /// Whether an acquired image was not presented.
    needs_recreate: bool,
}

/// Resources of one frame in flight.
struct Slot {
    pool: vk::CommandPool,
    commands: vk::CommandBuffer,
    acquired: vk::Semaphore,
    ticket: Option<Ticket>,
    /// Source image, until it is copied.
    source: Option<DeviceImage>,
}

impl Swapchain {
    /// Creates a swapchain of about this size; [`Swapchain::size`] returns the exact size.
    ///
    /// # Errors
    /// [`Error::Window`] if the surface supports none of our formats, or no copies; if memory runs out.
    pub fn new(device: &Device, surface: &Arc<Surface>, size: [u32; 2]) -> Result<Swapchain> {
        let shared = &device.0;
        // SAFETY: the surface belongs to the instance of the device.
        let formats = shared.gate.call("vkGetPhysicalDeviceSurfaceFormatsKHR", "window", || unsafe {
            surface.api.get_physical_device_surface_formats(shared.physical, surface.raw)
        })?;
        let srgb = |f: &&vk::SurfaceFormatKHR| f.color_space == vk::ColorSpaceKHR::SRGB_NONLINEAR;
        let fits = |texel_format: ImageFormat| {
            formats
                .iter()
                .filter(srgb)
                .find(|f| f.format == crate::format::raw(texel_format))
                .map(|f| (texel_format, *f))
        };
        let Some((texel_format, format)) = FORMATS.into_iter().find_map(fits) else {
            return Err(Error::Window("its surface supports no 8-bit sRGB format".into()));
        };
        let mut created = Swapchain {
            device: device.clone(),
            surface: surface.clone(),
            api: khr::swapchain::Device::new(&shared.instance.raw, &shared.raw),
            format,
            texel_format,
            size: [0, 0],
            raw: vk::SwapchainKHR::null(),
            images: Vec::new(),
            slots: Vec::new(),
            next: 0,
            needs_recreate: false,
        };
        created.recreate(size)?;
        Ok(created)
    }

    /// Returns width and height; zeros while the window has no size.
    pub fn size(&self) -> [u32; 2] {
        self.size
    }

    /// Returns the format of images to show. 8-bit values are sRGB-encoded in every format.
    pub fn format(&self) -> ImageFormat {
        self.texel_format
    }

    /// Returns whether the window can be presented to; a minimized window cannot.
    pub fn is_open(&self) -> bool {
        self.raw != vk::SwapchainKHR::null()
    }

    /// Recreates the swapchain at the window's current size. Waits for frames in flight.
    ///
    /// # Errors
    /// If the window is gone, memory runs out or the device fails.
    pub fn recreate(&mut self, size: [u32; 2]) -> Result<()> {
        let shared = self.device.0.clone();
        // SAFETY: the surface belongs to the instance of the device.
        let capabilities = shared.gate.call("vkGetPhysicalDeviceSurfaceCapabilitiesKHR", "window", || unsafe {
            self.surface.api.get_physical_device_surface_capabilities(shared.physical, self.surface.raw)
        })?;
        if !capabilities.supported_usage_flags.contains(vk::ImageUsageFlags::TRANSFER_DST) {
            return Err(Error::Window("its swapchain images cannot be copied to".into()));
        }
        let extent = if capabilities.current_extent.width == u32::MAX {
            let (least, most) = (capabilities.min_image_extent, capabilities.max_image_extent);
            [size[0].clamp(least.width, most.width), size[1].clamp(least.height, most.height)]
        } else {
            [capabilities.current_extent.width, capabilities.current_extent.height]
        };
        self.wait_idle()?;
        let old = std::mem::replace(&mut self.raw, vk::SwapchainKHR::null());
        self.size = [0, 0];
        let created = if extent.contains(&0) || size.contains(&0) {
            Ok(None)
        } else {
            self.create_chain(&capabilities, extent, old).map(Some)
        };
        self.destroy_chain(old);
        if let Some(raw) = created? {
            self.raw = raw;
            self.create_frames()?;
            self.size = extent;
        }
        Ok(())
    }

    fn create_chain(
        &self,
        capabilities: &vk::SurfaceCapabilitiesKHR,
        [width, height]: [u32; 2],
        old: vk::SwapchainKHR,
    ) -> Result<vk::SwapchainKHR> {
        let most = if capabilities.max_image_count == 0 { u32::MAX } else { capabilities.max_image_count };
        let opaque = vk::CompositeAlphaFlagsKHR::OPAQUE;
        let alpha = if capabilities.supported_composite_alpha.contains(opaque) {
            opaque
        } else {
            vk::CompositeAlphaFlagsKHR::INHERIT
        };
        let info = vk::SwapchainCreateInfoKHR::default()
            .surface(self.surface.raw)
            .min_image_count((capabilities.min_image_count + 1).clamp(FRAMES_IN_FLIGHT as u32, most))
            .image_format(self.format.format)
            .image_color_space(self.format.color_space)
            .image_extent(vk::Extent2D { width, height })
            .image_array_layers(1)
            .image_usage(vk::ImageUsageFlags::TRANSFER_DST)
            .image_sharing_mode(vk::SharingMode::EXCLUSIVE)
            .pre_transform(capabilities.current_transform)
            .composite_alpha(alpha)
            // Every device supports FIFO.
            .present_mode(vk::PresentModeKHR::FIFO)
            .clipped(true)
            .old_swapchain(old);
        // SAFETY: the surface is alive and supports the capabilities just queried; the old swapchain is ours and is
        // destroyed later.
        self.device.0.gate.make(ObjectKind::Swapchain, "vkCreateSwapchainKHR", "window", || unsafe {
            self.api.create_swapchain(&info, None)
        })
    }

    /// Creates the per-image semaphores and the frame slots of a new swapchain.
    fn create_frames(&mut self) -> Result<()> {
        let shared = self.device.0.clone();
        // SAFETY: the swapchain was just created.
        let images = shared
            .gate
            .call("vkGetSwapchainImagesKHR", "window", || unsafe { self.api.get_swapchain_images(self.raw) })?;
        for image in images {
            let copied = self.semaphore()?;
            self.images.push((image, copied));
        }
        for _ in 0..FRAMES_IN_FLIGHT {
            let acquired = self.semaphore()?;
            // Stored before any further call can fail, so that its resources are released.
            let null = (vk::CommandPool::null(), vk::CommandBuffer::null());
            self.slots.push(Slot { pool: null.0, commands: null.1, acquired, ticket: None, source: None });
            let info = vk::CommandPoolCreateInfo::default().queue_family_index(shared.queue_family);
            // SAFETY: the device is alive.
            let pool = shared.gate.make(ObjectKind::CommandPool, "vkCreateCommandPool", "window", || unsafe {
                shared.raw.create_command_pool(&info, None)
            })?;
            let last = self.slots.len() - 1;
            self.slots[last].pool = pool;
            let info = vk::CommandBufferAllocateInfo::default()
                .command_pool(pool)
                .level(vk::CommandBufferLevel::PRIMARY)
                .command_buffer_count(1);
            // SAFETY: the pool was just created.
            let commands = shared
                .gate
                .call("vkAllocateCommandBuffers", "window", || unsafe { shared.raw.allocate_command_buffers(&info) })?;
            self.slots[last].commands = commands[0];
        }
        self.next = 0;
        Ok(())
    }

    fn semaphore(&self) -> Result<vk::Semaphore> {
        let shared = &self.device.0;
        // SAFETY: the device is alive.
        shared.gate.make(ObjectKind::Semaphore, "vkCreateSemaphore", "window", || unsafe {
            shared.raw.create_semaphore(&vk::SemaphoreCreateInfo::default(), None)
        })
    }

    /// Copies an image in the general layout into the window. Runs after all earlier submissions.
    ///
    /// # Errors
    /// [`Error::WrongImage`] if size or format differ from the window's; [`Error::Timeout`] if no swapchain image
    /// becomes available; if the device fails.
    pub fn present(&mut self, image: &DeviceImage) -> Result<PresentStatus> {
        if self.needs_recreate || !self.is_open() {
            return Ok(PresentStatus::Outdated);
        }
        if image.size() != self.size || image.format() != self.texel_format {
            let shape = |[width, height]: [u32; 2], format: ImageFormat| format!("{width}x{height} {format}");
            let bound = shape(image.size(), image.format());
            return Err(Error::WrongImage {
                image: "window".into(),
                bound,
                declared: shape(self.size, self.texel_format),
            });
        }
        let shared = self.device.0.clone();
        let slot = &mut self.slots[self.next];
        if let Some(ticket) = slot.ticket {
            self.device.wait(ticket, "window")?;
            (slot.ticket, slot.source) = (None, None);
        }
        let (commands, pool, acquired) = (slot.commands, slot.pool, slot.acquired);
        let limit = u64::try_from(self.device.timeout().as_nanos()).unwrap_or(u64::MAX);
        // SAFETY: the slot's last frame is done, so nothing waits for or signals its semaphore.
        let index = match shared.gate.call("vkAcquireNextImageKHR", "window", || unsafe {
            self.api.acquire_next_image(self.raw, limit, acquired, vk::Fence::null())
        }) {
            Ok((index, _)) => index,
            Err(Error::Vulkan { result: vk::Result::ERROR_OUT_OF_DATE_KHR, .. }) => return Ok(PresentStatus::Outdated),
            Err(Error::Vulkan { result: vk::Result::TIMEOUT | vk::Result::NOT_READY, .. }) => {
                return Err(Error::Timeout { what: "window".into(), limit: self.device.timeout(), pass: None });
            }
            Err(error) => return Err(error),
        };
        // Returning without presenting leaves an acquired image and a semaphore that only a new swapchain releases.
        self.needs_recreate = true;
        let (target, copied) = self.images[index as usize];
        self.record(pool, commands, image, target)?;
        let ticket = shared.submit_between(commands, &[semaphore(acquired, 0)], &[semaphore(copied, 0)], "window")?;
        (self.slots[self.next].ticket, self.slots[self.next].source) = (Some(ticket), Some(image.clone()));
        self.next = (self.next + 1) % self.slots.len();
        let (chains, indices, waits) = ([self.raw], [index], [copied]);
        let info = vk::PresentInfoKHR::default().swapchains(&chains).image_indices(&indices).wait_semaphores(&waits);
        let queue = shared.queue();
        // SAFETY: the image was acquired from this swapchain, and the semaphore's signal is submitted. The queue is
        // locked.
        let presented =
            shared.gate.call("vkQueuePresentKHR", "window", || unsafe { self.api.queue_present(queue.raw, &info) });
        drop(queue);
        match presented {
            // A suboptimal swapchain still presents; the window reports a change itself.
            Ok(_) => {
                self.needs_recreate = false;
                Ok(PresentStatus::Presented)
            }
            Err(Error::Vulkan { result: vk::Result::ERROR_OUT_OF_DATE_KHR, .. }) => Ok(PresentStatus::Outdated),
            Err(error) => Err(error),
        }
    }

    fn record(
        &self,
        pool: vk::CommandPool,
        commands: vk::CommandBuffer,
        source: &DeviceImage,
        target: vk::Image,
    ) -> Result<()> {
        let shared = &self.device.0;
        let raw = &shared.raw;
        let all = vk::PipelineStageFlags2::ALL_COMMANDS;
        let copy = vk::PipelineStageFlags2::ALL_TRANSFER;
        let source_ready = [vk::MemoryBarrier2::default()
            .src_stage_mask(all)
            .src_access_mask(vk::AccessFlags2::MEMORY_WRITE)
            .dst_stage_mask(copy)
            .dst_access_mask(vk::AccessFlags2::TRANSFER_READ)];
        let change = vk::ImageMemoryBarrier2::default()
            .src_queue_family_index(vk::QUEUE_FAMILY_IGNORED)
            .dst_queue_family_index(vk::QUEUE_FAMILY_IGNORED)
            .image(target)
            .subresource_range(WHOLE);
        // The submission as a whole waits until the image is acquired.
        let acquire = [change
            .src_stage_mask(all)
            .dst_stage_mask(copy)
            .dst_access_mask(vk::AccessFlags2::TRANSFER_WRITE)
            .old_layout(vk::ImageLayout::UNDEFINED)
            .new_layout(vk::ImageLayout::TRANSFER_DST_OPTIMAL)];
        let release = [change
            .src_stage_mask(copy)
            .src_access_mask(vk::AccessFlags2::TRANSFER_WRITE)
            .dst_stage_mask(all)
            .old_layout(vk::ImageLayout::TRANSFER_DST_OPTIMAL)
            .new_layout(vk::ImageLayout::PRESENT_SRC_KHR)];
        let layers = vk::ImageSubresourceLayers {
            aspect_mask: vk::ImageAspectFlags::COLOR,
            mip_level: 0,
            base_array_layer: 0,
            layer_count: 1,
        };
        let [width, height] = self.size;
        let extent = vk::Extent3D { width, height, depth: 1 };
        let region = [vk::ImageCopy { src_subresource: layers, dst_subresource: layers, extent, ..Default::default() }];
        let begin = vk::CommandBufferBeginInfo::default().flags(vk::CommandBufferUsageFlags::ONE_TIME_SUBMIT);
        let first = vk::DependencyInfo::default().memory_barriers(&source_ready).image_memory_barriers(&acquire);
        let last = vk::DependencyInfo::default().image_memory_barriers(&release);
        // SAFETY: the slot's commands are not pending. Both images have the size of the copy, formats of one class,
        // and the required usages. The barriers and the caller's promise provide the layouts.
        unsafe {
            shared.gate.call("vkResetCommandPool", "window", || {
                raw.reset_command_pool(pool, vk::CommandPoolResetFlags::empty())
            })?;
            shared.gate.call("vkBeginCommandBuffer", "window", || raw.begin_command_buffer(commands, &begin))?;
            raw.cmd_pipeline_barrier2(commands, &first);
            let (from, to) = (vk::ImageLayout::GENERAL, vk::ImageLayout::TRANSFER_DST_OPTIMAL);
            raw.cmd_copy_image(commands, source.0.raw, from, target, to, &region);
            raw.cmd_pipeline_barrier2(commands, &last);
            shared.gate.call("vkEndCommandBuffer", "window", || raw.end_command_buffer(commands))
        }
    }

    /// Waits until nothing uses the swapchain.
    fn wait_idle(&mut self) -> Result<()> {
        let mut failed = None;
        for slot in &mut self.slots {
            let Some(ticket) = slot.ticket else { continue };
            match self.device.wait(ticket, "window") {
                Ok(()) => (slot.ticket, slot.source) = (None, None),
                Err(error) => {
                    slot.source.iter().for_each(|source| source.0.busy.until(ticket));
                    failed = failed.or(Some(error));
                }
            }
        }
        if let Some(error) = failed {
            return Err(error);
        }
        if self.is_open() {
            let shared = &self.device.0;
            let queue = shared.queue();
            // Our work is done, but the presentation engine may still read the last image. Only an idle queue tells
            // when it has.
            // SAFETY: the queue is locked.
            shared.gate.call("vkQueueWaitIdle", "window", || unsafe { shared.raw.queue_wait_idle(queue.raw) })?;
        }
        Ok(())
    }

    /// Destroys a swapchain and its resources; nothing uses them.
    fn destroy_chain(&mut self, chain: vk::SwapchainKHR) {
        let shared = &self.device.0;
        let count_destroyed = |kind| shared.gate.count_destroyed(kind);
        let acquired = self.slots.iter().map(|s| s.acquired);
        for semaphore in acquired.chain(self.images.iter().map(|i| i.1)) {
            // SAFETY: no work is left that signals or waits for it.
            unsafe { shared.raw.destroy_semaphore(semaphore, None) };
            count_destroyed(ObjectKind::Semaphore);
        }
        for slot in self.slots.iter().filter(|s| s.pool != vk::CommandPool::null()) {
            // SAFETY: its commands are done.
            unsafe { shared.raw.destroy_command_pool(slot.pool, None) };
            count_destroyed(ObjectKind::CommandPool);
        }
        if chain != vk::SwapchainKHR::null() {
            // SAFETY: its images are not in use.
            unsafe { self.api.destroy_swapchain(chain, None) };
            count_destroyed(ObjectKind::Swapchain);
        }
        self.slots.clear();
        self.images.clear();
        self.needs_recreate = false;
    }
}

impl Drop for Swapchain {
    fn drop(&mut self) {
        if let Err(error) = self.wait_idle() {
            // Leaking the swapchain and its device is safer than destroying what may be in use.
            tracing::error!(%error, "frames of a window are not done; their resources are leaked");
            std::mem::forget((self.device.clone(), self.surface.clone()));
            return;
        }
        self.destroy_chain(self.raw);
    }
}
