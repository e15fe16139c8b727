//! The visibility field's shape and start: a hash grid of features and a small network.
//!
//! Mueller et al. 2022 for the grid; SGS-Intrinsic, stage II, for sizes and network. Promises: sizes are a function of the
//! configuration alone, the start of the seed alone. Leaves evaluation to [`super`], files to the tools.

use crate::reference::rng::{random_bits, uniform_from};
use sgs_shaders::structs::FieldLevel;

/// Neurons of a hidden layer.
pub const FIELD_WIDTH: usize = 32;

/// Features of an entry.
pub const FIELD_FEATURES: usize = 2;

/// Most levels that kernels take.
pub const FIELD_LEVELS: u32 = 16;

/// Why there can be no such field.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum FieldError {
    /// Levels.
    #[error("A visibility field has 1 to 16 levels, not {0}.")]
    Levels(u32),
    /// Size of the tables.
    #[error("A level's table has 2^8 to 2^22 entries, not 2^{0}.")]
    Table(u32),
    /// Resolutions.
    #[error(
        "A visibility field's resolutions are between 2 and 65536, the finest not below the coarsest; not {0} to {1}."
    )]
    Resolutions(u32, u32),
}

/// The shape of a visibility field.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FieldConfig {
    /// Levels of the grid.
    pub levels: u32,
    /// A level has at most 2 to this many entries.
    pub log2_table: u32,
    /// Grid points along an axis, coarsest level.
    pub coarsest: u32,
    /// The same, finest level.
    pub finest: u32,
}

impl Default for FieldConfig {
    /// As in SGS-Intrinsic: 16 levels of at most 2^19 entries, 32 to 4096 points an axis.
    fn default() -> Self {
        FieldConfig { levels: 16, log2_table: 19, coarsest: 32, finest: 4096 }
    }
}

impl FieldConfig {
    /// The first reason why there can be no such field.
    ///
    /// # Errors
    /// If a size is out of range.
    pub fn check(&self) -> Result<(), FieldError> {
        if !(1..=FIELD_LEVELS).contains(&self.levels) {
            return Err(FieldError::Levels(self.levels));
        }
        if !(8..=22).contains(&self.log2_table) {
            return Err(FieldError::Table(self.log2_table));
        }
        if self.coarsest < 2 || self.finest < self.coarsest || self.finest > 1 << 16 {
            return Err(FieldError::Resolutions(self.coarsest, self.finest));
        }
        Ok(())
    }

    /// The levels, coarsest first, as kernels read them. Resolutions grow by a constant factor; a level that has no more
    /// grid points than a table may have entries is stored as it is, rounded up to 8 entries.
    pub fn table_levels(&self) -> Vec<FieldLevel> {
        let steps = f64::from((self.levels - 1).max(1));
        let growth = (f64::from(self.finest) / f64::from(self.coarsest)).ln() / steps;
        let largest = 1_u64 << self.log2_table;
        let mut offset = 0;
        let level = |i: u32| {
            let scale = f64::from(self.coarsest) * (f64::from(i) * growth).exp() - 1.0;
            // The last one would be rounded up for a rounding error.
            let resolution = (scale - 1e-6).ceil() as u64 + 1;
            let plain = resolution.pow(3).next_multiple_of(8);
            let hashed = plain > largest;
            let level = FieldLevel {
                scale: scale as f32,
                resolution: resolution as u32,
                offset,
                mask: if hashed { largest as u32 - 1 } else { 0 },
            };
            offset += plain.min(largest) as u32;
            level
        };
        (0..self.levels).map(level).collect()
    }

    /// Entries of all tables together.
    pub fn entries(&self) -> u32 {
        self.level_entries().iter().sum()
    }

    /// Entries of each level's table.
    pub fn level_entries(&self) -> Vec<u32> {
        let size = |l: &FieldLevel| match l.mask {
            0 => l.resolution.pow(3).next_multiple_of(8),
            mask => mask + 1,
        };
        self.table_levels().iter().map(size).collect()
    }

    /// Numbers that the first layer takes: features, direction, distance.
    pub fn inputs(&self) -> usize {
        FIELD_FEATURES * self.levels as usize + 4
    }

    /// Weights of the network: rows of the first layer, rows of the second, the last.
    pub fn weights(&self) -> usize {
        FIELD_WIDTH * self.inputs() + FIELD_WIDTH * FIELD_WIDTH + FIELD_WIDTH
    }

    /// The tables' start, uniform within 1e-4 of zero.
    pub fn initial_tables(&self, seed: u32) -> Vec<f32> {
        let uniform = |i: u32| (1e-4 * (2.0 * uniform_from(random_bits(seed, 1, i)) - 1.0)) as f32;
        (0..self.entries() * FIELD_FEATURES as u32).map(uniform).collect()
    }

    /// The network's start, uniform within the root of 6 over a layer's inputs (He et al. 2015).
    pub fn initial_weights(&self, seed: u32) -> Vec<f32> {
        let second = FIELD_WIDTH * self.inputs();
        let weight = |i: usize| {
            let inputs = if i < second { self.inputs() } else { FIELD_WIDTH };
            let bound = (6.0 / inputs as f64).sqrt();
            (bound * (2.0 * uniform_from(random_bits(seed, 2, i as u32)) - 1.0)) as f32
        };
        (0..self.weights()).map(weight).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_default_is_the_published_size() {
        let config = FieldConfig::default();
        config.check().unwrap();
        assert_eq!((config.entries(), config.inputs(), config.weights()), (7_177_968, 36, 36 * 32 + 32 * 32 + 32));
        let resolutions: Vec<u32> = config.table_levels().iter().map(|l| l.resolution).collect();
        let published = [32, 45, 62, 85, 117, 162, 223, 308, 426, 589, 813, 1124, 1553, 2145, 2965, 4096];
        assert_eq!(resolutions, published);
        let dense = config.table_levels().iter().filter(|l| l.mask == 0).count();
        assert_eq!(dense, 3);
        let smaller = FieldConfig { log2_table: 18, coarsest: 16, ..config };
        assert_eq!(smaller.entries(), 3_320_608);
    }

    #[test]
    fn one_level_is_the_coarsest() {
        let config = FieldConfig { levels: 1, log2_table: 12, coarsest: 8, finest: 8 };
        config.check().unwrap();
        assert_eq!((config.entries(), config.table_levels()[0].resolution), (512, 8));
    }

    #[test]
    fn sizes_out_of_range_are_refused() {
        let c = FieldConfig::default();
        assert_eq!(FieldConfig { levels: 17, ..c }.check(), Err(FieldError::Levels(17)));
        assert_eq!(FieldConfig { levels: 0, ..c }.check(), Err(FieldError::Levels(0)));
        assert_eq!(FieldConfig { log2_table: 23, ..c }.check(), Err(FieldError::Table(23)));
        assert_eq!(FieldConfig { coarsest: 1, ..c }.check(), Err(FieldError::Resolutions(1, 4096)));
        assert_eq!(FieldConfig { finest: 16, ..c }.check(), Err(FieldError::Resolutions(32, 16)));
    }

    #[test]
    fn the_start_is_within_its_bounds_and_its_seed() {
        let config = FieldConfig { levels: 4, log2_table: 10, coarsest: 4, finest: 64 };
        let (tables, weights) = (config.initial_tables(3), config.initial_weights(3));
        assert_eq!((tables.len(), weights.len()), (2 * config.entries() as usize, config.weights()));
        assert!(tables.iter().all(|t| t.abs() <= 1e-4) && tables.iter().any(|t| *t > 9e-5));
        let first = (6.0_f32 / 12.0).sqrt();
        assert!(
            weights[..32 * 12].iter().all(|w| w.abs() <= first) && weights[..32 * 12].iter().any(|w| *w > 0.95 * first)
        );
        assert_ne!(config.initial_tables(4), tables);
        assert_eq!(config.initial_weights(3), weights);
    }
}
