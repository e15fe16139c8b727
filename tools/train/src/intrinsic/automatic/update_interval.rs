//! Update interval of the environment map: the longest that images allow.
//!
//! The cost of filtering does not depend on the number of pixels of a view. A learned map hardly changes from step to
//! step, so an update every few steps suffices (`intrinsic.environment.every`). The cost of an outdated map is
//! measured. Snapshots of the map are taken a few steps before each measurement; the cost is the PSNR loss of images
//! with such a snapshot.

use super::{POLLS, WHOLE, due};
use crate::error::Result;
use crate::intrinsic::Intrinsic;
use crate::uniforms::uniform_bytes;
use sgs_passes::pipeline::{EnvironmentRefresh, IntrinsicOptions, StoredEnvironment};
use sgs_run::{RunLight, Texels, Visibility};

/// Candidate ages in steps, from the oldest.
const AGES: [u32; 3] = [8, 4, 2];

/// Snapshot of the texels: the step after which it was taken, and the values.
pub(in super::super) type Remembered = (u32, Vec<f32>);

/// Returns whether a snapshot taken after step `taken` is needed later than `now`.
fn wanted(taken: u32, now: u32, steps: u32) -> bool {
    let polls = POLLS.into_iter().filter(|share| *share >= WHOLE).map(|share| due(share, steps));
    polls.filter(|poll| *poll > now && *poll < steps).any(|poll| AGES.iter().any(|age| taken + age == poll))
}

impl Intrinsic {
    /// Returns whether a snapshot of the environment map is needed after this step.
    pub(in super::super) fn remembers(&self, step: u32) -> bool {
        let update_interval = self.automatic.is_some() && self.automatic_settings().parts.update_interval;
        update_interval && self.environment.is_some() && wanted(step, step, self.required.intrinsic.steps)
    }

    /// Takes a snapshot and drops those that are no longer needed. Requires that no work is in flight.
    pub(in super::super) fn remember(&mut self, step: u32) -> Result<()> {
        let steps = self.required.intrinsic.steps;
        if let (Some(texels), Some(a)) = (&self.parameters.environment, &mut self.automatic) {
            a.before.retain(|(taken, _)| wanted(*taken, step, steps));
            a.before.push((step, texels.download(&self.device)?));
        }
        Ok(())
    }

    /// Returns the snapshots.
    pub(in super::super) fn remembered(&self) -> &[Remembered] {
        self.automatic.as_ref().map_or(&[], |a| &a.before)
    }

    /// Finds the longest acceptable update interval in steps, with its PSNR loss.
    /// If no candidate is acceptable, returns the shortest one tried and its loss. Returns none if the current interval
    /// is as long as all candidates. `loss`: PSNR loss in dB of images under the given environment map.
    pub(super) fn update_interval(
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
            let contribution = loss(&RunLight { lights: None, environment, visibility: Visibility::None })?;
            tried = Some((every, contribution));
            if contribution <= gain {
                break;
            }
        }
        Ok(tried)
    }

    /// Returns whether the stored mip levels of the environment map fit into memory.
    /// The budget also covers the memory that steps will allocate again.
    pub(super) fn fits(&self, every: u32) -> Result<bool> {
        let Some((e, _)) = self.environment.as_ref().filter(|_| self.environment_updates.is_none()) else {
            return Ok(true);
        };
        let options = IntrinsicOptions { environment_every: every, ..self.options };
        let plan = EnvironmentRefresh::plan(&self.tuning, e, &options)?;
        let bytes = StoredEnvironment::bytes_of(e) + plan.arena_bytes + uniform_bytes(&self.device, &plan, 1);
        Ok(bytes + self.needs.released() <= self.device.budget().left())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn environment_snapshots_precede_measurements_of_components() {
        let all = |steps: u32| (1..=steps).filter(|s| wanted(*s, *s, steps)).collect::<Vec<_>>();
        assert_eq!(all(300), [142, 146, 148, 217, 221, 223]);
        assert_eq!(all(20), [2, 6, 7, 8, 11, 13]);
        assert_eq!(all(1), [0; 0]);
        // Snapshots for the first measurement are dropped after it.
        assert!(wanted(7, 10, 20) && !wanted(6, 10, 20) && !wanted(13, 15, 20));
    }
}
