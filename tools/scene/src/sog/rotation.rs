//! Rotations of SOG: the three smaller components in bytes, and which one is the largest.

use std::f64::consts::SQRT_2;

/// First value of the fourth byte; the index of the largest component is added.
const FIRST: u8 = 252;

/// Packs a unit quaternion (w, x, y, z).
pub(super) fn pack(q: [f64; 4]) -> [u8; 4] {
    let largest = (1..4).fold(0, |best, i| if q[i].abs() > q[best].abs() { i } else { best });
    let sign = if q[largest] < 0.0 { -1.0 } else { 1.0 };
    let mut packed = [0, 0, 0, FIRST + largest as u8];
    for (place, i) in packed.iter_mut().zip((0..4).filter(|i| *i != largest)) {
        *place = (255.0 * (sign * q[i] / SQRT_2 + 0.5)).round().clamp(0.0, 255.0) as u8;
    }
    packed
}

/// Unpacks a unit quaternion (w, x, y, z). An impossible fourth byte gives the identity.
pub(super) fn unpack(packed: [u8; 4]) -> [f32; 4] {
    let Some(largest) = packed[3].checked_sub(FIRST).map(usize::from) else { return [1.0, 0.0, 0.0, 0.0] };
    let mut q = [0.0_f64; 4];
    for (byte, i) in packed.iter().zip((0..4).filter(|i| *i != largest)) {
        q[i] = (f64::from(*byte) / 255.0 - 0.5) * SQRT_2;
    }
    let squares: f64 = q.iter().map(|v| v * v).sum();
    q[largest] = (1.0 - squares).max(0.0).sqrt();
    let length = (squares + q[largest] * q[largest]).sqrt();
    q.map(|v| (v / length) as f32)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rotations_come_back_within_their_step() {
        for i in 0..2000 {
            let at = |k: f64| (f64::from(i) * k).sin();
            let q = [at(0.7), at(1.3), at(2.1), at(3.7)];
            let length = q.iter().map(|v| v * v).sum::<f64>().sqrt();
            let q = q.map(|v| v / length);
            let found = unpack(pack(q));
            let dot: f64 = q.iter().zip(found).map(|(a, b)| a * f64::from(b)).sum();
            assert!(2.0 * dot.abs().min(1.0).acos().to_degrees() < 1.0, "{q:?} {found:?}");
        }
        assert_eq!(unpack([1, 2, 3, 7]), [1.0, 0.0, 0.0, 0.0]);
    }
}
