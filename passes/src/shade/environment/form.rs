//! Smoothness of an environment map as a precomputed quadratic form of its texels.
//!
//! The term is a mean over a latitude-longitude map: squared differences of each pixel and its neighbors below and to
//! the right, where the cube is looked up bilinearly. The term equals x' Q x with a fixed sparse Q whose rows add up to
//! zero. Only the entries off the diagonal are stored. The form is exact for the map's resolution, and training steps
//! never build the map.

use super::cube::Footprint;
use super::latlong::direction;

/// Off-diagonal entries of Q in compressed rows.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Form {
    /// Start of each row in `entries`, followed by the end of the last row.
    pub starts: Vec<u32>,
    /// Column and bits of the 32-bit coefficient.
    pub entries: Vec<[u32; 2]>,
}

/// Builds Q for a cube of `cube` texels a side, from a map of `size`. The map wraps around to the right.
pub fn form(cube: u32, size: [u32; 2]) -> Form {
    let [w, h] = size;
    let count = (6 * cube * cube) as usize;
    // Each pair is stored once, in the row of the smaller texel.
    let mut rows: Vec<Vec<(u32, f64)>> = vec![Vec::new(); count];
    let row_of = |y: u32| -> Vec<Footprint> { (0..w).map(|x| Footprint::of(direction(size, x, y), cube)).collect() };
    let mut pair = |a: &Footprint, b: &Footprint, share: f64| {
        let mut merged: [(u32, f64); 8] = [(0, 0.0); 8];
        let mut used = 0;
        for (f, sign) in [(a, 1.0), (b, -1.0)] {
            for (&texel, &weight) in f.texels.iter().zip(&f.weights) {
                if weight == 0.0 {
                    continue;
                }
                match merged[..used].iter_mut().find(|(t, _)| *t == texel) {
                    Some((_, c)) => *c += sign * weight,
                    None => {
                        merged[used] = (texel, sign * weight);
                        used += 1;
                    }
                }
            }
        }
        for i in 0..used {
            for j in i + 1..used {
                let ((s, p), (t, q)) = (merged[i], merged[j]);
                let value = share * p * q;
                let row = &mut rows[s.min(t) as usize];
                match row.iter_mut().find(|(c, _)| *c == s.max(t)) {
                    Some((_, c)) => *c += value,
                    None => row.push((s.max(t), value)),
                }
            }
        }
    };
    let across = 1.0 / (3.0 * f64::from(w) * f64::from(h));
    let down = 1.0 / (3.0 * f64::from(w) * f64::from(h - 1));
    let mut above: Option<Vec<Footprint>> = None;
    for y in 0..h {
        let here = row_of(y);
        for x in 0..w as usize {
            pair(&here[x], &here[(x + 1) % w as usize], across);
            if let Some(above) = &above {
                pair(&above[x], &here[x], down);
            }
        }
        above = Some(here);
    }
    // Writes each pair in both of its rows.
    let mut starts = vec![0_u32; count + 1];
    for (s, row) in rows.iter().enumerate() {
        starts[s + 1] += row.len() as u32;
        row.iter().for_each(|(t, _)| starts[*t as usize + 1] += 1);
    }
    for i in 0..count {
        starts[i + 1] += starts[i];
    }
    let mut next = starts.clone();
    let mut entries = vec![[0; 2]; starts[count] as usize];
    for (s, row) in rows.iter().enumerate() {
        for &(t, value) in row {
            for (from, to) in [(s as u32, t), (t, s as u32)] {
                let at = &mut next[from as usize];
                entries[*at as usize] = [to, (value as f32).to_bits()];
                *at += 1;
            }
        }
    }
    Form { starts, entries }
}
