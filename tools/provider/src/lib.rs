//! Networks that live outside of the engine: child processes that answer questions about images.
//!
//! A [`Provider`] is a program that the user names. It is spoken to over its standard input and output by the protocol
//! of `docs/guide/priors.md`: masks, regions, normals, features, materials, names and their embeddings. Whatever it does
//! wrong (it cannot be started, ends, hangs, writes nonsense) is a [`ProviderError`] of one sentence, after which it has
//! been stopped and reaped. [`Helper`] lets a caller go on without it. [`fill()`] asks one about the images of a scene and
//! writes `priors/`.
//!
//! No thread is started and nothing outlives the value. The crate knows files and images; neither devices nor training.

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
pub use fill::{FillError, FillOptions, Filled, Prior, fill};
pub use helper::{Fallback, Helper};
pub use kind::Kind;
pub use message::Message;
pub use offer::{About, Encoding, Offer};
pub use options::ProviderOptions;
pub use provider::Provider;
pub use question::{Features, Masks, Materials, Normals, Picture, Regions};

/// The versions of the protocol that are spoken here, lowest and highest.
pub const VERSIONS: [u32; 2] = [1, 1];
