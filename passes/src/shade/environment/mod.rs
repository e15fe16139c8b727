//! `environment`: light from far away, as a cube of texels that is learned.
//!
//! Parameters are the texels: raw linear radiance, `[6 * S * S * 3]` floats, S a power of two from 16 to 512, not negative
//! ([`environment_clamp`] after each step). In a step [`environment_filter`] makes mips and from them the levels that
//! surfaces of each roughness see, the last of which is the diffuse irradiance too; [`environment`] shades pixels;
//! [`environment_bwd`] leaves gradients of materials and, summed in fixed point, of the levels; [`environment_filter_bwd`]
//! takes those back to the texels by the filters' exact adjoints, together with [`environment_smoothness`].
//!
//! Promises: every filter is a fixed linear operator that keeps constants, so that a white environment is exactly white at
//! every roughness; lookups have no seams; the same bits from run to run. Radiance is not clamped, nothing shadows it,
//! and pixels are left out by coverage alone (and where there is no normal at all). Normals are detached.
//!
//! After SGS-Intrinsic; [`levels`] says where the filters differ from the published ones.

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
    Filtered, Kept, environment_filter, environment_filter_bwd, environment_filter_kept, environment_filter_kept_bwd,
};
pub use lookup::{
    EnvironmentSums, EnvironmentView, environment, environment_background, environment_bwd, environment_diffuse,
};
pub use smoothness::{Smoothness, environment_clamp, environment_smoothness};

use crate::reference::rng::Pcg;
use form::Form;
use levels::Level;
use map::MapLookup;
use sgs_engine::graph::{Buffer, Graph, Slice};

/// Why an environment cannot be made.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum EnvironmentError {
    /// The resolution is none of 16, 32, 64, 128, 256 and 512.
    #[error("An environment of {0} texels a side is not possible; use 16, 32, 64, 128, 256 or 512.")]
    Size(u32),
    /// The filters would take more products than kernels count.
    #[error("{0} products a level are too many for an environment's filter; {1} are the most.")]
    Products(u64, u64),
}

/// How an environment is filtered and measured.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EnvironmentOptions {
    /// Products of texel and weight that a level may take ([`levels::PRODUCTS`]): time against how far lobes reach.
    pub products: u64,
    /// Columns and rows of the map that smoothness is measured on ([`latlong::SIZE`]); none: there will be no such term.
    pub smoothness: Option<[u32; 2]>,
}

impl Default for EnvironmentOptions {
    fn default() -> Self {
        EnvironmentOptions { products: levels::PRODUCTS, smoothness: Some(latlong::SIZE) }
    }
}

/// Everything about an environment that does not change: its levels and tables.
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

/// How smoothness is measured.
#[derive(Clone, Debug)]
enum Measured {
    /// By a quadratic form of the texels.
    Form(Form),
    /// On the map, looked up in each step.
    Map(MapLookup),
}

/// Its tables as inputs of a graph.
#[derive(Clone, Copy, Debug)]
pub(super) enum SmoothnessTables {
    /// Starts and entries of the form's rows.
    Form([Buffer; 2]),
    /// Footprints of pixels, starts and entries of texels; columns and rows of the map.
    Map([Buffer; 3], [u32; 2]),
}

/// The tables as inputs of a graph.
#[derive(Clone, Copy, Debug)]
pub struct EnvironmentTables {
    areas: Buffer,
    levels: Buffer,
    split_sum: Buffer,
    smoothness: Option<SmoothnessTables>,
}

impl Environment {
    /// The most products of a level: llvmpipe ends loops after 65535 rounds.
    pub const MOST_PRODUCTS: u64 = 1 << 34;

    /// Works out the tables of an environment of `size` texels a side; with smoothness that takes about a second.
    ///
    /// # Errors
    /// If the size is not possible, or the filters would be too large.
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

    /// The finest cube whose smoothness is a quadratic form of its texels. A map of 1024 columns has no more texels along its equator;
    /// finer cubes are looked up at the map's pixels in each step.
    pub const FORM: u32 = 256;

    /// Texels along a side.
    pub fn size(&self) -> u32 {
        self.size
    }

    /// Floats of the parameters: three a texel.
    pub fn floats(&self) -> u32 {
        18 * self.size * self.size
    }

    /// The levels, from the sharpest to the irradiance.
    pub fn levels(&self) -> &[Level] {
        &self.levels
    }

    /// Texels of all levels.
    pub fn filtered_texels(&self) -> u32 {
        self.levels.iter().map(Level::texels).sum()
    }

    /// Factor of F0 and what is added, [`split_sum::NODES`] a row.
    pub fn split_sum(&self) -> &[[f32; 2]] {
        &self.split_sum
    }

    /// Texels to begin with: each number between 0.25 and 1.75.
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

    /// What the host must put into the tables once.
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

    /// Solid angles of a face of a level.
    fn areas(&self, tables: &EnvironmentTables, size: u32) -> Slice {
        let first = self.area_of.iter().find(|(s, _)| *s == size).map_or(0, |(_, first)| *first);
        Slice { buffer: tables.areas, offset: 4 * u64::from(first), bytes: 4 * u64::from(size * size) }
    }

    /// The parts that gradients of the texels are made of: first texel and size of each level's mip, then of smoothness.
    fn parts(&self, smoothness: bool) -> Vec<(u32, u32)> {
        let mut parts: Vec<(u32, u32)> = self.levels.iter().map(|l| (l.first, l.size)).collect();
        if smoothness && self.measured.is_some() {
            parts.push((self.filtered_texels(), self.size));
        }
        parts
    }
}
