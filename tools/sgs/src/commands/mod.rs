//! Commands, one file each.

pub mod ablate;
pub mod batch;
pub mod capture;
pub mod devices;
pub mod eval;
pub mod export;
mod export_page;
pub mod plan;
mod plan_intrinsic;
mod plan_transport;
pub mod priors;
mod programs;
mod progress;
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
