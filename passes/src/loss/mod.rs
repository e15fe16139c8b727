//! Losses: each a forward pass that leaves sums, and a gradient by what was rendered.

pub mod geometry_loss;
pub mod octahedral;
pub mod photometric;
pub mod sum;

pub use geometry_loss::{GeometryLoss, GeometrySums, geometry_loss};
pub use octahedral::{octahedral_decode, octahedral_encode};
pub use photometric::{Partials, Photometric, photometric, photometric_bwd, photometric_bwd_in_place};
pub use sum::loss_sum;
