//! Detection of divergence from the reports of the steps.
//!
//! Training has diverged if both conditions hold over a block of whole rounds of the views:
//!
//! - Images are about as far from their photographs as one plain color per view would be.
//! - Images are farther away than where training began, or learning rates exceed [`ROUGH`] times their defaults.
//!
//! The first condition alone is not sufficient: a bad start, images that no model can fit, and steps too small to
//! matter also meet it. A block in which most gradients are not finite counts as divergence, too. Blocks within
//! [`GRACE`] steps of the start or of a reset of opacities are not evaluated.
//!
//! Guarantees: the verdict depends on the reports alone, in their order, and its state is part of checkpoints. This
//! module decides no reaction to divergence.

mod plain;
mod worst;

pub(crate) use plain::plain;
pub(crate) use worst::{Group, diverged};

use serde::{Deserialize, Serialize};

/// Steps after the start, and after a reset, that are not evaluated.
const GRACE: u32 = 100;

/// Least number of steps that are evaluated together.
const BLOCK: usize = 60;

/// Threshold of far-off images. Share of the mean absolute difference of a plain color.
const FAR: f64 = 0.85;

/// First threshold of images that are worse than a state. Weighted loss relative to the state's loss, over the views
/// whose reference loss is known. Images are worse if they exceed both thresholds.
const WORSE: f64 = 1.02;

/// Second threshold of images that are worse than a state. Each loss is first divided by the difference of the plain
/// colors in its views. The threshold limits the ratio of the loss of all rendered views to the reference loss of the
/// known views.
const WORSE_OF_PLAIN: f64 = 1.1;

/// Threshold of rough learning rates. Multiple of the default rates; images that are far off then need no other
/// evidence.
const ROUGH: f64 = 30.0;

/// Rollback to the last validated state.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct RollBack {
    /// Step at which training had diverged.
    pub step: u32,
    /// Step whose state training continued from.
    pub to: u32,
    /// Factor on learning rates from then on.
    pub rates: f64,
}

/// Factor on learning rates at each rollback.
const HALF: f64 = 0.5;

impl RollBack {
    /// Returns the factor on learning rates after a number of rollbacks.
    pub(crate) fn rates_after(count: usize) -> f64 {
        HALF.powi(count as i32)
    }

    /// Returns rollbacks with another one, from step `step` to step `to`.
    pub(crate) fn appended(before: &[RollBack], step: u32, to: u32) -> Vec<RollBack> {
        let rates = RollBack::rates_after(before.len() + 1);
        before.iter().copied().chain([RollBack { step, to, rates }]).collect()
    }
}

/// Report of a step.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Seen {
    pub step: u32,
    pub view: usize,
    /// Weighted loss of the image.
    pub loss: f32,
    /// Mean absolute difference.
    pub l1: f32,
    /// Number of gradients since the start that were not finite.
    pub skipped: u32,
    /// Number of gradients of this step, at most; 0 if unknown.
    pub of: u32,
    /// Learning rates as a multiple of their defaults, at most.
    pub rates: f64,
}

/// Sums of a view within a block.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Sum {
    loss: f64,
    l1: f64,
    times: u32,
}

/// State of the divergence detection.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Watch {
    /// Mean absolute difference of one plain color, by view.
    plain: Vec<f64>,
    /// Steps of a block.
    block: u32,
    /// Step before the first that counts.
    begun: u32,
    /// Last step of the last block that was good; 0 if there is none.
    good_until: u32,
    /// Step of the rollback candidate, which waits for validation; 0 if there is none.
    candidate: u32,
    /// Losses of the reference state, by view, where they are known.
    reference: Vec<Option<f64>>,
    sums: Vec<Sum>,
    /// Gradients that were not finite, and all gradients, within the block.
    bad: [u64; 2],
    /// Counter of gradients that were not finite, at the last step.
    skipped: u32,
}

impl Watch {
    /// Starts for views for which one plain color would be off by `plain`.
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

    /// Returns true once when the rollback candidate is validated. Training has then gone well for a whole block since
    /// the candidate. Another candidate may follow.
    pub fn validate_candidate(&mut self) -> bool {
        let good = self.candidate > 0 && self.good_until >= self.candidate.saturating_add(self.block);
        if good {
            self.candidate = 0;
        }
        good
    }

    /// Marks the checkpoint of a step as the rollback candidate. Has no effect while another candidate waits for
    /// validation. Returns whether this step is the candidate.
    pub fn set_candidate(&mut self, step: u32) -> bool {
        if self.candidate == 0 {
            self.candidate = step;
        }
        self.is_candidate(step)
    }

    /// Returns whether the checkpoint of a step is the rollback candidate.
    pub fn is_candidate(&self, step: u32) -> bool {
        step > 0 && self.candidate == step
    }

    /// Restarts evaluation after a step that made all images worse on purpose. A reset of opacities is such a step.
    pub fn restart(&mut self, step: u32) {
        self.begun = step;
        self.reference.fill(None);
        self.clear();
    }

    fn clear(&mut self) {
        self.sums.fill(Sum::default());
        self.bad = [0; 2];
    }

    /// Records a step. Returns a description of the divergence if training has diverged.
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

    /// Evaluates a whole block. `rates`: learning rates during it, as a multiple of their defaults.
    fn judge(&mut self, step: u32, rates: f64) -> Option<String> {
        // Some views may be held out for a while. The others are evaluated if they are at least half of all.
        let seen = || self.sums.iter().zip(&self.plain).filter(|(s, _)| s.times > 0);
        let views = seen().count() as f64;
        if 2.0 * views < self.sums.len() as f64 {
            return None;
        }
        let mean = |s: &Sum, sum: f64| sum / f64::from(s.times);
        let l1 = seen().map(|(s, _)| mean(s, s.l1)).sum::<f64>() / views;
        let plain = seen().map(|(_, plain)| plain).sum::<f64>() / views;
        // Loss now, loss of the reference and plain colors, over the views whose reference is known; then the loss of
        // all views.
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
                "over the last {steps} steps images are off by {l1:.3} in the mean, where one plain color each would be off by \
                 {plain:.3}, and {why}"
            ));
        }
        if stuck {
            let [bad, of] = self.bad;
            return Some(format!("over the last {steps} steps {bad} of {of} gradients were not finite"));
        }
        // A state that such learning rates produced is no rollback target.
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

    /// Returns the state as text, exact to the bit.
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

    /// Restores the state from such text. If the text is damaged or of another number of views, returns false and
    /// starts from the beginning. The counter of gradients restarts at 0.
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
