//! Order of spherical-harmonics coefficients in memory and in files.
//!
//! Files follow the original 3DGS program: `f_dc_0..2`, then `f_rest_*` by channel. These hold all coefficients of
//! bands 1 and up for red, then green, then blue. In memory, every band is a separate array, ordered by coefficient
//! with interleaved channels.

/// Number of coefficients above band 0 per channel, by degree.
pub(super) const REST: [usize; 4] = [0, 3, 8, 15];

/// Returns the degree whose files have this number of `f_rest_*` properties.
pub(super) fn degree_of_rest(count: usize) -> Option<usize> {
    REST.iter().position(|per_channel| per_channel * 3 == count)
}

/// Returns the band of `f_rest_{index}` and its position in the band. The position counts the band's values of one
/// splat.
pub(super) fn place_of_rest(degree: usize, index: usize) -> (usize, usize) {
    let per_channel = REST[degree].max(1);
    let (channel, coefficient) = (index / per_channel, index % per_channel);
    let band = if coefficient < 3 {
        1
    } else if coefficient < 8 {
        2
    } else {
        3
    };
    (band, (coefficient - REST[band - 1]) * 3 + channel)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn degree_follows_from_the_number_of_coefficients() {
        assert_eq!([0, 9, 24, 45].map(degree_of_rest), [Some(0), Some(1), Some(2), Some(3)]);
        assert_eq!([1, 8, 10, 48].map(degree_of_rest), [None; 4]);
    }

    #[test]
    fn coefficient_positions_match_the_file_layout() {
        // Degree 3: f_rest_0 is red of the first coefficient of band 1; f_rest_15 is its green.
        assert_eq!(place_of_rest(3, 0), (1, 0));
        assert_eq!(place_of_rest(3, 15), (1, 1));
        assert_eq!(place_of_rest(3, 30), (1, 2));
        assert_eq!(place_of_rest(3, 3), (2, 0));
        assert_eq!(place_of_rest(3, 14), (3, 18));
        assert_eq!(place_of_rest(3, 44), (3, 20));
        assert_eq!(place_of_rest(1, 3), (1, 1));
        assert_eq!(place_of_rest(2, 15), (2, 13));
    }

    #[test]
    fn every_coefficient_position_is_used_once() {
        for degree in 1..=3 {
            let mut places: Vec<_> = (0..REST[degree] * 3).map(|i| place_of_rest(degree, i)).collect();
            places.sort();
            let expected: Vec<_> = (1..=degree).flat_map(|d| (0..(2 * d + 1) * 3).map(move |i| (d, i))).collect();
            assert_eq!(places, expected);
        }
    }
}
