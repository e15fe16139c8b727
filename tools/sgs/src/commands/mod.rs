//! One file a command.

pub mod ablate;
pub mod devices;
pub mod diverged;
pub mod eval;
pub mod export;
pub mod geometry;
pub mod intrinsic;
pub mod plan;
mod plan_intrinsic;
pub mod priors;
pub mod pseudo;
pub mod relight;
pub mod render;
pub mod report;
pub mod robustness;
pub mod series;
pub mod shell;
pub mod synth;
pub mod train;
pub mod view;
