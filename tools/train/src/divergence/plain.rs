//! Distance of one plain color from a photograph.

/// Returns the mean absolute difference of a photograph from its best plain color.
///
/// That color is the median of each channel. `packed`: 8 bits per channel; a pixel whose top byte is 0 is masked.
/// Masked pixels contribute no difference but count in the mean, as in the loss. Values are relative to white (1).
pub(crate) fn plain(packed: &[u32]) -> f64 {
    let mut sum = 0.0;
    for channel in 0..3 {
        let mut counts = [0_u64; 256];
        for word in packed.iter().filter(|w| **w >> 24 != 0) {
            counts[(word >> (8 * channel) & 0xff) as usize] += 1;
        }
        let all: u64 = counts.iter().sum();
        let mut below = 0;
        let median = counts.iter().position(|c| {
            below += c;
            2 * below >= all
        });
        let median = median.unwrap_or(0) as i64;
        sum += counts.iter().enumerate().map(|(v, c)| (v as i64 - median).unsigned_abs() * c).sum::<u64>() as f64;
    }
    sum / (255.0 * 3.0 * packed.len().max(1) as f64)
}

#[cfg(test)]
mod tests {
    use super::plain;

    #[test]
    fn plain_color_minimizes_absolute_difference() {
        let gray = |v: u32| 0xff00_0000 | v << 16 | v << 8 | v;
        assert_eq!(plain(&[gray(7); 9]), 0.0);
        // A median of 10: off by 10, 0 and 245.
        let three = [gray(0), gray(10), gray(255)];
        assert!((plain(&three) - 1.0 / 3.0).abs() < 1e-12);
        // Masked pixels contribute no difference but count in the mean.
        assert!((plain(&[three.as_slice(), &[0x00ff_ffff; 3]].concat()) - 1.0 / 6.0).abs() < 1e-12);
        assert_eq!((plain(&[]), plain(&[0; 4])), (0.0, 0.0));
    }
}
