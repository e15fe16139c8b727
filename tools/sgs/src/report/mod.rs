//! What `sgs report` shows: pictures of views, and what each light does.

pub mod evening;
pub mod lamps;
pub mod views;
