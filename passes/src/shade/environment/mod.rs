//! `environment`: distant light as a trainable cube map of texels.
//!
//! The parameters are the texels: raw linear radiance, `[6 * S * S * 3]` floats, where S is a power of two from 16 to
//! 512. They are not negative ([`environment_clamp`] after each step). Passes of a step:
//!
//! - [`environment_filter`] builds mips, and from them the levels for each roughness. The last level is also the
//!   diffuse irradiance.
//! - [`environment`] shades pixels.
//! - [`environment_bwd`] computes gradients of materials and, summed in fixed point, of the levels.
//! - [`environment_filter_bwd`] takes the gradients of the levels back to the texels by the filters' exact adjoints,
//!   and adds those of [`environment_smoothness`].
//!
//! Guarantees: every filter is a fixed linear operator that preserves constants, so that a white environment map is
//! exactly white at every roughness. Lookups have no seams. Results are bit-identical from run to run. Radiance is not
//! clamped and not shadowed. Only pixels with low coverage or without a normal are skipped. Normals are detached.
//!
//! After SGS-Intrinsic. [`levels`] documents where the filters differ from the published ones.

pub mod cube;
mod filter;
pub mod form;
pub mod latlong;
pub mod levels;
mod lookup;
pub mod map;
mod smoothness;
pub mod split_sum;

pub use filter::{
    Filtered, StoredFilter, environment_filter, environment_filter_bwd, environment_filter_stored,
    environment_filter_stored_bwd,
};
pub use lookup::{
    EnvironmentSums, EnvironmentView, environment, environment_background, environment_bwd, environment_diffuse,
};
pub use smoothness::{Smoothness, environment_clamp, environment_smoothness};

use crate::rng::Pcg;
use form::Form;
use levels::Level;
use map::MapLookup;
use sgs_engine::graph::{Buffer, Graph, Slice};

/// Reason why an environment map cannot be created.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum EnvironmentError {
    /// The resolution is none of 16, 32, 64, 128, 256 and 512.
    #[error("An environment of {0} texels a side is not possible; use 16, 32, 64, 128, 256 or 512.")]
    Size(u32),
    /// The filters would need more products than kernels can count.
    #[error("{0} products a level are too many for an environment's filter; {1} are the most.")]
    Products(u64, u64),
}

/// Options for filtering an environment map and for its smoothness term.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EnvironmentOptions {
    /// Limit on the products of texel and weight of a level ([`levels::PRODUCTS`]). Trades time for the reach of the
    /// lobes.
    pub products: u64,
    /// Columns and rows of the smoothness term's map ([`latlong::SIZE`]). `None` disables the term.
    pub smoothness: Option<[u32; 2]>,
}

impl Default for EnvironmentOptions {
    fn default() -> Self {
        EnvironmentOptions { products: levels::PRODUCTS, smoothness: Some(latlong::SIZE) }
    }
}

/// Constant data of an environment map: its levels and tables.
#[derive(Clone, Debug)]
pub struct Environment {
    size: u32,
    levels: Vec<Level>,
    areas: Vec<f32>,
    /// Size and first element in `areas`.
    area_of: Vec<(u32, u32)>,
    split_sum: Vec<[f32; 2]>,
    measured: Option<Measured>,
}

/// Evaluation method of the smoothness term.
#[derive(Clone, Debug)]
enum Measured {
    /// By a quadratic form of the texels.
    Form(Form),
    /// On the map, which is looked up in each step.
    Map(MapLookup),
}

/// Smoothness tables as inputs of a graph.
#[derive(Clone, Copy, Debug)]
pub(super) enum SmoothnessTables {
    /// Starts and entries of the form's rows.
    Form([Buffer; 2]),
    /// Footprints of pixels, starts and entries of texels; columns and rows of the map.
    Map([Buffer; 3], [u32; 2]),
}

/// Environment tables as inputs of a graph.
#[derive(Clone, Copy, Debug)]
pub struct EnvironmentTables {
    areas: Buffer,
    levels: Buffer,
    split_sum: Buffer,
    smoothness: Option<SmoothnessTables>,
}

impl Environment {
    /// Maximum number of products of a level. llvmpipe ends loops after 65535 iterations.
    pub const MOST_PRODUCTS: u64 = 1 << 34;

    /// Builds the tables of an environment map of `size` texels a side. With smoothness this takes about a second.
    ///
    /// # Errors
    /// If the size is not supported, or the filters would be too large.
    pub fn new(size: u32, options: &EnvironmentOptions) -> Result<Environment, EnvironmentError> {
        if !size.is_power_of_two() || !(16..=512).contains(&size) {
            return Err(EnvironmentError::Size(size));
        }
        if options.products > Environment::MOST_PRODUCTS {
            return Err(EnvironmentError::Products(options.products, Environment::MOST_PRODUCTS));
        }
        let levels = levels::levels(size, options.products);
        let (mut areas, mut area_of) = (Vec::new(), Vec::new());
        for level in &levels {
            let n = level.size;
            if !area_of.iter().any(|(s, _)| *s == n) {
                area_of.push((n, areas.len() as u32));
                areas.extend((0..n * n).map(|i| cube::solid_angle(n, i % n, i / n) as f32));
            }
        }
        let measured = options.smoothness.map(|map| match size > Self::FORM {
            true => Measured::Map(map::map_lookup(size, map)),
            false => Measured::Form(form::form(size, map)),
        });
        Ok(Environment { size, levels, areas, area_of, split_sum: split_sum::table(), measured })
    }

    /// Size of the finest cube whose smoothness is a quadratic form of its texels. A map of 1024 columns has no more
    /// texels along its equator. Finer cubes are looked up at the map's pixels in each step.
    pub const FORM: u32 = 256;

    /// Returns the number of texels along a side.
    pub fn size(&self) -> u32 {
        self.size
    }

    /// Returns the number of floats of the parameters, three per texel.
    pub fn floats(&self) -> u32 {
        18 * self.size * self.size
    }

    /// Returns the levels, from the sharpest to the irradiance.
    pub fn levels(&self) -> &[Level] {
        &self.levels
    }

    /// Returns the number of texels of all levels.
    pub fn filtered_texels(&self) -> u32 {
        self.levels.iter().map(Level::texels).sum()
    }

    /// Returns the split-sum table: the factor of F0 and the offset of each node. A row has [`split_sum::NODES`] nodes.
    pub fn split_sum(&self) -> &[[f32; 2]] {
        &self.split_sum
    }

    /// Returns random initial texels, uniform between 0.25 and 1.75.
    pub fn start(&self, seed: u32) -> Vec<f32> {
        let mut rng = Pcg::new(seed);
        (0..self.floats()).map(|_| rng.range(0.25, 1.75) as f32).collect()
    }

    /// Declares the tables as inputs of a graph.
    pub fn declare(&self, g: &mut Graph) -> EnvironmentTables {
        let bytes = |words: usize| 4 * words as u64;
        EnvironmentTables {
            areas: g.input("environment.areas", bytes(self.areas.len())),
            levels: g.input("environment.levels", bytes(2 * self.levels.len())),
            split_sum: g.input("environment.split_sum", bytes(2 * self.split_sum.len())),
            smoothness: self.measured.as_ref().map(|measured| match measured {
                Measured::Form(f) => SmoothnessTables::Form([
                    g.input("environment.form_starts", bytes(f.starts.len())),
                    g.input("environment.form_entries", bytes(2 * f.entries.len())),
                ]),
                Measured::Map(m) => {
                    let tables = [
                        g.input("environment.map_footprints", bytes(8 * m.footprints.len())),
                        g.input("environment.map_starts", bytes(m.starts.len())),
                        g.input("environment.map_entries", bytes(2 * m.entries.len())),
                    ];
                    SmoothnessTables::Map(tables, m.size)
                }
            }),
        }
    }

    /// Returns the contents that the host uploads to the tables once.
    pub fn contents(&self, tables: &EnvironmentTables) -> Vec<(Buffer, Vec<u8>)> {
        let levels: Vec<[u32; 2]> = self.levels.iter().map(|l| [l.size, l.first]).collect();
        let mut all = vec![
            (tables.areas, bytemuck::cast_slice(&self.areas).to_vec()),
            (tables.levels, bytemuck::cast_slice(&levels).to_vec()),
            (tables.split_sum, bytemuck::cast_slice(&self.split_sum).to_vec()),
        ];
        match (&self.measured, tables.smoothness) {
            (Some(Measured::Form(form)), Some(SmoothnessTables::Form([starts, entries]))) => {
                all.push((starts, bytemuck::cast_slice(&form.starts).to_vec()));
                all.push((entries, bytemuck::cast_slice(&form.entries).to_vec()));
            }
            (Some(Measured::Map(map)), Some(SmoothnessTables::Map([footprints, starts, entries], _))) => {
                all.push((footprints, bytemuck::cast_slice(&map.footprints).to_vec()));
                all.push((starts, bytemuck::cast_slice(&map.starts).to_vec()));
                all.push((entries, bytemuck::cast_slice(&map.entries).to_vec()));
            }
            _ => {}
        }
        all
    }

    /// Returns the slice with the texels' solid angles on a face of a level.
    fn areas(&self, tables: &EnvironmentTables, size: u32) -> Slice {
        let first = self.area_of.iter().find(|(s, _)| *s == size).map_or(0, |(_, first)| *first);
        Slice { buffer: tables.areas, offset: 4 * u64::from(first), bytes: 4 * u64::from(size * size) }
    }

    /// Returns the first texel and size of each term of the texels' gradients. The terms are each level's mip, then
    /// smoothness.
    fn parts(&self, smoothness: bool) -> Vec<(u32, u32)> {
        let mut parts: Vec<(u32, u32)> = self.levels.iter().map(|l| (l.first, l.size)).collect();
        if smoothness && self.measured.is_some() {
            parts.push((self.filtered_texels(), self.size));
        }
        parts
    }
}
