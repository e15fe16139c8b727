//! Twin of the exclusive scan.

/// Prefix sums of `values` (of `values[index[i]]` with an index) and the sum of all. What would pass 0xFFFFFFFF stays
/// there.
pub fn exclusive_scan(values: &[u32], index: Option<&[u32]>) -> (Vec<u32>, u32) {
    let mut sum = 0_u64;
    let mut next = |value: u32| {
        let before = sum;
        sum += u64::from(value);
        u32::try_from(before).unwrap_or(u32::MAX)
    };
    let prefixes = match index {
        Some(index) => index.iter().map(|&i| next(values[i as usize])).collect(),
        None => values.iter().map(|&v| next(v)).collect(),
    };
    (prefixes, u32::try_from(sum).unwrap_or(u32::MAX))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn small_cases() {
        assert_eq!(exclusive_scan(&[], None), (vec![], 0));
        assert_eq!(exclusive_scan(&[3, 1, 4], None), (vec![0, 3, 4], 8));
        assert_eq!(exclusive_scan(&[3, 1, 4], Some(&[2, 0])), (vec![0, 4], 7));
        assert_eq!(exclusive_scan(&[u32::MAX, 1, 1], None), (vec![0, u32::MAX, u32::MAX], u32::MAX));
    }
}
