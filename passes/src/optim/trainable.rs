//! `adam` of flat arrays of parameters.

use super::{Adam, Rate, adam};
use crate::Tuning;
use crate::scene::TrainableHandles;
use sgs_engine::graph::{Buffer, Graph, GraphError};

/// Control words of a step: flag, and counter of non-finite gradients.
#[derive(Clone, Copy, Debug)]
pub struct StepWords {
    /// Uniform `Step`: bias corrections.
    pub step: Buffer,
    /// Flag word. If it is not zero, the step changes nothing.
    pub flags: Buffer,
    /// Counter of skipped gradients.
    pub skipped: Buffer,
}

/// How Adam updates a parameter.
#[derive(Clone, Copy, Debug)]
pub struct AdamRule {
    /// Learning rate.
    pub rate: Rate,
    /// Term that keeps the division finite.
    pub epsilon: f32,
    /// Whether numbers without a gradient stay, with their moments.
    pub skip_zero: bool,
}

impl TrainableHandles {
    /// Adds the Adam pass that applies `gradient`. Does nothing if the graph was declared without training.
    ///
    /// # Errors
    /// If the graph rejects the pass.
    pub fn follow(
        &self,
        g: &mut Graph,
        t: &Tuning,
        words: &StepWords,
        gradient: Buffer,
        rule: AdamRule,
    ) -> Result<(), GraphError> {
        let (Some(moments), Some(live)) = (self.moments, self.work) else { return Ok(()) };
        let all = Adam {
            step: words.step,
            live,
            flags: words.flags,
            flag_words: 1,
            width: 1,
            capacity: u64::from(self.floats),
            rate: rule.rate,
            skip_zero: rule.skip_zero,
            epsilon: rule.epsilon,
            gradients: gradient,
            parameters: self.parameters,
            moments,
            skipped: words.skipped,
        };
        adam(g, *t, &format!("adam.{}", self.name), &all)
    }
}
