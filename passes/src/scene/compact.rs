//! Storage of Gaussians in training: exact, or compact with 16 bits for harmonics and moments.
//!
//! Compact storage takes 144 bytes of parameters and 240 of moments for a Gaussian with all bands, instead of 240 and 480:
//!
//! | numbers | stored as | largest relative error | reason |
//! |---|---|---|---|
//! | mean, opacity, log scale, rotation, normal | 32-bit float | none | a position needs more bits than 16 |
//! | spherical harmonics | half, two columns in 16 bytes | 2^-10, or 2^-24 absolute | colors are of size one |
//! | first moments | upper half of a 32-bit float | 2^-7 | gradients span many decades, so the exponent stays |
//! | second moments | bits 15 to 30 of a 32-bit float | 2^-8 | as the first; the bit of the sign is one more of precision |
//!
//! The first moments of a column and its second moments share 16 bytes of one buffer. Kernels round at random
//! (`include/rounding.glsl`): a second moment moves by a thousandth a step, less than half a unit of its last place, and
//! rounding to nearest would hold it still. The host rounds to nearest, ties to even: it stores numbers once, or numbers
//! that 16 bits hold already, such as those of a checkpoint.

use super::columns::{HARMONICS, column_at};
use super::{BLOCK, Model};
use half::f16;

/// Storage of Gaussians in training.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Storage {
    /// Every number in 32 bits.
    #[default]
    Exact,
    /// Spherical harmonics and Adam's moments in 16 bits.
    Compact,
}

/// Bytes of the buffer of second moments that compact storage does not use.
const PLACEHOLDER: u64 = 16;

/// Bits of the largest finite float.
const LARGEST: u32 = 0x7f7f_ffff;

/// Rounds a first moment to the upper 16 bits of a float.
fn first_bits(x: f32) -> u32 {
    let (bits, magnitude) = (x.to_bits(), x.to_bits() & 0x7fff_ffff);
    let rounded = magnitude.saturating_add(0x7fff + (magnitude >> 16 & 1)).min(LARGEST);
    (bits & 0x8000_0000 | rounded) >> 16
}

/// Rounds a second moment, which has no sign, to bits 15 to 30 of a float.
fn second_bits(x: f32) -> u32 {
    let magnitude = x.to_bits() & 0x7fff_ffff;
    magnitude.saturating_add(0x3fff + (magnitude >> 15 & 1)).min(LARGEST) >> 15
}

/// Rounds a parameter to half precision. Numbers beyond the largest half become the largest; NaN stays NaN.
fn half_bits(x: f32) -> u32 {
    let most = f16::MAX.to_f32();
    f16::from_f32(x.clamp(-most, most)).to_bits().into()
}

fn first_of(bits: u32) -> f32 {
    f32::from_bits(bits << 16)
}

fn second_of(bits: u32) -> f32 {
    f32::from_bits(bits << 15)
}

fn half_of(bits: u32) -> f32 {
    f16::from_bits(bits as u16).to_f32()
}

/// Packs four numbers of 16 bits in two words. The first of each pair is the lower half.
fn pack(numbers: &[f32], bits: fn(f32) -> u32) -> [u32; 2] {
    [0, 2].map(|j| bits(numbers[j]) | bits(numbers[j + 1]) << 16)
}

/// Unpacks two words.
fn unpack(words: &[u32], number: fn(u32) -> f32) -> [f32; 4] {
    [words[0] & 0xffff, words[0] >> 16, words[1] & 0xffff, words[1] >> 16].map(number)
}

impl Storage {
    /// Returns the columns of 16 bytes that a Gaussian's parameters take.
    pub fn columns(self, model: &Model) -> u32 {
        match self {
            Storage::Exact => model.columns(),
            Storage::Compact => HARMONICS + model.harmonic_columns().div_ceil(2) + u32::from(model.normals),
        }
    }

    /// Returns the bytes of parameters of `capacity` Gaussians without features.
    pub fn parameter_bytes(self, model: &Model, capacity: u32) -> u64 {
        u64::from(capacity.div_ceil(BLOCK)) * u64::from(BLOCK * self.columns(model)) * 16
    }

    /// Returns the bytes of the two buffers of moments. Compact storage keeps both moments in the first buffer.
    pub fn moment_bytes(self, model: &Model, capacity: u32) -> [u64; 2] {
        let columns = model.column_bytes(capacity);
        [columns, if self == Storage::Exact { columns } else { PLACEHOLDER }]
    }

    /// Returns the words of parameters, rounded to nearest.
    ///
    /// `columns`: see [`Model::to_columns`].
    pub fn store(self, model: &Model, columns: &[f32]) -> Vec<u32> {
        if self == Storage::Exact {
            return columns.iter().map(|x| x.to_bits()).collect();
        }
        let gaussians = columns.len() / (4 * model.columns() as usize);
        let mut words = vec![0; self.parameter_bytes(model, gaussians as u32) as usize / 4];
        self.for_columns(model, gaussians, |from, to, half| {
            let numbers = &columns[from..from + 4];
            match half {
                None => words[to..to + 4].iter_mut().zip(numbers).for_each(|(word, x)| *word = x.to_bits()),
                Some(half) => words[to + 2 * half..][..2].copy_from_slice(&pack(numbers, half_bits)),
            }
        });
        words
    }

    /// Returns the columns of stored parameters.
    pub fn load(self, model: &Model, words: &[u32]) -> Vec<f32> {
        if self == Storage::Exact {
            return words.iter().map(|x| f32::from_bits(*x)).collect();
        }
        let gaussians = words.len() / (4 * self.columns(model) as usize);
        let mut columns = vec![0.0; model.column_bytes(gaussians as u32) as usize / 4];
        self.for_columns(model, gaussians, |to, from, half| {
            let numbers = match half {
                None => [0, 1, 2, 3].map(|j| f32::from_bits(words[from + j])),
                Some(half) => unpack(&words[from + 2 * half..], half_of),
            };
            columns[to..to + 4].copy_from_slice(&numbers);
        });
        columns
    }

    /// Returns the words of both buffers of moments.
    ///
    /// Their input are columns of first and of second moments.
    pub fn store_moments(self, [first, second]: [&[f32]; 2]) -> [Vec<u32>; 2] {
        if self == Storage::Exact {
            return [first, second].map(|columns| columns.iter().map(|x| x.to_bits()).collect());
        }
        let columns = first.as_chunks::<4>().0.iter().zip(second.as_chunks::<4>().0);
        let words = columns.flat_map(|(a, b)| [pack(a, first_bits), pack(b, second_bits)]).flatten();
        [words.collect(), vec![0; PLACEHOLDER as usize / 4]]
    }

    /// Returns the columns of first and of second moments.
    pub fn load_moments(self, [first, second]: [&[u32]; 2]) -> [Vec<f32>; 2] {
        if self == Storage::Exact {
            return [first, second].map(|words| words.iter().map(|x| f32::from_bits(*x)).collect());
        }
        let columns = first.as_chunks::<4>().0.iter();
        [0, 2].map(|at| {
            let number = if at == 0 { first_of } else { second_of };
            columns.clone().flat_map(|words| unpack(&words[at..], number)).collect()
        })
    }

    /// Calls `f` for every column of every Gaussian: its first number in columns, its first word in compact storage, and
    /// which half of the 16 bytes it takes, if only a half.
    fn for_columns(self, model: &Model, gaussians: usize, mut f: impl FnMut(usize, usize, Option<usize>)) {
        let (all, stored) = (model.columns() as usize, self.columns(model) as usize);
        let (first, last) = (HARMONICS as usize, (HARMONICS + model.harmonic_columns()) as usize);
        for gaussian in 0..gaussians {
            for column in 0..all {
                let (at, half) = match column {
                    _ if column < first => (column, None),
                    _ if column < last => (first + (column - first) / 2, Some((column - first) % 2)),
                    _ => (stored - 1, None),
                };
                f(4 * column_at(gaussian, column, all), 4 * column_at(gaussian, at, stored), half);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MODELS: [Model; 5] = [
        Model { sh_degree: 0, normals: false, semantics: false, mip: false },
        Model { sh_degree: 0, normals: true, semantics: false, mip: false },
        Model { sh_degree: 1, normals: false, semantics: false, mip: false },
        Model { sh_degree: 2, normals: true, semantics: false, mip: false },
        Model { sh_degree: 3, normals: false, semantics: false, mip: false },
    ];

    #[test]
    fn compact_storage_takes_at_most_400_bytes_with_statistics() {
        let model = MODELS[4];
        let each = |storage: Storage| {
            let moments = storage.moment_bytes(&model, 3200);
            (storage.parameter_bytes(&model, 3200) / 3200, (moments[0] + moments[1]) / 3200)
        };
        assert_eq!((each(Storage::Exact), each(Storage::Compact)), ((240, 480), (144, 240)));
        assert_eq!(MODELS.map(|m| Storage::Compact.columns(&m)), [4, 5, 5, 8, 9]);
    }

    /// Numbers that 16 bits hold return unchanged, each from its own place.
    #[test]
    fn representable_numbers_are_stored_exactly() {
        for model in MODELS {
            for gaussians in [1, 32, 70] {
                // Small whole numbers and halves; all differ for the smaller models.
                let length = model.column_bytes(gaussians) as usize / 4;
                let numbers: Vec<f32> = (0..length).map(|i| (i % 2039) as f32 * 0.25 - 200.0).collect();
                let words = Storage::Compact.store(&model, &numbers);
                assert_eq!(words.len() as u64 * 4, Storage::Compact.parameter_bytes(&model, gaussians));
                assert_eq!(Storage::Compact.load(&model, &words), numbers);
                let first: Vec<f32> = (0..length).map(|i| (i % 255) as f32 - 127.0).collect();
                let second: Vec<f32> = (0..length).map(|i| (i % 511) as f32).collect();
                let stored = Storage::Compact.store_moments([&first, &second]);
                let loaded = Storage::Compact.load_moments([&stored[0], &stored[1]]);
                assert_eq!(loaded, [first, second]);
            }
        }
    }

    #[test]
    fn host_rounds_to_nearest_and_stays_finite() {
        for exponent in -126..127 {
            let x = 1.2345_f32 * 2.0_f32.powi(exponent);
            for x in [x, -x] {
                assert!((first_of(first_bits(x)) / x - 1.0).abs() <= 2.0_f32.powi(-8), "{x}");
                assert_eq!(first_of(first_bits(first_of(first_bits(x)))), first_of(first_bits(x)));
            }
            assert!((second_of(second_bits(x)) / x - 1.0).abs() <= 2.0_f32.powi(-9), "{x}");
        }
        for x in [f32::MAX, f32::INFINITY, f32::MIN, f32::NAN] {
            assert!(first_of(first_bits(x)).is_finite() && second_of(second_bits(x)).is_finite());
        }
        assert_eq!([0.0, -0.0].map(|x: f32| first_of(first_bits(x)).to_bits()), [0, 0x8000_0000]);
        assert_eq!([1e9, -f32::INFINITY].map(|x| half_of(half_bits(x))), [65504.0, -65504.0]);
        assert!(half_of(half_bits(f32::NAN)).is_nan() && half_of(half_bits(1e-9)) == 0.0);
    }
}
