//! Compiles and reflects kernels and generates Rust for them, in a build script.
//!
//! Guarantees: Every `*.comp` file in a subfolder becomes one Rust module. The module has the SPIR-V, the named
//! bindings with the access of the code, the push constants, and the specialization constants. Shared structs have
//! checked offsets. A kernel that does not compile stops the build with the compiler's message. A kernel that requires
//! an optional extension ([`OPTIONAL_EXTENSIONS`]) which the compiler lacks is listed as absent. This crate does not
//! use Vulkan.

mod access;
mod codegen;
mod compile;
mod reflect;

pub use codegen::generate;
pub use compile::{Absent, Error, Folder, OPTIONAL_EXTENSIONS, compile_folder};
pub use reflect::{Field, FieldType, Kernel, Spec, Struct};
pub use sgs_shader_abi::{Access, Binding, BindingKind, ImageFormat, SpecConstant};
