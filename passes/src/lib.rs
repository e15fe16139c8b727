//! GPU passes of splatting, shading and training.
//!
//! Typed stages are grouped as their kernels are. A CPU reference in double precision exists for each. The crate knows
//! Gaussians, lights and images, but not files or the command line.

mod accuracy;
mod bvh;
pub mod cost;
pub mod kernel;
pub mod loss;
mod matrices;
pub mod optim;
pub mod pipeline;
pub mod prim;
pub mod reference;
pub mod rng;
pub mod scene;
pub mod shade;
pub mod splat;
pub mod transport;
mod tuning;

pub use accuracy::Accuracy;
pub use matrices::{Matrices, NoMatrices};
pub use tuning::Tuning;
