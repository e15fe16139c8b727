//! Procedural furnished rooms, path-traced on the CPU.
//!
//! A scene directory holds images, cameras, points, simulated priors and ground truth. [`generate`] writes a layout
//! that the trainer reads ([`SynthLayout`]): by default `transforms.json`, `split.json`, `points.ply`, `images/`,
//! `priors/` and `gt/`. World: y up, meters. Images are sRGB of linear radiance at exposure 1. The same
//! [`SynthOptions`] give the same bytes on any number of threads. Other crates read scenes and use the GPU.

mod color;
mod error;
mod expose;
mod generate;
mod noise;
mod options;
mod output;
mod points;
mod priors;
mod rng;
mod scene;
mod trace;
mod views;

pub use error::SynthError;
pub use generate::{Summary, generate};
pub use options::{SceneName, SynthLayout, SynthOptions};
