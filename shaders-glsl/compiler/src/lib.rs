//! Compiles, reflects and generates the host side of kernels, for use in a build script.
//!
//! Promises: every `*.comp` below a folder becomes one Rust module with its SPIR-V, its named bindings and what the code
//! does to each, its push constants and shared structs with checked offsets, and its specialization constants. A kernel
//! that does not compile stops the build with the compiler's message. One that requires an optional extension
//! ([`OPTIONAL_EXTENSIONS`]) unknown to the compiler is listed as absent. Leaves Vulkan to others.

mod access;
mod codegen;
mod compile;
mod reflect;

pub use access::Access;
pub use codegen::generate;
pub use compile::{Absent, Error, Folder, OPTIONAL_EXTENSIONS, compile_folder};
pub use reflect::{Binding, BindingKind, Field, FieldType, Kernel, Spec, Struct};
