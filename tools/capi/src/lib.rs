//! The interface for C and C++: `libsgs` and `sgs.h`.
//!
//! A thin border around the same crates that the command line uses. Promises: every function returns a result code; no
//! panic crosses the border; there is no global state; null, stale and foreign handles are answered with an error. What a
//! caller must promise is written at the functions and in docs/guide/embed.md: the pointers it passes, the Vulkan handles,
//! and when its submissions are done. Reasons are in docs/adr/0013-c-interface.md.

#![allow(clippy::missing_safety_doc)] // The contracts are those of the header: pointers are null or what they are called.

mod border;
mod context;
mod host;
mod relight;
mod scene;
mod table;
mod trainer;
pub mod types;
mod view;

pub use context::*;
pub use host::*;
pub use relight::*;
pub use scene::*;
pub use trainer::*;
pub use types::*;
pub use view::*;
