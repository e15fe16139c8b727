//! Looking at what training has come to, and leaving out what is worth too little ([`super::worth`] says how that is measured).
//!
//! Promises: everything is judged before anything changes, each part with what has been found needless before it already gone, so that
//! of two of which either would do one stays; and what stays is said with its measure, too.

use super::lobes::merged;
use super::worth::{Light, Pictures, add, error, loss, needless};
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
    /// What shines by now: what has been judged needless is out of it.
    light: RunLight,
    /// Pictures by that light.
    all: Pictures,
    /// The error of all of it together.
    with: f64,
    decisions: Vec<Decision>,
}

impl Seen<'_> {
    /// The error of pictures with this light, before what lies behind.
    fn error(&self, direct: &[[f32; 3]], ambient: &[[f32; 3]]) -> f64 {
        let of = |light: &[[f32; 3]], i: usize| light.get(i).copied().unwrap_or_default();
        error(&self.photos, |i| add(add(self.all.behind[i], of(direct, i)), of(ambient, i)))
    }

    /// Takes another light of lamps or surroundings for what there is.
    fn shine(&mut self, direct: Option<Light>, ambient: Option<Light>) {
        if let Some(direct) = direct {
            self.all.direct = direct;
        }
        if let Some(ambient) = ambient {
            self.all.ambient = ambient;
        }
        self.with = self.error(&self.all.direct, &self.all.ambient);
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

    /// Decides whether a part stays that is worth so much.
    fn keeps(&mut self, part: Part, worth: f64) -> bool {
        let gain = self.gain;
        self.decided(part.name(), worth > gain, format!("it is worth {worth:.3} dB (asked: {gain})"), worth);
        worth > gain
    }

    /// Says that all of something stay, since even the most of them that were tried instead would cost too much.
    fn stay(&mut self, what: &str, all: &str, tried: Option<(u32, f64)>) {
        if let Some((few, worth)) = tried {
            let reason = format!("{all} stay: {few} would cost {worth:.3} dB (asked: {})", self.gain);
            self.decided(what, true, reason, worth);
        }
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

/// Everything stays where memory does not suffice for looking.
fn no_room(step: u32) -> Decision {
    let reason = "there is no memory to see what could be left out".to_owned();
    Decision { on: true, ..Decision::of_memory(step, "all parts", reason) }
}

impl Intrinsic {
    /// Leaves out what is worth too little by now. Where memory does not suffice for looking, everything stays.
    pub(in super::super) fn decide(&mut self, step: u32) -> Result<()> {
        // Pictures take about the room that steps do: not both at once.
        self.finish()?;
        self.forget_steps();
        let (decided, changes) = match self.worthless(step) {
            Err(e) if e.is_out_of_memory() => (vec![no_room(step)], Changes::default()),
            other => other?,
        };
        let resized = changes.texels.is_some();
        // Looking has changed nothing. From here on an error ends the training: it would go on with half a model.
        self.change(step, changes)?;
        if let Some(a) = self.automatic.as_mut().filter(|_| resized) {
            // Of a cube that is no more.
            a.before.clear();
        }
        for decision in decided {
            tracing::info!("{decision}");
            self.decisions.push(decision);
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
            Err(e) if e.is_out_of_memory() => self.decisions.push(no_room(0)),
            Err(e) => return Err(e),
        }
        Ok(())
    }

    fn try_to_look(&self, watched: &mut Automatic) -> Result<()> {
        watched.own = Some(self.own(&watched.views)?);
        self.pictures(&mut self.shading(&self.scaled_splats()?, &self.scaled_light()?)?, &watched.views)?;
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
        let (splats, light) = (self.scaled_splats()?, self.scaled_light()?);
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
        let waits = (a.lobes || a.levels || a.pace) && self.judges(WHOLE, step);
        if let Some(gained) = gained.filter(|_| waits && !settled) {
            let (settled, setting) = (a.settled, "intrinsic.automatic.settled".to_owned());
            let reason = format!(
                "pictures have become {gained:.2} dB better since the last look (asked: {settled} either way): these stay as they are"
            );
            let (what, asked) = ("lobes, levels and pace".to_owned(), Some(f64::from(settled)));
            seen.decisions.push(Decision { step, what, on: true, reason, measured: Some(gained), asked, setting });
        }
        let changes = self.judged(a, &mut seen, settled)?;
        Ok((seen.decisions, changes))
    }

    /// Whether what is judged from a share of the steps on is judged after this one. Where a network is shown views under other lights,
    /// that is done by graphs of its own, which have all parts.
    fn judges(&self, from: f64, step: u32) -> bool {
        self.relit.is_none() && super::judges(from, step, self.required.intrinsic.steps)
    }

    /// What can go. Nothing has changed yet.
    fn judged(&self, a: &AutomaticSettings, seen: &mut Seen<'_>, settled: bool) -> Result<Changes> {
        let (parts, lobes) = (self.judges(WHOLE, seen.step), self.judges(PARTED, seen.step) && settled);
        let mut changes = Changes::default();
        if a.lights && self.has(Part::Lights) {
            let (gains, none) = self.judge_lights(seen, self.relit.is_none() && self.has(Part::Environment))?;
            changes.gains = Some(gains);
            if none {
                changes.out.push(Part::Lights);
            }
        }
        let lit = self.has(Part::Lights) && !changes.out.contains(&Part::Lights);
        if lobes && a.lobes && lit && self.light_model.axes == Axes::Free {
            changes.lobes = self.judge_lobes(seen)?;
        }
        let mut surrounded = self.has(Part::Environment);
        if parts && a.environment && surrounded && lit {
            surrounded = seen.keeps(Part::Environment, loss(seen.with, seen.error(&seen.all.direct, &[])));
            if !surrounded {
                changes.out.push(Part::Environment);
                seen.light.environment = None;
                seen.shine(None, Some(Light::new()));
            }
        }
        let mut shadows = self.has(Part::Visibility) && lit;
        if parts && a.visibility && shadows {
            let (worth, direct) = self.shadowed(seen, &Visibility::None)?;
            shadows = seen.keeps(Part::Visibility, worth);
            if !shadows {
                changes.out.push(Part::Visibility);
                seen.light.visibility = Visibility::None;
                seen.shine(Some(direct), None);
            }
        }
        if parts && settled && a.levels && shadows {
            changes.levels = self.judge_levels(seen)?;
        }
        // Before texels go: those that are remembered are as many as there are.
        if parts && settled && a.pace && surrounded {
            changes.pace = self.judge_pace(seen)?;
        }
        if parts && a.texels && surrounded {
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
        let (mut gone, next) = needless(&seen.photos, &rest, &parts, seen.gain);
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
        } else if let Some(worth) = next {
            seen.decided("lights", true, format!("the faintest of {on} is worth {worth:.3} dB (asked: {gain})"), worth);
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

    /// To how few lobes those of each light can be merged.
    fn judge_lobes(&self, seen: &mut Seen<'_>) -> Result<Option<u32>> {
        let (lobes, gain, mut least) = (self.lobes(), seen.gain, None);
        for few in FEWER.into_iter().filter(|few| *few < lobes) {
            let mut some = RunLight { environment: None, ..seen.light.clone() };
            if let Some(file) = &mut some.lights {
                file.lights.iter_mut().for_each(|l| *l = merged(l, few as usize));
            }
            let direct = self.pictures(&mut self.shading(&seen.splats, &some)?, seen.views)?.direct;
            let worth = loss(seen.with, seen.error(&direct, &seen.all.ambient));
            if worth <= gain {
                let reason = format!("{few} of {lobes} stay: merging the others costs {worth:.3} dB (asked: {gain})");
                seen.decided("lobes", true, reason, worth);
                seen.light.lights = some.lights;
                seen.shine(Some(direct), None);
                return Ok(Some(few));
            }
            least = Some((few, worth));
        }
        seen.stay("lobes", &format!("all {lobes}"), least);
        Ok(None)
    }

    /// Without how many of its finest levels the visibility field will do.
    fn judge_levels(&self, seen: &mut Seen<'_>) -> Result<Option<u32>> {
        let (gain, mut least) = (seen.gain, None);
        let Visibility::Learned(field) = seen.light.visibility.clone() else { return Ok(None) };
        let levels = field.config.levels;
        let fewer = [levels / 4, levels / 2, 3 * levels / 4, levels - 1];
        for few in fewer.into_iter().filter(|n| (1..levels).contains(n)) {
            let other = Visibility::Learned(Box::new(field.first_levels(few)));
            let (worth, direct) = self.shadowed(seen, &other)?;
            if worth <= gain {
                let share = 100.0 * self.reached(few)?;
                let reason = format!(
                    "{few} of {levels} stay: without the others pictures lose {worth:.3} dB (asked: {gain}); gradients have \
                     reached {share:.0} % of their entries"
                );
                seen.decided("levels", true, reason, worth);
                seen.light.visibility = other;
                seen.shine(Some(direct), None);
                return Ok(Some(few));
            }
            least = Some((few, worth));
        }
        seen.stay("levels", &format!("all {levels}"), least);
        Ok(None)
    }

    /// How few texels of the surroundings will do.
    fn judge_texels(&self, seen: &mut Seen<'_>) -> Result<Option<u32>> {
        let Some(size) = self.environment_size() else { return Ok(None) };
        let gain = seen.gain;
        let Some((few, worth)) = self.enough_texels(gain, |few| self.surrounded(seen, few))? else { return Ok(None) };
        if worth > gain {
            seen.stay("texels", &format!("{size} along an edge"), Some((few, worth)));
            return Ok(None);
        }
        let reason = format!(
            "{few} along an edge instead of {size} stay: pictures lose {worth:.3} dB under means of them (asked: {gain})"
        );
        seen.decided("texels", true, reason, worth);
        Ok(Some(few))
    }

    /// How seldom surroundings may move.
    fn judge_pace(&self, seen: &mut Seen<'_>) -> Result<Option<u32>> {
        let gain = seen.gain;
        let tried = self.pace(seen.before, gain, |old| self.surrounded(seen, old))?;
        let Some((every, worth)) = tried else { return Ok(None) };
        let cost = format!("{every} steps old they cost {worth:.3} dB (asked: {gain})");
        let moves =
            format!("surroundings move once in {every} steps: as old as that they cost {worth:.3} dB (asked: {gain})");
        let (reason, pace) = if worth > gain {
            (format!("surroundings move as often as they did: {cost}"), None)
        } else if !self.fits(every)? {
            (
                format!(
                    "surroundings move as often as they did: {cost}, but there is no room to keep what is filtered"
                ),
                None,
            )
        } else {
            (moves, Some(every))
        };
        seen.decided("pace", true, reason, worth);
        Ok(pace)
    }

    /// Decibels that pictures lose under other surroundings.
    fn surrounded(&self, seen: &Seen<'_>, other: &RunLight) -> Result<f64> {
        let ambient = self.pictures(&mut self.shading(&seen.splats, other)?, seen.views)?.ambient;
        Ok(loss(seen.with, seen.error(&seen.all.direct, &ambient)))
    }

    /// Decibels that pictures lose with other shadows, and what lamps come to with these.
    fn shadowed(&self, seen: &Seen<'_>, visibility: &Visibility) -> Result<(f64, Light)> {
        let lights = seen.light.lights.clone();
        let light = RunLight { lights, environment: None, visibility: visibility.clone() };
        let direct = self.pictures(&mut self.shading(&seen.splats, &light)?, seen.views)?.direct;
        Ok((loss(seen.with, seen.error(&direct, &seen.all.ambient)), direct))
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
