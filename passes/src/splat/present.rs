//! `present`: conversion of one layer of a blended view to texels.
//!
//! Cost: a pixel reads 4 (C' + 1) bytes and writes a texel. C' is 3 for colors and normals and 1 for depth.

use super::{Blended, Channels, Screen};
use crate::Tuning;
use crate::kernel::{groups, stage};
use sgs_engine::graph::{Buffer, Graph, GraphError, Slice};
use sgs_shaders::present as kernel;

/// Layer of a view. The fourth component of a texel is always alpha, one minus the transmittance.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Layer {
    /// Red, green and blue over the background. Over black this is color premultiplied by alpha.
    Color,
    /// Blended z times a scale, in all three components; not divided by alpha.
    Depth,
    /// Blended normal in world space; n/2 + 1/2 in 8-bit formats.
    Normal,
    /// Alpha in all three components.
    Alpha,
}

/// Encoding of colors. Blended colors are display-referred, that is, sRGB-encoded.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Encoding {
    /// Encoded as blended.
    Display,
    /// Decoded to linear light. Formats that decode sRGB on reads hold encoded values in either case.
    Linear,
}

/// Texel formats that [`present`] can write.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum TexelFormat {
    /// `VK_FORMAT_R8G8B8A8_UNORM`
    Rgba8Unorm,
    /// `VK_FORMAT_B8G8R8A8_UNORM`
    Bgra8Unorm,
    /// `VK_FORMAT_R8G8B8A8_SRGB`: reads decode. Only colors are written, in their encoding.
    Rgba8Srgb,
    /// `VK_FORMAT_B8G8R8A8_SRGB`: like [`TexelFormat::Rgba8Srgb`].
    Bgra8Srgb,
    /// `VK_FORMAT_R16G16B16A16_SFLOAT`; values beyond ±65504 saturate.
    Rgba16Float,
    /// `VK_FORMAT_R32G32B32A32_SFLOAT`
    Rgba32Float,
}

impl TexelFormat {
    /// All formats.
    pub const ALL: [TexelFormat; 6] = [
        TexelFormat::Rgba8Unorm,
        TexelFormat::Bgra8Unorm,
        TexelFormat::Rgba8Srgb,
        TexelFormat::Bgra8Srgb,
        TexelFormat::Rgba16Float,
        TexelFormat::Rgba32Float,
    ];

    /// Returns the bytes of a texel.
    pub fn bytes(self) -> u64 {
        match self {
            TexelFormat::Rgba16Float => 8,
            TexelFormat::Rgba32Float => 16,
            _ => 4,
        }
    }

    /// Returns whether reads decode sRGB.
    pub fn srgb(self) -> bool {
        matches!(self, TexelFormat::Rgba8Srgb | TexelFormat::Bgra8Srgb)
    }

    fn texel(self) -> u32 {
        match self {
            TexelFormat::Rgba8Unorm | TexelFormat::Rgba8Srgb => 0,
            TexelFormat::Bgra8Unorm | TexelFormat::Bgra8Srgb => 1,
            TexelFormat::Rgba16Float => 2,
            TexelFormat::Rgba32Float => 3,
        }
    }
}

/// Output of [`present`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Presented {
    /// Layer to present.
    pub layer: Layer,
    /// Format of the texels.
    pub format: TexelFormat,
    /// Encoding of colors.
    pub encoding: Encoding,
    /// Factor on depths.
    pub depth_scale: f32,
}

/// Buffers of [`present`].
#[derive(Clone, Copy, Debug)]
pub struct Present {
    /// Blended view.
    pub blended: Blended,
    /// Channels of the view.
    pub channels: Channels,
    /// One word: not zero if the view is incomplete.
    pub flags: Buffer,
    /// One word: number of required entries.
    pub wanted: Slice,
    /// Texels, row by row without gaps.
    pub texels: Buffer,
    /// Three words that accumulate over replays: frames, incomplete frames, largest number of required entries.
    pub report: Buffer,
}

/// Converts a view to texels.
///
/// # Errors
/// If the graph rejects the pass.
pub fn present(g: &mut Graph, t: &Tuning, screen: &Screen, what: &Present, as_: &Presented) -> Result<(), GraphError> {
    let (layer, first) = match as_.layer {
        Layer::Color => (0, 0),
        Layer::Depth => (1, if what.channels.normals { 6 } else { 3 }),
        Layer::Normal => (2, 3),
        Layer::Alpha => (3, 0),
    };
    let linear = as_.layer == Layer::Color && as_.encoding == Encoding::Linear && !as_.format.srgb();
    pack(g, t, screen, what, [layer, first], as_.format, u32::from(linear), as_.depth_scale)
}

/// Converts a view of three channels in linear light to texels. Without an encoding, the channels are not colors.
///
/// # Errors
/// If the graph rejects the pass.
pub fn present_light(
    g: &mut Graph,
    t: &Tuning,
    screen: &Screen,
    what: &Present,
    format: TexelFormat,
    encoding: Option<Encoding>,
) -> Result<(), GraphError> {
    let encoded = encoding.is_some_and(|e| e == Encoding::Display || format.srgb());
    pack(g, t, screen, what, [0, 0], format, if encoded { 2 } else { 0 }, 1.0)
}

#[expect(clippy::too_many_arguments, reason = "declares a kernel")]
fn pack(
    g: &mut Graph,
    t: &Tuning,
    screen: &Screen,
    what: &Present,
    [layer, first]: [u32; 2],
    format: TexelFormat,
    linear: u32,
    depth_scale: f32,
) -> Result<(), GraphError> {
    let bindings = kernel::Bindings {
        params: screen.step.into(),
        image: what.blended.image.into(),
        transmittance: what.blended.transmittance.into(),
        flags: what.flags.into(),
        required: what.wanted,
        texels: what.texels.into(),
        report: what.report.into(),
    };
    let specs = kernel::Specs {
        workgroup: t.workgroup,
        channels: what.channels.count(),
        layer,
        first,
        texel: format.texel(),
        linear,
    };
    let push = depth_scale.to_ne_bytes();
    stage(g, "present", &kernel::KERNEL, bindings.entries(), specs.entries(), &push)
        .dispatch(groups(screen.pixels(), t.workgroup))
}
