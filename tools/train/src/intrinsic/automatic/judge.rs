//! Measurement of the model's components, and removal of needless ones.
//! Components whose contribution is too small are removed. [`super::contribution`] describes the measure.
//!
//! Guarantees: all components are measured before anything changes. Each measurement excludes components that have
//! already been rejected, so of two redundant components one stays. Decisions to keep a component also report its
//! measure.

use super::contribution::{Light, ShadedViews, add, error, loss, needless};
use super::lobes::merged;
use super::{Automatic, PARTED, Part, Remembered, WHOLE, Watched};
use crate::decision::Decision;
use crate::error::Result;
use crate::intrinsic::Intrinsic;
use sgs_config::AutomaticSettings;
use sgs_passes::pipeline::Renderer;
use sgs_passes::scene::{Gaussians, Model};
use sgs_passes::shade::lights::Axes;
use sgs_passes::splat::Channels;
use sgs_run::{RunLight, Visibility, gaussian_data};
use sgs_scene::Splats;

/// Candidate numbers of lobes.
const FEWER: [u32; 5] = [1, 2, 3, 4, 6];

/// State of a measurement, and its decisions.
struct Seen<'v> {
    step: u32,
    /// Least PSNR contribution of a component that stays, in dB.
    gain: f64,
    views: &'v [Watched],
    before: &'v [Remembered],
    photos: Vec<[f32; 3]>,
    splats: Splats,
    /// Current light without the components rejected before.
    light: RunLight,
    /// Components of the shaded images under this light.
    all: ShadedViews,
    /// Squared error of the complete image.
    with: f64,
    decisions: Vec<Decision>,
}

impl Seen<'_> {
    /// Returns the squared error of images with this light over the background.
    fn error(&self, direct: &[[f32; 3]], ambient: &[[f32; 3]]) -> f64 {
        let of = |light: &[[f32; 3]], i: usize| light.get(i).copied().unwrap_or_default();
        error(&self.photos, |i| add(add(self.all.behind[i], of(direct, i)), of(ambient, i)))
    }

    /// Replaces the direct or the ambient light, and updates the error.
    fn shine(&mut self, direct: Option<Light>, ambient: Option<Light>) {
        if let Some(direct) = direct {
            self.all.direct = direct;
        }
        if let Some(ambient) = ambient {
            self.all.ambient = ambient;
        }
        self.with = self.error(&self.all.direct, &self.all.ambient);
    }

    fn decided(&mut self, what: &str, on: bool, reason: String, contribution: f64) {
        let (step, what, setting) = (self.step, what.to_owned(), "intrinsic.automatic.parts".to_owned());
        self.decisions.push(Decision {
            step,
            what,
            on,
            reason,
            measured: Some(contribution),
            requested: Some(self.gain),
            setting,
        });
    }

    /// Decides whether a component with this PSNR contribution stays.
    fn keeps(&mut self, part: Part, contribution: f64) -> bool {
        let gain = self.gain;
        self.decided(
            part.name(),
            contribution > gain,
            format!("it contributes {contribution:.3} dB (limit: {gain})"),
            contribution,
        );
        contribution > gain
    }

    /// Records that nothing is reduced.
    /// Even the largest candidate tried would cost too much.
    fn stay(&mut self, what: &str, all: &str, tried: Option<(u32, f64)>) {
        if let Some((few, contribution)) = tried {
            let reason = format!("{all} stay: {few} would cost {contribution:.3} dB (limit: {})", self.gain);
            self.decided(what, true, reason, contribution);
        }
    }
}

/// Changes to the model.
#[derive(Default)]
struct Changes {
    gains: Option<Vec<f32>>,
    lobes: Option<u32>,
    levels: Option<u32>,
    texels: Option<u32>,
    update_interval: Option<u32>,
    out: Vec<Part>,
}

/// Makes the decision that all components stay for lack of memory.
/// Memory does not suffice for a measurement.
fn no_room(step: u32) -> Decision {
    let reason = "there is no memory to see what could be left out".to_owned();
    Decision { on: true, ..Decision::of_memory(step, "all parts", reason) }
}

impl Intrinsic {
    /// Removes the components that contribute too little.
    /// Everything stays if memory does not suffice for the measurement.
    pub(in super::super) fn decide(&mut self, step: u32) -> Result<()> {
        // A measurement takes about the memory of a step; both may not fit at once.
        self.finish()?;
        self.forget_steps();
        let (decided, changes) = match self.judge_contributions(step) {
            Err(e) if e.is_out_of_memory() => (vec![no_room(step)], Changes::default()),
            other => other?,
        };
        let resized = changes.texels.is_some();
        // The measurement changed nothing. An error from here on ends the training, which would otherwise continue with
        // half a model.
        self.change(step, changes)?;
        if let Some(a) = self.automatic.as_mut().filter(|_| resized) {
            // The snapshots belong to a cube of another size.
            a.before.clear();
        }
        for decision in decided {
            tracing::info!("{decision}");
            self.decisions.push(decision);
        }
        Ok(())
    }

    /// Finds the memory of a measurement by a trial before the first step.
    /// Records a decision if memory does not suffice.
    pub(in super::super) fn measure_poll(&mut self) -> Result<()> {
        let Some(mut watched) = self.automatic.take() else { return Ok(()) };
        let (found, bytes) = self.device.memory_during(|| self.try_poll(&mut watched));
        self.automatic = Some(watched);
        match found {
            Ok(()) => self.needs.poll(bytes),
            Err(e) if e.is_out_of_memory() => self.decisions.push(no_room(0)),
            Err(e) => return Err(e),
        }
        Ok(())
    }

    fn try_poll(&self, watched: &mut Automatic) -> Result<()> {
        watched.own = Some(self.own(&watched.views)?);
        self.images(&mut self.shading(&self.scaled_splats()?, &self.scaled_light()?)?, &watched.views)?;
        Ok(())
    }

    fn judge_contributions(&mut self, step: u32) -> Result<(Vec<Decision>, Changes)> {
        let (requested, watched) = (*self.automatic_settings(), self.automatic.take());
        let Some(mut watched) = watched else { return Ok(Default::default()) };
        let found = match watched.own {
            Some(own) => Ok(own),
            None => self.own(&watched.views),
        };
        let found = found.and_then(|own| {
            watched.own = Some(own);
            self.found(step, &requested, &mut watched, own)
        });
        self.automatic = Some(watched);
        found
    }

    /// Returns the sum of squared errors of images with the splats' own colors.
    /// Shaded images can hardly get better than these.
    fn own(&self, views: &[Watched]) -> Result<f64> {
        let model = Model {
            sh_degree: self.splats.sh_degree() as u32,
            normals: false,
            semantics: false,
            mip: self.splats.antialiased,
        };
        let gaussians = Gaussians::with(&self.device, model, self.splats.len() as u32, false, false)?;
        gaussians.upload(&self.device, &gaussian_data(&self.splats, model))?;
        let mut renderer =
            Renderer::new(&self.device, self.tuning, &gaussians, self.data.largest, Channels::default())?;
        let mut sum = 0.0;
        for view in views {
            let background = self.required.geometry.background;
            let rendered = renderer.render(&gaussians, &view.camera, model.sh_degree, background)?;
            for (p, photo) in &view.pixels {
                let off = |c: usize| f64::from(rendered.image[3 * p + c].clamp(0.0, 1.0) - photo[c]).powi(2);
                sum += (0..3).map(off).sum::<f64>();
            }
        }
        Ok(sum)
    }

    /// Measures all components. Returns the decisions and the changes.
    fn found(
        &mut self,
        step: u32,
        a: &AutomaticSettings,
        watched: &mut Automatic,
        own: f64,
    ) -> Result<(Vec<Decision>, Changes)> {
        let Automatic { views, before, last, .. } = watched;
        // Uses the value as written in decimal, not its nearest binary neighbor.
        let gain: f64 = a.gain.to_string().parse().unwrap_or(f64::from(a.gain));
        let photos: Vec<[f32; 3]> = views.iter().flat_map(|v| v.pixels.iter().map(|p| p.1)).collect();
        let (splats, light) = (self.scaled_splats()?, self.scaled_light()?);
        let all = self.images(&mut self.shading(&splats, &light)?, views)?;
        let mut seen = Seen { step, gain, views, before, photos, splats, light, all, with: 0.0, decisions: Vec::new() };
        seen.with = seen.error(&seen.all.direct, &seen.all.ambient);
        let gained = last.replace(seen.with).map(|last| loss(seen.with, last));
        let short = loss(own, seen.with);
        let [ready, most] = a.limits;
        let setting = || "intrinsic.automatic.limits".to_owned();
        if short > f64::from(ready) {
            let reason = format!(
                "shaded images are {short:.1} dB below those of the splats' own colors (limit: {ready}): nothing is measured yet"
            );
            let (what, requested) = ("all parts".to_owned(), Some(f64::from(ready)));
            let waits = Decision { step, what, on: true, reason, measured: Some(short), requested, setting: setting() };
            return Ok((vec![waits], Changes::default()));
        }
        tracing::info!("after step {step} shaded images are {short:.2} dB short of the splats' own colors");
        // Images that have become worse are oscillating.
        let settled = gained.is_some_and(|gained| gained.abs() <= f64::from(most));
        let waits = (a.parts.lobes || a.parts.levels || a.parts.update_interval) && self.judges(WHOLE, step);
        if let Some(gained) = gained.filter(|_| waits && !settled) {
            let reason = format!(
                "images gained {gained:.2} dB since the last measurement (limit: {most} either way): these stay as they are"
            );
            let (what, requested) = ("lobes, levels and update interval".to_owned(), Some(f64::from(most)));
            let measured = Some(gained);
            seen.decisions.push(Decision { step, what, on: true, reason, measured, requested, setting: setting() });
        }
        let changes = self.judged(a, &mut seen, settled)?;
        Ok((seen.decisions, changes))
    }

    /// Returns whether components that are judged from a share on are judged now.
    /// With a provider of materials they never are: its views under other lights come from separate graphs with all
    /// components.
    fn judges(&self, from: f64, step: u32) -> bool {
        self.relit.is_none() && super::judges(from, step, self.required.intrinsic.steps)
    }

    /// Selects the components that can be removed. Changes nothing yet.
    fn judged(&self, a: &AutomaticSettings, seen: &mut Seen<'_>, settled: bool) -> Result<Changes> {
        let (parts, lobes) = (self.judges(WHOLE, seen.step), self.judges(PARTED, seen.step) && settled);
        let mut changes = Changes::default();
        if a.parts.lights && self.has(Part::Lights) {
            let (gains, none) = self.judge_lights(seen, self.relit.is_none() && self.has(Part::Environment))?;
            changes.gains = Some(gains);
            if none {
                changes.out.push(Part::Lights);
            }
        }
        let lit = self.has(Part::Lights) && !changes.out.contains(&Part::Lights);
        if lobes && a.parts.lobes && lit && self.light_model.axes == Axes::Free {
            changes.lobes = self.judge_lobes(seen)?;
        }
        let mut has_environment = self.has(Part::Environment);
        if parts && a.parts.environment && has_environment && lit {
            has_environment = seen.keeps(Part::Environment, loss(seen.with, seen.error(&seen.all.direct, &[])));
            if !has_environment {
                changes.out.push(Part::Environment);
                seen.light.environment = None;
                seen.shine(None, Some(Light::new()));
            }
        }
        let mut shadows = self.has(Part::Visibility) && lit;
        if parts && a.parts.visibility && shadows {
            let (contribution, direct) = self.shadowed(seen, &Visibility::None)?;
            shadows = seen.keeps(Part::Visibility, contribution);
            if !shadows {
                changes.out.push(Part::Visibility);
                seen.light.visibility = Visibility::None;
                seen.shine(Some(direct), None);
            }
        }
        if parts && settled && a.parts.levels && shadows {
            changes.levels = self.judge_levels(seen)?;
        }
        // Before the texels are reduced: the snapshots have the current number of texels.
        if parts && settled && a.parts.update_interval && has_environment {
            changes.update_interval = self.judge_update_interval(seen)?;
        }
        if parts && a.parts.texels && has_environment {
            changes.texels = self.judge_texels(seen)?;
        }
        Ok(changes)
    }

    fn change(&mut self, step: u32, changes: Changes) -> Result<()> {
        if let (Some(gains), true) = (&changes.gains, self.has(Part::Lights)) {
            self.device.upload(&self.gains, 0, bytemuck::cast_slice(gains))?;
        }
        if let Some(lobes) = changes.lobes {
            self.merge_lobes(lobes)?;
        }
        if let Some(levels) = changes.levels {
            self.set_levels(levels)?;
        }
        for part in changes.out {
            self.leave_out(part)?;
        }
        if let Some(size) = changes.texels {
            self.set_texels(size)?;
        }
        match changes.update_interval {
            Some(every) => self.set_update_interval(every, step, self.moves(step)),
            None => Ok(()),
        }
    }

    /// Returns gains without the faint lights, and whether no light remains.
    /// All lights may go only if `all_may` is true.
    fn judge_lights(&self, seen: &mut Seen<'_>, all_may: bool) -> Result<(Vec<f32>, bool)> {
        let mut gains: Vec<f32> = seen.light.lights.iter().flat_map(|l| &l.lights).map(|l| l.gain).collect();
        // The environment map would be filtered again for each light.
        let only = RunLight { environment: None, ..seen.light.clone() };
        let parts = self.each(&mut self.shading(&seen.splats, &only)?, seen.views, &gains)?;
        let rest: Light = seen.all.behind.iter().zip(&seen.all.ambient).map(|(b, a)| add(*b, *a)).collect();
        let on = gains.iter().filter(|g| **g != 0.0).count();
        let (mut gone, next) = needless(&seen.photos, &rest, &parts, seen.gain);
        if gone.len() == on && !all_may {
            // One light must remain.
            gone.pop();
        }
        let none = gone.len() == on && on > 0;
        gone.iter().for_each(|(i, _)| gains[*i] = 0.0);
        let (contribution, gain) = (gone.last().map_or(0.0, |g| g.1), seen.gain);
        if none {
            seen.decided(
                "lights",
                false,
                format!("together they contribute {contribution:.3} dB (limit: {gain})"),
                contribution,
            );
        } else if !gone.is_empty() {
            let left = on - gone.len();
            let reason =
                format!("{left} of {on} stay: all others together contribute {contribution:.3} dB (limit: {gain})");
            seen.decided("lights", true, reason, contribution);
        } else if let Some(contribution) = next {
            seen.decided(
                "lights",
                true,
                format!("the faintest of {on} contributes {contribution:.3} dB (limit: {gain})"),
                contribution,
            );
        }
        if !gone.is_empty() {
            seen.light.lights.iter_mut().flat_map(|l| &mut l.lights).zip(&gains).for_each(|(l, gain)| l.gain = *gain);
            let mut direct = vec![[0.0; 3]; seen.photos.len()];
            for part in parts.iter().zip(&gains).filter(|(_, gain)| **gain != 0.0).map(|(part, _)| part) {
                direct.iter_mut().zip(part).for_each(|(sum, light)| *sum = add(*sum, *light));
            }
            seen.shine(Some(direct), None);
        }
        Ok((gains, none))
    }

    /// Finds the smallest number of lobes to which each light can be merged.
    fn judge_lobes(&self, seen: &mut Seen<'_>) -> Result<Option<u32>> {
        let (lobes, gain, mut least) = (self.lobes(), seen.gain, None);
        for few in FEWER.into_iter().filter(|few| *few < lobes) {
            let mut some = RunLight { environment: None, ..seen.light.clone() };
            if let Some(file) = &mut some.lights {
                file.lights.iter_mut().for_each(|l| *l = merged(l, few as usize));
            }
            let direct = self.images(&mut self.shading(&seen.splats, &some)?, seen.views)?.direct;
            let contribution = loss(seen.with, seen.error(&direct, &seen.all.ambient));
            if contribution <= gain {
                let reason =
                    format!("{few} of {lobes} stay: merging the others costs {contribution:.3} dB (limit: {gain})");
                seen.decided("lobes", true, reason, contribution);
                seen.light.lights = some.lights;
                seen.shine(Some(direct), None);
                return Ok(Some(few));
            }
            least = Some((few, contribution));
        }
        seen.stay("lobes", &format!("all {lobes}"), least);
        Ok(None)
    }

    /// Finds the smallest sufficient number of levels of the visibility field.
    fn judge_levels(&self, seen: &mut Seen<'_>) -> Result<Option<u32>> {
        let (gain, mut least) = (seen.gain, None);
        let Visibility::Learned(field) = seen.light.visibility.clone() else { return Ok(None) };
        let levels = field.config.levels;
        let fewer = [levels / 4, levels / 2, 3 * levels / 4, levels - 1];
        for few in fewer.into_iter().filter(|n| (1..levels).contains(n)) {
            let other = Visibility::Learned(Box::new(field.first_levels(few)));
            let (contribution, direct) = self.shadowed(seen, &other)?;
            if contribution <= gain {
                let share = 100.0 * self.reached(few)?;
                let reason = format!(
                    "{few} of {levels} stay: without the others images lose {contribution:.3} dB (limit: {gain}); gradients have \
                     reached {share:.0} % of their entries"
                );
                seen.decided("levels", true, reason, contribution);
                seen.light.visibility = other;
                seen.shine(Some(direct), None);
                return Ok(Some(few));
            }
            least = Some((few, contribution));
        }
        seen.stay("levels", &format!("all {levels}"), least);
        Ok(None)
    }

    /// Finds the smallest sufficient resolution of the environment map.
    fn judge_texels(&self, seen: &mut Seen<'_>) -> Result<Option<u32>> {
        let Some(size) = self.environment_size() else { return Ok(None) };
        let gain = seen.gain;
        let Some((few, contribution)) = self.enough_texels(gain, |few| self.environment_loss(seen, few))? else {
            return Ok(None);
        };
        if contribution > gain {
            seen.stay("texels", &format!("{size} along an edge"), Some((few, contribution)));
            return Ok(None);
        }
        let reason = format!(
            "{few} along an edge instead of {size} stay: with averaged texels images lose {contribution:.3} dB (limit: {gain})"
        );
        seen.decided("texels", true, reason, contribution);
        Ok(Some(few))
    }

    /// Finds the longest acceptable update interval of the environment map.
    fn judge_update_interval(&self, seen: &mut Seen<'_>) -> Result<Option<u32>> {
        let gain = seen.gain;
        let tried = self.update_interval(seen.before, gain, |old| self.environment_loss(seen, old))?;
        let Some((every, contribution)) = tried else { return Ok(None) };
        let cost = format!("at an age of {every} steps it costs {contribution:.3} dB (limit: {gain})");
        let moves = format!(
            "the environment map is updated every {every} steps: at that age it costs {contribution:.3} dB (limit: {gain})"
        );
        let (reason, update_interval) = if contribution > gain {
            (format!("the update interval of the environment map stays: {cost}"), None)
        } else if !self.fits(every)? {
            (
                format!(
                    "the update interval of the environment map stays: {cost}, but memory does not hold its stored levels"
                ),
                None,
            )
        } else {
            (moves, Some(every))
        };
        seen.decided("update_interval", true, reason, contribution);
        Ok(update_interval)
    }

    /// Returns the PSNR loss in dB of images under another environment map.
    fn environment_loss(&self, seen: &Seen<'_>, other: &RunLight) -> Result<f64> {
        let ambient = self.images(&mut self.shading(&seen.splats, other)?, seen.views)?.ambient;
        Ok(loss(seen.with, seen.error(&seen.all.direct, &ambient)))
    }

    /// Returns the PSNR loss in dB with another visibility, and its direct light.
    fn shadowed(&self, seen: &Seen<'_>, visibility: &Visibility) -> Result<(f64, Light)> {
        let lights = seen.light.lights.clone();
        let light = RunLight { lights, environment: None, visibility: visibility.clone() };
        let direct = self.images(&mut self.shading(&seen.splats, &light)?, seen.views)?.direct;
        Ok((loss(seen.with, seen.error(&direct, &seen.all.ambient)), direct))
    }

    /// Returns the share of finer-level entries that gradients have ever reached.
    /// The finer levels are those of the visibility field behind the `first` coarsest ones.
    fn reached(&self, first: u32) -> Result<f64> {
        let Some(field) = &self.parameters.visibility else { return Ok(0.0) };
        let behind = field.config().first_levels(first).entries() as usize;
        let [moments, _] = field.download_moments(&self.device)?;
        // An entry has two features with a pair of moments each; the second of a pair is of squares.
        let entries = moments[4 * behind..].as_chunks::<4>().0;
        let reached = entries.iter().filter(|m| m[1] > 0.0 || m[3] > 0.0).count();
        Ok(reached as f64 / entries.len().max(1) as f64)
    }
}
