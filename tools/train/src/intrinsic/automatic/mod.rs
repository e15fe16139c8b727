//! Automatic model selection of the intrinsic stage.
//!
//! Before the first step, sizes follow from what the cameras can resolve ([`sizes`]). During training, a few
//! measurements remove components that contribute nothing to images of training views ([`judge`], [`contribution`]).
//!
//! Guarantees: decisions depend only on the scene, the splats, the settings and the seed. Checkpoints store the
//! decisions. A removed component does not return. Quantities that need ground truth are not measured here.

mod contribution;
mod judge;
mod lobes;
mod sizes;
mod texels;
mod update_interval;

pub(super) use sizes::{Found, required};
pub(super) use texels::tables;
pub(super) use update_interval::Remembered;

use super::Intrinsic;
use crate::data::Packed;
use crate::decision::Decision;
use crate::error::Result;
use sgs_config::{AutomaticSettings, VisibilityKind};
use sgs_passes::pipeline::Camera;
use sgs_passes::scene::Trainable;
use sgs_passes::shade::visibility::{FieldConfig, VisibilityField};

/// Shares of the steps after which components are measured.
/// Lights can be judged at all of them. The environment map and the visibility must be learned first, and are judged
/// from [`WHOLE`] on.
const POLLS: [f64; 3] = [0.25, 0.5, 0.75];

/// Share of the steps from which whole components are judged.
const WHOLE: f64 = 0.5;

/// Share from which lobes are judged. The lobes of a light start alike and differentiate late.
const PARTED: f64 = 0.75;

/// Maximum number of training views in a measurement.
const VIEWS: usize = 6;

/// Maximum number of pixels per view.
const PIXELS: usize = 6000;

/// State of automatic model selection.
pub(super) struct Automatic {
    views: Vec<Watched>,
    /// Squared error of the splats' own colors at the selected pixels, once known.
    own: Option<f64>,
    /// Sum of squared errors of the shaded images at the last measurement.
    pub last: Option<f64>,
    /// Snapshots of the environment map from a few steps ago.
    pub before: Vec<Remembered>,
}

/// Selected pixels of a training view.
struct Watched {
    camera: Camera,
    /// Indices of the pixels and their display-referred colors in the photograph; valid pixels only.
    pixels: Vec<(usize, [f32; 3])>,
}

/// Component that can be removed as a whole.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Part {
    Lights,
    Environment,
    Visibility,
}

impl Part {
    const ALL: [Part; 3] = [Part::Lights, Part::Environment, Part::Visibility];

    fn name(self) -> &'static str {
        match self {
            Part::Lights => "lights",
            Part::Environment => "environment",
            Part::Visibility => "visibility",
        }
    }
}

impl Automatic {
    /// Selects views and pixels for the measurements.
    pub fn new(packed: &Packed) -> Automatic {
        let views = packed.views();
        let chosen = VIEWS.min(views.len());
        let watched = |k: usize| {
            let i = k * views.len() / chosen;
            let image = packed.image(i);
            let stride = image.len().div_ceil(PIXELS).max(1);
            // Takes one in `stride` pixels of a row, with an offset that changes from row to row.
            let width = views[i].0.size[0] as usize;
            let taken = (0..image.len()).filter(|p| (p % width.max(1) + 7 * (p / width.max(1))).is_multiple_of(stride));
            let color = |word: u32| [0, 8, 16].map(|shift| (word >> shift & 0xff) as f32 / 255.0);
            let pixels = taken.filter(|p| image[*p] >> 24 != 0).map(|p| (p, color(image[p]))).collect();
            Watched { camera: views[i].0, pixels }
        };
        Automatic { views: (0..chosen).map(watched).collect(), own: None, last: None, before: Vec::new() }
    }
}

/// Returns whether components are measured after this step.
fn polls(step: u32, steps: u32) -> bool {
    POLLS.iter().any(|share| due(*share, steps) == step) && step < steps
}

/// Returns whether components that are judged from a share on are judged at a step.
fn judges(from: f64, step: u32, steps: u32) -> bool {
    step >= due(from, steps)
}

/// Returns the step at a share of all steps.
fn due(share: f64, steps: u32) -> u32 {
    (share * f64::from(steps)).ceil() as u32
}

impl Intrinsic {
    /// Returns the decisions about the model, in order.
    pub fn decisions(&self) -> &[Decision] {
        &self.decisions
    }

    fn automatic_settings(&self) -> &AutomaticSettings {
        &self.required.intrinsic.automatic
    }

    /// Returns whether the model may change after this step.
    pub(super) fn decides_after(&self, step: u32) -> bool {
        self.automatic.is_some() && polls(step, self.required.intrinsic.steps)
    }

    /// Returns whether a component is modeled.
    fn has(&self, part: Part) -> bool {
        match part {
            Part::Lights => self.options.lights.is_some(),
            Part::Environment => self.environment.is_some(),
            Part::Visibility => self.options.visibility.is_some() || self.options.traced.is_some(),
        }
    }

    /// Removes a component and frees its memory. Graphs without it are built on first use.
    fn leave_out(&mut self, part: Part) -> Result<()> {
        self.finish()?;
        self.forget_steps();
        match part {
            Part::Environment => {
                self.environment_updates = None;
                self.environment = None;
                self.parameters.environment = None;
            }
            Part::Visibility => {
                (self.options.visibility, self.options.traced) = (None, None);
                self.parameters.visibility = None;
                self.traced = None;
                self.required.intrinsic.visibility.kind = VisibilityKind::None;
            }
            Part::Lights => {
                self.leave_out(Part::Visibility)?;
                self.options.lights = None;
                self.parameters.lights = None;
            }
        }
        Ok(())
    }

    /// Returns the maximum number of lobes of each light.
    pub(super) fn lobes(&self) -> u32 {
        self.light_model.lobes
    }

    /// Merges the lobes of each light until at most `most` remain.
    /// The first moments restart at zero. The gradient of a merged lobe is the sum of its lobes' gradients, so the root
    /// of its second moment is the sum of theirs. With the second moment of a single lobe, updates would be too long by
    /// the number of merged lobes. This would last until the mean of about a thousand steps forgets it.
    fn merge_lobes(&mut self, most: u32) -> Result<()> {
        self.finish()?;
        let (Some(mut file), Some(before)) = (self.scaled_lights()?, &self.parameters.lights) else {
            return Ok(());
        };
        let (row, old) = (self.light_model.row() as usize, self.light_model.lobes as usize);
        let moments = before.lobes.download_moments(&self.device)?;
        file.lights.iter_mut().for_each(|l| *l = lobes::merged(l, most as usize));
        let (_, _, raw, _) = file.raw();
        self.set_lobes(most, &raw)?;
        let square = |i: usize| {
            let (light, column) = (i / (most as usize * row), i % row);
            let sizes = (0..old).map(|k| moments[2 * ((light * old + k) * row + column) + 1].sqrt());
            sizes.sum::<f32>().powi(2)
        };
        let moments: Vec<f32> = (0..raw.len()).flat_map(|i| [0.0, square(i)]).collect();
        match &self.parameters.lights {
            Some(lights) => Ok(lights.lobes.upload_moments(&self.device, &moments)?),
            None => Ok(()),
        }
    }

    /// Returns the number of levels of the visibility field, if there is one.
    pub(super) fn levels(&self) -> Option<u32> {
        self.parameters.visibility.as_ref().map(|f| f.config().levels)
    }

    /// Changes the number of levels of the visibility field.
    /// A field with fewer levels keeps the coarsest ones with their moments. Otherwise a new field starts from initial
    /// values.
    pub(super) fn set_levels(&mut self, levels: u32) -> Result<()> {
        self.finish()?;
        self.forget_steps();
        let Some(field) = self.parameters.visibility.take() else { return Ok(()) };
        let config = *field.config();
        let made = if levels < config.levels {
            field.into_first_levels(&self.device, levels)?
        } else {
            drop(field);
            let (seed, bits) = (self.required.seed as u32, self.tuning.accuracy.visibility_bits);
            VisibilityField::new(&self.device, FieldConfig { levels, ..config }, seed, true, bits)?
        };
        self.options.visibility = Some(*made.config());
        self.required.intrinsic.visibility.levels = made.config().levels;
        self.parameters.visibility = Some(made);
        Ok(())
    }

    /// Replaces the lobes: `lobes` of each light, with the raw parameters `raw`.
    pub(super) fn set_lobes(&mut self, lobes: u32, raw: &[f32]) -> Result<()> {
        self.finish()?;
        self.forget_steps();
        self.light_model.lobes = lobes;
        self.required.intrinsic.lights.lobes = lobes;
        self.options.lights = self.options.lights.map(|(_, normalizer)| (self.light_model, normalizer));
        if let Some(lights) = &mut self.parameters.lights {
            lights.lobes = Trainable::new(&self.device, "light_lobes", raw, true)?;
        }
        Ok(())
    }

    /// Applies the decisions of a checkpoint.
    /// Returns false if the checkpoint still has a component that has been removed since.
    pub(super) fn take_decisions(&mut self, decisions: Vec<Decision>) -> Result<bool> {
        let out = |part: Part| decisions.iter().any(|d| d.step > 0 && !d.on && d.what == part.name());
        let lights = out(Part::Lights);
        for part in Part::ALL {
            match (out(part) || lights && part == Part::Visibility, self.has(part)) {
                (true, true) => self.leave_out(part)?,
                (false, false) if self.decisions.iter().any(|d| d.step > 0 && !d.on && d.what == part.name()) => {
                    return Ok(false);
                }
                _ => {}
            }
        }
        self.decisions = decisions;
        Ok(true)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn measurements_run_at_fixed_shares_and_never_at_the_end() {
        let all = |steps: u32| (1..=steps).filter(|step| polls(*step, steps)).collect::<Vec<_>>();
        assert_eq!(all(300), [75, 150, 225]);
        assert_eq!(all(3000), [750, 1500, 2250]);
        assert_eq!(all(4), [1, 2, 3]);
        assert_eq!(all(1), [0; 0]);
        assert!(judges(WHOLE, 150, 300) && judges(WHOLE, 225, 300) && !judges(WHOLE, 75, 300));
    }
}
