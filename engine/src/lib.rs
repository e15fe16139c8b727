//! Vulkan layer of SGS: devices, memory, kernels, frame graphs and timing. It knows nothing of Gaussians.
//!
//! Open a [`Device`], build a [`graph::Graph`] from passes that run kernels, compile it to a pure-data
//! [`graph::Plan`], and replay that with a [`graph::exec::Executor`]. `unsafe` code is confined to this crate.

pub mod device;
mod error;
mod format;
pub mod graph;
pub mod memory;
pub mod shader;

/// Vulkan's own types, for hosts that hand over handles.
pub use ash::vk;
pub use device::{
    Device, DeviceInfo, DeviceOptions, MatrixShape, PresentStatus, Surface, Swapchain, Ticket, Window, devices,
};
pub use error::{Error, Result};
pub use format::ImageFormat;
pub use memory::{Activity, Budget, BudgetSource, DeviceBuffer, DeviceImage, Location, STAGING_BYTES};
