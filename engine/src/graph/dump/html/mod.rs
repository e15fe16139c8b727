//! A plan as one page that can be looked at: a map of the passes with their dependencies, the arena as a picture,
//! groups with what their barriers are for, and every buffer with its lifetime.
//!
//! Promises: one file that loads nothing, well-formed as XML and as HTML, all facts in the markup itself (the script
//! only highlights and filters), names escaped. Leaves judgment of the plan to the verifier.

mod arena;
mod buffers;
mod groups;
mod map;

use std::fmt::{self, Write};

use super::causes::{Cause, causes};
use crate::graph::exec::PassTime;
use crate::graph::plan::Plan;
use crate::graph::resource::BufferKind;

/// The plan as an HTML page. `times`: what [`Executor::take_times`](crate::graph::exec::Executor::take_times) returned
/// for this plan, or nothing.
pub fn html(plan: &Plan, times: &[PassTime]) -> String {
    let mut out = String::new();
    // Writing to a string cannot fail.
    let _ = write(&Page::new(plan, times), &mut out);
    out
}

/// What the parts of the page draw from.
struct Page<'p> {
    plan: &'p Plan,
    follows: Vec<Vec<u32>>,
    /// By pass: who follows it.
    followed: Vec<Vec<u32>>,
    lifetimes: Vec<Option<(usize, usize)>>,
    /// By group, and last for the end: what the barrier before it is for.
    causes: Vec<Vec<Cause>>,
    /// By pass: median nanoseconds, where measured.
    times: Vec<Option<f64>>,
    /// By buffer: first and last group that touch it.
    used: Vec<Option<(usize, usize)>>,
}

impl<'p> Page<'p> {
    fn new(plan: &'p Plan, measured: &[PassTime]) -> Self {
        let follows = plan.dependencies();
        let mut followed = vec![Vec::new(); plan.passes.len()];
        for (pass, before) in follows.iter().enumerate() {
            before.iter().for_each(|&b| followed[b as usize].push(pass as u32));
        }
        // Times come in the order of the groups.
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
        Page { plan, follows, followed, lifetimes: plan.lifetimes(), causes: causes(plan), times, used }
    }

    /// Nanoseconds of all passes together; none if nothing was measured.
    fn total(&self) -> Option<f64> {
        self.times.iter().flatten().copied().reduce(|a, b| a + b)
    }

    /// Nanoseconds of the slowest pass.
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
    let edges = page.follows.iter().map(Vec::len).sum::<usize>();
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

/// Text with everything escaped that means something in markup.
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
                // Neither XML nor a reader can do anything with these.
                c if c.is_control() || matches!(c, '\u{fffe}' | '\u{ffff}') => f.write_char('\u{fffd}')?,
                c => f.write_char(c)?,
            }
        }
        Ok(())
    }
}

/// A number of bytes for people.
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

/// A time for people.
fn duration(nanoseconds: f64) -> String {
    if nanoseconds < 1e3 {
        format!("{nanoseconds:.0} ns")
    } else if nanoseconds < 1e6 {
        format!("{:.1} µs", nanoseconds / 1e3)
    } else {
        format!("{:.2} ms", nanoseconds / 1e6)
    }
}

/// A buffer's color, as far apart as possible from its neighbors'.
fn hue(buffer: usize) -> u64 {
    (buffer as u64 * 137_508) / 1000 % 360
}

fn median(samples: &[f64]) -> Option<f64> {
    let mut sorted = samples.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted.get(sorted.len() / 2).copied()
}

/// Numbers with spaces between them.
fn list(numbers: &[u32]) -> String {
    numbers.iter().map(u32::to_string).collect::<Vec<_>>().join(" ")
}
