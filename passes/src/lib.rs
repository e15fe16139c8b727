//! The mathematics on the GPU: typed stages in the families of the kernels, and a CPU twin of each in double precision.
//!
//! Knows Gaussians, lights and images; never files or the command line.

mod accuracy;
pub mod cost;
pub mod kernel;
pub mod loss;
mod matrices;
pub mod optim;
pub mod pipeline;
pub mod prim;
pub mod reference;
pub mod scene;
pub mod shade;
pub mod splat;
mod tuning;

pub use accuracy::Accuracy;
pub use matrices::{Matrices, NoMatrices};
pub use tuning::Tuning;
