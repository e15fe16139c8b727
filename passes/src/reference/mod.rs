//! A twin in double precision for every stage, on the CPU, with the same name. Written from the definitions.

pub mod adam;
pub mod blend;
pub mod densify;
pub mod geometry_loss;
pub mod intersect;
pub mod photometric;
pub mod present;
pub mod project;
pub mod radix_sort;
pub mod rng;
pub mod scan;
