//! Files: what is written where, in which encoding.
//!
//! Everything goes into a sibling of the output directory that is renamed into place at the end, so an output
//! directory is either complete or absent.

pub(crate) mod exr;
pub(crate) mod layout;
pub(crate) mod lights;
pub(crate) mod meta;
pub(crate) mod npy;
pub(crate) mod ply;
pub(crate) mod png;
pub(crate) mod stage;
pub(crate) mod view;
