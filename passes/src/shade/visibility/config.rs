//! Shape and initial values of the visibility field: a hash grid and a small network.
//!
//! The grid follows Mueller et al. 2022; sizes and network follow SGS-Intrinsic, stage II. Guarantees: sizes are a
//! function of the configuration alone, initial values of the seed alone. [`super`] evaluates the field, and the tools
//! handle files.

use crate::rng::{random_bits, uniform_from};
use sgs_shaders::structs::FieldLevel;

/// Neurons of a hidden layer.
pub const FIELD_WIDTH: usize = crate::matrices::WIDTH as usize;

/// Features of an entry.
pub const FIELD_FEATURES: usize = 2;

/// Maximum number of levels in the kernels.
pub const FIELD_LEVELS: u32 = 16;

/// Weights of a field with the maximum number of levels. Kernels bind them as a uniform buffer
/// (`visibility_weights.glsl`), of which every device supports 16 KiB.
const MOST_WEIGHTS: usize = FieldConfig::new(FIELD_LEVELS, 19, 32, 4096).weights();
const _: () = assert!(MOST_WEIGHTS == 4 * 552 && 4 * MOST_WEIGHTS <= 16 << 10);

/// Reason why a field's configuration is invalid.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum FieldError {
    /// The number of levels is out of range.
    #[error("A visibility field has 1 to 16 levels, not {0}.")]
    Levels(u32),
    /// The total number of levels is smaller than the number of levels, or too large.
    #[error("A visibility field with {0} levels cannot be the first ones of {1}: that is {0} to 16.")]
    Of(u32, u32),
    /// The size of the tables is out of range.
    #[error("A level's table has 2^8 to 2^22 entries, not 2^{0}.")]
    Table(u32),
    /// The resolutions are out of range.
    #[error(
        "A visibility field's resolutions are between 2 and 65536, the finest not below the coarsest; not {0} to {1}."
    )]
    Resolutions(u32, u32),
}

/// Shape of a visibility field.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FieldConfig {
    /// Levels of the grid, coarsest first.
    pub levels: u32,
    /// Number of levels from the coarsest to the finest resolution. Larger than `levels` if the finest levels have been
    /// dropped.
    pub of: u32,
    /// Base-2 logarithm of the maximum number of entries of a level.
    pub log2_table: u32,
    /// Grid points along an axis of the coarsest level.
    pub coarsest: u32,
    /// Grid points along an axis of the finest level.
    pub finest: u32,
}

impl Default for FieldConfig {
    /// Returns the shape of SGS-Intrinsic. 16 levels of at most 2^19 entries, with 32 to 4096 points per axis.
    fn default() -> Self {
        FieldConfig::new(16, 19, 32, 4096)
    }
}

impl FieldConfig {
    /// Returns a configuration of `levels` levels. Levels have `coarsest` to `finest` grid points along an axis, and at
    /// most 2 to the `log2_table` entries each.
    pub const fn new(levels: u32, log2_table: u32, coarsest: u32, finest: u32) -> FieldConfig {
        FieldConfig { levels, of: levels, log2_table, coarsest, finest }
    }

    /// Returns the configuration with only its coarsest `levels` levels, at least one.
    pub fn first_levels(&self, levels: u32) -> FieldConfig {
        FieldConfig { levels: levels.clamp(1, self.levels), ..*self }
    }

    /// Returns the tables and layers that remain for [`FieldConfig::first_levels`]. The inputs hold `each` numbers per
    /// feature of an entry and per weight. The result behaves as if the features of the dropped levels were zero.
    pub fn numbers_of_first_levels(&self, levels: u32, each: usize, [tables, layers]: [&[f32]; 2]) -> [Vec<f32>; 2] {
        let left = self.first_levels(levels);
        let table_numbers = left.entries() as usize * FIELD_FEATURES * each;
        let features = FIELD_FEATURES * left.levels as usize * each;
        let (row, first) = (self.inputs() * each, self.inputs() * FIELD_WIDTH * each);
        // In a row, the weights of direction and distance follow those of the features.
        let rows = layers[..first].chunks(row).flat_map(|r| r[..features].iter().chain(&r[row - 4 * each..]));
        let layers = rows.chain(&layers[first..]).copied().collect();
        [tables[..table_numbers].to_vec(), layers]
    }

    /// Checks the configuration, and returns the first violation.
    ///
    /// # Errors
    /// If a size is out of range.
    pub fn check(&self) -> Result<(), FieldError> {
        if !(1..=FIELD_LEVELS).contains(&self.levels) {
            return Err(FieldError::Levels(self.levels));
        }
        if !(self.levels..=FIELD_LEVELS).contains(&self.of) {
            return Err(FieldError::Of(self.levels, self.of));
        }
        if !(8..=22).contains(&self.log2_table) {
            return Err(FieldError::Table(self.log2_table));
        }
        if self.coarsest < 2 || self.finest < self.coarsest || self.finest > 1 << 16 {
            return Err(FieldError::Resolutions(self.coarsest, self.finest));
        }
        Ok(())
    }

    /// Returns the levels, coarsest first, in the layout of the kernels. Resolutions grow by a constant factor. A level
    /// with no more grid points than the maximum number of entries is stored densely, rounded up to 8 entries.
    pub fn table_levels(&self) -> Vec<FieldLevel> {
        let steps = f64::from((self.of - 1).max(1));
        let growth = (f64::from(self.finest) / f64::from(self.coarsest)).ln() / steps;
        let largest = 1_u64 << self.log2_table;
        let mut offset = 0;
        let level = |i: u32| {
            let scale = f64::from(self.coarsest) * (f64::from(i) * growth).exp() - 1.0;
            // Without the tolerance, a rounding error could round the last resolution up.
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

    /// Returns the number of entries of all tables.
    pub fn entries(&self) -> u32 {
        self.level_entries().iter().sum()
    }

    /// Returns the number of entries of each level's table.
    pub fn level_entries(&self) -> Vec<u32> {
        let size = |l: &FieldLevel| match l.mask {
            0 => l.resolution.pow(3).next_multiple_of(8),
            mask => mask + 1,
        };
        self.table_levels().iter().map(size).collect()
    }

    /// Returns the inputs of the first layer: features, direction, distance.
    pub const fn inputs(&self) -> usize {
        FIELD_FEATURES * self.levels as usize + 4
    }

    /// Returns the number of weights of the network. The weights are rows of the first layer, rows of the second layer,
    /// and the last layer.
    pub const fn weights(&self) -> usize {
        FIELD_WIDTH * self.inputs() + FIELD_WIDTH * FIELD_WIDTH + FIELD_WIDTH
    }

    /// Returns initial tables, uniform within 1e-4 of zero.
    pub fn initial_tables(&self, seed: u32) -> Vec<f32> {
        let uniform = |i: u32| (1e-4 * (2.0 * uniform_from(random_bits(seed, 1, i)) - 1.0)) as f32;
        (0..self.entries() * FIELD_FEATURES as u32).map(uniform).collect()
    }

    /// Returns initial weights (He et al. 2015). Weights are uniform within the root of 6 over a layer's number of
    /// inputs.
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
    use crate::reference::visibility::Field;
    use crate::rng::Pcg;

    #[test]
    fn default_has_the_published_size() {
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
    fn single_level_has_the_coarsest_resolution() {
        let config = FieldConfig::new(1, 12, 8, 8);
        config.check().unwrap();
        assert_eq!((config.entries(), config.table_levels()[0].resolution), (512, 8));
    }

    #[test]
    fn out_of_range_sizes_are_rejected() {
        let c = FieldConfig::default();
        assert_eq!(FieldConfig { levels: 17, ..c }.check(), Err(FieldError::Levels(17)));
        assert_eq!(FieldConfig { levels: 0, ..c }.check(), Err(FieldError::Levels(0)));
        assert_eq!(FieldConfig { of: 17, ..c }.check(), Err(FieldError::Of(16, 17)));
        assert_eq!(FieldConfig { of: 15, ..c }.check(), Err(FieldError::Of(16, 15)));
        assert_eq!(FieldConfig { log2_table: 23, ..c }.check(), Err(FieldError::Table(23)));
        assert_eq!(FieldConfig { coarsest: 1, ..c }.check(), Err(FieldError::Resolutions(1, 4096)));
        assert_eq!(FieldConfig { finest: 16, ..c }.check(), Err(FieldError::Resolutions(32, 16)));
    }

    #[test]
    fn initial_values_are_bounded_and_seeded() {
        let config = FieldConfig::new(4, 10, 4, 64);
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

    #[test]
    fn first_levels_equal_the_whole_field_with_zero_features() {
        let whole = FieldConfig::new(5, 9, 4, 60);
        let mut rng = Pcg::new(4);
        let tables: Vec<f32> = (0..2 * whole.entries()).map(|_| rng.normal() as f32).collect();
        let layers = whole.initial_weights(2);
        let (low, high) = ([-1.0, -2.0, 0.0], [2.0, 2.0, 3.0]);
        for levels in 1..=5 {
            let few = whole.first_levels(levels);
            few.check().unwrap();
            assert!(few.level_entries() == whole.level_entries()[..levels as usize] && few.levels == levels);
            let [some, rows] = whole.numbers_of_first_levels(levels, 1, [&tables, &layers]);
            assert_eq!((some.len(), rows.len()), (2 * few.entries() as usize, few.weights()));
            // Dropping levels is equivalent to features of zero.
            let mut dark = tables.clone();
            dark[some.len()..].fill(0.0);
            let (a, b) = (Field::new(&few, &some, &rows, low, high), Field::new(&whole, &dark, &layers, low, high));
            for _ in 0..20 {
                let [p, q] = [(); 2]
                    .map(|()| [0, 1, 2].map(|k| f64::from(low[k]) + f64::from(high[k] - low[k]) * rng.uniform()));
                let (x, y) = (a.visibility(p, q), b.visibility(p, q));
                assert!((x - y).abs() < 1e-12, "{levels} levels: {x}, {y}");
            }
            // Several numbers per weight stay together.
            let twice = |v: &[f32]| v.iter().flat_map(|x| [*x, -*x]).collect::<Vec<f32>>();
            let pairs = whole.numbers_of_first_levels(levels, 2, [&twice(&tables), &twice(&layers)]);
            assert_eq!(pairs, [twice(&some), twice(&rows)]);
        }
        assert_eq!((whole.first_levels(0).levels, whole.first_levels(9)), (1, whole));
    }
}
