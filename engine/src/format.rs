//! Texel formats of images, and their Vulkan formats.
//!
//! Device support is in [`crate::DeviceInfo::storage_formats`].

use ash::vk;

pub use sgs_shader_abi::ImageFormat;

/// Returns the Vulkan format of a texel format.
pub(crate) fn raw(format: ImageFormat) -> vk::Format {
    match format {
        ImageFormat::R32Float => vk::Format::R32_SFLOAT,
        ImageFormat::R32Uint => vk::Format::R32_UINT,
        ImageFormat::Rgba8Unorm => vk::Format::R8G8B8A8_UNORM,
        ImageFormat::Bgra8Unorm => vk::Format::B8G8R8A8_UNORM,
        ImageFormat::Rgba8Srgb => vk::Format::R8G8B8A8_SRGB,
        ImageFormat::Bgra8Srgb => vk::Format::B8G8R8A8_SRGB,
        ImageFormat::Rgba16Float => vk::Format::R16G16B16A16_SFLOAT,
        ImageFormat::Rgba32Float => vk::Format::R32G32B32A32_SFLOAT,
    }
}
