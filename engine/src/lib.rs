//! Vulkan, and nothing else: devices, memory, kernels, graphs, time. Never Gaussians.
//!
//! A [`Device`] is opened, a [`graph::Graph`] is built from passes that name kernels, compiled to a pure-data
//! [`graph::Plan`], and replayed by an [`graph::exec::Executor`]. `unsafe` lives in this crate alone.

pub mod device;
mod error;
mod format;
pub mod graph;
pub mod memory;
pub mod shader;

/// Vulkan's own types, for hosts that hand over handles.
pub use ash::vk;
pub use device::{Device, DeviceInfo, DeviceOptions, MatrixShape, Shown, Surface, Swapchain, Ticket, Window, devices};
pub use error::{Error, Result};
pub use format::ImageFormat;
pub use memory::{Activity, Budget, BudgetSource, DeviceBuffer, DeviceImage, Location, STAGING_BYTES};
