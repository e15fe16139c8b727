//! Octahedral encoding of unit vectors in 32 bits.
//!
//! Kernels read prior normals in this encoding (`octahedral.glsl`). The octahedron's faces are unfolded onto a square,
//! 16 bits per axis (Meyer et al. 2010). The error is at most 7e-5 radians. The pattern 0 marks an absent vector; the
//! direction straight down, which would have this pattern, has another encoding.

/// Packs a vector of any length. Returns 0 if it has no direction.
pub fn octahedral_encode(v: [f32; 3]) -> u32 {
    let v = v.map(f64::from);
    let sum: f64 = v.iter().map(|x| x.abs()).sum();
    if !sum.is_finite() || sum < 1e-30 {
        return 0;
    }
    let [x, y, z] = v.map(|x| x / sum);
    let fold = (-z).max(0.0);
    let away = |a: f64| if a >= 0.0 { a + fold } else { a - fold };
    let bits = |a: f64| ((0.5 * away(a) + 0.5).clamp(0.0, 1.0) * 65535.0).round() as u32;
    match bits(x) | bits(y) << 16 {
        // All four corners encode the same direction.
        0 => u32::MAX,
        packed => packed,
    }
}

/// Returns the unit vector, or `None` for the pattern 0.
pub fn octahedral_decode(packed: u32) -> Option<[f64; 3]> {
    if packed == 0 {
        return None;
    }
    let of = |bits: u32| 2.0 * f64::from(bits & 0xffff) / 65535.0 - 1.0;
    let (x, y) = (of(packed), of(packed >> 16));
    let z = 1.0 - x.abs() - y.abs();
    let fold = (-z).max(0.0);
    let back = |a: f64| if a >= 0.0 { a - fold } else { a + fold };
    let v = [back(x), back(y), z];
    let norm = v.iter().map(|x| x * x).sum::<f64>().sqrt();
    Some(v.map(|x| x / norm))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::Pcg;

    #[test]
    fn round_trip_error_is_below_7e_5() {
        let mut rng = Pcg::new(1);
        let mut cases: Vec<[f32; 3]> = (0..2000).map(|_| [0; 3].map(|_| rng.normal() as f32)).collect();
        for axis in 0..3 {
            for sign in [1.0, -1.0] {
                let mut v = [0.0; 3];
                v[axis] = sign;
                cases.push(v);
            }
        }
        for v in cases {
            let found = octahedral_decode(octahedral_encode(v)).unwrap_or_else(|| panic!("{v:?} was lost"));
            let norm = v.iter().map(|&x| f64::from(x * x)).sum::<f64>().sqrt();
            let distance: f64 = v.iter().zip(found).map(|(&x, f)| (f64::from(x) / norm - f).powi(2)).sum();
            assert!(distance.sqrt() < 7e-5, "{v:?} {found:?}");
        }
    }

    #[test]
    fn vectors_without_direction_encode_to_zero() {
        for v in [[0.0; 3], [f32::NAN, 0.0, 1.0], [f32::INFINITY, 0.0, 0.0]] {
            assert_eq!(octahedral_encode(v), 0);
        }
        assert_eq!(octahedral_decode(0), None);
    }
}
