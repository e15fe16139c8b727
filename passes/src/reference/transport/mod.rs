//! Reference of transport: rays against all discs, and the radiosity of a dense system of equations.

mod matrix;
mod rays;
mod responses;
mod source;

pub use matrix::Matrix;
pub use rays::{Bounds, Disc, Possible, direction, gather, gather_bwd};
pub use responses::{gaussian_emission, response_radiosity, response_source, response_sum};
pub use source::{RoomParameters, RoomSource, SurfelMaterial, blend, reflectance, source};

/// Three numbers.
pub type V3 = [f64; 3];

/// Returns the scalar product.
fn dot(a: V3, b: V3) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}
