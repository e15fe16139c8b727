//! Bilinear lookups of an environment map at the pixels of the smoothness map. Stored by pixel and, transposed, by
//! texel.
//!
//! For cubes finer than the map, the quadratic form ([`super::form`]) would hold more than ten times as many numbers.

use super::cube::Footprint;
use super::latlong::direction;

/// Lookups of a cube at the pixels of a map.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MapLookup {
    /// Columns and rows of the map.
    pub size: [u32; 2],
    /// By pixel: four texels and the bits of their weights.
    pub footprints: Vec<[u32; 8]>,
    /// Start of each texel's range in `entries`, followed by the end of the last range.
    pub starts: Vec<u32>,
    /// Pixel and bits of the weight.
    pub entries: Vec<[u32; 2]>,
}

/// Builds the lookups of a cube of `cube` texels a side in a map of `size`.
pub fn map_lookup(cube: u32, size: [u32; 2]) -> MapLookup {
    let [w, h] = size;
    let count = (6 * cube * cube) as usize;
    let pixels = (0..h).flat_map(|y| (0..w).map(move |x| (x, y)));
    let footprints: Vec<[u32; 8]> = pixels
        .map(|(x, y)| {
            let Footprint { texels, weights } = Footprint::of(direction(size, x, y), cube);
            std::array::from_fn(|k| if k < 4 { texels[k] } else { (weights[k - 4] as f32).to_bits() })
        })
        .collect();
    let used = |f: &[u32; 8]| (0..4).map(|k| (f[k], f[4 + k])).filter(|(_, w)| *w != 0).collect::<Vec<_>>();
    let mut starts = vec![0_u32; count + 1];
    for f in &footprints {
        used(f).iter().for_each(|(texel, _)| starts[*texel as usize + 1] += 1);
    }
    for i in 0..count {
        starts[i + 1] += starts[i];
    }
    let mut next = starts.clone();
    let mut entries = vec![[0; 2]; starts[count] as usize];
    for (pixel, f) in footprints.iter().enumerate() {
        for (texel, weight) in used(f) {
            let at = &mut next[texel as usize];
            entries[*at as usize] = [pixel as u32, weight];
            *at += 1;
        }
    }
    MapLookup { size, footprints, starts, entries }
}
