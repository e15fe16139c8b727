//! The harness: a device with validation on, graphs run once with poisoned outputs, tolerances, finite differences.

pub mod compare;
pub mod gpu;
pub mod scenes;

pub use compare::{Tolerance, assert_close, finite_difference, worst};
pub use gpu::{Gpu, Outputs};
