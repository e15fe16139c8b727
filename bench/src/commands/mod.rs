//! Commands, one file each.

pub mod batch;
pub mod ceiling;
pub mod compile;
pub mod host;
pub mod intrinsic;
pub mod isa;
mod own_step;
pub mod passes;
pub mod results;
pub mod roofline;
pub mod rooms;
pub mod savings;
pub mod scaling;
pub mod step;
mod tiles;
pub mod tradeoff;
