//! What parts of the model are worth at training views, and leaving out what is worth too little.
//!
//! A part is worth the decibels that the shaded picture loses without it, everything else being as it is: an upper bound, since what stays
//! could make up for it. Materials are not judged so: pictures say little of what they are made of. Light adds up, so that lights need a picture each and no more; they are taken away from the faintest on, for as long
//! as all that are gone are worth less than asked together.

use super::lobes::merged;
use super::{Part, Watched};
use crate::convert::gaussian_data;
use crate::error::Result;
use crate::geometry::Decision;
use crate::intrinsic::Intrinsic;
use crate::shaded::{RunLight, Shading, Visibility, shaded_scene};
use rayon::prelude::*;
use sgs_passes::pipeline::Renderer;
use sgs_passes::scene::{Gaussians, Model};
use sgs_passes::shade::lights::Axes;
use sgs_passes::splat::Channels;
use sgs_scene::{Splats, linear_to_srgb, srgb_to_linear};

/// Numbers of lobes that are tried.
const FEWER: [u32; 5] = [1, 2, 3, 4, 6];

/// Linear light of the chosen pixels of all views, one behind the other.
type Light = Vec<[f32; 3]>;

/// What pictures are made of.
struct Pictures {
    /// What lies behind surfaces.
    behind: Light,
    /// Of lamps together.
    direct: Light,
    /// Of surroundings.
    ambient: Light,
}

/// The sum of squared errors of light against what photographs show.
fn error(photos: &[[f32; 3]], light: impl Fn(usize) -> [f32; 3] + Sync) -> f64 {
    let one = |(p, photo): (usize, &[f32; 3])| -> f64 {
        let light = light(p);
        (0..3).map(|c| f64::from(linear_to_srgb(light[c].clamp(0.0, 1.0)) - photo[c]).powi(2)).sum()
    };
    // Summed in the same order by any number of threads.
    let parts: Vec<f64> = photos
        .par_chunks(1024)
        .enumerate()
        .map(|(i, chunk)| chunk.iter().enumerate().map(|(k, photo)| one((1024 * i + k, photo))).sum())
        .collect();
    parts.iter().sum()
}

/// Decibels that a picture loses when its error grows.
fn loss(with: f64, without: f64) -> f64 {
    10.0 * (without.max(1e-12) / with.max(1e-12)).log10()
}

fn add(a: [f32; 3], b: [f32; 3]) -> [f32; 3] {
    [0, 1, 2].map(|c| a[c] + b[c])
}

/// Which lights can go: from the faintest on, as long as the picture loses less than asked. Returns them, each with what it is
/// worth together with those before it.
///
/// `parts`: light of each, empty where it is off; `rest`: everything else.
fn needless(photos: &[[f32; 3]], rest: &Light, parts: &[Light], gain: f64) -> Vec<(usize, f64)> {
    let energy = |part: &Light| part.iter().flatten().map(|v| f64::from(v.max(0.0))).sum::<f64>();
    let mut order: Vec<(usize, f64)> =
        parts.iter().enumerate().filter(|(_, part)| !part.is_empty()).map(|(i, part)| (i, energy(part))).collect();
    order.sort_by(|a, b| a.1.total_cmp(&b.1).then(a.0.cmp(&b.0)));
    // What is left: summed from the brightest on, so that nothing is subtracted.
    let mut left = vec![rest.clone()];
    for (i, _) in order.iter().rev() {
        let below = &left[left.len() - 1];
        left.push(below.iter().zip(&parts[*i]).map(|(a, b)| add(*a, *b)).collect());
    }
    let with = error(photos, |p| left[left.len() - 1][p]);
    let mut gone = Vec::new();
    for (k, (i, _)) in order.iter().enumerate() {
        let light = &left[order.len() - 1 - k];
        let lost = loss(with, error(photos, |p| light[p]));
        if lost > gain {
            break;
        }
        gone.push((*i, lost));
    }
    gone
}

impl Intrinsic {
    /// Leaves out what is worth too little by now. Where memory does not suffice for looking, everything stays.
    pub(in super::super) fn decide(&mut self, step: u32) -> Result<()> {
        let decided = match self.worthless(step) {
            Err(e) if e.is_out_of_memory() => {
                tracing::info!("after step {step} there is no memory to see what could be left out");
                return Ok(());
            }
            other => other?,
        };
        for decision in decided {
            tracing::info!("{decision}");
            if let Some(a) = &mut self.automatic {
                a.decisions.push(decision);
            }
        }
        Ok(())
    }

    fn worthless(&mut self, step: u32) -> Result<Vec<Decision>> {
        let (asked, watched) = (*self.automatic_settings(), self.automatic.take());
        let Some(mut watched) = watched else { return Ok(Vec::new()) };
        let found = match watched.own {
            Some(own) => Ok(own),
            None => self.own(&watched.views),
        };
        let found = found.and_then(|own| {
            watched.own = Some(own);
            self.found(step, &asked, &watched.views, own)
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

    fn found(&mut self, step: u32, a: &super::AutomaticSettings, views: &[Watched], own: f64) -> Result<Vec<Decision>> {
        // As it is written, not as it is nearest to in binary.
        let gain: f64 = a.gain.to_string().parse().unwrap_or(f64::from(a.gain));
        let photos: Vec<[f32; 3]> = views.iter().flat_map(|v| v.pixels.iter().map(|p| p.1)).collect();
        let (splats, mut light) = (self.splats()?, self.light()?);
        let all = self.pictures(&mut self.shading(&splats, &light)?, views)?;
        let sum = |p: &Pictures, ambient: bool, i: usize| {
            let light = add(p.behind[i], p.direct[i]);
            if ambient { add(light, p.ambient[i]) } else { light }
        };
        let with = error(&photos, |i| sum(&all, true, i));
        let short = loss(own, with);
        if short > f64::from(a.ready) {
            let (ready, setting) = (a.ready, "intrinsic.automatic.ready".to_owned());
            let reason = format!(
                "shaded pictures are {short:.1} dB short of the splats' own colors (asked: {ready}): nothing is judged yet"
            );
            let (what, asked) = ("all parts".to_owned(), Some(f64::from(ready)));
            return Ok(vec![Decision { step, what, on: true, reason, measured: Some(short), asked, setting }]);
        }
        tracing::info!("after step {step} shaded pictures are {short:.2} dB short of the splats' own colors");
        let mut decisions = Vec::new();
        let mut decided = |what: &str, on: bool, reason: String, worth: f64| {
            let (what, setting) = (what.to_owned(), format!("intrinsic.automatic.{what}"));
            decisions.push(Decision { step, what, on, reason, measured: Some(worth), asked: Some(gain), setting });
        };
        // A network is shown views under other lights by graphs of its own, which have all parts.
        let whole = self.relit.is_none();
        let judged = whole && super::looks_at_parts(step, self.required.intrinsic.steps);

        let mut gains: Vec<f32> = light.lights.iter().flat_map(|l| &l.lights).map(|l| l.gain).collect();
        let mut none_left = false;
        if a.lights && self.has(Part::Lights) {
            // Surroundings would be filtered anew for each.
            let environment = light.environment.take();
            let parts = self.each(&mut self.shading(&splats, &light)?, views, &gains)?;
            light.environment = environment;
            let rest: Light = all.behind.iter().zip(&all.ambient).map(|(b, a)| add(*b, *a)).collect();
            let on = gains.iter().filter(|g| **g != 0.0).count();
            let mut gone = needless(&photos, &rest, &parts, gain);
            if gone.len() == on && !(whole && self.has(Part::Environment)) {
                // Something has to shine.
                gone.pop();
            }
            none_left = gone.len() == on && on > 0;
            gone.iter().for_each(|(i, _)| gains[*i] = 0.0);
            let worth = gone.last().map_or(0.0, |g| g.1);
            if none_left {
                decided("lights", false, format!("together they are worth {worth:.3} dB (asked: {gain})"), worth);
            } else if !gone.is_empty() {
                let left = on - gone.len();
                let reason =
                    format!("{left} of {on} stay: all others together are worth {worth:.3} dB (asked: {gain})");
                decided("lights", true, reason, worth);
            }
        }
        let mut fewer = None;
        let free = self.light_model.axes == Axes::Free;
        if judged && a.lobes && free && self.has(Part::Lights) && !none_left {
            let mut only = RunLight { environment: None, ..light.clone() };
            if let Some(file) = &mut only.lights {
                file.lights.iter_mut().zip(&gains).for_each(|(l, gain)| l.gain = *gain);
            }
            let off = |only: &RunLight| -> Result<f64> {
                let lit = self.pictures(&mut self.shading(&splats, only)?, views)?.direct;
                Ok(error(&photos, |i| add(add(all.behind[i], lit[i]), all.ambient[i])))
            };
            let (whole, lobes) = (off(&only)?, self.lobes());
            for few in FEWER.into_iter().filter(|few| *few < lobes) {
                let mut some = only.clone();
                if let Some(file) = &mut some.lights {
                    file.lights.iter_mut().for_each(|l| *l = merged(l, few as usize));
                }
                let worth = loss(whole, off(&some)?);
                if worth <= gain {
                    let reason =
                        format!("{few} of {lobes} stay: merging the others costs {worth:.3} dB (asked: {gain})");
                    decided("lobes", true, reason, worth);
                    fewer = Some(few);
                    break;
                }
            }
        }
        let mut out = Vec::new();
        if judged && a.environment && self.has(Part::Environment) && self.has(Part::Lights) && !none_left {
            let worth = loss(with, error(&photos, |i| sum(&all, false, i)));
            if worth <= gain {
                decided("environment", false, format!("it is worth {worth:.3} dB (asked: {gain})"), worth);
                out.push(Part::Environment);
            }
        }
        if judged && a.visibility && self.has(Part::Visibility) && !none_left {
            let light = RunLight { visibility: Visibility::None, ..light };
            let without = self.pictures(&mut self.shading(&splats, &light)?, views)?;
            let worth = loss(with, error(&photos, |i| sum(&without, true, i)));
            if worth <= gain {
                decided("visibility", false, format!("it is worth {worth:.3} dB (asked: {gain})"), worth);
                out.push(Part::Visibility);
            }
        }
        let mut pace = None;
        if judged && a.pace && self.has(Part::Environment) && !out.contains(&Part::Environment) {
            pace = self.pace(gain, |old| {
                let ambient = self.pictures(&mut self.shading(&splats, old)?, views)?.ambient;
                Ok(loss(with, error(&photos, |i| add(sum(&all, false, i), ambient[i]))))
            })?;
        }
        if let Some((every, worth)) = pace {
            let reason = format!(
                "surroundings move once in {every} steps: as old as that they cost {worth:.3} dB (asked: {gain})"
            );
            decided("pace", true, reason, worth);
        }
        if none_left {
            out.push(Part::Lights);
        } else if self.has(Part::Lights) {
            self.device.upload(&self.gains, 0, bytemuck::cast_slice(&gains))?;
        }
        if let Some(few) = fewer {
            self.merge_lobes(few)?;
        }
        for part in out {
            self.leave_out(part)?;
        }
        if let Some((every, _)) = pace {
            self.set_pace(every, step, self.moves(step))?;
        }
        Ok(decisions)
    }

    fn shading(&self, splats: &Splats, light: &RunLight) -> Result<Shading> {
        let (lights, environment) = (light.lights.as_ref(), light.environment.as_ref());
        let scene = shaded_scene(&self.device, splats, lights, environment, &light.visibility)?;
        Shading::new(&self.device, scene)
    }

    /// Light of the chosen pixels.
    fn pictures(&self, shading: &mut Shading, views: &[Watched]) -> Result<Pictures> {
        let behind = self.required.geometry.background.map(srgb_to_linear);
        let mut all = Pictures { behind: Vec::new(), direct: Vec::new(), ambient: Vec::new() };
        for view in views {
            let shaded = shading.shade_from(&view.camera)?;
            let covered = shaded.covered();
            for (p, _) in &view.pixels {
                let c = covered[*p];
                let of = |light: &[f32]| [0, 1, 2].map(|k| c * light.get(3 * p + k).copied().unwrap_or(0.0));
                all.behind.push(behind.map(|b| (1.0 - c) * b));
                all.direct.push(of(&shaded.0.direct));
                all.ambient.push(of(&shaded.0.ambient));
            }
        }
        Ok(all)
    }

    /// The same of each light alone; nothing where it is off.
    fn each(&self, shading: &mut Shading, views: &[Watched], gains: &[f32]) -> Result<Vec<Light>> {
        let one = |i: usize| -> Result<Light> {
            if gains[i] == 0.0 {
                return Ok(Vec::new());
            }
            let alone: Vec<f32> = (0..gains.len()).map(|k| if k == i { gains[k] } else { 0.0 }).collect();
            shading.set_gains(&self.device, &alone)?;
            Ok(self.pictures(shading, views)?.direct)
        };
        (0..gains.len()).map(one).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plain(value: f32, pixels: usize) -> Light {
        vec![[value; 3]; pixels]
    }

    #[test]
    fn a_loss_is_in_decibels() {
        assert!((loss(1.0, 10.0) - 10.0).abs() < 1e-12 && loss(2.0, 2.0) == 0.0 && loss(2.0, 1.0) < 0.0);
        assert!(loss(0.0, 0.0) == 0.0 && loss(0.0, 1.0).is_finite());
        let photos = plain(0.5, 3000);
        let light = srgb_to_linear(0.75);
        let expected = 9000.0 * 0.0625;
        assert!((error(&photos, |_| [light; 3]) - expected).abs() < 1e-3 * expected);
        // What is brighter than white is white.
        assert_eq!(error(&photos, |_| [7.0; 3]), error(&photos, |_| [1.0; 3]));
    }

    #[test]
    fn the_faintest_lights_go_together_for_less_than_asked() {
        let pixels = 2000;
        let photos: Vec<[f32; 3]> =
            (0..pixels).map(|p| [linear_to_srgb(0.1 + 0.4 * (p % 7) as f32 / 7.0); 3]).collect();
        let lit = |share: f32| (0..pixels).map(|p| [share * (0.1 + 0.4 * (p % 7) as f32 / 7.0); 3]).collect::<Light>();
        // What the photographs do not have, by a hundredth: without that an error of nothing has no decibels.
        let rest = plain(0.01, pixels);
        let parts = [lit(0.5), lit(1e-4), Vec::new(), lit(0.4999), lit(2e-4), plain(0.0, pixels)];
        let of = |rest: &Light, parts: &[Light], gain: f64| -> (Vec<usize>, f64) {
            let gone = needless(&photos, rest, parts, gain);
            (gone.iter().map(|g| g.0).collect(), gone.last().map_or(0.0, |g| g.1))
        };
        let (gone, worth) = of(&rest, &parts, 0.05);
        assert_eq!(gone, [5, 1, 4]);
        // Less light is nearer to the photographs here.
        assert!(worth < 0.0, "{worth}");
        let (dark, some) = (plain(0.0, pixels), [lit(0.9), lit(0.05), lit(0.04)]);
        let (gone, worth) = of(&dark, &some, 15.0);
        assert!(gone == [2] && worth > 13.0 && worth <= 15.0, "{gone:?} {worth}");
        assert_eq!(of(&dark, &some, 0.5).0, [0; 0]);
        // Everything may go, where nothing is worth anything.
        assert_eq!(of(&lit(1.0), &[plain(0.0, pixels), plain(0.0, pixels)], 0.02).0, [0, 1]);
    }
}
