//! Rotations of SPZ files.

/// Largest magnitude of a stored component.
const MOST: f64 = 511.0;

/// Packs a unit quaternion (w, x, y, z) into 4 bytes: the index of the largest component, and ten bits for each other.
pub(super) fn pack([w, x, y, z]: [f64; 4]) -> u32 {
    let q = [x, y, z, w];
    let largest = (1..4).fold(0, |best, i| if q[i].abs() > q[best].abs() { i } else { best });
    let mut packed = largest as u32;
    for i in (0..4).filter(|i| *i != largest) {
        let magnitude = (MOST * std::f64::consts::SQRT_2 * q[i].abs()).round().min(MOST) as u32;
        // The largest component is positive in the file.
        let negative = u32::from((q[i] < 0.0) != (q[largest] < 0.0));
        packed = packed << 10 | negative << 9 | magnitude;
    }
    packed
}

/// Unpacks 4 bytes to a unit quaternion (w, x, y, z).
pub(super) fn unpack(packed: u32) -> [f32; 4] {
    let largest = (packed >> 30) as usize;
    let mut q = [0.0_f64; 4];
    let mut rest = packed;
    for i in (0..4).rev().filter(|i| *i != largest) {
        let magnitude = f64::from(rest & 511) / MOST * std::f64::consts::FRAC_1_SQRT_2;
        q[i] = if rest >> 9 & 1 == 1 { -magnitude } else { magnitude };
        rest >>= 10;
    }
    let squares: f64 = q.iter().map(|v| v * v).sum();
    q[largest] = (1.0 - squares).max(0.0).sqrt();
    // Three components of the largest magnitude leave less than a unit.
    let length = (squares + q[largest] * q[largest]).sqrt().max(1e-6);
    let [x, y, z, w] = q.map(|v| (v / length) as f32);
    [w, x, y, z]
}

/// Packs a unit quaternion (w, x, y, z) into 3 bytes: x, y and z, where w is positive.
pub(super) fn pack_3([w, x, y, z]: [f64; 4]) -> [u8; 3] {
    let sign = if w < 0.0 { -1.0 } else { 1.0 };
    [x, y, z].map(|v| (127.5 * (sign * v + 1.0)).round().clamp(0.0, 255.0) as u8)
}

/// Unpacks 3 bytes to a unit quaternion (w, x, y, z).
pub(super) fn unpack_3(bytes: [u8; 3]) -> [f32; 4] {
    let [x, y, z] = bytes.map(|b| f64::from(b) / 127.5 - 1.0);
    let squares = x * x + y * y + z * z;
    let w = (1.0 - squares).max(0.0).sqrt();
    let length = (squares + w * w).sqrt();
    [w, x, y, z].map(|v| (v / length) as f32)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns unit quaternions in many directions.
    fn many() -> impl Iterator<Item = [f64; 4]> {
        (0..2000).map(|i| {
            let at = |k: f64| (f64::from(i) * k).sin();
            let q = [at(0.7), at(1.3), at(2.1), at(3.7)];
            let length = q.iter().map(|v| v * v).sum::<f64>().sqrt();
            q.map(|v| v / length)
        })
    }

    /// Returns the angle between two rotations in degrees.
    fn angle(a: [f64; 4], b: [f32; 4]) -> f64 {
        let dot: f64 = a.iter().zip(b).map(|(a, b)| a * f64::from(b)).sum();
        2.0 * dot.abs().min(1.0).acos().to_degrees()
    }

    #[test]
    fn rotations_come_back_within_their_step() {
        for q in many() {
            let (four, three) = (angle(q, unpack(pack(q))), angle(q, unpack_3(pack_3(q))));
            assert!(four < 0.3, "{q:?}: {four}");
            // A small w is lost to the rounding of the others.
            assert!(three < 12.0, "{q:?}: {three}");
        }
        assert_eq!(unpack(pack([1.0, 0.0, 0.0, 0.0])), [1.0, 0.0, 0.0, 0.0]);
        assert_eq!(unpack(pack([0.0, 0.0, -1.0, 0.0])), [0.0, 0.0, 1.0, 0.0]);
    }

    #[test]
    fn every_word_is_a_unit_quaternion() {
        for word in (0..=u32::MAX).step_by(65_537).chain([u32::MAX, 0x3fff_ffff]) {
            let length: f32 = unpack(word).iter().map(|v| v * v).sum();
            assert!((length - 1.0).abs() < 1e-5, "{word:x}: {length}");
        }
    }
}
