//! Few inputs that stand for many: those that take the branches that the kept corpus does not, most branches a byte first.

use crate::campaign::attempt;
use crate::coverage::Coverage;
use crate::target::{Target, corpus};
use std::collections::HashSet;

/// The inputs that take branches which neither the corpus of a target takes nor those before, at most `room` bytes in all, of
/// which a file takes 200 beside its own; and how many branches more they take than the corpus. `None` where the program does not count branches.
///
/// Chosen greedily, which comes near the best choice there is. Inputs at which the target fails are left out.
pub fn distill(target: &Target, inputs: &[Vec<u8>], mut room: usize) -> Option<(Vec<Vec<u8>>, usize)> {
    let mut coverage = Coverage::of_program();
    if !coverage.counts() {
        return None;
    }
    let mut branches = |input: &[u8]| -> HashSet<u32> {
        loop {
            coverage.begin();
            let sound = attempt(target, input).is_ok();
            if !coverage.elsewhere() {
                return if sound { coverage.taken() } else { HashSet::new() };
            }
        }
    };
    let old: HashSet<u32> = corpus(target).iter().flat_map(|(_, input)| branches(input)).collect();
    let new = |input: &Vec<u8>| (input.clone(), &branches(input) - &old);
    let mut left: Vec<(Vec<u8>, HashSet<u32>)> = inputs.iter().map(new).collect();
    let (mut chosen, mut more) = (Vec::new(), 0);
    loop {
        left.retain(|(input, new)| !new.is_empty() && input.len() + OVERHEAD <= room);
        let worth = |(input, new): &(Vec<u8>, HashSet<u32>)| new.len() as f64 / (input.len() + OVERHEAD) as f64;
        let best = (0..left.len()).max_by(|a, b| worth(&left[*a]).total_cmp(&worth(&left[*b])));
        let Some(best) = best else { return Some((chosen, more)) };
        let (input, taken) = left.swap_remove(best);
        left.iter_mut().for_each(|(_, new)| new.retain(|branch| !taken.contains(branch)));
        room -= input.len() + OVERHEAD;
        more += taken.len();
        chosen.push(input);
    }
}

/// What a file costs beside its bytes.
const OVERHEAD: usize = 200;
