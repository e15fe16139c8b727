//! A host's buffers and images under our types.
//!
//! Promises that nothing of the host's is destroyed or changed by wrapping it; only the view that is made of an image is
//! destroyed with the wrapper. Leaves lifetimes, and who uses what when, to the host: that is what the contracts say.

use super::image::ImageInner;
use super::{Backing, DeviceBuffer, DeviceImage, Inner, Location};
use crate::device::{Busy, Device};
use crate::error::{Error, Result};
use crate::format::ImageFormat;
use ash::vk;
use std::sync::Arc;

impl Device {
    /// Wraps a host's buffer: graphs can bind it as an external buffer of at most `bytes`.
    ///
    /// # Errors
    /// [`Error::Host`] for a null handle or no bytes.
    ///
    /// # Safety
    /// The host promises:
    /// * the buffer was made from this device, is bound to memory and at least `bytes` long; it may be used by our queue
    ///   family (it is concurrent, or exclusive and owned by that family), with the usages that our commands need:
    ///   storage buffer for kernels, indirect buffer for dispatches, transfer source and destination for copies and fills;
    /// * buffer and memory live until every handle is gone and all work that uses them is done;
    /// * whatever else uses these bytes is ordered against our commands by the host, with barriers or semaphores.
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

    /// Wraps a host's image of `size` texels: graphs can copy to it, and kernels write it if `storage`.
    ///
    /// # Errors
    /// [`Error::Host`] for a null handle or a size of zero; [`Error::NotStorageImage`] if `storage` is wanted of a format
    /// that the device cannot have so; if the view cannot be made.
    ///
    /// # Safety
    /// The host promises:
    /// * the image was made from this device with this format, two-dimensional, of exactly this size, one sample, its
    ///   first mip level and layer being the ones meant; it is bound to memory, and may be used by our queue family;
    ///   its usage has transfer destination for copies to it, transfer source for copies from it, and storage if
    ///   `storage`;
    /// * image and memory live until every handle is gone and all work that uses them is done;
    /// * whenever our commands run, the image is in the layout that the plan states as its entry, and whatever else uses
    ///   it is ordered against our commands by the host, with barriers or semaphores.
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
    /// The raw buffer, for hosts that use it in commands of their own.
    pub fn raw(&self) -> vk::Buffer {
        self.0.raw
    }
}

impl DeviceImage {
    /// The raw image, for hosts that use it in commands of their own.
    pub fn raw(&self) -> vk::Image {
        self.0.raw
    }
}
