//! What brings bytes to readers, by what they read.

pub(crate) mod images;
pub(crate) mod light;
pub(crate) mod look;
pub(crate) mod provider;
pub(crate) mod runs;
pub(crate) mod scenes;
pub(crate) mod splats;
pub(crate) mod tensors;

use std::fmt::Display;

/// What a reader came to, in words.
fn said<T, E: Display>(result: Result<T, E>, read: impl FnOnce(T) -> String) -> String {
    match result {
        Ok(value) => read(value),
        Err(error) => error.to_string(),
    }
}
