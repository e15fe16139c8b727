//! The kernels: GLSL in, SPIR-V and typed metadata out.
//!
//! Everything below is generated from the GLSL files of this folder: a kernel's push constants and shared structs field
//! by field with checked offsets, its bindings by name with the access of the code, its specialization constants.
//! A leaf: it knows no Vulkan and no Gaussians' meaning.

/// How the code behind a binding touches it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Access {
    /// Only loads.
    Read,
    /// Only stores.
    Write,
    /// Loads and stores, or atomics whose result is used.
    ReadWrite,
    /// Only commuting atomics whose result is unused.
    Accumulate,
}

/// Kind of a binding.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BindingKind {
    /// A storage buffer.
    Storage,
    /// A uniform buffer.
    Uniform,
    /// A two-dimensional storage image.
    Image(ImageFormat),
}

/// Formats that kernels declare for their images.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ImageFormat {
    /// `r32f`.
    R32Float,
    /// `r32ui`.
    R32Uint,
    /// `rgba8`.
    Rgba8Unorm,
    /// `rgba16f`.
    Rgba16Float,
    /// `rgba32f`.
    Rgba32Float,
}

/// One binding of descriptor set 0.
#[derive(Clone, Copy, Debug)]
pub struct Binding {
    /// GLSL name.
    pub name: &'static str,
    /// Number.
    pub number: u32,
    /// Kind of the bound resource.
    pub kind: BindingKind,
    /// Access of the code.
    pub access: Access,
}

/// One specialization constant.
#[derive(Clone, Copy, Debug)]
pub struct Spec {
    /// GLSL name.
    pub name: &'static str,
    /// `constant_id`.
    pub id: u32,
    /// Default as raw bits.
    pub default: u32,
}

/// A kernel: its module and what was reflected from it.
#[derive(Clone, Copy, Debug)]
pub struct Kernel {
    /// The stage's name.
    pub name: &'static str,
    /// The family (folder) it belongs to.
    pub family: &'static str,
    /// The module.
    pub spirv: Spirv,
    /// Bytes of push constants.
    pub push_bytes: u32,
    /// Bindings by number.
    pub bindings: &'static [Binding],
    /// Specialization constants by id.
    pub specs: &'static [Spec],
}

/// A kernel that needs newer GLSL than some compilers know.
#[derive(Clone, Copy, Debug)]
pub struct Optional {
    /// The kernel's name.
    pub name: &'static str,
    /// The extension of GLSL that it needs.
    pub extension: &'static str,
    /// The kernel, if this build's compiler knew the extension.
    pub kernel: Option<&'static Kernel>,
}

/// The optional kernel of this name, if this build has it.
pub fn optional(name: &str) -> Option<&'static Kernel> {
    OPTIONAL.iter().find(|o| o.name == name)?.kernel
}

/// Whether this build's compiler knew an extension of GLSL that some kernels need.
pub fn compiled_with(extension: &str) -> bool {
    OPTIONAL.iter().any(|o| o.extension == extension && o.kernel.is_some())
}

/// An embedded SPIR-V module, aligned for reading as words.
#[derive(Clone, Copy)]
pub struct Spirv {
    bytes: &'static [u8],
}

impl Spirv {
    /// The module's words.
    pub fn words(&self) -> &'static [u32] {
        bytemuck::cast_slice(self.bytes)
    }
}

impl std::fmt::Debug for Spirv {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Spirv({} bytes)", self.bytes.len())
    }
}

/// Bytes at the alignment of a word.
#[repr(C, align(4))]
struct Aligned<const N: usize>([u8; N]);

impl<const N: usize> Aligned<N> {
    const fn as_slice(&'static self) -> &'static [u8] {
        &self.0
    }
}

include!(concat!(env!("OUT_DIR"), "/kernels.rs"));
