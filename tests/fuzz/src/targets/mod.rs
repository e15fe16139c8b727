//! Targets, grouped by the files that they read.

pub(crate) mod describe;
pub(crate) mod images;
pub(crate) mod light;
pub(crate) mod provider;
pub(crate) mod runs;
pub(crate) mod scenes;
pub(crate) mod splats;
pub(crate) mod tensors;

use std::fmt::Display;

/// Returns the text of a reader's result: of its value or its error.
fn text_of<T, E: Display>(result: Result<T, E>, read: impl FnOnce(T) -> String) -> String {
    match result {
        Ok(value) => read(value),
        Err(error) => error.to_string(),
    }
}
