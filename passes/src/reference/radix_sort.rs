//! Reference of the radix sort, and of the ranking of elements within a block.

use std::ops::Range;

/// Masks a key to the given bits.
fn masked(key: u32, bits: &Range<u32>) -> u32 {
    let below = |bit: u32| ((1_u64 << bit.min(32)) - 1) as u32;
    key & below(bits.end) & !below(bits.start)
}

/// Sorts pairs stably by the bits `bits` of their keys. Without values, the values are the positions.
pub fn radix_sort(keys: &[u32], values: Option<&[u32]>, bits: Range<u32>) -> (Vec<u32>, Vec<u32>) {
    let mut order: Vec<u32> = (0..keys.len() as u32).collect();
    order.sort_by_key(|&i| masked(keys[i as usize], &bits));
    let sorted = order.iter().map(|&i| keys[i as usize]).collect();
    (sorted, values.map_or(order.clone(), |v| order.iter().map(|&i| v[i as usize]).collect()))
}

/// Block of `radix_scatter`, emulated with the kernel's index arithmetic. Supports any subgroup size, since the
/// available devices have few of them.
#[derive(Clone, Copy, Debug)]
pub struct BlockRanking {
    /// Lanes of a subgroup, at most 128.
    pub subgroup: usize,
    /// Subgroups of the workgroup.
    pub subgroups: usize,
    /// Elements of a lane.
    pub items: usize,
    /// Bits of the digit.
    pub bits: u32,
    /// Lowest bit of the digit in the key.
    pub shift: u32,
}

/// Peers of each lane: number of earlier lanes with its digit, and the last one.
type Peers = Vec<(u32, usize)>;

impl BlockRanking {
    fn digit(&self, key: u32) -> usize {
        ((key >> self.shift) & ((1 << self.bits) - 1)) as usize
    }

    /// Finds peers by votes on each bit, 32 lanes a word.
    fn peers_by_votes(&self, digits: &[usize], valid: &[bool]) -> Peers {
        let ballot = |vote: &dyn Fn(usize) -> bool| {
            let mut words = [0_u32; 4];
            for lane in (0..self.subgroup).filter(|&lane| vote(lane)) {
                words[lane / 32] |= 1 << (lane % 32);
            }
            words
        };
        let everyone = ballot(&|lane| valid[lane]);
        let peers = |lane: usize| {
            if !valid[lane] {
                return (0, lane);
            }
            let mut mask = everyone;
            for bit in 0..self.bits {
                let set = digits[lane] >> bit & 1 != 0;
                let votes = ballot(&|other| digits[other] >> bit & 1 != 0);
                for (word, votes) in mask.iter_mut().zip(votes) {
                    *word &= if set { votes } else { !votes };
                }
            }
            let below = |word: usize| match lane.saturating_sub(32 * word) {
                _ if lane < 32 * word => 0,
                shift if shift >= 32 => u32::MAX,
                shift => (1_u32 << shift) - 1,
            };
            let before = (0..4).map(|word| (mask[word] & below(word)).count_ones()).sum();
            let word = (0..4).rev().find(|&word| mask[word] != 0).expect("invariant: a lane is its own peer");
            (before, 32 * word + 31 - mask[word].leading_zeros() as usize)
        };
        (0..self.subgroup).map(peers).collect()
    }

    /// Finds peers by comparison with each lane.
    fn peers_by_lanes(&self, digits: &[usize], valid: &[bool]) -> Peers {
        let shown: Vec<u32> =
            (0..self.subgroup).map(|lane| if valid[lane] { digits[lane] as u32 } else { !(lane as u32) }).collect();
        let peers = |lane: usize| {
            let same = |other: &usize| shown[*other] == shown[lane];
            let before = (0..lane).filter(same).count() as u32;
            (before, (0..self.subgroup).rfind(same).unwrap_or(lane))
        };
        (0..self.subgroup).map(peers).collect()
    }

    /// Returns the position of each element in the block's order by digit. Panics if a 16-bit counter overflows, or if
    /// the two methods find different peers.
    pub fn positions(&self, keys: &[u32]) -> Vec<usize> {
        let bins = 1 << self.bits;
        let pairs = usize::div_ceil(bins, 2);
        let half_of = |word: u32, digit: usize| word >> (digit % 2 * 16) & 0xFFFF;
        let mut pool = vec![0_u32; self.subgroups * pairs];
        let mut places = vec![0_u32; keys.len()];
        // Subgroups are independent in this phase, so they may run in any order.
        for subgroup in 0..self.subgroups {
            for k in 0..self.items {
                let first = (subgroup * self.items + k) * self.subgroup;
                let at = |lane: usize| first + lane;
                let valid: Vec<bool> = (0..self.subgroup).map(|lane| at(lane) < keys.len()).collect();
                let digits: Vec<usize> =
                    (0..self.subgroup).map(|lane| self.digit(keys.get(at(lane)).copied().unwrap_or(0))).collect();
                let peers = self.peers_by_votes(&digits, &valid);
                assert_eq!(peers, self.peers_by_lanes(&digits, &valid), "peers of {digits:?} {valid:?}");
                let word = |lane: usize| subgroup * pairs + digits[lane] / 2;
                for lane in (0..self.subgroup).filter(|&lane| valid[lane]) {
                    places[at(lane)] = half_of(pool[word(lane)], digits[lane]) + peers[lane].0;
                }
                for lane in (0..self.subgroup).filter(|&lane| valid[lane] && peers[lane].1 == lane) {
                    let before = half_of(pool[word(lane)], digits[lane]);
                    pool[word(lane)] += (peers[lane].0 + 1) << (digits[lane] % 2 * 16);
                    assert!(half_of(pool[word(lane)], digits[lane]) > before, "a counter of 16 bits ran over");
                }
            }
        }
        let mut totals = vec![0_u32; pairs];
        for pair in 0..pairs {
            let mut sum = 0_u32;
            for subgroup in 0..self.subgroups {
                let added = std::mem::replace(&mut pool[subgroup * pairs + pair], sum);
                sum += added;
            }
            totals[pair] = sum;
        }
        let mut starts = vec![0_u32; bins];
        let mut start = 0;
        for digit in 0..bins {
            starts[digit] = start;
            start += half_of(totals[digit / 2], digit);
        }
        let position = |(i, &key): (usize, &u32)| {
            let (digit, subgroup) = (self.digit(key), i / (self.subgroup * self.items));
            (places[i] + half_of(pool[subgroup * pairs + digit / 2], digit) + starts[digit]) as usize
        };
        keys.iter().enumerate().map(position).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::Pcg;

    #[test]
    fn bits_outside_the_range_are_ignored() {
        let keys = [0x8000_0013, 0x0000_0102, 0x0000_0013];
        assert_eq!(radix_sort(&keys, None, 0..32).1, [2, 1, 0]);
        assert_eq!(radix_sort(&keys, None, 0..31).1, [0, 2, 1]);
        assert_eq!(radix_sort(&keys, None, 0..4).1, [1, 0, 2]);
        assert_eq!(radix_sort(&keys, Some(&[7, 8, 9]), 8..40).1, [9, 8, 7]);
        assert_eq!(radix_sort(&keys, None, 5..5), (keys.to_vec(), vec![0, 1, 2]));
    }

    #[test]
    fn blocks_are_ranked_stably_at_every_subgroup_size() {
        let mut rng = Pcg::new(5);
        for (subgroup, subgroups, items) in [(8, 32, 4), (8, 1, 16), (32, 8, 16), (32, 1, 3), (64, 4, 16), (128, 2, 5)]
        {
            for (bits, shift) in [(8, 0), (8, 24), (5, 3), (1, 31), (0, 0), (7, 11)] {
                let ranking = BlockRanking { subgroup, subgroups, items, bits, shift };
                let block = subgroup * subgroups * items;
                for count in [0, 1, subgroup - 1, subgroup, subgroup + 1, block / 2 + 1, block - 1, block] {
                    let random: Vec<u32> = (0..count).map(|_| rng.next_u32()).collect();
                    for keys in [random, vec![u32::MAX; count], (0..count as u32).rev().collect()] {
                        let positions = ranking.positions(&keys);
                        let (_, order) = radix_sort(&keys, None, shift..shift + bits);
                        for (place, &i) in order.iter().enumerate() {
                            assert_eq!(positions[i as usize], place, "{ranking:?}, {count} keys, element {i}");
                        }
                    }
                }
            }
        }
    }
}
