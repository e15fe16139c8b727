//! Whether training still gets anywhere, by what its steps report anyway.
//!
//! Training has diverged where, over a block of whole rounds of the views, pictures are about as far from their photographs as
//! one plain color would be, and either farther than they were where training began, or learning rates are [`ROUGH`]. Far alone
//! does not do: a bad start, pictures that nobody could learn, and steps too small to matter come to that. Not judged is what
//! follows the start or a reset of opacities within [`GRACE`] steps.
//!
//! Promises: what is judged depends on reports alone, in their order; its state goes into checkpoints. Leaves to others what is to
//! be done.

mod plain;
mod worst;

pub(crate) use plain::plain;
pub(crate) use worst::{Group, worst};

use serde::{Deserialize, Serialize};

/// Steps after the start, and after a reset, that are not judged.
const GRACE: u32 = 100;

/// Least steps that are judged together.
const BLOCK: usize = 60;

/// Pictures count as far off where their mean absolute difference is more than this share of a plain color's.
const FAR: f64 = 0.85;

/// They count as worse than a state where the weighted loss is more than this times the state's, by view ...
const WORSE: f64 = 1.02;

/// ... and this times in proportion to what plain colors are off in the views that are compared.
const WORSE_OF_PLAIN: f64 = 1.1;

/// Learning rates so many times their defaults are rough: no wonder where pictures are far off then.
const ROUGH: f64 = 30.0;

/// A return to the last good state.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct RollBack {
    /// The step at which training had diverged.
    pub step: u32,
    /// The step whose state it went on from.
    pub to: u32,
    /// What learning rates were multiplied by from then on.
    pub rates: f64,
}

/// What learning rates are multiplied by at each return.
pub(crate) const HALF: f64 = 0.5;

/// What a step came to.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Seen {
    pub step: u32,
    pub view: usize,
    /// Weighted loss of the picture.
    pub loss: f32,
    /// Mean absolute difference.
    pub l1: f32,
    /// Gradients that were not finite, so far.
    pub skipped: u32,
    /// How many there might be in this step; 0 where that is not known.
    pub of: u32,
    /// How many times their defaults learning rates are, at most.
    pub rates: f64,
}

/// Sums of a view within a block.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Sum {
    loss: f64,
    l1: f64,
    times: u32,
}

/// The watch.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Watch {
    /// What one plain color a view is off.
    plain: Vec<f64>,
    /// Steps of a block.
    block: u32,
    /// The step before the first that counts.
    begun: u32,
    /// The last step of the last block that was found good; 0 if there is none.
    good_until: u32,
    /// The step of the checkpoint that will be gone back to once it is known to be good; 0 if there is none.
    candidate: u32,
    /// Losses of the state that others are compared with, by view, where they are known.
    reference: Vec<Option<f64>>,
    sums: Vec<Sum>,
    /// Gradients that were not finite, and all, within the block.
    bad: [u64; 2],
    /// Their counter at the last step.
    skipped: u32,
}

impl Watch {
    /// For views of which one plain color would be off by `plain`.
    pub fn new(plain: Vec<f64>) -> Watch {
        let views = plain.len().max(1);
        Watch {
            block: (views * BLOCK.div_ceil(views)) as u32,
            begun: 0,
            good_until: 0,
            candidate: 0,
            reference: vec![None; views],
            sums: vec![Sum::default(); views],
            bad: [0; 2],
            skipped: 0,
            plain,
        }
    }

    /// Returns true once when training has gone well for a whole block since the rollback candidate. Another candidate may follow.
    pub fn validate_candidate(&mut self) -> bool {
        let good = self.candidate > 0 && self.good_until >= self.candidate.saturating_add(self.block);
        if good {
            self.candidate = 0;
        }
        good
    }

    /// Marks the checkpoint of a step as the rollback candidate, unless another one waits for validation. Returns whether it is the one.
    pub fn set_candidate(&mut self, step: u32) -> bool {
        if self.candidate == 0 {
            self.candidate = step;
        }
        self.is_candidate(step)
    }

    /// Whether the checkpoint of a step is the rollback candidate.
    pub fn is_candidate(&self, step: u32) -> bool {
        step > 0 && self.candidate == step
    }

    /// After this step everything was made worse on purpose.
    pub fn restart(&mut self, step: u32) {
        self.begun = step;
        self.reference.fill(None);
        self.clear();
    }

    fn clear(&mut self) {
        self.sums.fill(Sum::default());
        self.bad = [0; 2];
    }

    /// Takes notice of a step; what is wrong, if training has diverged.
    pub fn see(&mut self, seen: &Seen) -> Option<String> {
        let Seen { step, view, loss, l1, skipped, of, rates } = *seen;
        if step == self.begun.saturating_add(1) {
            self.reference[view] = Some(f64::from(loss));
        }
        let sum = &mut self.sums[view];
        (sum.loss, sum.l1, sum.times) =
            (sum.loss + f64::from(loss), sum.l1 + f64::from(l1), sum.times.saturating_add(1));
        let more = skipped.wrapping_sub(std::mem::replace(&mut self.skipped, skipped));
        self.bad = [self.bad[0].saturating_add(more.into()), self.bad[1].saturating_add(of.into())];
        if !step.is_multiple_of(self.block) {
            return None;
        }
        let wrong = (step >= self.begun.saturating_add(GRACE + self.block)).then(|| self.judge(step, rates)).flatten();
        self.clear();
        wrong
    }

    /// Judges a whole block, during which learning rates were so many times their defaults.
    fn judge(&mut self, step: u32, rates: f64) -> Option<String> {
        // Views may be held back for a while: the others are judged.
        let seen = || self.sums.iter().zip(&self.plain).filter(|(s, _)| s.times > 0);
        let views = seen().count() as f64;
        if 2.0 * views < self.sums.len() as f64 {
            return None;
        }
        let mean = |s: &Sum, sum: f64| sum / f64::from(s.times);
        let l1 = seen().map(|(s, _)| mean(s, s.l1)).sum::<f64>() / views;
        let plain = seen().map(|(_, plain)| plain).sum::<f64>() / views;
        // Loss now and of the reference, and plain colors: of the views of which the reference is known.
        let mut known = [0.0; 4];
        for ((s, plain), reference) in self.sums.iter().zip(&self.plain).zip(&self.reference) {
            if s.times == 0 {
                continue;
            }
            known[3] += mean(s, s.loss);
            if let Some(r) = reference {
                known = [known[0] + mean(s, s.loss), known[1] + r, known[2] + plain, known[3]];
            }
        }
        let [now, then, of, all] = known;
        let far = l1 > FAR * plain;
        let worse = now > WORSE * then && all * of > WORSE_OF_PLAIN * then * plain * views;
        let stuck = self.bad[1] > 0 && self.bad[0] > self.bad[1] / 2;
        let rough = rates > ROUGH;
        let steps = self.block;
        if far && (worse || rough) {
            let why = match (worse, self.reference.iter().all(Option::is_some)) {
                (false, _) => format!("learning rates are up to {rates:.0} times their defaults"),
                (true, true) => format!("the loss of all views is {:.2} times what it was", now / then),
                (true, false) => format!("the loss of the first view is {:.2} times what it was", now / then),
            };
            return Some(format!(
                "over the last {steps} steps pictures are off by {l1:.3} in the mean, where one plain color each would be off by \
                 {plain:.3}, and {why}"
            ));
        }
        if stuck {
            let [bad, of] = self.bad;
            return Some(format!("over the last {steps} steps {bad} of {of} gradients were not finite"));
        }
        // What such rates come to is not worth going back to.
        if !rough {
            self.good_until = step;
        }
        if !far {
            let all_seen = || self.sums.iter().zip(&self.reference).filter(|(s, _)| s.times > 0);
            let best = all_seen().map(|(_, r)| *r).sum::<Option<f64>>();
            if best.is_none_or(|best| all < best) {
                for (s, reference) in self.sums.iter().zip(&mut self.reference).filter(|(s, _)| s.times > 0) {
                    *reference = Some(mean(s, s.loss));
                }
            }
        }
        None
    }

    /// Its state as text, to the bit.
    pub fn save(&self) -> String {
        let mut words = vec![
            u64::from(self.begun),
            u64::from(self.good_until),
            self.bad[0],
            self.bad[1],
            u64::from(self.candidate),
        ];
        for (s, r) in self.sums.iter().zip(&self.reference) {
            words.extend([s.loss.to_bits(), s.l1.to_bits(), u64::from(s.times), r.map_or(u64::MAX, f64::to_bits)]);
        }
        words.iter().map(|w| format!("{w:x}")).collect::<Vec<_>>().join(" ")
    }

    /// Goes on from such a text; false, and as new, if it is none of so many views. The counter of gradients begins anew.
    pub fn restore(&mut self, text: &str) -> bool {
        let words: Option<Vec<u64>> = text.split(' ').map(|w| u64::from_str_radix(w, 16).ok()).collect();
        *self = Watch::new(std::mem::take(&mut self.plain));
        let Some((head, rest)) = words.as_deref().and_then(|w| w.split_first_chunk::<5>()) else { return false };
        let (views, []) = rest.as_chunks::<4>() else { return false };
        if views.len() != self.sums.len() {
            return false;
        }
        self.begun = head[0] as u32;
        self.good_until = head[1] as u32;
        self.bad = [head[2], head[3]];
        self.candidate = head[4] as u32;
        for (i, [loss, l1, times, reference]) in views.iter().enumerate() {
            self.sums[i] = Sum { loss: f64::from_bits(*loss), l1: f64::from_bits(*l1), times: *times as u32 };
            self.reference[i] = (*reference != u64::MAX).then_some(f64::from_bits(*reference));
        }
        true
    }
}

#[cfg(test)]
mod tests;
