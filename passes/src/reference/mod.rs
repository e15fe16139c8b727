//! Reference of every stage: double precision on the CPU, under the same name. All are written from the definitions.

pub mod adam;
pub mod area_lights;
pub mod blend;
pub mod brdf;
pub mod compose;
pub mod correspondence;
pub mod cross_view;
pub mod densify;
pub mod edge_aware;
pub mod environment;
pub mod gbuffer;
pub mod geometry_loss;
pub mod intersect;
pub mod lights;
pub mod material_images;
pub mod msg;
pub mod photometric;
pub mod present;
pub mod project;
pub mod radix_sort;
pub mod region_mask;
pub mod relocate;
pub mod rounding;
pub mod scan;
pub mod semantic;
pub mod show;
pub mod srgb;
pub mod stored;
pub mod sub_tiles;
pub mod taps;
pub mod traced;
pub mod transport;
pub mod transport_reflect;
pub mod transport_shade;
pub mod visibility;
pub mod visibility_half;

pub use crate::rng;

/// Returns the central difference of `f` along coordinate `i` of `x`.
#[cfg(test)]
fn difference(x: &mut [f64], i: usize, f: impl Fn(&[f64]) -> f64) -> f64 {
    let old = x[i];
    x[i] = old + 1e-5;
    let up = f(x);
    x[i] = old - 1e-5;
    let down = f(x);
    x[i] = old;
    (up - down) / 2e-5
}
