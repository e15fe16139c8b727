//! Interface for C and C++: `libsgs` and `sgs.h`. The interface is a thin layer over the crates of the command line.
//!
//! Guarantees: every function returns a result code, except those that return the version or a text. No panic crosses
//! the interface. The library has no global state. Null, stale and foreign handles return an error.
//!
//! The functions and docs/guide/embed.md state the obligations of the caller: valid pointers and Vulkan handles, and
//! when submissions are complete. docs/adr/0013-c-interface.md has the reasons.

#![allow(clippy::missing_safety_doc)] // The header states the contracts: pointers are null or what they are called.

mod border;
mod context;
mod emitter;
mod host;
mod object;
mod relight;
mod scene;
mod table;
mod trainer;
pub mod types;
mod view;

pub use context::*;
pub use emitter::*;
pub use host::*;
pub use relight::*;
pub use scene::*;
pub use trainer::*;
pub use types::*;
pub use view::*;
