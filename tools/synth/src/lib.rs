//! Procedural furnished rooms, path-traced on the CPU: complete scene directories with images, cameras, points,
//! imitated priors and ground truth.
//!
//! [`generate`] makes a directory in a layout that the trainer reads ([`SynthLayout`]): by default `transforms.json`,
//! `split.json`, `points.ply`, `images/`, `priors/` and `gt/`. World: y up, meters; images are sRGB of linear radiance at exposure 1.
//! The same [`SynthOptions`] give the same bytes on any number of threads. Reading scenes back, and everything that
//! needs a GPU, is left to other crates.

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
