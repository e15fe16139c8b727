//! Texel formats of images.
//!
//! Pure data: components and size of a texel. Device support is in [`crate::DeviceInfo::storage_formats`].

use ash::vk;
use std::fmt;

/// Texel format of an image.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug, PartialOrd, Ord, serde::Serialize)]
#[serde(rename_all = "lowercase")]
#[non_exhaustive]
pub enum ImageFormat {
    /// One 32-bit float.
    R32Float,
    /// One 32-bit unsigned integer.
    R32Uint,
    /// Red, green, blue, alpha; 8 bits each, normalized to [0, 1].
    Rgba8Unorm,
    /// Like [`ImageFormat::Rgba8Unorm`] with blue first in memory; the usual format of windows.
    Bgra8Unorm,
    /// Red, green, blue in the sRGB encoding, linear alpha; 8 bits each.
    Rgba8Srgb,
    /// Like [`ImageFormat::Rgba8Srgb`] with blue first in memory.
    Bgra8Srgb,
    /// Four 16-bit floats.
    Rgba16Float,
    /// Four 32-bit floats.
    Rgba32Float,
}

impl ImageFormat {
    /// All formats.
    pub const ALL: [ImageFormat; 8] = [
        ImageFormat::R32Float,
        ImageFormat::R32Uint,
        ImageFormat::Rgba8Unorm,
        ImageFormat::Bgra8Unorm,
        ImageFormat::Rgba8Srgb,
        ImageFormat::Bgra8Srgb,
        ImageFormat::Rgba16Float,
        ImageFormat::Rgba32Float,
    ];

    /// Returns the size of a packed texel in bytes.
    pub fn texel_bytes(self) -> u64 {
        match self {
            ImageFormat::R32Float
            | ImageFormat::R32Uint
            | ImageFormat::Rgba8Unorm
            | ImageFormat::Bgra8Unorm
            | ImageFormat::Rgba8Srgb
            | ImageFormat::Bgra8Srgb => 4,
            ImageFormat::Rgba16Float => 8,
            ImageFormat::Rgba32Float => 16,
        }
    }

    /// Returns the size of a tightly packed image in bytes. Rows start at the top, texels at the left.
    pub fn packed_bytes(self, [width, height]: [u32; 2]) -> u64 {
        u64::from(width) * u64::from(height) * self.texel_bytes()
    }

    /// Returns the Vulkan format.
    pub(crate) fn raw(self) -> vk::Format {
        match self {
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
}

impl fmt::Display for ImageFormat {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            ImageFormat::R32Float => "r32float",
            ImageFormat::R32Uint => "r32uint",
            ImageFormat::Rgba8Unorm => "rgba8unorm",
            ImageFormat::Bgra8Unorm => "bgra8unorm",
            ImageFormat::Rgba8Srgb => "rgba8srgb",
            ImageFormat::Bgra8Srgb => "bgra8srgb",
            ImageFormat::Rgba16Float => "rgba16float",
            ImageFormat::Rgba32Float => "rgba32float",
        })
    }
}

#[cfg(test)]
mod tests {
    use super::ImageFormat;

    #[test]
    fn texel_bytes_match_components() {
        let bytes = ImageFormat::ALL.map(ImageFormat::texel_bytes);
        assert_eq!(bytes, [4, 4, 4, 4, 4, 4, 8, 16]);
        assert_eq!(ImageFormat::Rgba16Float.packed_bytes([3, 5]), 120);
        // No overflow at sizes above any device limit.
        assert_eq!(ImageFormat::R32Uint.packed_bytes([u32::MAX, 2]), 34_359_738_360);
    }
}
