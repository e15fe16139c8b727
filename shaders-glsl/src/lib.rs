//! Compute kernels: SPIR-V and typed metadata, generated from GLSL.
//!
//! The build script generates a module for each `*.comp` file of this folder. The module has the kernel's push
//! constants, bindings by name with the access of the code, and specialization constants. Structs that host and shader
//! share have checked offsets. This crate depends on neither Vulkan nor the renderer.

pub use sgs_shader_abi::{Access, Binding, BindingKind, ImageFormat, SpecConstant};
use std::borrow::Cow;

/// Kernel with its SPIR-V module and reflected metadata.
#[derive(Clone, Copy, Debug)]
pub struct Kernel {
    /// Name, the file stem of the GLSL.
    pub name: &'static str,
    /// Family, the folder of the GLSL.
    pub family: &'static str,
    /// SPIR-V module.
    pub spirv: Spirv,
    /// Size of the push constants in bytes.
    pub push_bytes: u32,
    /// Bindings, sorted by number.
    pub bindings: &'static [Binding],
    /// Specialization constants, sorted by id.
    pub specs: &'static [SpecConstant],
}

/// Kernel that needs a GLSL extension which some compilers lack.
#[derive(Clone, Copy, Debug)]
pub struct Optional {
    /// Name of the kernel.
    pub name: &'static str,
    /// GLSL extension that the kernel needs.
    pub extension: &'static str,
    /// The kernel, if the compiler of this build supports the extension.
    pub kernel: Option<&'static Kernel>,
}

/// Returns the optional kernel of a name, if this build has it.
pub fn optional(name: &str) -> Option<&'static Kernel> {
    OPTIONAL.iter().find(|o| o.name == name)?.kernel
}

/// Returns whether the compiler of this build supports a GLSL extension.
///
/// Answers only for extensions that some kernel needs; returns false for others.
pub fn compiled_with(extension: &str) -> bool {
    OPTIONAL.iter().any(|o| o.extension == extension && o.kernel.is_some())
}

/// Embedded SPIR-V module, aligned for reading as words.
#[derive(Clone, Copy)]
pub struct Spirv {
    bytes: &'static [u8],
}

impl Spirv {
    /// Returns the words of the module.
    pub fn words(&self) -> &'static [u32] {
        bytemuck::cast_slice(self.bytes)
    }
}

impl std::fmt::Debug for Spirv {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Spirv({} bytes)", self.bytes.len())
    }
}

/// Bytes with the alignment of a 32-bit word.
#[repr(C, align(4))]
struct Aligned<const N: usize>([u8; N]);

impl<const N: usize> Aligned<N> {
    const fn as_slice(&'static self) -> &'static [u8] {
        &self.0
    }
}

include!(concat!(env!("OUT_DIR"), "/kernels.rs"));
