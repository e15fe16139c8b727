//! Checks of buffers and kernels against device limits. They run before any allocation.

use super::DeviceInfo;
use crate::error::{Error, Result};
use crate::graph::{BufferKind, PassKind, Plan};
use crate::shader::BindingKind;

/// Upper bounds below the device's own, to test or plan for a smaller device. The default changes nothing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Limits {
    /// Maximum storage binding in bytes.
    pub storage_range: u64,
    /// Maximum buffer size in bytes.
    pub buffer: u64,
    /// Maximum allocation size in bytes.
    pub allocation: u64,
    /// Maximum number of storage buffers of a kernel.
    pub storage_buffers: u32,
}

impl Default for Limits {
    fn default() -> Self {
        Limits { storage_range: u64::MAX, buffer: u64::MAX, allocation: u64::MAX, storage_buffers: u32::MAX }
    }
}

impl Limits {
    /// Lowers the limits of a device.
    pub(crate) fn lower(&self, info: &mut DeviceInfo) {
        info.max_storage_range = info.max_storage_range.min(self.storage_range);
        info.max_buffer = info.max_buffer.min(self.buffer);
        info.max_allocation = info.max_allocation.min(self.allocation);
        info.max_storage_buffers = info.max_storage_buffers.min(self.storage_buffers);
    }
}

impl DeviceInfo {
    /// Returns the size of the largest possible buffer in bytes.
    pub fn largest_buffer(&self) -> u64 {
        self.max_buffer.min(self.max_allocation)
    }

    /// Returns the size of the largest buffer that can be bound as a whole, in bytes.
    pub fn largest_binding(&self) -> u64 {
        self.largest_buffer().min(self.max_storage_range)
    }

    /// Checks the size of a buffer against the device limits.
    pub(crate) fn check_buffer(&self, name: &str, bytes: u64) -> Result<()> {
        let limit = self.largest_buffer();
        if bytes <= limit {
            return Ok(());
        }
        let what = name.to_owned();
        Err(Error::BufferTooLarge { what, bytes, limit, device: self.name.clone() })
    }

    /// Checks the buffers and kernels of a plan against the limits of this device.
    ///
    /// # Errors
    /// [`Error::BufferTooLarge`], [`Error::BindingTooLarge`], [`Error::TooManyBuffers`].
    pub fn check_plan(&self, plan: &Plan) -> Result<()> {
        self.check_buffer(&format!("arena of {}", plan.name), plan.arena_bytes)?;
        for buffer in plan.buffers.iter().filter(|b| b.kind == BufferKind::External && b.image.is_none()) {
            self.check_buffer(&buffer.name, buffer.bytes)?;
        }
        for pass in &plan.passes {
            for (slice, _, _) in &pass.accesses {
                let info = &plan.buffers[slice.buffer.index()];
                if slice.bytes > self.max_storage_range && info.image.is_none() {
                    let (what, limit) = (info.name.clone(), self.max_storage_range);
                    return Err(Error::BindingTooLarge { what, bytes: slice.bytes, limit });
                }
            }
            let PassKind::Compute { shader, .. } = &pass.kind else { continue };
            let count = shader.bindings.iter().filter(|b| b.kind == BindingKind::Storage).count() as u32;
            if count > self.max_storage_buffers {
                return Err(Error::TooManyBuffers {
                    pass: pass.name.clone(),
                    count,
                    limit: self.max_storage_buffers,
                    device: self.name.clone(),
                });
            }
        }
        Ok(())
    }
}
