//! Light of single emitters as colors of Gaussians.
//!
//! Viewers switch, dim and recolor lights with them.
//!
//! Shading takes blended materials, so no color of a single Gaussian is exact ([`crate::bake`]). But linear light is the sum of
//! the light of all emitters. A color per Gaussian and emitter, fitted to images of that emitter alone, therefore follows every
//! change of their colors and intensities.

mod fit;

use crate::emitting::Emitting;
use crate::error::{RelightError, Result};
use fit::{Fit, FitView};
use glam::DVec3;
use sgs_engine::Device;
use sgs_passes::Tuning;
use sgs_passes::pipeline::{FrameEmitter, Surface, SurfaceBuilder};
use sgs_passes::transport::AreaLight;
use sgs_run::{EmitterRow, Shading, camera};
use sgs_scene::{ALBEDO_RANGE, Camera, PageLight, Splats, Unit};

/// Degree of the harmonics of responses.
pub const RESPONSE_DEGREE: usize = 1;

/// Maximum number of lights. Further emitters share the last one.
const LIGHTS: usize = 16;

/// Maximum number of views of the fit.
const VIEWS: usize = 64;

/// Maximum side of an image of the fit.
const SIDE: u32 = 480;

/// Maximum number of pairs of pixel and Gaussian in all views of the fit.
const PAIRS: usize = 60_000_000;

/// Responses to all lights of a run.
#[derive(Clone, Debug, PartialEq)]
pub struct LightResponses {
    /// Lights with the responses of the Gaussians, in the order of the emitters.
    ///
    /// Responses have [`RESPONSE_DEGREE`]. Emitters that share a light have their number as name.
    pub lights: Vec<PageLight>,
    /// Number of views of the fit.
    pub views: usize,
    /// Mean PSNR of display values at these views under the lights of the run.
    pub psnr: f64,
    /// Lowest mean PSNR of display values at these views with one light of the run off; `None` if fewer than two are on.
    pub psnr_one_off: Option<f64>,
}

/// Emitters that a light consists of.
struct Members {
    name: String,
    on: bool,
    color: [f32; 3],
    /// Light of each emitter of the run while this light is on alone.
    frame: Vec<FrameEmitter>,
}

/// Fits a color per Gaussian and emitter to images of the emitters.
///
/// Calls `on_report` with the number of finished parts and of all.
///
/// # Errors
/// If there are no cameras or emitters, the Gaussians have no materials, or the device fails.
pub fn fit_responses(
    device: &Device,
    splats: &Splats,
    emitting: &Emitting,
    cameras: &[Camera],
    mut on_report: impl FnMut(usize, usize),
) -> Result<LightResponses> {
    let lights = lights_of(emitting);
    if cameras.is_empty() || lights.is_empty() {
        return Err(RelightError::Edit("Responses need cameras and emitters, but there are none.".into()));
    }
    let chosen = spread(cameras);
    let total = chosen.len() + lights.len();
    let mut shading = Shading::new(device, emitting.live(device, splats)?)?.without_visibility();
    let largest = chosen.iter().fold([1; 2], |l, c| [l[0].max(c.width), l[1].max(c.height)]);
    let tuning = Tuning::for_device(device.info());
    let mut builder = SurfaceBuilder::new(device, tuning, &shading.scene().gaussians, largest)?;
    let unit = Unit::of_length(f64::from(shading.scene().unit));
    // Light of the run.
    let shares: Vec<[f32; 3]> = lights.iter().map(|l| l.color.map(|v| if l.on { v } else { 0.0 })).collect();
    let (mut views, mut pairs) = (Vec::new(), 0);
    for (i, view) in chosen.iter().enumerate() {
        let mut targets = Vec::new();
        for light in &lights {
            shading.set_emitters(&light.frame);
            targets.push(shading.shade_again(view)?.radiance([0.0; 3]).data);
        }
        let gaussians = &shading.scene().gaussians;
        let placed = camera(&view.in_unit(unit));
        builder.measure(gaussians, &placed)?;
        let surface = Surface::new(device, builder.shape())?;
        builder.fill(gaussians, &placed, &surface)?;
        builder.finish()?;
        let [_, _, coverage] = surface.download(device)?;
        let fitted = FitView::new(&splats.means, view.position(), &surface.weights(device)?, &coverage, targets);
        pairs += fitted.pairs();
        views.push(fitted);
        on_report(i + 1, total);
        if pairs > PAIRS {
            break;
        }
    }
    let shown = chosen.len();
    let fit = Fit::new(albedo(splats)?, views, (RESPONSE_DEGREE + 1).pow(2), shares);
    let values = fit.solve(|done| on_report(shown + done, total));
    let (psnr, psnr_one_off) = (fit.psnr(&values), fit.psnr_one_off(&values));
    let light =
        |(Members { name, on, color, .. }, response): (Members, Vec<f32>)| PageLight { name, on, color, response };
    let lights = lights.into_iter().zip(values).map(light).collect();
    Ok(LightResponses { lights, views: fit.views(), psnr, psnr_one_off })
}

/// Returns the lights of the emitters.
fn lights_of(emitting: &Emitting) -> Vec<Members> {
    let rows = &emitting.file.emitters;
    let alone = if rows.len() > LIGHTS { LIGHTS - 1 } else { rows.len() };
    // An emitter is white in its response. Emitters that share a light keep their colors.
    let lit = |row: &EmitterRow, color: [f32; 3], in_place: bool| {
        let surface = if in_place { emitting.surface_of(&row.shape) } else { [0.0; 3] };
        FrameEmitter { light: AreaLight { shape: row.shape, color }, surface: [0, 1, 2].map(|c| surface[c] * color[c]) }
    };
    let frame = |color: &dyn Fn(usize) -> [f32; 3]| {
        rows.iter().enumerate().map(|(i, row)| lit(row, color(i), emitting.in_place[i])).collect::<Vec<_>>()
    };
    let mut lights = Vec::new();
    for (i, row) in rows.iter().enumerate().take(alone) {
        let most = row.color.iter().copied().fold(0.0, f32::max);
        let level = if most > 0.0 { most } else { 1.0 };
        lights.push(Members {
            name: row.name.clone(),
            on: row.on && most > 0.0,
            color: if most > 0.0 { row.color.map(|v| v / level) } else { [1.0; 3] },
            frame: frame(&|k| if k == i { [level; 3] } else { [0.0; 3] }),
        });
    }
    if alone < rows.len() {
        let frame = frame(&|k| if k >= alone && rows[k].on { rows[k].color } else { [0.0; 3] });
        let name = format!("{} others", rows.len() - alone);
        lights.push(Members { name, on: true, color: [1.0; 3], frame });
    }
    lights
}

/// Returns the cameras of the fit, evenly chosen and of limited size.
///
/// The first ones of any number are spread evenly, too, because the limit of pairs may end the list early.
fn spread(cameras: &[Camera]) -> Vec<Camera> {
    let every = cameras.len().div_ceil(VIEWS).max(1);
    let small = |c: &Camera| {
        let by = f64::from(SIDE) / f64::from(c.width.max(c.height));
        let side = |s: u32| (f64::from(s) * by).round().max(1.0) as u32;
        if by < 1.0 { c.scaled(side(c.width), side(c.height)) } else { c.clone() }
    };
    let chosen: Vec<&Camera> = cameras.iter().step_by(every).collect();
    halving(chosen.len()).map(|i| small(chosen[i])).collect()
}

/// Returns all numbers below `count`: both halves in turns, and so on within each half.
///
/// It is the order of the numbers with reversed bits.
fn halving(count: usize) -> impl Iterator<Item = usize> {
    let bits = count.next_power_of_two().trailing_zeros();
    (0..1_usize << bits)
        .map(move |i| if bits == 0 { 0 } else { i.reverse_bits() >> (usize::BITS - bits) })
        .filter(move |i| *i < count)
}

/// Returns the linear albedo of each Gaussian.
fn albedo(splats: &Splats) -> Result<Vec<[f32; 3]>> {
    let missing = || RelightError::Edit("The Gaussians have no albedo; train their materials.".into());
    let [low, span] = ALBEDO_RANGE;
    let value = |v: f32| low + span / (1.0 + (-v).exp());
    Ok(splats.albedo.as_ref().ok_or_else(missing)?.iter().map(|a| a.map(value)).collect())
}

/// Returns the direction from a camera to a Gaussian.
fn direction(mean: &[f32; 3], from: DVec3) -> DVec3 {
    (DVec3::from(mean.map(f64::from)) - from).normalize_or(DVec3::Z)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_beginning_of_the_views_is_spread_evenly() {
        assert_eq!(halving(0).collect::<Vec<_>>(), [0; 0]);
        assert_eq!(halving(1).collect::<Vec<_>>(), [0]);
        assert_eq!(halving(6).collect::<Vec<_>>(), [0, 4, 2, 1, 5, 3]);
        for count in [2, 7, 33, 64] {
            let order: Vec<usize> = halving(count).collect();
            let mut sorted = order.clone();
            sorted.sort_unstable();
            assert_eq!(sorted, (0..count).collect::<Vec<_>>());
            for taken in 2..=count {
                let mut first = order[..taken].to_vec();
                first.sort_unstable();
                first.push(count);
                let gap = first.windows(2).map(|pair| pair[1] - pair[0]).max().unwrap();
                assert!(gap <= 4 * count.div_ceil(taken), "{taken} of {count} leave {gap} views out");
            }
        }
    }
}
