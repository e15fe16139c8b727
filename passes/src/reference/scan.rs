//! Reference of the exclusive scan.

/// Returns the prefix sums of `values` and the total. With an index, the values are `values[index[i]]`. Sums saturate
/// at 0xFFFFFFFF.
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
    fn small_cases_match_expected_sums() {
        assert_eq!(exclusive_scan(&[], None), (vec![], 0));
        assert_eq!(exclusive_scan(&[3, 1, 4], None), (vec![0, 3, 4], 8));
        assert_eq!(exclusive_scan(&[3, 1, 4], Some(&[2, 0])), (vec![0, 4], 7));
        assert_eq!(exclusive_scan(&[u32::MAX, 1, 1], None), (vec![0, u32::MAX, u32::MAX], u32::MAX));
    }
}
