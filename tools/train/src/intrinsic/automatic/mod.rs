//! The intrinsic stage without what a scene does not require.
//!
//! Before the first step sizes follow from what cameras can tell apart ([`sizes`]); while training, at a few steps, what adds nothing to
//! pictures of training views is left out ([`judge`], [`worth`]). Promises: decisions depend on the scene, the splats, the settings and the seed alone;
//! checkpoints hold them; what has been left out does not come back. What must be measured against ground truth is left to others.

mod judge;
mod lobes;
mod pace;
mod sizes;
mod texels;
mod worth;

pub(super) use pace::Remembered;
pub(super) use sizes::{Found, required};
pub(super) use texels::tables;

use super::Intrinsic;
use crate::data::Packed;
use crate::decision::Decision;
use crate::error::Result;
use sgs_config::{AutomaticSettings, VisibilityKind};
use sgs_passes::pipeline::Camera;
use sgs_passes::scene::Trainable;
use sgs_passes::shade::visibility::{FieldConfig, VisibilityField};

/// Shares of the steps after which it is looked at. Lights can be judged at all of them; surroundings and shadows have to be learned first,
/// and are judged from [`WHOLE`] on.
const LOOKS: [f64; 3] = [0.25, 0.5, 0.75];

/// The share of the steps from which whole parts are judged.
const WHOLE: f64 = 0.5;

/// The share from which lobes are judged: those of a light begin alike, and part late.
const PARTED: f64 = 0.75;

/// Most training views that are looked at.
const VIEWS: usize = 6;

/// Most pixels of each.
const PIXELS: usize = 6000;

/// What it takes to look.
pub(super) struct Automatic {
    views: Vec<Watched>,
    /// The sum of squared errors of the splats' own colors there, once it is known.
    own: Option<f64>,
    /// The sum of squared errors of shaded pictures when they were last looked at.
    pub last: Option<f64>,
    /// Surroundings as they were a few steps ago.
    pub before: Vec<Remembered>,
}

/// Pixels of a training view.
struct Watched {
    camera: Camera,
    /// Which pixels, and what the photograph shows there (display-referred); those that do not count are left out.
    pixels: Vec<(usize, [f32; 3])>,
}

/// What can be left out whole.
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
    /// Takes what is looked at from the training views.
    pub fn new(packed: &Packed) -> Automatic {
        let views = packed.views();
        let chosen = VIEWS.min(views.len());
        let watched = |k: usize| {
            let i = k * views.len() / chosen;
            let image = packed.image(i);
            let stride = image.len().div_ceil(PIXELS).max(1);
            // Of every so many pixels in a row one, in another place from row to row.
            let width = views[i].0.size[0] as usize;
            let taken = (0..image.len()).filter(|p| (p % width.max(1) + 7 * (p / width.max(1))).is_multiple_of(stride));
            let color = |word: u32| [0, 8, 16].map(|shift| (word >> shift & 0xff) as f32 / 255.0);
            let pixels = taken.filter(|p| image[*p] >> 24 != 0).map(|p| (p, color(image[p]))).collect();
            Watched { camera: views[i].0, pixels }
        };
        Automatic { views: (0..chosen).map(watched).collect(), own: None, last: None, before: Vec::new() }
    }
}

/// Whether it is looked at after this step.
fn looks(step: u32, steps: u32) -> bool {
    LOOKS.iter().any(|share| due(*share, steps) == step) && step < steps
}

/// Whether what is judged from a share on is judged then.
fn judges(from: f64, step: u32, steps: u32) -> bool {
    step >= due(from, steps)
}

/// The step at a share of all.
fn due(share: f64, steps: u32) -> u32 {
    (share * f64::from(steps)).ceil() as u32
}

impl Intrinsic {
    /// Decisions about the model, in order.
    pub fn decisions(&self) -> &[Decision] {
        &self.decisions
    }

    fn automatic_settings(&self) -> &AutomaticSettings {
        &self.required.intrinsic.automatic
    }

    /// Whether something is decided after this step.
    pub(super) fn decides_after(&self, step: u32) -> bool {
        self.automatic.is_some() && looks(step, self.required.intrinsic.steps)
    }

    /// Whether a part is modeled.
    fn has(&self, part: Part) -> bool {
        match part {
            Part::Lights => self.options.lights.is_some(),
            Part::Environment => self.environment.is_some(),
            Part::Visibility => self.options.visibility.is_some() || self.options.traced.is_some(),
        }
    }

    /// Gives up what a part has in memory; graphs are made without it when they are due.
    fn leave_out(&mut self, part: Part) -> Result<()> {
        self.finish()?;
        self.forget_steps();
        match part {
            Part::Environment => {
                self.seldom = None;
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

    /// Lobes of each light, at most.
    pub(super) fn lobes(&self) -> u32 {
        self.light_model.lobes
    }

    /// Merges the lobes of each light until so many are left. They begin without momentum. What is
    /// asked of a lobe is what was asked of all that went into it together, so that its scale is the sum of theirs: with that of one alone
    /// moves would be as many times too long, until the mean of a thousand steps forgets it.
    fn merge_lobes(&mut self, most: u32) -> Result<()> {
        self.finish()?;
        let (Some(mut file), Some([_, before])) = (self.scaled_lights()?, &self.parameters.lights) else {
            return Ok(());
        };
        let (row, old) = (self.light_model.row() as usize, self.light_model.lobes as usize);
        let moments = before.download_moments(&self.device)?;
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
            Some([_, lobes]) => Ok(lobes.upload_moments(&self.device, &moments)?),
            None => Ok(()),
        }
    }

    /// Levels of the visibility field, if there is one.
    pub(super) fn levels(&self) -> Option<u32> {
        self.parameters.visibility.as_ref().map(|f| f.config().levels)
    }

    /// Makes it a field of so many levels. What is there of these stays, with its moments; levels that are not start anew.
    pub(super) fn set_levels(&mut self, levels: u32) -> Result<()> {
        self.finish()?;
        self.forget_steps();
        let Some(field) = self.parameters.visibility.take() else { return Ok(()) };
        let config = *field.config();
        let made = if levels < config.levels {
            field.into_first_levels(&self.device, levels)?
        } else {
            drop(field);
            let (seed, bits) = (self.required.seed as u32, self.tuning.accuracy.table_bits);
            VisibilityField::new(&self.device, FieldConfig { levels, ..config }, seed, true, bits)?
        };
        self.options.visibility = Some(*made.config());
        self.required.intrinsic.visibility.levels = made.config().levels;
        self.parameters.visibility = Some(made);
        Ok(())
    }

    /// Room for so many lobes of each light, with these values.
    pub(super) fn set_lobes(&mut self, lobes: u32, raw: &[f32]) -> Result<()> {
        self.finish()?;
        self.forget_steps();
        self.light_model.lobes = lobes;
        self.required.intrinsic.lights.lobes = lobes;
        self.options.lights = self.options.lights.map(|(_, normalizer)| (self.light_model, normalizer));
        if let Some([_, parameters]) = &mut self.parameters.lights {
            *parameters = Trainable::new(&self.device, "light_lobes", raw, true)?;
        }
        Ok(())
    }

    /// Takes over what a checkpoint says was decided. False if something has been left out that it still has.
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
    fn it_is_looked_at_a_few_times_and_never_at_the_end() {
        let all = |steps: u32| (1..=steps).filter(|step| looks(*step, steps)).collect::<Vec<_>>();
        assert_eq!(all(300), [75, 150, 225]);
        assert_eq!(all(3000), [750, 1500, 2250]);
        assert_eq!(all(4), [1, 2, 3]);
        assert_eq!(all(1), [0; 0]);
        assert!(judges(WHOLE, 150, 300) && judges(WHOLE, 225, 300) && !judges(WHOLE, 75, 300));
    }
}
