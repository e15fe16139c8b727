//! Content of `sgs report`: images of views, and the contribution of each light.

pub mod emitters;
pub mod evening;
pub mod lights;
pub mod relit;
pub mod views;
