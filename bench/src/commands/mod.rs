//! The commands, one a file.

pub mod ceiling;
pub mod passes;
pub mod scaling;
pub mod step;
