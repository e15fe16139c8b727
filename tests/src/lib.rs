//! Test harness: device, graphs, tolerances, the `sgs` program and tiny rooms.
//!
//! The device has validation on. Graphs run once with poisoned outputs. Gradients are tested against finite
//! differences.

pub mod area_lights;
pub mod browser;
pub mod busy;
pub mod cli;
pub mod compare;
pub mod drawn;
pub mod emitting;
pub mod emulated;
pub mod environment;
pub mod feature_view;
pub mod field;
pub mod field_half;
pub mod foreign;
pub mod gbuffer;
pub mod gpu;
pub mod gradients;
pub mod intrinsic;
pub mod kernels;
pub mod lit;
mod long;
pub mod materials;
pub mod meaning;
pub mod photographs;
pub mod place;
mod pool;
pub mod priors;
pub mod program;
pub mod random;
pub mod regions;
pub mod rooms;
pub mod runs;
pub mod scenes;
pub mod screen;
pub mod semantics;
pub mod splats;
pub mod surfaces;
pub mod transport;
pub mod turn;
pub mod whole;

pub use compare::{Tolerance, assert_close, finite_difference, worst};
pub use gpu::{Gpu, Outputs};
pub use long::takes_long;
pub use place::{Place, files};
pub use turn::{Turn, turn};
