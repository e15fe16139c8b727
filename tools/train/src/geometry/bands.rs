//! Automatic number of spherical-harmonics bands. Used with `geometry.sh_degree = "auto"`.
//!
//! Training starts with band 0. After a twentieth of the steps all bands are added, for a trial of a tenth of the
//! steps. A few training views are held out during the trial. At its end they are rendered with no band, with one, and
//! so on. A band stays if the band and those above it raise the PSNR of these views by `sh_gain`. The other
//! bands are removed with their moments. Views that are trained on would not do, because a band improves every
//! photograph that it is fitted to.
//!
//! Guarantees: the seed and the step determine which views are held out, and when. A band that does not fit into memory
//! is left out.

use super::{Decision, Geometry, Progress};
use crate::error::Result;
use crate::error::error;
use crate::schedule::hash;
use serde::{Deserialize, Serialize};
use sgs_config::MOST_BANDS;
use sgs_passes::pipeline::{RenderedImage, Renderer};
use sgs_passes::scene::{Layout, Model};
use sgs_passes::splat::Channels;
use std::path::Path;

/// Least number of views at which some are held out. With fewer, the views that are trained on are measured.
const FEW: usize = 4;

/// One of this many views is held out.
const SHARE: usize = 4;

/// Number of views that are measured, at most.
const MOST: usize = 16;

/// State of the search for the number of bands.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct Bands {
    /// Highest band of the trial, while the trial lasts.
    tried: Option<u32>,
    /// Training views that are held out during the trial.
    held: Vec<usize>,
    /// Whether the search is finished.
    settled: bool,
}

impl Bands {
    /// Returns whether bands may still be added.
    pub fn is_open(&self) -> bool {
        !self.settled && self.tried.is_none()
    }

    /// Returns the state if it fits the model and the number of views. `path`: file that the state was read from.
    pub fn checked(self, path: &Path, model: Model, views: usize) -> Result<Bands> {
        let possible = self.tried.is_none_or(|band| band > 0 && band == model.sh_degree);
        if !possible || self.held.iter().any(|v| *v >= views) || self.held.len() * 2 > views {
            return Err(error(path, "damaged: \"bands\" does not fit what it holds".into()));
        }
        Ok(self)
    }
}

/// Measured contribution of bands.
struct Contribution {
    /// Mean PSNR over the views in dB, by number of bands.
    psnr: Vec<f64>,
    views: usize,
    /// Whether the views were held out.
    held: bool,
}

impl Contribution {
    /// Returns the PSNR gain in dB of a band together with those above it.
    fn of(&self, band: u32) -> f64 {
        let (below, from) = self.psnr.split_at(band as usize);
        from.iter().copied().fold(f64::NEG_INFINITY, f64::max) - below[band as usize - 1]
    }
}

/// Returns the steps after which the trial of all bands begins and ends.
fn trial(steps: u32) -> [u32; 2] {
    let begin = (steps / 20).max(1);
    [begin, begin + (steps / 10).max(1)]
}

impl Geometry {
    /// Returns whether the trial begins or ends after a step.
    pub(super) fn bands_due(&self, step: u32) -> bool {
        let open = self.bands.as_ref().is_some_and(|b| !b.settled);
        open && trial(self.settings.geometry.steps).contains(&step)
    }

    /// Returns whether views were held out in recent steps. These are the last `steps` steps up to `step`.
    pub(super) fn was_held_back(&self, step: u32, steps: u32) -> bool {
        let [begin, end] = trial(self.settings.geometry.steps);
        self.bands.is_some() && step > begin && step < end.saturating_add(steps)
    }

    /// Returns the training view of a step. A view that is held out is replaced by one that is not.
    pub(super) fn view(&self, step: u32) -> usize {
        let view = self.schedule.view(step);
        let Some(bands) = self.bands.as_ref().filter(|b| b.held.contains(&view)) else { return view };
        let others: Vec<usize> = (0..self.data.views.len()).filter(|v| !bands.held.contains(v)).collect();
        others[(hash(self.settings.seed ^ 0xba2d, u64::from(step)) % others.len() as u64) as usize]
    }

    /// Begins the trial of all bands, or ends it. The end removes the bands whose gain is too small.
    pub(super) fn turn_bands(&mut self, step: u32, on_report: &mut impl FnMut(&Progress)) -> Result<()> {
        let Some(mut bands) = self.bands.take() else { return Ok(()) };
        match bands.tried.take() {
            None => {
                let from = self.gaussians.model.sh_degree;
                let tried = self.add_bands()?;
                for band in tried + 1..=MOST_BANDS {
                    self.decide_band(step, band, None, false, on_report);
                }
                if tried > from {
                    bands.tried = Some(tried);
                    bands.held = held_back(self.settings.seed, self.data.views.len());
                }
            }
            Some(tried) => {
                let held = std::mem::take(&mut bands.held);
                let contribution = match self.contribution(tried, held) {
                    Ok(contribution) => Some(contribution),
                    Err(error) if error.is_out_of_memory() => None,
                    Err(error) => return Err(error),
                };
                let requested = self.settings.geometry.sh_gain;
                let pays = |band: &u32| contribution.as_ref().is_some_and(|w| w.of(*band) >= requested);
                let chosen = (1..=tried).take_while(pays).count() as u32;
                for band in 1..=tried {
                    self.decide_band(step, band, contribution.as_ref(), band <= chosen, on_report);
                }
                if chosen < tried {
                    self.forget_steps();
                    self.gaussians.set_degree(&self.device, chosen)?;
                }
            }
        }
        bands.settled = bands.tried.is_none();
        self.bands = Some(bands);
        self.rebuild()
    }

    /// Adds all bands, or as many as memory suffices for. Returns the highest.
    fn add_bands(&mut self) -> Result<u32> {
        self.forget_steps();
        let from = self.gaussians.model.sh_degree;
        for degree in (from + 1..=MOST_BANDS).rev() {
            let layout = self.gaussians.layout();
            let model = Model { sh_degree: degree, ..layout.model };
            if !self.fits(&Layout { model, ..layout }, self.options.entry_capacity)? {
                continue;
            }
            match self.gaussians.set_degree(&self.device, degree) {
                Ok(()) => return Ok(degree),
                Err(error) if error.is_out_of_memory() => {}
                Err(error) => return Err(error.into()),
            }
        }
        Ok(from)
    }

    /// Records the decision about a band.
    fn decide_band(
        &mut self,
        step: u32,
        band: u32,
        contribution: Option<&Contribution>,
        on: bool,
        on_report: &mut impl FnMut(&Progress),
    ) {
        let requested = self.settings.geometry.sh_gain;
        let reason = match contribution {
            Some(w) => {
                let above = if (band as usize) + 1 < w.psnr.len() { " with those above it" } else { "" };
                let which = match (w.held, w.views) {
                    (true, 1) => "view that was held back",
                    (true, _) => "views that were held back",
                    (false, 1) => "view that is trained on",
                    (false, _) => "views that are trained on",
                };
                format!("gains {:.3} dB{above} at {} {which}, limit {requested:.3}", w.of(band), w.views)
            }
            None => "there is no memory for it".to_owned(),
        };
        let decision = Decision {
            step,
            what: format!("band {band}"),
            on,
            reason,
            measured: contribution.map(|w| w.of(band)),
            requested: Some(requested),
            setting: "geometry.sh_degree".to_owned(),
        };
        self.decide(decision, on_report);
    }

    /// Measures the PSNR of views with no band, with one, and so on up to the highest. Frees the memory of the step
    /// before it renders.
    fn contribution(&mut self, highest: u32, held: Vec<usize>) -> Result<Contribution> {
        self.forget_steps();
        let held_back = !held.is_empty();
        let all = self.data.views.len();
        let views = if held_back { held } else { spread(0, all, all.min(MOST)) };
        let channels = Channels { colors: true, normals: false, depth: false };
        let (device, entries) = (self.device.clone(), self.options.entry_capacity);
        let largest = self.options.largest;
        let mut renderer = Renderer::with_entries(&device, self.tuning, &self.gaussians, largest, channels, entries)?;
        let mut psnr = vec![0.0; highest as usize + 1];
        for &view in &views {
            let (camera, first) = self.data.views[view];
            let bytes = 4 * u64::from(camera.size[0]) * u64::from(camera.size[1]);
            let photo = device.download(&self.data.part(view).targets, 4 * u64::from(first), bytes)?;
            for (degree, psnr) in (0..).zip(&mut psnr) {
                let background = self.settings.geometry.background;
                let rendered = renderer.render(&self.gaussians, &camera, degree, background)?;
                *psnr += decibels(&rendered, &photo) / views.len() as f64;
            }
        }
        tracing::info!(?psnr, ?views, "bands");
        Ok(Contribution { psnr, views: views.len(), held: held_back })
    }
}

/// Returns the training views that are held out during the trial, evenly spread.
fn held_back(seed: u64, views: usize) -> Vec<usize> {
    if views < FEW {
        return Vec::new();
    }
    let first = hash(seed, 0xba2d5) % views as u64;
    spread(first as usize, views, (views / SHARE).clamp(1, MOST))
}

/// Returns `count` of `all` indices, evenly spread from `first` on.
fn spread(first: usize, all: usize, count: usize) -> Vec<usize> {
    (0..count).map(|i| (first + i * all / count) % all).collect()
}

/// Returns the PSNR in dB of an image against a packed photograph. Ignores masked pixels. Returns 100 for equal images.
fn decibels(rendered: &RenderedImage, photo: &[u8]) -> f64 {
    let (mut sum, mut count) = (0.0, 0_u64);
    for (pixel, [r, g, b, counts]) in rendered.image.chunks_exact(rendered.channels as usize).zip(photo.as_chunks().0) {
        if *counts > 0 {
            let off = |v: f32, t: u8| (f64::from(v.clamp(0.0, 1.0)) - f64::from(t) / 255.0).powi(2);
            sum += off(pixel[0], *r) + off(pixel[1], *g) + off(pixel[2], *b);
            count += 3;
        }
    }
    let mean: f64 = sum / count.max(1) as f64;
    -10.0 * mean.max(1e-10).log10()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn held_out_views_are_evenly_spread() {
        assert_eq!(held_back(0, 3), [0; 0]);
        for (views, count) in [(4, 1), (7, 1), (12, 3), (24, 6), (500, 16)] {
            let mut held = held_back(7, views);
            held.sort_unstable();
            held.dedup();
            assert!(held.len() == count && held.iter().all(|v| *v < views), "{held:?}");
        }
        assert_ne!(held_back(7, 100), held_back(8, 100));
        assert_eq!(spread(0, 5, 5), [0, 1, 2, 3, 4]);
        assert_eq!(spread(10, 12, 3), [10, 2, 6]);
    }

    #[test]
    fn band_contribution_includes_bands_above() {
        let contribution = Contribution { psnr: vec![20.0, 19.5, 21.0, 20.9], views: 1, held: true };
        let of = |band| (contribution.of(band) * 1e6).round() / 1e6;
        assert_eq!([of(1), of(2), of(3)], [1.0, 1.5, -0.1]);
        assert_eq!((trial(1000), trial(40), trial(5)), ([50, 150], [2, 6], [1, 2]));
    }

    #[test]
    fn psnr_ignores_masked_pixels() {
        let image = vec![0.0, 0.5, 2.0, 1.0, 1.0, 1.0];
        let rendered = RenderedImage { size: [2, 1], channels: 3, image, transmittance: vec![0.0; 2] };
        assert!((decibels(&rendered, &[0, 128, 255, 255, 0, 0, 0, 0]) - 58.9).abs() < 0.1);
        assert!((decibels(&rendered, &[0, 128, 255, 255, 255, 255, 0, 255]) - 7.78).abs() < 0.01);
        assert_eq!(decibels(&rendered, &[9, 9, 9, 0, 9, 9, 9, 0]), 100.0);
    }
}
