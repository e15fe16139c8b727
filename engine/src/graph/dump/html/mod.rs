//! HTML page of a plan: map of passes and dependencies, arena diagram, groups with barrier hazards, and buffers.
//!
//! Promises: one self-contained file, well-formed as XML and HTML. All facts are in the markup; the script only
//! highlights and filters. Names are escaped. The verifier judges correctness.

mod arena;
mod buffers;
mod groups;
mod map;

use std::fmt::{self, Write};

use super::causes::{Cause, causes};
use crate::graph::dump::PassTime;
use crate::graph::plan::Plan;
use crate::graph::resource::BufferKind;

/// Returns the plan as an HTML page.
///
/// `times`: the result of [`Executor::take_times`](crate::exec::Executor::take_times) for this plan, or empty.
pub fn html(plan: &Plan, times: &[PassTime]) -> String {
    let mut out = String::new();
    // Writing to a string cannot fail.
    let _ = write(&Page::new(plan, times), &mut out);
    out
}

/// Data of the page.
struct Page<'p> {
    plan: &'p Plan,
    dependencies: Vec<Vec<u32>>,
    /// By pass: passes that depend on it.
    dependents: Vec<Vec<u32>>,
    lifetimes: Vec<Option<(usize, usize)>>,
    /// By group, and last for the end: hazards of its barrier.
    causes: Vec<Vec<Cause>>,
    /// By pass: median nanoseconds, if measured.
    times: Vec<Option<f64>>,
    /// By buffer: first and last group that access it.
    used: Vec<Option<(usize, usize)>>,
}

impl<'p> Page<'p> {
    fn new(plan: &'p Plan, measured: &[PassTime]) -> Self {
        let dependencies = plan.dependencies();
        let mut dependents = vec![Vec::new(); plan.passes.len()];
        for (pass, before) in dependencies.iter().enumerate() {
            before.iter().for_each(|&b| dependents[b as usize].push(pass as u32));
        }
        // Times are in group order.
        let mut times = vec![None; plan.passes.len()];
        let running = plan.groups.iter().flat_map(|group| group.passes.iter().copied());
        for (pass, time) in running.zip(measured) {
            if plan.passes[pass].name == time.name {
                times[pass] = median(&time.nanoseconds);
            }
        }
        let mut used: Vec<Option<(usize, usize)>> = vec![None; plan.buffers.len()];
        for (at, group) in plan.groups.iter().enumerate() {
            for (slice, ..) in group.passes.iter().flat_map(|&pass| &plan.passes[pass].accesses) {
                let used = &mut used[slice.buffer.index()];
                *used = Some((used.map_or(at, |(first, _)| first), at));
            }
        }
        Page { plan, dependencies, dependents, lifetimes: plan.lifetimes(), causes: causes(plan), times, used }
    }

    /// Returns the summed nanoseconds of all passes; `None` if nothing was measured.
    fn total(&self) -> Option<f64> {
        self.times.iter().flatten().copied().reduce(|a, b| a + b)
    }

    /// Returns the nanoseconds of the slowest pass.
    fn longest(&self) -> f64 {
        self.times.iter().flatten().copied().fold(0.0, f64::max)
    }

    fn barriers(&self) -> usize {
        self.plan.groups.iter().filter_map(|group| group.barrier).chain(self.plan.final_barrier).count()
    }

    fn running(&self) -> usize {
        self.plan.groups.iter().map(|group| group.passes.len()).sum()
    }
}

fn write(page: &Page<'_>, out: &mut String) -> fmt::Result {
    let plan = page.plan;
    let name = Text(&plan.name);
    writeln!(out, "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\"/>")?;
    writeln!(out, "<meta name=\"viewport\" content=\"width=device-width, initial-scale=1\"/>\n<title>{name}</title>")?;
    writeln!(out, "<style>/*<![CDATA[*/\n{}/*]]>*/</style>\n</head>\n<body>", include_str!("page.css"))?;
    writeln!(out, "<header><h1>{name} <small>plan {:016x}</small></h1>", plan.key)?;
    out.push_str(
        "<div class=\"tools\"><input id=\"search\" type=\"search\" placeholder=\"find passes, kernels, buffers\" \
         aria-label=\"find\"/><output id=\"found\"></output><button id=\"theme\" type=\"button\" \
         title=\"light or dark\">◐</button></div></header>\n",
    );
    totals(page, out)?;
    out.push_str("<div class=\"columns\">\n");
    map::write(page, out)?;
    out.push_str("<main>\n");
    arena::write(page, out)?;
    groups::write(page, out)?;
    buffers::write(page, out)?;
    writeln!(out, "</main>\n</div>\n<script>//<![CDATA[\n{}//]]></script>\n</body>\n</html>", include_str!("page.js"))
}

fn totals(page: &Page<'_>, out: &mut String) -> fmt::Result {
    let plan = page.plan;
    out.push_str("<div class=\"tiles\">\n");
    let mut tile = |value: String, what: &str, note: String| {
        let note = Text(&note);
        writeln!(out, "<div class=\"tile\" title=\"{note}\"><b>{value}</b><span>{what}</span></div>")
    };
    let saved = plan.arena_unaliased_bytes.saturating_sub(plan.arena_bytes);
    let share = 100.0 * saved as f64 / plan.arena_unaliased_bytes.max(1) as f64;
    let exact = |bytes: u64| format!("{bytes} bytes");
    let edges = page.dependencies.iter().map(Vec::len).sum::<usize>();
    tile(page.running().to_string(), "passes", "passes that run".into())?;
    tile(plan.culled.len().to_string(), "dropped", "declared passes that no output needs".into())?;
    tile(plan.groups.len().to_string(), "groups", "sets of passes that may run at once".into())?;
    tile(page.barriers().to_string(), "barriers", "of a replay, the last one included".into())?;
    tile(edges.to_string(), "dependencies", "without those that others imply".into())?;
    tile(bytes(plan.arena_bytes), "arena", exact(plan.arena_bytes))?;
    tile(bytes(plan.arena_unaliased_bytes), "without sharing", exact(plan.arena_unaliased_bytes))?;
    tile(format!("{share:.0} %"), "saved", exact(saved))?;
    if !plan.image_slots.is_empty() {
        let images = plan.image_slots.iter().map(|slot| slot.bytes()).sum();
        tile(bytes(images), "image slots", exact(images))?;
    }
    let bound = plan.buffers.iter().filter(|info| info.kind == BufferKind::External).map(|info| info.bytes).sum();
    tile(bytes(bound), "bound from outside", exact(bound))?;
    if let Some(total) = page.total() {
        tile(
            duration(total),
            "of passes, measured",
            "sum of the passes' medians; with timestamps passes do not overlap".into(),
        )?;
    }
    writeln!(out, "</div>")
}

/// Text with all markup characters escaped.
struct Text<'t>(&'t str);

impl fmt::Display for Text<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for c in self.0.chars() {
            match c {
                '&' => f.write_str("&amp;")?,
                '<' => f.write_str("&lt;")?,
                '>' => f.write_str("&gt;")?,
                '"' => f.write_str("&quot;")?,
                '\'' => f.write_str("&#39;")?,
                // Invalid in XML, and not printable.
                c if c.is_control() || matches!(c, '\u{fffe}' | '\u{ffff}') => f.write_char('\u{fffd}')?,
                c => f.write_char(c)?,
            }
        }
        Ok(())
    }
}

/// Formats a number of bytes with a unit.
fn bytes(bytes: u64) -> String {
    let mut value = bytes as f64;
    for unit in ["B", "KiB", "MiB"] {
        if value < 1024.0 {
            let digits = if unit == "B" || value >= 100.0 { 0 } else { 1 };
            return format!("{value:.digits$} {unit}");
        }
        value /= 1024.0;
    }
    format!("{value:.2} GiB")
}

/// Formats a duration with a unit.
fn duration(nanoseconds: f64) -> String {
    if nanoseconds < 1e3 {
        format!("{nanoseconds:.0} ns")
    } else if nanoseconds < 1e6 {
        format!("{:.1} µs", nanoseconds / 1e3)
    } else {
        format!("{:.2} ms", nanoseconds / 1e6)
    }
}

/// Returns a buffer's hue; neighboring buffers differ strongly.
fn hue(buffer: usize) -> u64 {
    (buffer as u64 * 137_508) / 1000 % 360
}

fn median(samples: &[f64]) -> Option<f64> {
    let mut sorted = samples.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted.get(sorted.len() / 2).copied()
}

/// Joins numbers with spaces.
fn list(numbers: &[u32]) -> String {
    numbers.iter().map(u32::to_string).collect::<Vec<_>>().join(" ")
}
