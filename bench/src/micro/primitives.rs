//! Benchmark of `scan` and `radix_sort`. Every word is checked against the reference.

use super::Context;
use crate::harness::{Rig, add_passes, bytes, spans};
use crate::report::Report;
use crate::stats::Summary;
use sgs_engine::graph::Graph;
use sgs_passes::cost::Counts;
use sgs_passes::prim::{Count, exclusive_scan, radix_sort};
use sgs_passes::reference::rng::Pcg;
use sgs_passes::reference::{radix_sort as sort_reference, scan as scan_reference};

/// Measures prefix sums from one buffer to another.
pub fn scan(c: &Context<'_>, report: &mut Report) -> anyhow::Result<()> {
    let mut rng = Pcg::new(1);
    let values: Vec<u32> = (0..c.elements).map(|_| rng.next_u32() >> 20).collect();
    let mut g = Graph::new("scan");
    let words = 4 * u64::from(c.elements);
    let (source, target) = (g.input("source", words), g.external("target", words));
    let total = g.external("total", 4);
    exclusive_scan(&mut g, c.tuning, "scan", source, None, target, total, Count::Host(c.elements))?;
    let mut rig = Rig::new(c.device, g, vec![(source, bytes(&values))], true)?;
    measure(c, report, &mut rig, "scanned")?;
    let (expected, sum) = scan_reference::exclusive_scan(&values, None);
    anyhow::ensure!(rig.get::<u32>(target)? == expected && rig.get::<u32>(total)? == [sum], "The scan is wrong.");
    report.check(format!("scan: all of {} sums are those of the reference", c.elements));
    Ok(())
}

/// Measures a sort of key-value pairs by all 32 bits.
pub fn sort(c: &Context<'_>, report: &mut Report) -> anyhow::Result<()> {
    let mut rng = Pcg::new(2);
    let keys: Vec<u32> = (0..c.elements).map(|_| rng.next_u32()).collect();
    let mut g = Graph::new("radix_sort");
    let words = 4 * u64::from(c.elements);
    let source = g.input("keys", words);
    let count = Count::Host(c.elements);
    let sorted = radix_sort(&mut g, c.tuning, "radix_sort", source, None, 0..32, true, count)?;
    let (keys_out, values_out) = (g.external("keys_sorted", words), g.external("values_sorted", words));
    g.copy("out.keys", sorted.keys.unwrap_or(sorted.values), keys_out)?;
    g.copy("out.values", sorted.values, values_out)?;
    let mut rig = Rig::new(c.device, g, vec![(source, bytes(&keys))], true)?;
    measure(c, report, &mut rig, "sorted")?;
    let (expected_keys, expected_values) = sort_reference::radix_sort(&keys, None, 0..32);
    let right = rig.get::<u32>(keys_out)? == expected_keys && rig.get::<u32>(values_out)? == expected_values;
    anyhow::ensure!(right, "The sort is wrong.");
    report.check(format!("radix_sort: all of {} pairs are where the reference has them", c.elements));
    Ok(())
}

fn measure(c: &Context<'_>, report: &mut Report, rig: &mut Rig, what: &str) -> anyhow::Result<()> {
    let (times, _) = rig.measure(c.warmup, c.repeats)?;
    let counts = Counts { elements: f64::from(c.elements), ..Default::default() };
    let name = rig.plan().name.clone();
    add_passes(report, rig.plan(), &times, &counts, &c.ceiling);
    let inner: Vec<_> = times.into_iter().filter(|t| !t.name.starts_with("out.")).collect();
    let span = Summary::of(&spans(&inner));
    report.time(&format!("{name}, {} elements", c.elements), "ms", span.scaled(1e-6));
    report.fact(&format!("{what}, M elements/s"), f64::from(c.elements) / span.median.max(1.0) * 1e3);
    Ok(())
}
