//! External networks: child processes that answer questions about images.
//!
//! A [`Provider`] is a program that the user names. It communicates over its standard input and output by the protocol
//! of `docs/guide/priors.md`: masks, regions, normals, depth, features, materials, class names and their embeddings. Every
//! fault (a failed start, an early end, a timeout, invalid output) is a [`ProviderError`] of one sentence. After a
//! fault the process has been stopped and reaped. [`Helper`] lets a caller continue without a provider. [`fill()`] asks
//! a provider about the images of a scene and writes `priors/`.
//!
//! The crate starts no threads, and no process outlives its value. It depends on files and images, not on devices or
//! training.

mod array;
mod error;
mod fill;
mod frame;
mod helper;
mod kind;
mod message;
mod offer;
mod options;
#[cfg(unix)]
mod pipe;
#[cfg(not(unix))]
#[path = "pipe_elsewhere.rs"]
mod pipe;
mod provider;
mod question;
mod words;

pub use array::Array;
pub use error::{Nonsense, ProviderError, Result};
pub use fill::{FillError, FillOptions, Filled, Prior, fill, fill_normals_from_depth};
pub use helper::{Fallback, Helper};
pub use kind::Kind;
pub use message::Message;
pub use offer::{About, Encoding, Offer};
pub use options::ProviderOptions;
pub use provider::Provider;
pub use question::{Depth, Features, Masks, Materials, Normals, ProviderImage, Regions};

/// Lowest and highest supported version of the protocol.
pub const VERSIONS: [u32; 2] = [1, 1];
