//! Memory and semaphores shared between devices or processes as file descriptors.
//!
//! Promises: a device without support returns an error that names the extension. The descriptors are opaque: they are
//! valid only for the same driver on the same physical device (equal `deviceUUID` and `driverUUID`). The caller
//! transfers the descriptor and synchronizes both sides.

use super::image::ImageInner;
use super::{DeviceBuffer, DeviceImage, Inner, Location};
use crate::allocator::Backing;
use crate::device::{Busy, Device, ObjectKind, Shared};
use crate::error::{Error, Result};
use crate::format::ImageFormat;
use ash::{khr, vk};
use std::os::fd::{FromRawFd, IntoRawFd, OwnedFd};
use std::sync::Arc;

const MEMORY: vk::ExternalMemoryHandleTypeFlags = vk::ExternalMemoryHandleTypeFlags::OPAQUE_FD;
const SEMAPHORE: vk::ExternalSemaphoreHandleTypeFlags = vk::ExternalSemaphoreHandleTypeFlags::OPAQUE_FD;

/// Exported memory.
#[derive(Debug)]
pub struct SharedHandle {
    /// File descriptor; holds its own reference to the memory.
    pub fd: OwnedFd,
    /// Size of the memory in bytes, which the importer needs. At least the size of the buffer or image.
    pub bytes: u64,
}

/// Semaphore in addition to the device's own timeline.
pub struct Semaphore {
    raw: vk::Semaphore,
    name: String,
    device: Device,
}

impl Device {
    /// Creates a buffer with exportable memory ([`DeviceBuffer::export`]).
    ///
    /// # Errors
    /// [`Error::MissingExtension`] without `VK_KHR_external_memory_fd`; if memory runs out.
    pub fn shared_buffer(&self, name: &str, bytes: u64) -> Result<DeviceBuffer> {
        self.external_buffer(name, bytes, None)
    }

    /// Creates a buffer over imported memory.
    ///
    /// # Errors
    /// As [`Device::shared_buffer`]; if the driver rejects the descriptor.
    ///
    /// # Safety
    /// The handle was exported from a buffer of at least `bytes`, created by [`Device::shared_buffer`] or
    /// equivalently (same size, same usages), by the same driver on the same physical device. Both sides synchronize
    /// their use.
    pub unsafe fn import_buffer(&self, name: &str, bytes: u64, handle: SharedHandle) -> Result<DeviceBuffer> {
        self.external_buffer(name, bytes, Some(handle))
    }

    fn external_buffer(&self, name: &str, bytes: u64, handle: Option<SharedHandle>) -> Result<DeviceBuffer> {
        let shared = &self.0;
        self.memory_fd(name)?;
        let bytes = bytes.max(4).next_multiple_of(4);
        let mut external = vk::ExternalMemoryBufferCreateInfo::default().handle_types(MEMORY);
        let info = super::buffer_info(bytes).push_next(&mut external);
        // SAFETY: the device is alive and has external memory.
        let raw = shared
            .gate
            .make(ObjectKind::Buffer, "vkCreateBuffer", name, || unsafe { shared.raw.create_buffer(&info, None) })?;
        // SAFETY: the buffer was just created from this device.
        let requirements = unsafe { shared.raw.get_buffer_memory_requirements(raw) };
        let dedicated = vk::MemoryDedicatedAllocateInfo::default().buffer(raw);
        let backing = shared.allocate_external(name, requirements, dedicated, handle).and_then(|memory| {
            // SAFETY: the memory was allocated for this buffer.
            let bound = shared
                .gate
                .call("vkBindBufferMemory", name, || unsafe { shared.raw.bind_buffer_memory(raw, memory, 0) });
            let backing = Backing::Shared(memory, requirements.size);
            bound.map(|()| backing).inspect_err(|_| shared.free_backing(backing))
        });
        let backing = backing.inspect_err(|_| {
            // SAFETY: nothing uses the buffer yet.
            unsafe { shared.raw.destroy_buffer(raw, None) };
            shared.gate.count_destroyed(ObjectKind::Buffer);
        })?;
        let mut state = shared.memory.lock();
        state.add(bytes);
        state.activity.buffers += 1;
        state.activity.made += 1;
        drop(state);
        shared.name(raw, name);
        Ok(DeviceBuffer(Arc::new(Inner {
            raw,
            bytes,
            name: name.to_owned(),
            location: Location::Device,
            allocation: None,
            mapped: None,
            backing,
            busy: Busy::default(),
            device: self.clone(),
        })))
    }

    /// Creates an image with exportable memory ([`DeviceImage::export`]). The image is in the general layout.
    ///
    /// # Errors
    /// As [`Device::shared_buffer`].
    pub fn shared_image(&self, name: &str, size: [u32; 2], format: ImageFormat) -> Result<DeviceImage> {
        let image = self.external_image(name, size, format, None)?;
        self.to_general(&image)?;
        Ok(image)
    }

    /// Creates an image over imported memory. The image is in the layout in which the exporter left it.
    ///
    /// # Errors
    /// As [`Device::import_buffer`].
    ///
    /// # Safety
    /// The handle was exported from an image of this size and format, created by [`Device::shared_image`] or
    /// equivalently (two-dimensional, one level, layer and sample, optimal tiling, same usages), by the same driver
    /// on the same physical device. Both sides synchronize their use and agree on the layout.
    pub unsafe fn import_image(
        &self,
        name: &str,
        size: [u32; 2],
        format: ImageFormat,
        handle: SharedHandle,
    ) -> Result<DeviceImage> {
        self.external_image(name, size, format, Some(handle))
    }

    fn external_image(
        &self,
        name: &str,
        size: [u32; 2],
        format: ImageFormat,
        handle: Option<SharedHandle>,
    ) -> Result<DeviceImage> {
        let shared = &self.0;
        self.memory_fd(name)?;
        let mut external = vk::ExternalMemoryImageCreateInfo::default().handle_types(MEMORY);
        let info = self.image_info(name, size, format)?.push_next(&mut external);
        // SAFETY: the device is alive and has external memory.
        let raw = shared
            .gate
            .make(ObjectKind::Image, "vkCreateImage", name, || unsafe { shared.raw.create_image(&info, None) })?;
        let mut made = ImageInner {
            raw,
            view: None,
            size,
            format,
            name: name.to_owned(),
            allocation: None,
            // Nothing is freed until memory is allocated.
            backing: Backing::Shared(vk::DeviceMemory::null(), 0),
            busy: Busy::default(),
            device: self.clone(),
        };
        shared.memory.count_image();
        // SAFETY: the image was just created from this device.
        let requirements = unsafe { shared.raw.get_image_memory_requirements(raw) };
        let dedicated = vk::MemoryDedicatedAllocateInfo::default().image(raw);
        let memory = shared.allocate_external(name, requirements, dedicated, handle)?;
        shared.memory.lock().add(requirements.size);
        made.backing = Backing::Shared(memory, requirements.size);
        // SAFETY: the memory was allocated for this image.
        shared.gate.call("vkBindImageMemory", name, || unsafe { shared.raw.bind_image_memory(raw, memory, 0) })?;
        if self.supports_storage_image(format) {
            made.make_view()?;
        }
        shared.name(raw, name);
        Ok(DeviceImage(Arc::new(made)))
    }

    /// Creates an exportable semaphore: a timeline from 0, or a binary one.
    ///
    /// # Errors
    /// [`Error::MissingExtension`] without `VK_KHR_external_semaphore_fd`; if the device fails.
    pub fn shared_semaphore(&self, name: &str, timeline: bool) -> Result<Semaphore> {
        self.semaphore_fd(name)?;
        self.semaphore(name, timeline, true)
    }

    /// Imports a semaphore.
    ///
    /// # Errors
    /// As [`Device::shared_semaphore`]; if the driver rejects the descriptor.
    ///
    /// # Safety
    /// The descriptor was exported from a semaphore of the same kind by the same driver on the same physical device.
    pub unsafe fn import_semaphore(&self, name: &str, timeline: bool, fd: OwnedFd) -> Result<Semaphore> {
        let api = self.semaphore_fd(name)?;
        let semaphore = self.semaphore(name, timeline, false)?;
        let raw = fd.into_raw_fd();
        let info = vk::ImportSemaphoreFdInfoKHR::default().semaphore(semaphore.raw).handle_type(SEMAPHORE).fd(raw);
        // SAFETY: the semaphore is new and of the kind that was exported, as the caller promises.
        let imported = self.0.gate.call("vkImportSemaphoreFdKHR", name, || unsafe { api.import_semaphore_fd(&info) });
        imported.inspect_err(|_| {
            // SAFETY: a failed import leaves the descriptor to the caller.
            drop(unsafe { OwnedFd::from_raw_fd(raw) });
        })?;
        Ok(semaphore)
    }

    fn semaphore(&self, name: &str, timeline: bool, export: bool) -> Result<Semaphore> {
        let kind = if timeline { vk::SemaphoreType::TIMELINE } else { vk::SemaphoreType::BINARY };
        let mut kind = vk::SemaphoreTypeCreateInfo::default().semaphore_type(kind);
        let mut external = vk::ExportSemaphoreCreateInfo::default().handle_types(SEMAPHORE);
        let mut info = vk::SemaphoreCreateInfo::default().push_next(&mut kind);
        if export {
            info = info.push_next(&mut external);
        }
        // SAFETY: the device is alive and has timeline semaphores.
        let raw = self.0.gate.make(ObjectKind::Semaphore, "vkCreateSemaphore", name, || unsafe {
            self.0.raw.create_semaphore(&info, None)
        })?;
        Ok(Semaphore { raw, name: name.to_owned(), device: self.clone() })
    }

    fn memory_fd(&self, what: &str) -> Result<khr::external_memory_fd::Device> {
        if !self.info().optional.external_memory_fd {
            return Err(self.missing_extension(what, "VK_KHR_external_memory_fd"));
        }
        Ok(khr::external_memory_fd::Device::new(&self.0.instance.raw, &self.0.raw))
    }

    fn semaphore_fd(&self, what: &str) -> Result<khr::external_semaphore_fd::Device> {
        if !self.info().optional.external_semaphore_fd {
            return Err(self.missing_extension(what, "VK_KHR_external_semaphore_fd"));
        }
        Ok(khr::external_semaphore_fd::Device::new(&self.0.instance.raw, &self.0.raw))
    }

    fn missing_extension(&self, what: &str, extension: &'static str) -> Error {
        Error::MissingExtension { what: format!("Sharing \"{what}\""), extension, device: self.info().name.clone() }
    }

    fn export(&self, name: &str, backing: Backing) -> Result<SharedHandle> {
        let api = self.memory_fd(name)?;
        let Backing::Shared(memory, bytes) = backing else {
            return Err(Error::NotShared(name.to_owned()));
        };
        let info = vk::MemoryGetFdInfoKHR::default().memory(memory).handle_type(MEMORY);
        // SAFETY: the memory is alive and was created for export, or imported with the same handle type.
        let fd = self.0.gate.call("vkGetMemoryFdKHR", name, || unsafe { api.get_memory_fd(&info) })?;
        // SAFETY: the call returns a new, owned descriptor.
        Ok(SharedHandle { fd: unsafe { OwnedFd::from_raw_fd(fd) }, bytes })
    }
}

impl Shared {
    /// Allocates exportable memory, or imports memory, outside the allocator.
    fn allocate_external(
        &self,
        name: &str,
        requirements: vk::MemoryRequirements,
        mut dedicated: vk::MemoryDedicatedAllocateInfo<'_>,
        handle: Option<SharedHandle>,
    ) -> Result<vk::DeviceMemory> {
        self.memory.check_budget(name, requirements.size, true)?;
        // SAFETY: the physical device belongs to the instance.
        let memory = unsafe { self.instance.raw.get_physical_device_memory_properties(self.physical) };
        let fits = |i: &u32| requirements.memory_type_bits & (1 << i) != 0;
        let local =
            |i: &u32| memory.memory_types[*i as usize].property_flags.contains(vk::MemoryPropertyFlags::DEVICE_LOCAL);
        let all = 0..memory.memory_type_count;
        let kind = all.clone().filter(fits).find(local).or_else(|| all.clone().find(fits));
        let kind = kind.ok_or_else(|| Error::OutOfMemory {
            what: name.to_owned(),
            bytes: requirements.size,
            reason: "no memory type can be shared".into(),
        })?;
        let size = handle.as_ref().map_or(requirements.size, |h| h.bytes.max(requirements.size));
        let mut export = vk::ExportMemoryAllocateInfo::default().handle_types(MEMORY);
        let fd = handle.map(|h| h.fd.into_raw_fd());
        let mut import = vk::ImportMemoryFdInfoKHR::default().handle_type(MEMORY).fd(fd.unwrap_or(-1));
        let mut info = vk::MemoryAllocateInfo::default().allocation_size(size).memory_type_index(kind);
        info = info.push_next(&mut dedicated);
        info = if fd.is_some() { info.push_next(&mut import) } else { info.push_next(&mut export) };
        // SAFETY: the chain satisfies the extension; the caller promises a valid import.
        let made = self
            .gate
            .make(ObjectKind::Memory, "vkAllocateMemory", name, || unsafe { self.raw.allocate_memory(&info, None) });
        made.inspect_err(|_| {
            if let Some(fd) = fd {
                // SAFETY: a failed import leaves the descriptor to the caller.
                drop(unsafe { OwnedFd::from_raw_fd(fd) });
            }
        })
    }
}

impl DeviceBuffer {
    /// Exports the memory.
    ///
    /// # Errors
    /// [`Error::NotShared`] unless [`Device::shared_buffer`] created it; [`Error::MissingExtension`].
    pub fn export(&self) -> Result<SharedHandle> {
        self.0.device.export(&self.0.name, self.0.backing)
    }
}

impl DeviceImage {
    /// Exports the memory.
    ///
    /// # Errors
    /// [`Error::NotShared`] unless [`Device::shared_image`] created it; [`Error::MissingExtension`].
    pub fn export(&self) -> Result<SharedHandle> {
        self.0.device.export(&self.0.name, self.0.backing)
    }
}

impl Semaphore {
    /// Returns the raw semaphore, to wait for and to signal.
    pub fn raw(&self) -> vk::Semaphore {
        self.raw
    }

    /// Exports the semaphore.
    ///
    /// # Errors
    /// If the device fails, or the semaphore was itself imported.
    pub fn export(&self) -> Result<OwnedFd> {
        let api = self.device.semaphore_fd(&self.name)?;
        let info = vk::SemaphoreGetFdInfoKHR::default().semaphore(self.raw).handle_type(SEMAPHORE);
        // SAFETY: the semaphore is alive.
        let fd =
            self.device.0.gate.call("vkGetSemaphoreFdKHR", &self.name, || unsafe { api.get_semaphore_fd(&info) })?;
        // SAFETY: the call returns a new, owned descriptor.
        Ok(unsafe { OwnedFd::from_raw_fd(fd) })
    }
}

impl Drop for Semaphore {
    fn drop(&mut self) {
        // SAFETY: a submission's contract keeps its semaphores alive until the work is done.
        unsafe { self.device.0.raw.destroy_semaphore(self.raw, None) };
        self.device.0.gate.count_destroyed(ObjectKind::Semaphore);
    }
}
