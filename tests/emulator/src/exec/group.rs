//! Operations of subgroups.

use super::at;
use super::subgroup::{Subgroup, lanes, truth};
use crate::code::{Combine, Group, NONE, Slot, Vote};
use crate::fault::Fault;
use crate::scalar::{self, Lanes};

/// Runs an operation that combines or moves lanes.
pub(super) fn group<const N: usize>(s: &mut Subgroup<N>, op: Group, d: Slot, a: Slot, b: Slot) -> Result<(), Fault> {
    let mask = s.mask;
    let value = |slot: Slot| if slot == NONE { [0; N] } else { at(&s.registers, slot) };
    let (a, b) = (value(a), value(b));
    let first = mask.trailing_zeros() as usize;
    let everywhere = |x: bool| [u32::from(x); N];
    let found = match op {
        Group::Elect => std::array::from_fn(|l| u32::from(l == first)),
        Group::All => everywhere(truth(&a) & mask == mask),
        Group::Any => everywhere(truth(&a) & mask != 0),
        Group::AllEqual => everywhere(lanes(mask).all(|l| a[l] == a[first])),
        Group::Ballot(word) => {
            let ballot = truth(&a) & mask;
            [if word < 2 { (ballot >> (32 * word)) as u32 } else { 0 }; N]
        }
        Group::BroadcastFirst => [a[first]; N],
        Group::Broadcast => {
            if let Some(lane) = lanes(mask).find(|l| b[*l] != b[first]) {
                let (lane, from) = (lane as u32, b[lane]);
                return Err(Fault::Shuffle { operation: "broadcast", lane, from, why: "not the lane of the others" });
            }
            moved(mask, &a, "broadcast", |_| b[first])?
        }
        Group::Shuffle => moved(mask, &a, "shuffle", |l| b[l])?,
        Group::ShuffleXor => moved(mask, &a, "shuffle xor", |l| l as u32 ^ b[l])?,
        Group::ShuffleUp => moved(mask, &a, "shuffle up", |l| (l as u32).wrapping_sub(b[l]))?,
        Group::ShuffleDown => moved(mask, &a, "shuffle down", |l| (l as u32).wrapping_add(b[l]))?,
        Group::Arithmetic(op, how, identity) => {
            let mut found = [identity; N];
            let cluster = if let Combine::Clustered(size) = how { size as usize } else { N };
            for base in (0..N).step_by(cluster.max(1)) {
                let mut sum = None;
                for l in lanes(mask).filter(|l| *l / cluster * cluster == base) {
                    let next = sum.map_or(a[l], |sum| scalar::bin(op, &[sum], &[a[l]])[0]);
                    found[l] = if how == Combine::Exclusive { sum.unwrap_or(identity) } else { next };
                    sum = Some(next);
                }
                if matches!(how, Combine::Reduce | Combine::Clustered(_)) {
                    found[base..(base + cluster).min(N)].fill(sum.unwrap_or(identity));
                }
            }
            found
        }
    };
    s.put(d, found, mask);
    Ok(())
}

/// Returns what active lanes read from other lanes. Fails if a lane that is read is inactive.
fn moved<const N: usize>(
    mask: u64,
    a: &Lanes<N>,
    operation: &'static str,
    from: impl Fn(usize) -> u32,
) -> Result<Lanes<N>, Fault> {
    let mut found = [u32::MAX; N];
    for l in lanes(mask) {
        let from = from(l);
        if from >= N as u32 || mask >> from & 1 == 0 {
            let why = if from >= N as u32 { "outside the subgroup" } else { "inactive" };
            return Err(Fault::Shuffle { operation, lane: l as u32, from, why });
        }
        found[l] = a[from as usize];
    }
    Ok(found)
}

/// Answers a question to a ballot.
pub(super) fn vote<const N: usize>(s: &mut Subgroup<N>, op: Vote, d: Slot, ballot: [Slot; 4], lane: Slot) {
    let [low, high] = [ballot[0], ballot[1]].map(|slot| at(&s.registers, slot));
    let lane = if lane == NONE { [0; N] } else { at(&s.registers, lane) };
    let whole = if N == 64 { u64::MAX } else { (1 << N) - 1 };
    let found = std::array::from_fn(|l| {
        let bits = (u64::from(low[l]) | u64::from(high[l]) << 32) & whole;
        match op {
            Vote::Bit => u32::from(lane[l] < 64 && bits >> lane[l] & 1 != 0),
            Vote::Lowest => bits.trailing_zeros(),
            Vote::Highest => 63_u32.wrapping_sub(bits.leading_zeros()),
            Vote::Count(how) => match how {
                Combine::Inclusive => (bits & (u64::MAX >> (63 - l))).count_ones(),
                Combine::Exclusive => (bits & !(u64::MAX << l)).count_ones(),
                Combine::Reduce | Combine::Clustered(_) => bits.count_ones(),
            },
        }
    });
    s.put(d, found, s.mask);
}
