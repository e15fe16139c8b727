//! Furniture. Each item stands on the floor at the origin of its frame and faces +z.

pub(crate) mod decor;
pub(crate) mod lamps;
pub(crate) mod plants;
pub(crate) mod seats;
pub(crate) mod shelves;
pub(crate) mod tables;
pub(crate) mod textiles;
pub(crate) mod walls;
