//! Benchmark of a full-screen splat among small ones: passes that walk its tiles and entries.
//!
//! The view is measured without the splat, with it, and with it processed by one lane. The splat is in front of all
//! others, so its weights are its alphas. Its gradient is checked against their sum on the host.

use super::Context;
use super::blend::subject;
use super::view::Subject;
use crate::harness::{Rig, bytes};
use crate::report::Report;
use crate::stats::median;
use anyhow::{Context as _, ensure};
use sgs_engine::graph::Buffer;
use sgs_passes::Tuning;
use sgs_passes::pipeline::Camera;
use sgs_passes::scene::{GaussianData, Group};
use sgs_passes::splat::{BackwardKernel, Blended, Gradients, blend, blend_bwd, blend_debt, project_bwd};
use sgs_shaders::structs::{Splat, Work};

/// Rounds in which the variants take turns.
const ROUNDS: u32 = 5;

/// Maximum relative error of the gradient: a sum over all pixels in single precision.
const ERROR: f64 = 1e-3;

/// First coefficient of the spherical harmonics.
const SH0: f64 = 0.282_094_791_773_878_14;

/// Outputs of a variant.
struct Outputs {
    entries: Buffer,
    count: Buffer,
    ids: Buffer,
    splats: Buffer,
    /// Gradients of the parameters.
    parameters: Buffer,
}

/// Measures the view without the splat, with it, and with it by one lane.
pub fn one(c: &Context<'_>, report: &mut Report) -> anyhow::Result<()> {
    let plain = subject(c);
    let data = with_splat(plain.data, &plain.camera);
    let serial = Tuning { large_tiles: u32::MAX, ..c.tuning };
    let variants = [(plain.data, c.tuning), (&data, c.tuning), (&data, serial)];
    let mut rigs = variants
        .iter()
        .map(|&(data, tuning)| build(&Subject { data, tuning, ..subject(c) }))
        .collect::<anyhow::Result<Vec<_>>>()?;
    let mut times = vec![Times::default(); variants.len()];
    for round in 0..ROUNDS {
        for ((rig, _), times) in rigs.iter_mut().zip(&mut times) {
            let (passes, _) = rig.measure(if round == 0 { c.warmup } else { 1 }, c.repeats.div_ceil(ROUNDS))?;
            for pass in passes.iter().filter(|p| !p.name.starts_with("out.")) {
                times.add(&pass.name, &pass.nanoseconds);
            }
        }
    }
    let ms =
        |f: &dyn Fn(&Times) -> f64| times.iter().map(|t| format!("{:.3}", f(t) / 1e6)).collect::<Vec<_>>().join(", ");
    for name in ["project", "intersect", "project_bwd"] {
        report.fact(&format!("{name}: no full-screen splat, one, one by one lane, ms"), ms(&|t| t.of(name)));
    }
    let rest = |t: &Times| t.all(|name| !name.starts_with("blend"));
    report.fact("all passes but blending: no full-screen splat, one, one by one lane, ms", ms(&rest));
    report.fact("all passes: no full-screen splat, one, one by one lane, ms", ms(&|t| t.all(|_| true)));
    report.fact("all passes but blending: one full-screen splat over none", rest(&times[1]) / rest(&times[0]));

    let tiles: u32 = [0, 1].map(|k| plain.camera.size[k].div_ceil(c.tuning.tile[k])).iter().product();
    let totals = rigs.iter().map(|(rig, o)| Ok(rig.get::<u32>(o.entries)?[0])).collect::<anyhow::Result<Vec<_>>>()?;
    let expected = [totals[0], totals[0] + tiles, totals[0] + tiles];
    ensure!(totals == expected, "The variants have {totals:?} entries in place of {expected:?}.");
    let mut errors = Vec::new();
    for (rig, outputs) in &rigs[1..] {
        let error = gradient_error(rig, outputs, plain.data.len(), &plain)?;
        ensure!(error < ERROR, "The gradient of the full-screen splat is off by {error:.1e}.");
        errors.push(format!("{error:.1e}"));
    }
    report.check(format!(
        "large_splats: one splat touches all {tiles} tiles, and its color's gradient is off by {}",
        errors.join(", ")
    ));
    Ok(())
}

/// Times of passes by name.
#[derive(Clone, Default)]
struct Times(Vec<(String, Vec<f64>)>);

impl Times {
    fn add(&mut self, name: &str, nanoseconds: &[f64]) {
        match self.0.iter_mut().find(|(n, _)| n == name) {
            Some((_, all)) => all.extend(nanoseconds),
            None => self.0.push((name.to_owned(), nanoseconds.to_vec())),
        }
    }

    /// Returns the median of one pass.
    fn of(&self, name: &str) -> f64 {
        self.all(|n| n == name)
    }

    /// Returns the sum of the medians of some passes.
    fn all(&self, selects: impl Fn(&str) -> bool) -> f64 {
        self.0.iter().filter(|(n, _)| selects(n)).map(|(_, times)| median(times)).sum()
    }
}

/// Adds a faint splat over the whole view, right in front of the camera.
fn with_splat(data: &GaussianData, camera: &Camera) -> GaussianData {
    let mut data = data.clone();
    let distance = 0.03 + camera.near;
    let forward = camera.world_to_camera[2];
    let mean = [0, 1, 2].map(|k| camera.position[k] + distance * forward[k]);
    data.groups[Group::Means as usize].extend(mean);
    // Eight times as far to the side as the view reaches in front of it.
    data.groups[Group::LogScales as usize].extend([(8.0 * distance).ln(); 3]);
    data.groups[Group::Rotations as usize].extend([1.0, 0.0, 0.0, 0.0]);
    data.groups[Group::OpacityLogits as usize].push(-3.0);
    for group in Group::ALL.into_iter().skip(Group::Sh0 as usize) {
        let values = &mut data.groups[group as usize];
        if !values.is_empty() {
            values.resize(values.len() + group.width() as usize, 0.0);
        }
    }
    data
}

fn build(s: &Subject<'_>) -> anyhow::Result<(Rig, Outputs)> {
    let channels = u64::from(s.channels.count());
    let t = s.tuning;
    s.rig(|v| {
        let pixels = v.screen.pixels();
        let into = Blended {
            image: v.graph.external("image", 4 * channels * pixels),
            transmittance: v.graph.external("transmittance", 4 * pixels),
        };
        blend(&mut v.graph, &t, &v.screen, &v.visible, &v.entries, &into)?;
        let gradient = Blended {
            image: v.graph.input("grad_image", 4 * channels * pixels),
            transmittance: v.graph.input("grad_transmittance", 4 * pixels),
        };
        v.inputs.push((gradient.image, bytes(&vec![0.5_f32; (channels * pixels) as usize])));
        let owed = blend_debt(&mut v.graph, &t, &v.screen, s.channels.count(), &into, &gradient)?;
        let which = BackwardKernel::Pixel;
        let sums = blend_bwd(&mut v.graph, &t, &v.screen, &v.visible, &v.entries, &owed, which, false)?;
        let n = s.data.len() as u64;
        let parameters = v.graph.external("grad_parameters", s.model.column_bytes(n as u32));
        let gradients = Gradients { parameters, means2d: v.graph.external("means2d", 8 * n), pose: None };
        project_bwd(&mut v.graph, &t, &v.screen, &v.handles, &v.visible, &sums, &gradients)?;
        let (entries, visible) = (v.entries, v.visible);
        Ok(Outputs {
            entries: v.keep("entries", entries.wanted, 4)?,
            count: v.keep("visible", visible.work.slice, size_of::<Work>() as u64)?,
            ids: v.keep("splat_ids", visible.ids, 4 * n)?,
            splats: v.keep("splats", visible.splats, size_of::<Splat>() as u64 * n)?,
            parameters,
        })
    })
}

/// Returns the relative error of the color gradient of the frontmost Gaussian.
fn gradient_error(rig: &Rig, outputs: &Outputs, gaussian: usize, s: &Subject<'_>) -> anyhow::Result<f64> {
    let count = rig.get::<Work>(outputs.count)?[0].count as usize;
    let ids: Vec<u32> = rig.get(outputs.ids)?;
    let at = ids[..count].iter().position(|id| *id as usize == gaussian).context("the splat is not visible")?;
    let splat = rig.get::<Splat>(outputs.splats)?[at];
    let [u11, u12, u22] = splat.factor.map(f64::from);
    let [width, height] = s.camera.size;
    let alpha = |i: u32| {
        let dx = f64::from(i % width) + 0.5 - f64::from(splat.mean[0]);
        let dy = f64::from(i / width) + 0.5 - f64::from(splat.mean[1]);
        f64::from(splat.opacity) * (-(u11 * dx + u12 * dy).powi(2) - (u22 * dy).powi(2)).exp2()
    };
    let expected = 0.5 * SH0 * (0..width * height).map(alpha).sum::<f64>();
    let columns: Vec<f32> = rig.get(outputs.parameters)?;
    let gradients = s.model.from_columns(&columns, gaussian + 1);
    let found = &gradients.group(Group::Sh0)[3 * gaussian..][..3];
    let errors = found.iter().map(|g| (f64::from(*g) / expected - 1.0).abs());
    Ok(errors.fold(0.0, |most, e| if e > most || e.is_nan() { e } else { most }))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sums_are_of_medians() {
        let mut times = Times::default();
        times.add("a", &[1.0, 5.0]);
        times.add("b", &[10.0]);
        times.add("a", &[2.0]);
        assert_eq!((times.of("a"), times.all(|_| true)), (2.0, 12.0));
    }
}
