//! Benchmark of all kernels of `blend_bwd`.
//!
//! Two checks. First, the image is linear in the features. Their gradients times themselves, summed over all entries,
//! equal the image times its gradient, summed over all pixels. Every kernel must satisfy this identity. Second, the
//! kernels share no code and must agree on every gradient. The comparison is by entry, or by splat for the kernel
//! that writes sums.

use super::Context;
use super::blend::{counts, subject};
use super::view::Subject;
use crate::harness::{Rig, add_passes, bytes};
use crate::report::Report;
use crate::stats::Summary;
use anyhow::{Context as _, ensure};
use sgs_engine::graph::Buffer;
use sgs_passes::reference::rng::Pcg;
use sgs_passes::splat::{BackwardKernel, Blended, blend_bwd, blend_debt, blend_for};
use sgs_shaders::structs::Work;

/// Maximum relative error of the identity: sums of millions of single-precision products.
const IDENTITY: f64 = 1e-3;

/// Outputs of one kernel on the host.
struct Outcome {
    which: BackwardKernel,
    /// Gradients by entry, or by splat if the kernel sums them.
    gradients: Vec<f32>,
    /// Splat of each entry.
    owners: Vec<u32>,
    time: Summary,
    identity: f64,
}

impl Outcome {
    fn name(&self) -> &'static str {
        match self.which {
            BackwardKernel::Pixel => "blend_bwd",
            BackwardKernel::Splat => "blend_bwd_splat",
            BackwardKernel::Bucket => "blend_bwd_bucket",
            BackwardKernel::Atomic => "blend_bwd_atomic",
        }
    }

    /// Returns double-precision sums by splat; `row` is the number of values per splat.
    fn by_splat(&self, splats: usize, row: usize) -> Vec<f32> {
        if self.which == BackwardKernel::Atomic {
            return self.gradients.clone();
        }
        let mut sums = vec![0.0_f64; splats * row];
        for (values, owner) in self.gradients.chunks_exact(row).zip(&self.owners) {
            let sum = &mut sums[*owner as usize * row..][..row];
            sum.iter_mut().zip(values).for_each(|(s, v)| *s += f64::from(*v));
        }
        sums.into_iter().map(|s| s as f32).collect()
    }
}

struct Outputs {
    gradients: Buffer,
    owners: Buffer,
    features: Buffer,
    count: Buffer,
    image: Buffer,
}

/// Measures all kernels that the device supports.
pub fn all(c: &Context<'_>, report: &mut Report) -> anyhow::Result<()> {
    let s = subject(c);
    let counts = counts(&s)?;
    let mut outcomes: Vec<Outcome> = Vec::new();
    use BackwardKernel::{Atomic, Bucket, Pixel, Splat};
    for which in [Pixel, Splat, Bucket, Atomic] {
        if !which.runs_on(c.device.info()) {
            continue;
        }
        let (mut rig, outputs) = build(c, &s, which)?;
        let (times, _) = rig.measure(c.warmup, c.repeats)?;
        // Checkpoints belong to the kernel that needs them.
        let times: Vec<_> = times.into_iter().filter(|t| t.name.starts_with("blend_b")).collect();
        add_passes(report, rig.plan(), &times, &counts, &c.ceiling);
        let backward = times.iter().find(|t| t.name.starts_with("blend_bwd"));
        let time = backward.map(|t| Summary::of(&t.nanoseconds)).unwrap_or_default();
        outcomes.push(read(&rig, &outputs, s.channels.count() as usize, which, time)?);
    }
    let row = 6 + s.channels.count() as usize;
    let (pixel, others) = outcomes.split_first().context("there is no kernel")?;
    let mut errors = Vec::new();
    for o in &outcomes {
        ensure!(o.identity < IDENTITY, "{} violates the identity of features by {:.2e}.", o.name(), o.identity);
        errors.push(format!("{:.1e}", o.identity));
    }
    for o in others {
        let apart = match o.which {
            BackwardKernel::Atomic => disagreement(&pixel.by_splat(o.gradients.len() / row, row), &o.gradients, row),
            _ => disagreement(&pixel.gradients, &o.gradients, row),
        };
        ensure!(apart < 1e-2, "Gradients of {} differ from those by pixels by {apart:.2e} of the largest.", o.name());
        errors.push(format!("{} differs by {apart:.1e}", o.name()));
    }
    report.check(format!("blend_bwd: the identity of features holds to {}", errors.join(", ")));
    let fastest =
        outcomes.iter().min_by(|a, b| a.time.median.total_cmp(&b.time.median)).context("there is no kernel")?;
    let times: Vec<String> = outcomes.iter().map(|o| format!("{:.3} ms {}", o.time.median / 1e6, o.name())).collect();
    report.fact("faster backward kernel", format!("{} ({})", fastest.name(), times.join(", ")));
    Ok(())
}

fn build(c: &Context<'_>, s: &Subject<'_>, which: BackwardKernel) -> anyhow::Result<(Rig, Outputs)> {
    let channels = u64::from(s.channels.count());
    s.rig(|v| {
        let pixels = v.screen.pixels();
        let into = Blended {
            image: v.graph.external("image", 4 * channels * pixels),
            transmittance: v.graph.external("transmittance", 4 * pixels),
        };
        let buckets = blend_for(&mut v.graph, &c.tuning, &v.screen, &v.visible, &v.entries, &into, which)?;
        let gradient = Blended {
            image: v.graph.input("grad_image", 4 * channels * pixels),
            transmittance: v.graph.input("grad_transmittance", 4 * pixels),
        };
        let mut owed = blend_debt(&mut v.graph, &c.tuning, &v.screen, s.channels.count(), &into, &gradient)?;
        owed.buckets = buckets;
        let sums = blend_bwd(&mut v.graph, &c.tuning, &v.screen, &v.visible, &v.entries, &owed, which, false)?;
        v.inputs.push((gradient.image, bytes(&image_gradient(channels * pixels))));
        let (e, n) = (u64::from(v.entries.capacity), u64::from(v.visible.capacity));
        let rows = if which == BackwardKernel::Atomic { n } else { e };
        let (entries, visible) = (v.entries, v.visible);
        Ok(Outputs {
            gradients: v.keep("entry_gradients", sums.gradients, 4 * (6 + channels) * rows)?,
            owners: v.keep("entry_splats", entries.splats, 4 * e)?,
            features: v.keep("features", visible.features, 4 * channels * n)?,
            count: v.keep("entry_count", entries.work.slice, size_of::<Work>() as u64)?,
            image: into.image,
        })
    })
}

/// Returns a positive image gradient, so that sums do not cancel.
///
/// Errors of the sums therefore stay relative.
fn image_gradient(count: u64) -> Vec<f32> {
    let mut rng = Pcg::new(4);
    (0..count).map(|_| rng.range(0.25, 1.0) as f32).collect()
}

fn read(
    rig: &Rig,
    outputs: &Outputs,
    channels: usize,
    which: BackwardKernel,
    time: Summary,
) -> anyhow::Result<Outcome> {
    let count = rig.get::<Work>(outputs.count)?[0].count as usize;
    let mut gradients: Vec<f32> = rig.get(outputs.gradients)?;
    let (mut owners, features): (Vec<u32>, Vec<f32>) = (rig.get(outputs.owners)?, rig.get(outputs.features)?);
    owners.truncate(count);
    if which != BackwardKernel::Atomic {
        gradients.truncate(count * (6 + channels));
    }
    let image: Vec<f32> = rig.get(outputs.image)?;
    let image_sum = dot(&image, &image_gradient(image.len() as u64));
    let mut sum = 0.0;
    for (i, values) in gradients.chunks_exact(6 + channels).enumerate() {
        let owner = if which == BackwardKernel::Atomic { i } else { owners[i] as usize };
        // Entries behind the last visible splat have no features.
        if values[6..].iter().any(|v| *v != 0.0) {
            sum += dot(&values[6..], &features[owner * channels..][..channels]);
        }
    }
    ensure!(image_sum > 0.0 && sum.is_finite(), "The image is black, or gradients are not finite.");
    Ok(Outcome { which, gradients, owners, time, identity: (sum / image_sum - 1.0).abs() })
}

fn dot(a: &[f32], b: &[f32]) -> f64 {
    a.iter().zip(b).map(|(x, y)| f64::from(*x) * f64::from(*y)).sum()
}

/// Returns the largest difference of two gradient sets.
///
/// Each column is relative to its largest absolute value.
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
    fn entry_gradients_are_summed_by_splat() {
        let one = |which, gradients: &[f32]| Outcome {
            which,
            gradients: gradients.to_vec(),
            owners: vec![1, 0, 1],
            time: Summary::default(),
            identity: 0.0,
        };
        let entries = one(BackwardKernel::Pixel, &[1.0, 2.0, 3.0, 4.0, 5.0, 6.0]);
        assert_eq!(entries.by_splat(3, 2), [3.0, 4.0, 6.0, 8.0, 0.0, 0.0]);
        let sums = [3.0, 4.0, 6.0, 8.0, 0.0, 0.0];
        assert_eq!(one(BackwardKernel::Atomic, &sums).by_splat(3, 2), sums);
    }

    #[test]
    fn injected_disagreements_are_detected() {
        let a = [1.0, 100.0, -2.0, 50.0];
        assert_eq!(disagreement(&a, &a, 2), 0.0);
        // A column of small values is not compared at the scale of a column of large ones.
        assert!(disagreement(&a, &[1.0, 100.0, -1.9, 50.0], 2) > 0.04);
        assert_eq!(disagreement(&a, &[1.0, f32::NAN, -2.0, 50.0], 2), f64::INFINITY);
        assert_eq!(disagreement(&a, &a[..3], 2), f64::INFINITY);
    }
}
