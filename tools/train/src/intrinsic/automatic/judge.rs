//! Looking at what training has come to, and leaving out what is worth too little ([`super::worth`] says how that is measured).
//!
//! Promises: everything is judged before anything changes.

use super::lobes::merged;
use super::worth::{Light, Pictures, add, error, loss, needless};
use super::{Automatic, PARTED, Part, Remembered, WHOLE, Watched};
use crate::convert::gaussian_data;
use crate::error::Result;
use crate::geometry::Decision;
use crate::intrinsic::Intrinsic;
use crate::settings::AutomaticSettings;
use crate::shaded::{RunLight, Visibility};
use sgs_passes::pipeline::Renderer;
use sgs_passes::scene::{Gaussians, Model};
use sgs_passes::shade::lights::Axes;
use sgs_passes::splat::Channels;
use sgs_scene::Splats;

/// Numbers of lobes that are tried.
const FEWER: [u32; 5] = [1, 2, 3, 4, 6];

/// What was looked at, and what was decided by it.
struct Seen<'v> {
    step: u32,
    /// What a part must be worth, decibels.
    gain: f64,
    views: &'v [Watched],
    before: &'v [Remembered],
    photos: Vec<[f32; 3]>,
    splats: Splats,
    light: RunLight,
    all: Pictures,
    /// The error of all light together.
    with: f64,
    decisions: Vec<Decision>,
}

impl Seen<'_> {
    /// The error of pictures with this light, before what lies behind.
    fn error(&self, direct: &[[f32; 3]], ambient: &[[f32; 3]]) -> f64 {
        let of = |light: &[[f32; 3]], i: usize| light.get(i).copied().unwrap_or_default();
        error(&self.photos, |i| add(add(self.all.behind[i], of(direct, i)), of(ambient, i)))
    }

    fn decided(&mut self, what: &str, on: bool, reason: String, worth: f64) {
        let (step, what, setting) = (self.step, what.to_owned(), format!("intrinsic.automatic.{what}"));
        self.decisions.push(Decision {
            step,
            what,
            on,
            reason,
            measured: Some(worth),
            asked: Some(self.gain),
            setting,
        });
    }
}

/// What is done about it.
#[derive(Default)]
struct Changes {
    gains: Option<Vec<f32>>,
    lobes: Option<u32>,
    levels: Option<u32>,
    texels: Option<u32>,
    pace: Option<u32>,
    out: Vec<Part>,
}

impl Intrinsic {
    /// Leaves out what is worth too little by now. Where memory does not suffice for looking, everything stays.
    pub(in super::super) fn decide(&mut self, step: u32) -> Result<()> {
        // Pictures take about the room that steps do: not both at once.
        self.finish()?;
        self.execs = [None, None, None];
        let (decided, changes) = match self.worthless(step) {
            Err(e) if e.is_out_of_memory() => {
                tracing::info!("after step {step} there is no memory to see what could be left out");
                return Ok(());
            }
            other => other?,
        };
        let resized = changes.texels.is_some();
        // Looking has changed nothing. From here on an error ends the training: it would go on with half a model.
        self.change(step, changes)?;
        if let Some(a) = &mut self.automatic {
            if resized {
                // Of a cube that is no more.
                a.before.clear();
            }
            for decision in decided {
                tracing::info!("{decision}");
                a.decisions.push(decision);
            }
        }
        Ok(())
    }

    /// Finds out before the first step what looking will take, by doing so once; nothing where memory does not suffice for it.
    pub(in super::super) fn expect_to_look(&mut self) -> Result<()> {
        let Some(mut watched) = self.automatic.take() else { return Ok(()) };
        let (found, bytes) = self.device.memory_during(|| self.try_to_look(&mut watched));
        self.automatic = Some(watched);
        match found {
            Ok(()) => self.needs.look(bytes),
            Err(e) if e.is_out_of_memory() => {}
            Err(e) => return Err(e),
        }
        Ok(())
    }

    fn try_to_look(&self, watched: &mut Automatic) -> Result<()> {
        watched.own = Some(self.own(&watched.views)?);
        self.pictures(&mut self.shading(&self.splats()?, &self.light()?)?, &watched.views)?;
        Ok(())
    }

    fn worthless(&mut self, step: u32) -> Result<(Vec<Decision>, Changes)> {
        let (asked, watched) = (*self.automatic_settings(), self.automatic.take());
        let Some(mut watched) = watched else { return Ok(Default::default()) };
        let found = match watched.own {
            Some(own) => Ok(own),
            None => self.own(&watched.views),
        };
        let found = found.and_then(|own| {
            watched.own = Some(own);
            self.found(step, &asked, &mut watched, own)
        });
        self.automatic = Some(watched);
        found
    }

    /// The sum of squared errors of the pictures that the splats' own colors make: about as good as shaded ones can get.
    fn own(&self, views: &[Watched]) -> Result<f64> {
        let model = Model { sh_degree: self.splats.sh_degree() as u32, normals: false, semantics: false };
        let gaussians = Gaussians::with(&self.device, model, self.splats.len() as u32, false, false)?;
        gaussians.upload(&self.device, &gaussian_data(&self.splats, model))?;
        let mut renderer =
            Renderer::new(&self.device, self.tuning, &gaussians, self.data.largest, Channels::default())?;
        let mut sum = 0.0;
        for view in views {
            let background = self.required.geometry.background;
            let picture = renderer.render(&gaussians, &view.camera, model.sh_degree, background)?;
            for (p, photo) in &view.pixels {
                let off = |c: usize| f64::from(picture.image[3 * p + c].clamp(0.0, 1.0) - photo[c]).powi(2);
                sum += (0..3).map(off).sum::<f64>();
            }
        }
        Ok(sum)
    }

    /// What is decided, and what is to be done about it.
    fn found(
        &mut self,
        step: u32,
        a: &AutomaticSettings,
        watched: &mut Automatic,
        own: f64,
    ) -> Result<(Vec<Decision>, Changes)> {
        let Automatic { views, before, last, .. } = watched;
        // As it is written, not as it is nearest to in binary.
        let gain: f64 = a.gain.to_string().parse().unwrap_or(f64::from(a.gain));
        let photos: Vec<[f32; 3]> = views.iter().flat_map(|v| v.pixels.iter().map(|p| p.1)).collect();
        let (splats, light) = (self.splats()?, self.light()?);
        let all = self.pictures(&mut self.shading(&splats, &light)?, views)?;
        let mut seen = Seen { step, gain, views, before, photos, splats, light, all, with: 0.0, decisions: Vec::new() };
        seen.with = seen.error(&seen.all.direct, &seen.all.ambient);
        let gained = last.replace(seen.with).map(|last| loss(seen.with, last));
        let short = loss(own, seen.with);
        if short > f64::from(a.ready) {
            let (ready, setting) = (a.ready, "intrinsic.automatic.ready".to_owned());
            let reason = format!(
                "shaded pictures are {short:.1} dB short of the splats' own colors (asked: {ready}): nothing is judged yet"
            );
            let (what, asked) = ("all parts".to_owned(), Some(f64::from(ready)));
            let waits = Decision { step, what, on: true, reason, measured: Some(short), asked, setting };
            return Ok((vec![waits], Changes::default()));
        }
        tracing::info!("after step {step} shaded pictures are {short:.2} dB short of the splats' own colors");
        // Pictures that have become worse are swinging.
        let settled = gained.is_some_and(|gained| gained.abs() <= f64::from(a.settled));
        if let Some(gained) = gained.filter(|_| !settled) {
            tracing::info!(
                "they have become {gained:.2} dB better since the last look: lobes, levels and pace stay as they are"
            );
        }
        let changes = self.judged(a, &mut seen, settled)?;
        Ok((seen.decisions, changes))
    }

    /// What can go. Nothing has changed yet.
    fn judged(&self, a: &AutomaticSettings, seen: &mut Seen<'_>, settled: bool) -> Result<Changes> {
        // A network is shown views under other lights by graphs of its own, which have all parts.
        let whole = self.relit.is_none();
        let judges = |from: f64| whole && super::judges(from, seen.step, self.required.intrinsic.steps);
        let (parts, lobes) = (judges(WHOLE), judges(PARTED) && settled);
        let mut changes = Changes::default();
        if a.lights && self.has(Part::Lights) {
            let (gains, none) = self.judge_lights(seen, whole && self.has(Part::Environment))?;
            changes.gains = Some(gains);
            if none {
                changes.out.push(Part::Lights);
            }
        }
        let lit = self.has(Part::Lights) && !changes.out.contains(&Part::Lights);
        if lobes && a.lobes && lit && self.light_model.axes == Axes::Free {
            changes.lobes = self.judge_lobes(seen, changes.gains.as_deref())?;
        }
        let mut goes = |seen: &mut Seen<'_>, part: Part, worth: f64| {
            let gain = seen.gain;
            if worth <= gain {
                seen.decided(part.name(), false, format!("it is worth {worth:.3} dB (asked: {gain})"), worth);
                changes.out.push(part);
            }
            worth <= gain
        };
        let mut surrounded = self.has(Part::Environment);
        if parts && a.environment && surrounded && lit {
            let worth = loss(seen.with, seen.error(&seen.all.direct, &[]));
            surrounded = !goes(seen, Part::Environment, worth);
        }
        let mut shadows = self.has(Part::Visibility) && lit;
        if parts && a.visibility && shadows {
            let worth = self.shadowed(seen, Visibility::None)?;
            shadows = !goes(seen, Part::Visibility, worth);
        }
        if parts && settled && a.levels && shadows {
            changes.levels = self.judge_levels(seen)?;
        }
        if parts && a.texels && surrounded {
            changes.texels = self.judge_texels(seen)?;
        }
        if parts && settled && a.pace && surrounded {
            changes.pace = self.judge_pace(seen)?;
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
        match changes.pace {
            Some(every) => self.set_pace(every, step, self.moves(step)),
            None => Ok(()),
        }
    }

    /// Gains without what is worth too little, and whether nothing is left, which only may be if all may go.
    fn judge_lights(&self, seen: &mut Seen<'_>, all_may: bool) -> Result<(Vec<f32>, bool)> {
        let mut gains: Vec<f32> = seen.light.lights.iter().flat_map(|l| &l.lights).map(|l| l.gain).collect();
        // Surroundings would be filtered anew for each.
        let only = RunLight { environment: None, ..seen.light.clone() };
        let parts = self.each(&mut self.shading(&seen.splats, &only)?, seen.views, &gains)?;
        let rest: Light = seen.all.behind.iter().zip(&seen.all.ambient).map(|(b, a)| add(*b, *a)).collect();
        let on = gains.iter().filter(|g| **g != 0.0).count();
        let mut gone = needless(&seen.photos, &rest, &parts, seen.gain);
        if gone.len() == on && !all_may {
            // Something has to shine.
            gone.pop();
        }
        let none = gone.len() == on && on > 0;
        gone.iter().for_each(|(i, _)| gains[*i] = 0.0);
        let (worth, gain) = (gone.last().map_or(0.0, |g| g.1), seen.gain);
        if none {
            seen.decided("lights", false, format!("together they are worth {worth:.3} dB (asked: {gain})"), worth);
        } else if !gone.is_empty() {
            let left = on - gone.len();
            let reason = format!("{left} of {on} stay: all others together are worth {worth:.3} dB (asked: {gain})");
            seen.decided("lights", true, reason, worth);
        }
        Ok((gains, none))
    }

    /// To how few lobes those of each light can be merged.
    fn judge_lobes(&self, seen: &mut Seen<'_>, gains: Option<&[f32]>) -> Result<Option<u32>> {
        let mut only = RunLight { environment: None, ..seen.light.clone() };
        if let (Some(file), Some(gains)) = (&mut only.lights, gains) {
            file.lights.iter_mut().zip(gains).for_each(|(l, gain)| l.gain = *gain);
        }
        let off = |only: &RunLight| -> Result<f64> {
            let lit = self.pictures(&mut self.shading(&seen.splats, only)?, seen.views)?.direct;
            Ok(seen.error(&lit, &seen.all.ambient))
        };
        let (whole, lobes, gain) = (off(&only)?, self.lobes(), seen.gain);
        for few in FEWER.into_iter().filter(|few| *few < lobes) {
            let mut some = only.clone();
            if let Some(file) = &mut some.lights {
                file.lights.iter_mut().for_each(|l| *l = merged(l, few as usize));
            }
            let worth = loss(whole, off(&some)?);
            if worth <= gain {
                let reason = format!("{few} of {lobes} stay: merging the others costs {worth:.3} dB (asked: {gain})");
                seen.decided("lobes", true, reason, worth);
                return Ok(Some(few));
            }
        }
        Ok(None)
    }

    /// Without how many of its finest levels the visibility field will do.
    fn judge_levels(&self, seen: &mut Seen<'_>) -> Result<Option<u32>> {
        let (gain, light) = (seen.gain, seen.light.clone());
        let Visibility::Learned(field) = &light.visibility else { return Ok(None) };
        let levels = field.config.levels;
        let fewer = [levels / 4, levels / 2, 3 * levels / 4, levels - 1];
        for few in fewer.into_iter().filter(|n| (1..levels).contains(n)) {
            let worth = self.shadowed(seen, Visibility::Learned(Box::new(field.first_levels(few))))?;
            if worth <= gain {
                let share = 100.0 * self.reached(few)?;
                let reason = format!(
                    "{few} of {levels} stay: without the others pictures lose {worth:.3} dB (asked: {gain}); gradients have \
                     reached {share:.0} % of their entries"
                );
                seen.decided("levels", true, reason, worth);
                return Ok(Some(few));
            }
        }
        Ok(None)
    }

    /// How few texels of the surroundings will do.
    fn judge_texels(&self, seen: &mut Seen<'_>) -> Result<Option<u32>> {
        let gain = seen.gain;
        let found = self.enough_texels(gain, |few| self.surrounded(seen, few))?;
        let (Some((size, worth)), Some((e, _))) = (found, &self.environment) else { return Ok(None) };
        let reason = format!(
            "{size} along an edge instead of {} stay: pictures lose {worth:.3} dB under means of them (asked: {gain})",
            e.size()
        );
        seen.decided("texels", true, reason, worth);
        Ok(Some(size))
    }

    /// How seldom surroundings may move.
    fn judge_pace(&self, seen: &mut Seen<'_>) -> Result<Option<u32>> {
        let gain = seen.gain;
        let found = self.pace(seen.before, gain, |old| self.surrounded(seen, old))?;
        let Some((every, worth)) = found else { return Ok(None) };
        let reason =
            format!("surroundings move once in {every} steps: as old as that they cost {worth:.3} dB (asked: {gain})");
        seen.decided("pace", true, reason, worth);
        Ok(Some(every))
    }

    /// Decibels that pictures lose under other surroundings.
    fn surrounded(&self, seen: &Seen<'_>, other: &RunLight) -> Result<f64> {
        let ambient = self.pictures(&mut self.shading(&seen.splats, other)?, seen.views)?.ambient;
        Ok(loss(seen.with, seen.error(&seen.all.direct, &ambient)))
    }

    /// Decibels that pictures lose with other shadows.
    fn shadowed(&self, seen: &Seen<'_>, visibility: Visibility) -> Result<f64> {
        let light = RunLight { visibility, ..seen.light.clone() };
        let other = self.pictures(&mut self.shading(&seen.splats, &light)?, seen.views)?;
        Ok(loss(seen.with, seen.error(&other.direct, &other.ambient)))
    }

    /// The share of entries of the visibility field's levels behind the first ones that gradients have ever reached.
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
