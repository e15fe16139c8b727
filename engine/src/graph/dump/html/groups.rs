//! List of groups: barriers with their hazards, and passes with their accesses.

use std::fmt::{self, Write};

use super::{Page, Text, bytes, duration, hue, list};
use crate::graph::dump::causes::Cause;
use crate::graph::dump::{describe, labels, transition, verb};
use crate::graph::plan::Barrier;
use crate::graph::plan::verify::Hazard;
use crate::graph::resource::BufferState;

/// Writes all groups, the final barrier, and dropped passes.
pub(super) fn write(page: &Page<'_>, out: &mut String) -> fmt::Result {
    let plan = page.plan;
    writeln!(out, "<section id=\"groups\"><h2>groups</h2>")?;
    for (at, group) in plan.groups.iter().enumerate() {
        writeln!(out, "<section class=\"group\" id=\"g{at}\">")?;
        barrier(page, at, group.barrier, out)?;
        writeln!(out, "<h3 title=\"group {at}\">{at}</h3><div class=\"passes\">")?;
        for &index in &group.passes {
            pass(page, index, out)?;
        }
        writeln!(out, "</div></section>")?;
    }
    if plan.final_barrier.is_some() {
        writeln!(out, "<section class=\"group\" id=\"end\">")?;
        barrier(page, plan.groups.len(), plan.final_barrier, out)?;
        writeln!(out, "<h3>end: outputs may be read</h3></section>")?;
    }
    if !plan.culled.is_empty() {
        writeln!(
            out,
            "<section class=\"group\" id=\"dropped\"><h3>dropped: no output needs them</h3>\
             <div class=\"passes\">"
        )?;
        for &index in &plan.culled {
            pass(page, index, out)?;
        }
        writeln!(out, "</div></section>")?;
    }
    writeln!(out, "</section>")
}

fn barrier(page: &Page<'_>, at: usize, barrier: Option<Barrier>, out: &mut String) -> fmt::Result {
    let Some(barrier) = barrier else { return Ok(()) };
    let causes = &page.causes[at];
    let half = |stages: String, accesses: String| {
        let stages = stages.replace('|', " + ").replace("none", "–");
        let accesses = accesses.replace('|', ", ").replace('_', " ").replace("none", "order only");
        format!("<b>{stages}</b> <small>{accesses}</small>")
    };
    let from = half(barrier.src_stage.to_string(), barrier.src_access.to_string());
    let to = half(barrier.dst_stage.to_string(), barrier.dst_access.to_string());
    writeln!(out, "<details class=\"barrier\"><summary><span class=\"scope\">{from} <span>→</span> {to}</span>")?;
    // Each buffer once, in hazard order.
    let mut listed: Vec<usize> = Vec::new();
    for cause in causes {
        for buffer in [cause.first.1, cause.second.1] {
            if !listed.contains(&buffer) {
                listed.push(buffer);
            }
        }
    }
    write!(out, "<span class=\"chips\">")?;
    for &buffer in listed.iter().take(6) {
        chip(page, buffer, "", "", out)?;
    }
    if listed.len() > 6 {
        write!(out, "<small>+ {}</small>", listed.len() - 6)?;
    }
    let (count, s) = (causes.len(), if causes.len() == 1 { "" } else { "s" });
    writeln!(out, "</span><small class=\"count\">{count} hazard{s}</small></summary><ul>")?;
    for cause in causes {
        line(page, cause, out)?;
    }
    outside(page, at, out)?;
    writeln!(out, "</ul></details>")
}

/// Writes the other reasons of the first and last barrier: layout transitions, and external users between replays.
fn outside(page: &Page<'_>, at: usize, out: &mut String) -> fmt::Result {
    let plan = page.plan;
    let (first, last) = (at == 0, at == plan.groups.len());
    let changes = plan.entry.iter().filter(|_| first).chain(plan.exit.iter().filter(|_| last));
    for change in changes {
        writeln!(out, "<li>{}</li>", Text(&transition(plan, change)))?;
    }
    for (buffer, info) in plan.buffers() {
        let (word, state) = if first { ("before", info.entry) } else { ("after", info.exit) };
        if (first || last) && state != BufferState::Ready {
            let who = if state == BufferState::Host { "the host" } else { "other commands on the queue" };
            write!(out, "<li>{who} {word} the replay ")?;
            chip(page, buffer.index(), "", "", out)?;
            writeln!(out, "</li>")?;
        }
    }
    Ok(())
}

fn line(page: &Page<'_>, cause: &Cause, out: &mut String) -> fmt::Result {
    let (short, class) = match cause.hazard {
        Hazard::ReadAfterWrite => ("read after write", "raw"),
        Hazard::WriteAfterRead => ("write after read", "war"),
        Hazard::WriteAfterWrite => ("write after write", "waw"),
    };
    write!(out, "<li><span class=\"hazard {class}\">{short}</span> ")?;
    let aliased = cause.first.1 != cause.second.1;
    side(page, cause.first, aliased, out)?;
    write!(out, " → ")?;
    side(page, cause.second, true, out)?;
    if aliased {
        write!(out, " <small>aliased memory</small>")?;
    }
    if cause.across {
        write!(out, " <small>from the previous replay</small>")?;
    }
    if cause.chained {
        write!(out, " <small>together with other barriers</small>")?;
    }
    writeln!(out, "</li>")
}

/// Writes one side of a hazard, optionally with its buffer.
fn side(page: &Page<'_>, side: (Option<usize>, usize), buffer: bool, out: &mut String) -> fmt::Result {
    match side.0 {
        Some(pass) => write!(out, "<a href=\"#p{pass}\">{}</a> ", Text(&page.plan.passes[pass].name))?,
        None => write!(out, "<em>readers of the outputs</em> ")?,
    }
    if buffer { chip(page, side.1, "", "", out) } else { Ok(()) }
}

fn pass(page: &Page<'_>, index: usize, out: &mut String) -> fmt::Result {
    let plan = page.plan;
    let pass = &plan.passes[index];
    let (name, does) = (Text(&pass.name), describe(pass));
    let does = Text(&does);
    let touched = pass.accesses.iter().map(|(slice, ..)| plan.buffers[slice.buffer.index()].name.as_str());
    let find = touched.collect::<Vec<_>>().join(" ");
    let mut time = String::new();
    if let (Some(nanoseconds), Some(total)) = (page.times[index], page.total()) {
        let share = 100.0 * nanoseconds / total.max(1.0);
        let bar = 100.0 * nanoseconds / page.longest().max(1.0);
        time = format!(
            "<span class=\"time\" style=\"--time:{bar:.1}%\">{} <small>{share:.1} %</small></span>",
            duration(nanoseconds)
        );
    }
    writeln!(
        out,
        "<article class=\"pass\" id=\"p{index}\" data-pass=\"{index}\" data-in=\"{}\" data-out=\"{}\" \
         data-find=\"{name} {does} {}\"><h4>{name}</h4><p class=\"does\">{does}</p>{time}<div class=\"chips\">",
        list(&page.dependencies[index]),
        list(&page.dependents[index]),
        Text(&find),
    )?;
    for ((slice, access, used), label) in pass.accesses.iter().zip(labels(pass)) {
        let info = &plan.buffers[slice.buffer.index()];
        let verb = verb(*access, *used);
        let mut note = format!("{label}: {verb} {}", bytes(slice.bytes));
        if slice.bytes != info.bytes {
            note += &format!(", bytes {}..{} of {}", slice.offset, slice.offset + slice.bytes, info.bytes);
        }
        if pass.discards(slice) {
            note += ", discards";
        }
        chip(page, slice.buffer.index(), verb, &note, out)?;
    }
    writeln!(out, "</div></article>")
}

/// Writes a buffer's name in its color, with its access.
fn chip(page: &Page<'_>, buffer: usize, verb: &str, note: &str, out: &mut String) -> fmt::Result {
    let info = &page.plan.buffers[buffer];
    let (name, hue) = (Text(&info.name), hue(buffer));
    let note = if note.is_empty() { bytes(info.bytes) } else { note.to_owned() };
    let sign = match verb {
        "" => "",
        "read" | "uniform" | "indirect" => "→ ",
        "read+write" => "⇄ ",
        "accumulate" => "+ ",
        _ => "← ",
    };
    let class = verb.replace('+', "");
    let note = Text(&note);
    write!(
        out,
        "<a class=\"chip {class}\" href=\"#b{buffer}\" data-buffer=\"{buffer}\" style=\"--hue:{hue}\" \
         title=\"{note}\">{sign}{name}</a>"
    )
}
