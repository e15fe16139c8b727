//! Output files and their encodings.
//!
//! Everything is written to a sibling of the output directory, which is renamed into place at the end. An output
//! directory is therefore either complete or absent.

pub(crate) mod exr;
pub(crate) mod layout;
pub(crate) mod lights;
pub(crate) mod meta;
pub(crate) mod npy;
pub(crate) mod ply;
pub(crate) mod png;
pub(crate) mod stage;
pub(crate) mod view;
