//! How often surroundings move: as seldom as pictures allow.
//!
//! Filtering them costs the same however few pixels a view has. Once they are learned they hardly change from step to step, and may be
//! filtered once in several (`intrinsic.environment.every`). What their age costs is measured: a few steps before everything is looked at they
//! are remembered, and pictures lose so many decibels with what they were then.

use super::{LOOKS, WHOLE, due};
use crate::error::Result;
use crate::intrinsic::Intrinsic;
use crate::memory::allowed;
use crate::uniforms::uniform_bytes;
use sgs_passes::pipeline::{EnvironmentRefresh, IntrinsicOptions, KeptEnvironment};
use sgs_run::{RunLight, Texels, Visibility};

/// Ages in steps that are tried.
const AGES: [u32; 3] = [8, 4, 2];

/// Texels as they were after a step.
pub(in super::super) type Remembered = (u32, Vec<f32>);

/// Whether texels as they are after `taken` steps are asked for later than `now`.
fn wanted(taken: u32, now: u32, steps: u32) -> bool {
    let looks = LOOKS.into_iter().filter(|share| *share >= WHOLE).map(|share| due(share, steps));
    looks.filter(|look| *look > now && *look < steps).any(|look| AGES.iter().any(|age| taken + age == look))
}

impl Intrinsic {
    /// Whether it has to be remembered what surroundings are after this step.
    pub(in super::super) fn remembers(&self, step: u32) -> bool {
        let pace = self.automatic.is_some() && self.automatic_settings().pace;
        pace && self.environment.is_some() && wanted(step, step, self.required.intrinsic.steps)
    }

    /// Remembers them. All work is done.
    pub(in super::super) fn remember(&mut self, step: u32) -> Result<()> {
        let steps = self.required.intrinsic.steps;
        if let (Some(texels), Some(a)) = (&self.parameters.environment, &mut self.automatic) {
            a.before.retain(|(taken, _)| wanted(*taken, step, steps));
            a.before.push((step, texels.download(&self.device)?));
        }
        Ok(())
    }

    /// What is remembered.
    pub(in super::super) fn remembered(&self) -> &[Remembered] {
        self.automatic.as_ref().map_or(&[], |a| &a.before)
    }

    /// The most steps that surroundings may be old by now, or if they may not the fewest that were tried, and what that costs; none where
    /// they move as seldom already. `loss`: decibels that pictures lose under such surroundings.
    pub(super) fn pace(
        &self,
        before: &[Remembered],
        gain: f64,
        mut loss: impl FnMut(&RunLight) -> Result<f64>,
    ) -> Result<Option<(u32, f64)>> {
        let Some((e, _)) = &self.environment else { return Ok(None) };
        let mut tried = None;
        for every in AGES.into_iter().filter(|every| *every > self.options.environment_every) {
            let Some((_, data)) = before.iter().find(|(taken, _)| taken + every == self.done) else { continue };
            let environment = Some(Texels { size: e.size(), data: data.clone() });
            let worth = loss(&RunLight { lights: None, environment, visibility: Visibility::None })?;
            tried = Some((every, worth));
            if worth <= gain {
                break;
            }
        }
        Ok(tried)
    }

    /// Whether there is memory for surroundings that are kept, beside what steps will take again.
    pub(super) fn fits(&self, every: u32) -> Result<bool> {
        let Some((e, _)) = self.environment.as_ref().filter(|_| self.seldom.is_none()) else { return Ok(true) };
        let options = IntrinsicOptions { environment_every: every, ..self.options };
        let plan = EnvironmentRefresh::plan(&self.tuning, e, &options)?;
        let bytes = KeptEnvironment::bytes_of(e) + plan.arena_bytes + uniform_bytes(&self.device, &plan, 1);
        Ok(bytes + self.needs.given_up() <= allowed(&self.device, &self.required).left())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn surroundings_are_remembered_before_whole_parts_are_judged() {
        let all = |steps: u32| (1..=steps).filter(|s| wanted(*s, *s, steps)).collect::<Vec<_>>();
        assert_eq!(all(300), [142, 146, 148, 217, 221, 223]);
        assert_eq!(all(20), [2, 6, 7, 8, 11, 13]);
        assert_eq!(all(1), [0; 0]);
        // What was there for the first look goes with it.
        assert!(wanted(7, 10, 20) && !wanted(6, 10, 20) && !wanted(13, 15, 20));
    }
}
