//! Wrappers of a host's buffers and images.
//!
//! Promises: wrapping neither destroys nor changes the host's objects. Only the view created for an image is
//! destroyed with the wrapper. The host manages lifetimes and synchronization, as the safety contracts state.

use super::image::ImageInner;
use super::{DeviceBuffer, DeviceImage, Inner, Location};
use crate::allocator::Backing;
use crate::device::{Busy, Device};
use crate::error::{Error, Result};
use crate::format::ImageFormat;
use ash::vk;
use std::sync::Arc;

impl Device {
    /// Wraps a host's buffer, for binding as an external buffer of at most `bytes`.
    ///
    /// # Errors
    /// [`Error::Host`] for a null handle or a size of zero.
    ///
    /// # Safety
    /// The host promises:
    /// * The buffer was created from this device, is bound to memory and is at least `bytes` long. Our queue family
    ///   may use it (concurrent sharing, or exclusive and owned by that family). It has the usages of our commands:
    ///   storage buffer for kernels, indirect buffer for dispatches, transfer source and destination for copies and
    ///   fills.
    /// * Buffer and memory live until every handle is dropped and all work that uses them is done.
    /// * The host orders all other uses of these bytes against our commands, by barriers or semaphores.
    pub unsafe fn wrap_buffer(&self, name: &str, raw: vk::Buffer, bytes: u64) -> Result<DeviceBuffer> {
        if raw == vk::Buffer::null() || bytes == 0 {
            return Err(Error::Host(format!("buffer \"{name}\" is null or empty")));
        }
        Ok(DeviceBuffer(Arc::new(Inner {
            raw,
            bytes,
            name: name.to_owned(),
            location: Location::Device,
            allocation: None,
            mapped: None,
            backing: Backing::Host,
            busy: Busy::default(),
            device: self.clone(),
        })))
    }

    /// Wraps a host's image of `size` texels, for copies, and for kernels if `storage`.
    ///
    /// # Errors
    /// [`Error::Host`] for a null handle or a size of zero; [`Error::NotStorageImage`] if `storage` is set but the
    /// device does not support it for the format; if the view cannot be created.
    ///
    /// # Safety
    /// The host promises:
    /// * The image was created from this device with this format: two-dimensional, of exactly this size, one sample.
    ///   Its first mip level and layer are used. It is bound to memory, and our queue family may use it. Its usage
    ///   has transfer destination for copies to it, transfer source for copies from it, and storage if `storage`.
    /// * Image and memory live until every handle is dropped and all work that uses them is done.
    /// * Whenever our commands run, the image is in the plan's entry layout. The host orders all other uses of the
    ///   image against our commands, by barriers or semaphores.
    pub unsafe fn wrap_image(
        &self,
        name: &str,
        raw: vk::Image,
        size: [u32; 2],
        format: ImageFormat,
        storage: bool,
    ) -> Result<DeviceImage> {
        if raw == vk::Image::null() || size.contains(&0) {
            return Err(Error::Host(format!("image \"{name}\" is null or empty")));
        }
        if storage && !self.supports_storage_image(format) {
            return Err(Error::NotStorageImage { image: name.to_owned(), format });
        }
        let mut made = ImageInner {
            raw,
            view: None,
            size,
            format,
            name: name.to_owned(),
            allocation: None,
            backing: Backing::Host,
            busy: Busy::default(),
            device: self.clone(),
        };
        if storage {
            made.make_view()?;
        }
        Ok(DeviceImage(Arc::new(made)))
    }
}

impl DeviceBuffer {
    /// Returns the raw buffer, for the host's own commands.
    pub fn raw(&self) -> vk::Buffer {
        self.0.raw
    }
}

impl DeviceImage {
    /// Returns the raw image, for the host's own commands.
    pub fn raw(&self) -> vk::Image {
        self.0.raw
    }
}
