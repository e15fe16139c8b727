//! Pictures into a window, one after the other.
//!
//! Promises: an image is copied into the window behind all work that was submitted before, and nothing of the host waits
//! for the device unless as many pictures as there are slots are on their way; a window of another size is told apart and
//! never an error; nothing is made from picture to picture. Leaves drawing to plans, which draw into an image of ours: the
//! window's own images come and go with its size, and a plan would have to be recorded for each.

use super::surface::Surface;
use super::{Device, ObjectKind, Ticket, semaphore};
use crate::error::{Error, Result};
use crate::format::ImageFormat;
use crate::memory::DeviceImage;
use crate::memory::image::WHOLE;
use ash::{khr, vk};
use std::sync::Arc;

/// Pictures that may be on their way together.
const SLOTS: usize = 2;

/// Formats that we fill, the best first.
const FORMATS: [ImageFormat; 4] =
    [ImageFormat::Bgra8Unorm, ImageFormat::Rgba8Unorm, ImageFormat::Bgra8Srgb, ImageFormat::Rgba8Srgb];

/// What became of a picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Shown {
    /// It is on its way to the window.
    Yes,
    /// The window has changed: [`Swapchain::renew`], then show it again.
    Outdated,
}

/// The images of a window.
pub struct Swapchain {
    device: Device,
    surface: Arc<Surface>,
    api: khr::swapchain::Device,
    format: vk::SurfaceFormatKHR,
    texels: ImageFormat,
    size: [u32; 2],
    /// Null while the window has no size.
    raw: vk::SwapchainKHR,
    /// The window's images, and what says that one is filled.
    images: Vec<(vk::Image, vk::Semaphore)>,
    slots: Vec<Slot>,
    next: usize,
    /// An image was taken and not given back.
    torn: bool,
}

/// What one picture on its way uses.
struct Slot {
    pool: vk::CommandPool,
    commands: vk::CommandBuffer,
    taken: vk::Semaphore,
    ticket: Option<Ticket>,
    /// The picture, until it is copied.
    source: Option<DeviceImage>,
}

impl Swapchain {
    /// For a window of about this size; what it is exactly says [`Swapchain::size`].
    ///
    /// # Errors
    /// [`Error::Window`] if the window takes none of our formats, or no copies; if memory runs out.
    pub fn new(device: &Device, surface: &Arc<Surface>, size: [u32; 2]) -> Result<Swapchain> {
        let shared = &device.0;
        // SAFETY: the surface belongs to the instance of the device.
        let known = shared.gate.call("vkGetPhysicalDeviceSurfaceFormatsKHR", "window", || unsafe {
            surface.api.get_physical_device_surface_formats(shared.physical, surface.raw)
        })?;
        let srgb = |f: &&vk::SurfaceFormatKHR| f.color_space == vk::ColorSpaceKHR::SRGB_NONLINEAR;
        let fits =
            |texels: ImageFormat| known.iter().filter(srgb).find(|f| f.format == texels.raw()).map(|f| (texels, *f));
        let Some((texels, format)) = FORMATS.into_iter().find_map(fits) else {
            return Err(Error::Window("it takes no pictures of 8 bits a color in sRGB".into()));
        };
        let mut made = Swapchain {
            device: device.clone(),
            surface: surface.clone(),
            api: khr::swapchain::Device::new(&shared.instance.raw, &shared.raw),
            format,
            texels,
            size: [0, 0],
            raw: vk::SwapchainKHR::null(),
            images: Vec::new(),
            slots: Vec::new(),
            next: 0,
            torn: false,
        };
        made.renew(size)?;
        Ok(made)
    }

    /// Columns and rows; zeros while the window has none.
    pub fn size(&self) -> [u32; 2] {
        self.size
    }

    /// What images to be shown hold. 8-bit values are sRGB-encoded in every format.
    pub fn format(&self) -> ImageFormat {
        self.texels
    }

    /// Whether there is anything to show in: a minimized window has no size.
    pub fn is_open(&self) -> bool {
        self.raw != vk::SwapchainKHR::null()
    }

    /// Takes the window as it is now. Waits for the pictures on their way.
    ///
    /// # Errors
    /// If the window is gone, memory runs out or the device fails.
    pub fn renew(&mut self, size: [u32; 2]) -> Result<()> {
        let shared = self.device.0.clone();
        // SAFETY: the surface belongs to the instance of the device.
        let now = shared.gate.call("vkGetPhysicalDeviceSurfaceCapabilitiesKHR", "window", || unsafe {
            self.surface.api.get_physical_device_surface_capabilities(shared.physical, self.surface.raw)
        })?;
        if !now.supported_usage_flags.contains(vk::ImageUsageFlags::TRANSFER_DST) {
            return Err(Error::Window("nothing can be copied into its images".into()));
        }
        let extent = if now.current_extent.width == u32::MAX {
            let (least, most) = (now.min_image_extent, now.max_image_extent);
            [size[0].clamp(least.width, most.width), size[1].clamp(least.height, most.height)]
        } else {
            [now.current_extent.width, now.current_extent.height]
        };
        self.settle()?;
        let old = std::mem::replace(&mut self.raw, vk::SwapchainKHR::null());
        self.size = [0, 0];
        let made =
            if extent.contains(&0) || size.contains(&0) { Ok(None) } else { self.chain(&now, extent, old).map(Some) };
        self.forget(old);
        if let Some(raw) = made? {
            self.raw = raw;
            self.fill()?;
            self.size = extent;
        }
        Ok(())
    }

    fn chain(
        &self,
        now: &vk::SurfaceCapabilitiesKHR,
        [width, height]: [u32; 2],
        old: vk::SwapchainKHR,
    ) -> Result<vk::SwapchainKHR> {
        let most = if now.max_image_count == 0 { u32::MAX } else { now.max_image_count };
        let opaque = vk::CompositeAlphaFlagsKHR::OPAQUE;
        let alpha =
            if now.supported_composite_alpha.contains(opaque) { opaque } else { vk::CompositeAlphaFlagsKHR::INHERIT };
        let info = vk::SwapchainCreateInfoKHR::default()
            .surface(self.surface.raw)
            .min_image_count((now.min_image_count + 1).clamp(SLOTS as u32, most))
            .image_format(self.format.format)
            .image_color_space(self.format.color_space)
            .image_extent(vk::Extent2D { width, height })
            .image_array_layers(1)
            .image_usage(vk::ImageUsageFlags::TRANSFER_DST)
            .image_sharing_mode(vk::SharingMode::EXCLUSIVE)
            .pre_transform(now.current_transform)
            .composite_alpha(alpha)
            // Every device has it.
            .present_mode(vk::PresentModeKHR::FIFO)
            .clipped(true)
            .old_swapchain(old);
        // SAFETY: the surface is alive and takes what was just read from it; the old chain is ours and is destroyed after.
        self.device.0.gate.make(ObjectKind::Swapchain, "vkCreateSwapchainKHR", "window", || unsafe {
            self.api.create_swapchain(&info, None)
        })
    }

    /// Makes what a new chain needs beside it.
    fn fill(&mut self) -> Result<()> {
        let shared = self.device.0.clone();
        // SAFETY: the chain was just made.
        let images = shared
            .gate
            .call("vkGetSwapchainImagesKHR", "window", || unsafe { self.api.get_swapchain_images(self.raw) })?;
        for image in images {
            let filled = self.semaphore()?;
            self.images.push((image, filled));
        }
        for _ in 0..SLOTS {
            let taken = self.semaphore()?;
            // The slot is put away before anything more can fail, so that what it has is given back.
            let null = (vk::CommandPool::null(), vk::CommandBuffer::null());
            self.slots.push(Slot { pool: null.0, commands: null.1, taken, ticket: None, source: None });
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
            // SAFETY: the pool was just made.
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

    /// Copies an image in the general layout into the window, behind everything submitted so far.
    ///
    /// # Errors
    /// [`Error::WrongImage`] if it is not of the window's size and format; [`Error::Timeout`] if the window gives no image
    /// back; if the device fails.
    pub fn show(&mut self, image: &DeviceImage) -> Result<Shown> {
        if self.torn || !self.is_open() {
            return Ok(Shown::Outdated);
        }
        if image.size() != self.size || image.format() != self.texels {
            let shape = |[width, height]: [u32; 2], format: ImageFormat| format!("{width}x{height} {format}");
            let given = shape(image.size(), image.format());
            return Err(Error::WrongImage { image: "window".into(), given, declared: shape(self.size, self.texels) });
        }
        let shared = self.device.0.clone();
        let slot = &mut self.slots[self.next];
        if let Some(ticket) = slot.ticket {
            self.device.wait(ticket, "window")?;
            (slot.ticket, slot.source) = (None, None);
        }
        let (commands, pool, taken) = (slot.commands, slot.pool, slot.taken);
        let limit = u64::try_from(self.device.timeout().as_nanos()).unwrap_or(u64::MAX);
        // SAFETY: the slot's last picture is done, so that nothing waits for its semaphore or will signal it.
        let index = match shared.gate.call("vkAcquireNextImageKHR", "window", || unsafe {
            self.api.acquire_next_image(self.raw, limit, taken, vk::Fence::null())
        }) {
            Ok((index, _)) => index,
            Err(Error::Vulkan { result: vk::Result::ERROR_OUT_OF_DATE_KHR, .. }) => return Ok(Shown::Outdated),
            Err(Error::Vulkan { result: vk::Result::TIMEOUT | vk::Result::NOT_READY, .. }) => {
                return Err(Error::Timeout { what: "window".into(), limit: self.device.timeout(), pass: None });
            }
            Err(error) => return Err(error),
        };
        // From here on, leaving without presenting leaves an image and a semaphore that only a new chain gets rid of.
        self.torn = true;
        let (target, filled) = self.images[index as usize];
        self.record(pool, commands, image, target)?;
        let ticket = shared.submit_between(commands, &[semaphore(taken, 0)], &[semaphore(filled, 0)], "window")?;
        (self.slots[self.next].ticket, self.slots[self.next].source) = (Some(ticket), Some(image.clone()));
        self.next = (self.next + 1) % self.slots.len();
        let (chains, indices, waits) = ([self.raw], [index], [filled]);
        let info = vk::PresentInfoKHR::default().swapchains(&chains).image_indices(&indices).wait_semaphores(&waits);
        let queue = shared.queue();
        // SAFETY: the image was taken from this chain, and what waits for the semaphore has its signal on the way. The
        // queue is locked.
        let shown =
            shared.gate.call("vkQueuePresentKHR", "window", || unsafe { self.api.queue_present(queue.raw, &info) });
        drop(queue);
        match shown {
            // A chain that only fits badly still shows; a window that changes says so by itself.
            Ok(_) => {
                self.torn = false;
                Ok(Shown::Yes)
            }
            Err(Error::Vulkan { result: vk::Result::ERROR_OUT_OF_DATE_KHR, .. }) => Ok(Shown::Outdated),
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
        let drawn = [vk::MemoryBarrier2::default()
            .src_stage_mask(all)
            .src_access_mask(vk::AccessFlags2::MEMORY_WRITE)
            .dst_stage_mask(copy)
            .dst_access_mask(vk::AccessFlags2::TRANSFER_READ)];
        let change = vk::ImageMemoryBarrier2::default()
            .src_queue_family_index(vk::QUEUE_FAMILY_IGNORED)
            .dst_queue_family_index(vk::QUEUE_FAMILY_IGNORED)
            .image(target)
            .subresource_range(WHOLE);
        // The submission as a whole waits until the image is ours.
        let take = [change
            .src_stage_mask(all)
            .dst_stage_mask(copy)
            .dst_access_mask(vk::AccessFlags2::TRANSFER_WRITE)
            .old_layout(vk::ImageLayout::UNDEFINED)
            .new_layout(vk::ImageLayout::TRANSFER_DST_OPTIMAL)];
        let give = [change
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
        let first = vk::DependencyInfo::default().memory_barriers(&drawn).image_memory_barriers(&take);
        let last = vk::DependencyInfo::default().image_memory_barriers(&give);
        // SAFETY: the slot's commands are not pending; both images have the size of the copy, formats of one class, the
        // usages and, by the barriers and the caller's word, the layouts that it needs.
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

    /// Waits until nothing of the chain is in use any more.
    fn settle(&mut self) -> Result<()> {
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
            // Our work is done; what may be left is the window's system, which takes the last picture over. Nothing but the
            // queue tells when it has.
            // SAFETY: the queue is locked.
            shared.gate.call("vkQueueWaitIdle", "window", || unsafe { shared.raw.queue_wait_idle(queue.raw) })?;
        }
        Ok(())
    }

    /// Destroys a chain and what was made for it; nothing of it is in use.
    fn forget(&mut self, chain: vk::SwapchainKHR) {
        let shared = &self.device.0;
        let gone = |kind| shared.gate.gone(kind);
        let taken = self.slots.iter().map(|s| s.taken);
        for semaphore in taken.chain(self.images.iter().map(|i| i.1)) {
            // SAFETY: no work is left that signals it or waits for it.
            unsafe { shared.raw.destroy_semaphore(semaphore, None) };
            gone(ObjectKind::Semaphore);
        }
        for slot in self.slots.iter().filter(|s| s.pool != vk::CommandPool::null()) {
            // SAFETY: its commands are done.
            unsafe { shared.raw.destroy_command_pool(slot.pool, None) };
            gone(ObjectKind::CommandPool);
        }
        if chain != vk::SwapchainKHR::null() {
            // SAFETY: its images are not in use.
            unsafe { self.api.destroy_swapchain(chain, None) };
            gone(ObjectKind::Swapchain);
        }
        self.slots.clear();
        self.images.clear();
        self.torn = false;
    }
}

impl Drop for Swapchain {
    fn drop(&mut self) {
        if let Err(error) = self.settle() {
            // Destroying what may be in use is worse than leaving it, and the device with it.
            tracing::error!(%error, "a window's pictures are not done; what they use is left");
            std::mem::forget((self.device.clone(), self.surface.clone()));
            return;
        }
        self.forget(self.raw);
    }
}
