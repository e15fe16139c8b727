//! Selection of few inputs that take the branches which the corpus misses.

use crate::campaign::attempt;
use crate::corpus::corpus;
use crate::coverage::Coverage;
use crate::target::Target;
use std::collections::HashSet;

/// Selects inputs with branches that neither the corpus nor earlier ones take.
///
/// Returns the selected inputs and the number of branches that they add to the corpus. `room`: maximum size in bytes;
/// each file counts 200 bytes in addition to its own. Returns `None` if the program does not count branches.
///
/// The selection is greedy by branches per byte, which is close to the optimum. Inputs at which the target fails are
/// left out.
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
    let old: HashSet<u32> = corpus(target).values().flat_map(|input| branches(input)).collect();
    let new = |input: &Vec<u8>| (input.clone(), &branches(input) - &old);
    let mut left: Vec<(Vec<u8>, HashSet<u32>)> = inputs.iter().map(new).collect();
    let (mut chosen, mut more) = (Vec::new(), 0);
    loop {
        left.retain(|(input, new)| !new.is_empty() && input.len() + OVERHEAD <= room);
        let gain = |(input, new): &(Vec<u8>, HashSet<u32>)| new.len() as f64 / (input.len() + OVERHEAD) as f64;
        let best = (0..left.len()).max_by(|a, b| gain(&left[*a]).total_cmp(&gain(&left[*b])));
        let Some(best) = best else { return Some((chosen, more)) };
        let (input, taken) = left.swap_remove(best);
        left.iter_mut().for_each(|(_, new)| new.retain(|branch| !taken.contains(branch)));
        room -= input.len() + OVERHEAD;
        more += taken.len();
        chosen.push(input);
    }
}

/// Cost of a file in addition to its size, in bytes.
const OVERHEAD: usize = 200;
