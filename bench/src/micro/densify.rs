//! Benchmark of `densify`, restored to the same start before each replay.
//!
//! Counts of pruned, cloned and split Gaussians must match the reference.

use super::Context;
use super::view::work_of;
use crate::harness::{Rig, add_passes, bytes, spans};
use crate::report::Report;
use crate::stats::Summary;
use sgs_engine::graph::{Buffer, Graph};
use sgs_passes::cost::Counts;
use sgs_passes::optim::{Densify, densify};
use sgs_passes::reference::densify::{Candidate, Settings, Verdict, verdict};
use sgs_passes::reference::rng::Pcg;
use sgs_passes::scene::{GaussianData, Gaussians, Group};
use sgs_shaders::structs::{Densify as Values, DensifyStats, Work};

/// Returns statistics that refine a tenth and prune a tenth of the Gaussians.
///
/// These fractions are typical of the first thousands of steps.
fn statistics(count: usize) -> Vec<f32> {
    let mut rng = Pcg::new(6);
    let mut all = Vec::with_capacity(4 * count);
    for _ in 0..count {
        let kind = rng.uniform();
        let gradient = if kind < 0.1 { rng.range(3e-4, 1e-2) } else { rng.range(0.0, 1e-4) };
        let weight = if kind > 0.9 { 0.0 } else { rng.range(0.1, 5.0) };
        all.extend([gradient as f32, 1.0, weight as f32, 0.0]);
    }
    all
}

/// Measures one densification.
pub fn one(c: &Context<'_>, report: &mut Report) -> anyhow::Result<()> {
    let w = c.workload;
    let count = w.start.len();
    let capacity = (count + count / 2) as u32;
    let settings = Settings {
        grad_threshold: 2e-4,
        normal_threshold: 0.0,
        split_size: 0.01 * w.extent,
        prune_opacity: 0.005,
        prune_weight: 1e-4,
        prune_size: 1e6,
        cap: capacity as usize,
        seed: 5,
    };
    // Used for the declaration only: the rig allocates its own memory.
    let gaussians = Gaussians::new(c.device, w.model, capacity, true)?;
    let mut g = Graph::new("densify");
    let uniform = g.uniform("settings", size_of::<Values>() as u64);
    let handles = gaussians.declare(&mut g, true);
    let stats_buffer = g.external("stats", size_of::<DensifyStats>() as u64);
    let what = Densify::of(&handles, uniform, stats_buffer);
    let what = what.ok_or_else(|| anyhow::anyhow!("Gaussians in training have moments."))?;
    let statistics = statistics(count);
    let mut inputs = vec![(uniform, bytes(&[values(&settings)]))];
    // Copies back everything that a replay changes.
    let mut restore = |name: &str, target: Buffer, content: Vec<u8>| -> anyhow::Result<()> {
        let from = g.input(format!("{name} as they were"), content.len() as u64);
        g.copy(format!("out.restore {name}"), from, target.slice(0, content.len() as u64))?;
        inputs.push((from, content));
        Ok(())
    };
    restore("parameters", handles.parameters, bytes(&w.model.to_columns(&w.start)))?;
    restore("statistics", what.statistics, bytes(&statistics))?;
    restore("count", handles.work, bytes(&[work_of(count as u32)]))?;
    densify(&mut g, c.tuning, &what)?;
    let mut rig = Rig::new(c.device, g, inputs, true)?;
    let (times, _) = rig.measure(c.warmup, c.repeats)?;
    let stats: DensifyStats = rig.get(stats_buffer)?[0];
    let live: Work = rig.get(handles.work)?[0];
    check(&stats, &live, &w.start, &statistics, &settings)?;
    let moved = f64::from(stats.cloned + 2 * stats.split) + f64::from(stats.pruned);
    let counts = Counts { gaussians: count as f64, moved, ..Default::default() };
    add_passes(report, rig.plan(), &times, &counts, &c.ceiling);
    let inner: Vec<_> = times.into_iter().filter(|t| !t.name.starts_with("out.")).collect();
    report.time("densify", "ms", Summary::of(&inside(&inner)).scaled(1e-6));
    report.check(format!(
        "densify: {} pruned, {} cloned, {} split of {count}, as the reference decides",
        stats.pruned, stats.cloned, stats.split
    ));
    Ok(())
}

/// Returns the durations of the passes themselves; the restoring copies run before them.
fn inside(times: &[sgs_engine::exec::PassTime]) -> Vec<f64> {
    let first = |r: usize| times.iter().map(|t| t.start[r]).fold(f64::INFINITY, f64::min);
    spans(times).iter().enumerate().map(|(r, end)| end - first(r)).collect()
}

fn values(s: &Settings) -> Values {
    Values {
        grad_threshold: s.grad_threshold as f32,
        normal_threshold: s.normal_threshold as f32,
        split_size: s.split_size as f32,
        prune_opacity: s.prune_opacity as f32,
        prune_weight: s.prune_weight as f32,
        prune_size: s.prune_size as f32,
        cap: s.cap as u32,
        seed: s.seed,
    }
}

fn check(
    stats: &DensifyStats,
    live: &Work,
    data: &GaussianData,
    statistics: &[f32],
    settings: &Settings,
) -> anyhow::Result<()> {
    let of = |g: Group, i: usize| f64::from(data.group(g)[i]);
    let (mut pruned, mut cloned, mut split) = (0, 0, 0);
    for i in 0..data.len() {
        let candidate = Candidate {
            mean: [0, 1, 2].map(|k| of(Group::Means, 3 * i + k)),
            log_scale: [0, 1, 2].map(|k| of(Group::LogScales, 3 * i + k)),
            rotation: [0, 1, 2, 3].map(|k| of(Group::Rotations, 4 * i + k)),
            opacity_logit: of(Group::OpacityLogits, i),
            sh0: [0, 1, 2].map(|k| of(Group::Sh0, 3 * i + k)),
            statistics: [0, 1, 2, 3].map(|k| f64::from(statistics[4 * i + k])),
        };
        match verdict(&candidate, settings) {
            Verdict::Prune { .. } => pruned += 1,
            Verdict::Clone { .. } => cloned += 1,
            Verdict::Split { .. } => split += 1,
            Verdict::Keep => {}
        }
    }
    // Scales at the threshold between cloning and splitting may round to either side.
    let refined = stats.cloned + stats.split;
    let near = u32::abs_diff(stats.cloned, cloned) <= 1 + refined / 1000;
    let right = stats.pruned == pruned && refined == cloned + split && near;
    let whole = stats.before as usize == data.len()
        && stats.after == stats.before - stats.pruned + refined
        && live.count == stats.after
        && stats.refused == 0;
    anyhow::ensure!(
        right && whole,
        "Densification gave {stats:?} with {} alive, but the reference prunes {pruned}, clones {cloned} and splits {split}.",
        live.count
    );
    Ok(())
}
