//! Photographs, prior normals and prior depths of half the width and height.
//!
//! A pixel is the mean of four. Colors are averaged as displayed, since Gaussians are blended as displayed. An odd last
//! row or column is left out, so a smaller pixel always covers exactly four.

use rayon::prelude::*;
use sgs_passes::loss::{octahedral_decode, octahedral_encode, unpack_depth};

/// Least width and height of a smaller photograph, in pixels. Smaller ones cost image quality.
pub(crate) const LEAST: u32 = 64;

/// Returns the size after halving.
pub(crate) fn halved_size(size: [u32; 2]) -> [u32; 2] {
    size.map(|n| (n / 2).max(1))
}

/// Returns a packed photograph at half its size. A pixel is valid if two of its four are; it is the mean of the valid
/// ones.
pub(crate) fn halved_image(image: &[u32], size: [u32; 2]) -> Vec<u32> {
    halved(image, size, |four| {
        let valid = four.iter().filter(|p| **p >> 24 != 0).count() as u32;
        if 2 * valid < four.len() as u32 {
            return 0;
        }
        let mean = |shift: u32| {
            let sum: u32 = four.iter().filter(|p| **p >> 24 != 0).map(|p| p >> shift & 0xff).sum();
            ((sum + valid / 2) / valid) << shift
        };
        mean(0) | mean(8) | mean(16) | 0xff00_0000
    })
}

/// Returns a packed map of normals at half its size. A normal is the direction of the sum of the known ones among its
/// four; it is unknown if fewer than two are known.
pub(crate) fn halved_normals(normals: &[u32], size: [u32; 2]) -> Vec<u32> {
    halved(normals, size, |four| {
        let known: Vec<[f64; 3]> = four.iter().filter_map(|n| octahedral_decode(*n)).collect();
        if 2 * known.len() < four.len() {
            return 0;
        }
        octahedral_encode([0, 1, 2].map(|axis| known.iter().map(|n| n[axis]).sum::<f64>() as f32))
    })
}

/// Returns a packed map of depths at half its size. A depth is the middle one of the known ones among its four, the
/// nearer of two middle ones, so that no depth between two surfaces appears. It is unknown if fewer than two are known.
pub(crate) fn halved_depths(depths: &[u32], size: [u32; 2]) -> Vec<u32> {
    halved(depths, size, |four| {
        let mut known: Vec<(f64, u32)> = four.iter().filter_map(|d| Some((unpack_depth(*d)?[0], *d))).collect();
        if 2 * known.len() < four.len() {
            return 0;
        }
        known.sort_by(|a, b| a.0.total_cmp(&b.0));
        known[known.len() / 2].1
    })
}

fn halved(data: &[u32], size: [u32; 2], of: impl Fn(&[u32]) -> u32 + Sync) -> Vec<u32> {
    let ([width, height], [columns, rows]) = (size.map(|n| n as usize), halved_size(size).map(|n| n as usize));
    let row = |y: usize| {
        let (of, next) = (&of, (2 * y + 1).min(height - 1));
        (0..columns).map(move |x| {
            let right = (2 * x + 1).min(width - 1);
            of(&[2 * y, next].map(|y| [data[y * width + 2 * x], data[y * width + right]]).concat())
        })
    };
    (0..rows).into_par_iter().flat_map_iter(row).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    const WHITE: u32 = 0xffff_ffff;

    #[test]
    fn pixels_are_means_of_the_valid_ones_among_four() {
        // The last column and row are left out.
        let image = [
            0xff00_0a01,
            0xff00_0b02,
            WHITE,
            0x0012_3456,
            7, //
            0xff00_0c03,
            0xff00_0e05,
            0,
            WHITE,
            7, //
            1,
            2,
            3,
            4,
            5,
        ];
        // The means of 1, 2, 3, 5 and of 10, 11, 12, 14, rounded.
        assert_eq!(halved_image(&image, [5, 3]), [0xff00_0c03, WHITE]);
        assert_eq!(halved_image(&[WHITE, 0, 0, 0], [2, 2]), [0]);
        assert_eq!(halved_image(&[0xff00_0004, 0xff00_0006], [1, 2]), [0xff00_0005]);
    }

    #[test]
    fn normals_are_mean_directions_of_the_known_ones() {
        let [x, y, z] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]].map(octahedral_encode);
        let decoded = |packed: u32| octahedral_decode(packed).unwrap();
        let mean = halved_normals(&[x, y, 0, 0, z, 0, 0, 0], [4, 2]);
        let expected = [0.5f64.sqrt(), 0.5f64.sqrt(), 0.0];
        assert_eq!(mean.len(), 2);
        assert!(mean[1] == 0, "fewer than two known");
        let four = halved_normals(&[x, y, x, y], [2, 2]);
        let off = decoded(four[0]).into_iter().zip(expected).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(off < 1e-4, "{four:?}");
        // Opposite normals have no mean direction.
        let opposite = octahedral_encode([-1.0, 0.0, 0.0]);
        let none = halved_normals(&[x, opposite, x, opposite], [2, 2]);
        assert!(none[0] == 0 || octahedral_decode(none[0]).is_some());
    }
}
