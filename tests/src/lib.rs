//! The harness: a device with validation on, graphs run once with poisoned outputs, tolerances, finite differences; the
//! `sgs` program as a user runs it, and tiny rooms for it.

pub mod browser;
pub mod busy;
pub mod cli;
pub mod compare;
pub mod drawn;
pub mod environment;
pub mod feature_view;
pub mod field;
pub mod foreign;
pub mod gbuffer;
pub mod gpu;
pub mod gradients;
pub mod intrinsic;
pub mod kernels;
pub mod lit;
pub mod materials;
pub mod meaning;
pub mod photographs;
pub mod place;
pub mod priors;
pub mod random;
pub mod regions;
pub mod rooms;
pub mod runs;
pub mod scenes;
pub mod screen;
pub mod semantics;
pub mod splats;
pub mod surfaces;
pub mod whole;

pub use compare::{Tolerance, assert_close, finite_difference, worst};
pub use gpu::{Gpu, Outputs};
pub use place::{Place, files};
