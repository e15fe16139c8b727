//! Vulkan layer of SGS: devices, memory, kernels, frame graphs and timing. It knows nothing of Gaussians.
//!
//! Open a [`Device`], build a [`graph::Graph`] from passes that run kernels, compile it to a pure-data
//! [`graph::Plan`], and replay that with a [`exec::Executor`]. `unsafe` code is confined to this crate.

mod allocator;
pub mod device;
mod error;
pub mod exec;
mod format;
pub mod graph;
pub mod memory;
pub mod shader;
mod swapchain;

pub use allocator::{Activity, Budget, BudgetSource};
/// Vulkan's own types, for hosts that hand over handles.
pub use ash::vk;
pub use device::{
    CompileOnlyDevice, DRIVER_VARIABLES, Device, DeviceInfo, DeviceOptions, DriverFile, Environment, FoundDevice,
    MatrixShape, PlannedGpu, Selection, Surface, Ticket, Window, devices, driver_files, find_device, select_auto,
};
pub use error::{Error, Result};
pub use format::ImageFormat;
pub use memory::{DeviceBuffer, DeviceImage, Location, Piece, STAGING_BYTES};
pub use swapchain::{PresentStatus, Swapchain};
