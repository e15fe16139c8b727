//! Interface of a compiled kernel: bindings with their access, image formats and specialization constants.
//!
//! The shader compiler reflects these types, generated kernels contain them, and the engine plans with them. This crate
//! depends on neither Vulkan nor a compiler. Feature `serde` adds serialization.

use std::borrow::Cow;
use std::fmt;

/// Access of a kernel to a binding. Reflected from the kernel's code rather than its decorations.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
pub enum Access {
    /// Loads only, or no access at all.
    Read,
    /// Stores only. The graph assumes that earlier contents may remain, unless the pass discards them.
    Write,
    /// Loads and stores, other atomics, or additive atomics with used results.
    ReadWrite,
    /// Atomic additions and subtractions with unused results: passes that accumulate commute.
    ///
    /// Atomic minima, maxima and bit operations commute among themselves, but not with additions. Since `Access` does
    /// not state the operation, they count as [`Access::ReadWrite`].
    Accumulate,
}

/// Descriptor type of a binding.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
pub enum BindingKind {
    /// Storage buffer.
    Storage,
    /// Uniform buffer.
    Uniform,
    /// Two-dimensional storage image of this format.
    Image(ImageFormat),
}

/// Texel format of an image.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug, PartialOrd, Ord)]
#[cfg_attr(feature = "serde", derive(serde::Serialize), serde(rename_all = "lowercase"))]
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

/// Binding of descriptor set 0.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Binding {
    /// GLSL name of the block instance or image.
    ///
    /// An unnamed block with one member has the name of that member.
    pub name: Cow<'static, str>,
    /// Binding number.
    pub number: u32,
    /// Descriptor type.
    pub kind: BindingKind,
    /// Access of the code.
    pub access: Access,
}

/// Specialization constant (32 bits).
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct SpecConstant {
    /// GLSL name.
    pub name: Cow<'static, str>,
    /// `constant_id`.
    pub id: u32,
    /// Default value, as raw bits.
    pub default: u32,
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
