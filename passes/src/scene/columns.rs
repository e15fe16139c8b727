//! Layout of Gaussians in device memory: columns of four numbers, in blocks of 32 Gaussians.
//!
//! Columns form pieces of four. A Gaussian's numbers of a piece are 64 bytes side by side, and those of the block's other
//! Gaussians follow. So the lanes of a subgroup read and write memory that lies together, and a Gaussian whose neighbors
//! are culled wastes no part of a line of memory. Column 0 holds mean and opacity logit, column 1 the log scale and an unused number, column 2 the rotation.
//! The harmonics follow: three channels of each coefficient in turn, padded to a whole column. Normals take the last
//! column, with an unused number. `shaders-glsl/include/gaussian.glsl` has the same layout. Semantic features are not
//! part of it: they are read in rows of 32.
//!
//! Moments of Adam have the layout of the parameters, in a buffer each for the first and the second. Compact storage
//! ([`super::Storage`]) differs.

use super::{GaussianData, Group, Model};

/// Gaussians per block.
pub const BLOCK: u32 = 32;

/// Columns of a piece.
const PIECE: usize = 4;

/// First column of the harmonics.
pub(super) const HARMONICS: u32 = 3;

/// Returns the position of one of a Gaussian's `columns` columns, in columns.
pub(super) fn column_at(gaussian: usize, column: usize, columns: usize) -> usize {
    let block = BLOCK as usize;
    let first = column / PIECE * PIECE;
    let width = PIECE.min(columns - first);
    block * (gaussian / block * columns + first) + gaussian % block * width + column % PIECE
}

impl Model {
    /// Returns the columns per Gaussian.
    pub fn columns(&self) -> u32 {
        HARMONICS + self.harmonic_columns() + u32::from(self.normals)
    }

    /// Returns the columns of the spherical harmonics.
    pub(super) fn harmonic_columns(&self) -> u32 {
        (3 * (self.sh_degree + 1).pow(2)).div_ceil(4)
    }

    /// Returns the bytes of the columns of `capacity` Gaussians.
    pub fn column_bytes(&self, capacity: u32) -> u64 {
        u64::from(capacity.div_ceil(BLOCK)) * u64::from(BLOCK * self.columns()) * 16
    }

    /// Returns the position of a Gaussian's number among the floats of the columns. `group` must not be
    /// [`Group::Semantics`].
    fn position(&self, group: Group, gaussian: usize, number: usize) -> usize {
        let (column, component) = self.place(group, number);
        4 * column_at(gaussian, column, self.columns() as usize) + component
    }

    /// Returns column and component of a number of a group.
    fn place(&self, group: Group, number: usize) -> (usize, usize) {
        let harmonic = |first: usize| (HARMONICS as usize + (first + number) / 4, (first + number) % 4);
        match group {
            Group::Means => (0, number),
            Group::OpacityLogits => (0, 3),
            Group::LogScales => (1, number),
            Group::Rotations => (2, number),
            Group::Sh0 => harmonic(0),
            Group::Sh1 => harmonic(3),
            Group::Sh2 => harmonic(12),
            Group::Sh3 => harmonic(27),
            Group::Normals => (self.columns() as usize - 1, number),
            Group::Semantics => unreachable!("invariant: features are no columns"),
        }
    }

    fn groups_in_columns(&self) -> impl Iterator<Item = Group> + '_ {
        self.groups().filter(|group| *group != Group::Semantics)
    }

    /// Arranges the numbers of `count` Gaussians in columns. Number `k` of a group is element `stride * k + first` of the
    /// group's data: parameters have stride 1, pairs of moments stride 2. Unused numbers are zero.
    fn arranged(&self, data: &GaussianData, count: usize, stride: usize, first: usize) -> Vec<f32> {
        let mut columns = vec![0.0; self.column_bytes(count as u32) as usize / 4];
        for group in self.groups_in_columns() {
            let (from, width) = (data.group(group), group.width() as usize);
            for gaussian in 0..count {
                for number in 0..width {
                    let value = from[stride * (gaussian * width + number) + first];
                    columns[self.position(group, gaussian, number)] = value;
                }
            }
        }
        columns
    }

    /// Arranges parameters in columns. Semantic features are left out.
    pub fn to_columns(&self, data: &GaussianData) -> Vec<f32> {
        self.arranged(data, data.len(), 1, 0)
    }

    /// Arranges pairs of moments in columns of first and of second moments.
    pub fn moments_to_columns(&self, pairs: &GaussianData) -> [Vec<f32>; 2] {
        [0, 1].map(|which| self.arranged(pairs, pairs.len() / 2, 2, which))
    }

    /// Returns the parameters of `count` Gaussians in columns. Semantic features are empty.
    pub fn from_columns(&self, columns: &[f32], count: usize) -> GaussianData {
        let mut data = GaussianData::default();
        for group in self.groups_in_columns() {
            let numbers = (0..count * group.width() as usize).map(|i| {
                let (gaussian, number) = (i / group.width() as usize, i % group.width() as usize);
                columns[self.position(group, gaussian, number)]
            });
            data.groups[group as usize] = numbers.collect();
        }
        data
    }

    /// Returns pairs of moments from columns of first and of second moments. Those of semantic features are empty.
    pub fn moments_from_columns(&self, [first, second]: [&[f32]; 2], count: usize) -> GaussianData {
        let [first, second] = [first, second].map(|columns| self.from_columns(columns, count));
        let mut pairs = GaussianData::default();
        for group in self.groups_in_columns() {
            let both = first.group(group).iter().zip(second.group(group));
            pairs.groups[group as usize] = both.flat_map(|(a, b)| [*a, *b]).collect();
        }
        pairs
    }

    /// Returns the columns of another model with the numbers that both have. Others are zero.
    pub(super) fn converted(&self, columns: &[f32], to: &Model) -> Vec<f32> {
        let gaussians = columns.len() / (4 * self.columns() as usize);
        let mut into = vec![0.0; to.column_bytes(gaussians as u32) as usize / 4];
        for group in self.groups_in_columns().filter(|group| to.has(*group)) {
            for gaussian in 0..gaussians {
                for number in 0..group.width() as usize {
                    into[to.position(group, gaussian, number)] = columns[self.position(group, gaussian, number)];
                }
            }
        }
        into
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MODELS: [Model; 5] = [
        Model { sh_degree: 0, normals: false, semantics: false, mip: false },
        Model { sh_degree: 0, normals: true, semantics: true, mip: false },
        Model { sh_degree: 1, normals: false, semantics: false, mip: false },
        Model { sh_degree: 2, normals: true, semantics: false, mip: false },
        Model { sh_degree: 3, normals: true, semantics: true, mip: false },
    ];

    fn numbered(model: &Model, count: usize, stride: usize) -> GaussianData {
        let mut data = GaussianData::default();
        let mut next = 0.0;
        for group in model.groups_in_columns() {
            let numbers = stride * count * group.width() as usize;
            data.groups[group as usize] = std::iter::repeat_with(|| {
                next += 1.0;
                next
            })
            .take(numbers)
            .collect();
        }
        data
    }

    #[test]
    fn columns_hold_every_number_once() {
        assert_eq!(MODELS.map(|m| m.columns()), [4, 5, 6, 11, 16]);
        for model in MODELS {
            for count in [1, 31, 32, 33, 100] {
                let data = numbered(&model, count, 1);
                let columns = model.to_columns(&data);
                assert_eq!(columns.len() as u64 * 4, model.column_bytes(count as u32));
                assert_eq!(
                    columns.iter().filter(|x| **x != 0.0).count(),
                    data.groups.iter().map(Vec::len).sum::<usize>()
                );
                assert_eq!(model.from_columns(&columns, count), data);
                let pairs = numbered(&model, count, 2);
                let [first, second] = model.moments_to_columns(&pairs);
                assert_eq!(model.moments_from_columns([&first, &second], count), pairs);
            }
        }
    }

    /// Pieces of a block lie side by side, and the columns of a piece too.
    #[test]
    fn gaussians_of_a_block_lie_side_by_side() {
        for model in MODELS {
            let columns = model.columns() as usize;
            for group in model.groups_in_columns() {
                let at = |gaussian| model.position(group, gaussian, 0);
                let piece = model.place(group, 0).0 / PIECE;
                let stride = 4 * PIECE.min(columns - PIECE * piece);
                assert!((1..32).all(|i| at(i) == at(0) + stride * i), "{}", group.name());
                assert_eq!(at(32), at(0) + 4 * 32 * columns);
            }
            assert_eq!(model.position(Group::Rotations, 5, 1), 4 * (5 * 4 + 2) + 1);
        }
    }

    #[test]
    fn conversion_keeps_common_bands_and_clears_others() {
        let (small, large) = (MODELS[1], MODELS[4]);
        let data = numbered(&large, 40, 1);
        let fewer = large.from_columns(&large.to_columns(&data), 40);
        let back = small.from_columns(&large.converted(&large.to_columns(&data), &small), 40);
        for group in small.groups_in_columns() {
            assert_eq!(back.group(group), fewer.group(group));
        }
        let grown = large.from_columns(&small.converted(&small.to_columns(&back), &large), 40);
        assert_eq!(grown.group(Group::Normals), data.group(Group::Normals));
        assert!(grown.group(Group::Sh1).iter().chain(grown.group(Group::Sh3)).all(|x| *x == 0.0));
    }
}
