//! Benchmark of `project`, `intersect` and `blend` in one view.
//!
//! Every pixel is checked against the image of the CPU reference.

use super::Context;
use super::view::{Subject, overlap};
use crate::harness::{add_passes, spans};
use crate::report::Report;
use crate::stats::Summary;
use crate::workload::{reference_camera, reference_gaussians};
use sgs_passes::cost::Counts;
use sgs_passes::reference::blend::{Blended as Truth, render};
use sgs_passes::splat::{Blended, Channels, blend};

/// Maximum difference of single and double precision where no threshold is near.
const LARGEST: f64 = 5e-3;

/// Minimum PSNR of the whole image in dB. Thresholds decided differently are rare and have small effects.
const PSNR: f64 = 55.0;

/// Returns the view in which stages are measured.
pub fn subject<'s>(c: &'s Context<'_>) -> Subject<'s> {
    let w = c.workload;
    let channels = Channels { colors: true, normals: w.model.normals, depth: w.model.normals };
    Subject { device: c.device, tuning: c.tuning, model: w.model, data: &w.start, camera: w.views[0].0, channels }
}

/// Returns the counts of the view.
pub fn counts(s: &Subject<'_>) -> anyhow::Result<Counts> {
    let o = overlap(s)?;
    Ok(Counts {
        gaussians: s.data.len() as f64,
        visible: o.visible,
        entries: o.entries,
        pixels: f64::from(s.camera.size[0]) * f64::from(s.camera.size[1]),
        pairs: o.entries * o.tried,
        width: f64::from(s.model.width()),
        ..Default::default()
    })
}

/// Measures the forward passes.
pub fn forward(c: &Context<'_>, report: &mut Report) -> anyhow::Result<()> {
    let s = subject(c);
    let counts = counts(&s)?;
    let channels = s.channels.count();
    let (mut rig, into) = s.rig(|v| {
        let pixels = v.screen.pixels();
        let into = Blended {
            image: v.graph.external("image", 4 * u64::from(channels) * pixels),
            transmittance: v.graph.external("transmittance", 4 * pixels),
        };
        blend(&mut v.graph, &c.tuning, &v.screen, &v.visible, &v.entries, &into)?;
        Ok(into)
    })?;
    let (times, _) = rig.measure(c.warmup, c.repeats)?;
    add_passes(report, rig.plan(), &times, &counts, &c.ceiling);
    let inner: Vec<_> = times.into_iter().filter(|t| !t.name.starts_with("out.")).collect();
    report.time("view, project to blend", "ms", Summary::of(&spans(&inner)).scaled(1e-6));
    report.fact("view: visible, entries", format!("{:.0}, {:.0}", counts.visible, counts.entries));
    let degree = s.model.sh_degree as usize;
    let truth = render(&reference_gaussians(s.data), &reference_camera(&s.camera), degree, s.channels.depth, [0.0; 3]);
    let image: Vec<f32> = rig.get(into.image)?;
    let transmittance: Vec<f32> = rig.get(into.transmittance)?;
    let (largest, psnr, doubtful) = difference(&image, &transmittance, &truth, channels as usize);
    anyhow::ensure!(
        largest < LARGEST && psnr > PSNR,
        "The image differs from the reference's by {largest:.2e} where it may not ({psnr:.1} dB over all)."
    );
    report.check(format!(
        "project, intersect, blend: {psnr:.1} dB from the reference's image, at most {largest:.1e} off in {:.1} % of the pixels (the rest is near a threshold)",
        100.0 * (1.0 - doubtful)
    ));
    Ok(())
}

/// Returns the largest error where nothing is doubtful, PSNR and doubtful fraction.
///
/// Doubtful pixels are near a threshold. PSNR is over all pixels. A NaN has infinite error.
fn difference(image: &[f32], transmittance: &[f32], truth: &Truth, channels: usize) -> (f64, f64, f64) {
    let apart = |found: f32, t: f64| {
        // Depth grows with the scene, so its error is relative; colors and normals are of the order of one.
        let d = (f64::from(found) - t).abs() / t.abs().max(1.0);
        if d.is_nan() { f64::INFINITY } else { d }
    };
    let (mut largest, mut square, mut doubtful) = (0.0_f64, 0.0, 0);
    for (p, &doubt) in truth.doubtful.iter().enumerate() {
        let mut worst = apart(transmittance[p], truth.transmittance[p]);
        for at in p * channels..(p + 1) * channels {
            let d = apart(image[at], truth.image[at]);
            square += if at - p * channels < 3 { d * d } else { 0.0 };
            worst = worst.max(d);
        }
        doubtful += u32::from(doubt);
        largest = if doubt { largest } else { largest.max(worst) };
    }
    let pixels = truth.doubtful.len().max(1) as f64;
    (largest, -10.0 * (square / (3.0 * pixels)).max(1e-30).log10(), f64::from(doubtful) / pixels)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn injected_errors_are_detected() {
        let truth = Truth { image: vec![0.5; 6], transmittance: vec![0.2; 2], doubtful: vec![false; 2] };
        let (image, transmittance) = (vec![0.5_f32; 6], vec![0.2_f32; 2]);
        let (largest, psnr, _) = difference(&image, &transmittance, &truth, 3);
        assert!(largest < 1e-6 && psnr > 100.0);
        for bad in [0.51, f32::NAN] {
            let mut image = image.clone();
            image[4] = bad;
            let (largest, psnr, _) = difference(&image, &transmittance, &truth, 3);
            assert!(!(largest < LARGEST && psnr > PSNR), "{largest} {psnr}");
        }
        let (largest, ..) = difference(&image, &[0.2, 0.21], &truth, 3);
        assert!(largest > LARGEST);
    }
}
