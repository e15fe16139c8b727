//! `blend_bwd` by both kernels, and which of them is faster here.
//!
//! Checked twice. The picture is linear in the features, so their gradients times themselves, summed over all entries,
//! are the picture times its gradient, summed over all pixels: an identity that neither kernel's method enters. And the
//! two kernels, which share no code for it, must agree on every gradient.

use super::Context;
use super::blend::{counts, subject};
use super::view::Subject;
use crate::harness::{Rig, add_passes, bytes};
use crate::report::Report;
use crate::stats::Summary;
use sgs_engine::graph::Buffer;
use sgs_passes::reference::rng::Pcg;
use sgs_passes::splat::{BackwardKernel, Blended, blend, blend_bwd, blend_debt};
use sgs_shaders::structs::Work;

/// Relative error of the identity: sums of millions of single-precision products.
const IDENTITY: f64 = 1e-3;

/// What is read back of one kernel.
struct Outcome {
    gradients: Vec<f32>,
    time: Summary,
    identity: f64,
}

struct Kept {
    gradients: Buffer,
    owners: Buffer,
    features: Buffer,
    count: Buffer,
    image: Buffer,
}

/// Both kernels.
pub fn both(c: &Context<'_>, report: &mut Report) -> anyhow::Result<()> {
    let s = subject(c);
    let counts = counts(&s)?;
    let mut outcomes = Vec::new();
    for which in [BackwardKernel::Pixel, BackwardKernel::Splat] {
        let (mut rig, kept) = build(c, &s, which)?;
        let (times, _) = rig.measure(c.warmup, c.repeats)?;
        let times: Vec<_> = times.into_iter().filter(|t| t.name.starts_with("blend_bwd")).collect();
        add_passes(report, rig.plan(), &times, &counts, &c.ceiling);
        let time = times.first().map(|t| Summary::of(&t.nanoseconds)).unwrap_or_default();
        outcomes.push(read(&rig, &kept, s.channels.count() as usize, time)?);
    }
    let [pixel, splat] = [&outcomes[0], &outcomes[1]];
    for (name, o) in [("blend_bwd", pixel), ("blend_bwd_splat", splat)] {
        anyhow::ensure!(o.identity < IDENTITY, "{name} violates the identity of features by {:.2e}.", o.identity);
    }
    let apart = disagreement(&pixel.gradients, &splat.gradients, 6 + s.channels.count() as usize);
    anyhow::ensure!(apart < 1e-2, "The two kernels' gradients differ by {apart:.2e} of the largest.");
    report.check(format!(
        "blend_bwd: the identity of features holds to {:.1e} and {:.1e}; the kernels differ by {apart:.1e}",
        pixel.identity, splat.identity
    ));
    let (a, b) = (pixel.time.median, splat.time.median);
    let faster = if a <= b { "pixel" } else { "splat" };
    report.fact("faster backward kernel", format!("{faster} ({:.3} ms by pixel, {:.3} ms by splat)", a / 1e6, b / 1e6));
    Ok(())
}

fn build(c: &Context<'_>, s: &Subject<'_>, which: BackwardKernel) -> anyhow::Result<(Rig, Kept)> {
    let channels = u64::from(s.channels.count());
    s.rig(|v| {
        let pixels = v.screen.pixels();
        let into = Blended {
            image: v.graph.external("image", 4 * channels * pixels),
            transmittance: v.graph.external("transmittance", 4 * pixels),
        };
        blend(&mut v.graph, &c.tuning, &v.screen, &v.visible, &v.entries, &into)?;
        let gradient = Blended {
            image: v.graph.input("grad_image", 4 * channels * pixels),
            transmittance: v.graph.input("grad_transmittance", 4 * pixels),
        };
        let owed = blend_debt(&mut v.graph, &c.tuning, &v.screen, s.channels.count(), &into, &gradient)?;
        let sums = blend_bwd(&mut v.graph, &c.tuning, &v.screen, &v.visible, &v.entries, &owed, which, false)?;
        v.inputs.push((gradient.image, bytes(&image_gradient(channels * pixels))));
        let (e, n) = (u64::from(v.entries.capacity), u64::from(v.visible.capacity));
        let (entries, visible) = (v.entries, v.visible);
        Ok(Kept {
            gradients: v.keep("entry_gradients", sums.gradients, 4 * (6 + channels) * e)?,
            owners: v.keep("entry_splats", entries.splats, 4 * e)?,
            features: v.keep("features", visible.features, 4 * channels * n)?,
            count: v.keep("entry_count", entries.work.slice, size_of::<Work>() as u64)?,
            image: into.image,
        })
    })
}

/// Positive, so that sums do not cancel and their error stays relative.
fn image_gradient(count: u64) -> Vec<f32> {
    let mut rng = Pcg::new(4);
    (0..count).map(|_| rng.range(0.25, 1.0) as f32).collect()
}

fn read(rig: &Rig, kept: &Kept, channels: usize, time: Summary) -> anyhow::Result<Outcome> {
    let count = rig.get::<Work>(kept.count)?[0].count as usize;
    let mut gradients: Vec<f32> = rig.get(kept.gradients)?;
    gradients.truncate(count * (6 + channels));
    let (owners, features): (Vec<u32>, Vec<f32>) = (rig.get(kept.owners)?, rig.get(kept.features)?);
    let image: Vec<f32> = rig.get(kept.image)?;
    let picture = dot(&image, &image_gradient(image.len() as u64));
    let mut sum = 0.0;
    for (entry, values) in gradients.chunks_exact(6 + channels).enumerate() {
        let owner = owners[entry] as usize;
        sum += dot(&values[6..], &features[owner * channels..][..channels]);
    }
    anyhow::ensure!(picture > 0.0 && sum.is_finite(), "The picture is black, or gradients are not finite.");
    Ok(Outcome { gradients, time, identity: (sum / picture - 1.0).abs() })
}

fn dot(a: &[f32], b: &[f32]) -> f64 {
    a.iter().zip(b).map(|(x, y)| f64::from(*x) * f64::from(*y)).sum()
}

/// The largest difference of two sets of gradients, by column relative to its largest number.
fn disagreement(a: &[f32], b: &[f32], columns: usize) -> f64 {
    if a.len() != b.len() {
        return f64::INFINITY;
    }
    let (mut scale, mut apart) = (vec![1e-30_f32; columns], vec![0.0_f32; columns]);
    for (i, (x, y)) in a.iter().zip(b).enumerate() {
        let d = (x - y).abs();
        let k = i % columns;
        scale[k] = scale[k].max(x.abs());
        apart[k] = if d.is_nan() { f32::INFINITY } else { apart[k].max(d) };
    }
    scale.iter().zip(&apart).map(|(s, d)| f64::from(d / s)).fold(0.0, f64::max)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn planted_disagreements_are_caught() {
        let a = [1.0, 100.0, -2.0, 50.0];
        assert_eq!(disagreement(&a, &a, 2), 0.0);
        // A column of small numbers is not excused by one of large ones.
        assert!(disagreement(&a, &[1.0, 100.0, -1.9, 50.0], 2) > 0.04);
        assert_eq!(disagreement(&a, &[1.0, f32::NAN, -2.0, 50.0], 2), f64::INFINITY);
        assert_eq!(disagreement(&a, &a[..3], 2), f64::INFINITY);
    }
}
