//! Diagram of the arena: offsets downward, groups to the right, one rectangle per transient.

use std::fmt::{self, Write};

use super::{Page, Text, bytes, hue};

/// Size of the diagram and of its margins in pixels.
const WIDTH: f64 = 1100.0;
const HEIGHT: f64 = 420.0;
const LEFT: f64 = 74.0;
const TOP: f64 = 78.0;
const BOTTOM: f64 = 24.0;
/// Height of the live-bytes curve above the diagram.
const LIVE: f64 = 56.0;

/// Writes the diagram and its explanation.
pub(super) fn write(page: &Page<'_>, out: &mut String) -> fmt::Result {
    let plan = page.plan;
    if plan.arena_bytes == 0 {
        return Ok(());
    }
    let groups = plan.groups.len();
    // A kept transient lives past the last group, which takes one more column.
    let columns = groups + usize::from(page.lifetimes.iter().flatten().any(|&(_, last)| last == groups));
    let arena = plan.arena_bytes as f64;
    let x = |group: usize| LEFT + (WIDTH - LEFT) * group as f64 / columns.max(1) as f64;
    let y = |offset: u64| TOP + (HEIGHT - TOP - BOTTOM) * offset as f64 / arena;
    let mut live = vec![0u64; columns];
    for (index, life) in page.lifetimes.iter().enumerate() {
        let Some((first, last)) = *life else { continue };
        if plan.buffers[index].image.is_some() {
            continue;
        }
        live[first..=last.min(columns - 1)].iter_mut().for_each(|sum| *sum += plan.buffers[index].bytes);
    }
    let most = live.iter().copied().max().unwrap_or(0);
    writeln!(
        out,
        "<section id=\"arena\"><h2>arena</h2><p>{} for transients of {} together; at most {} of them are alive at \
         once. Above: bytes alive by group, against the arena's size. Below: where each lives, and when.</p>",
        bytes(plan.arena_bytes),
        bytes(plan.arena_unaliased_bytes),
        bytes(most),
    )?;
    writeln!(
        out,
        "<svg viewBox=\"0 0 {WIDTH} {HEIGHT}\" role=\"img\" aria-label=\"the arena, offset by group\">\
         <rect class=\"ground\" x=\"{LEFT}\" y=\"{TOP}\" width=\"{}\" height=\"{}\"/>\
         <line class=\"full\" x1=\"{LEFT}\" x2=\"{WIDTH}\" y1=\"8\" y2=\"8\"/>",
        WIDTH - LEFT,
        HEIGHT - TOP - BOTTOM
    )?;
    for (at, &sum) in live.iter().enumerate() {
        let height = LIVE * sum as f64 / arena.max(most as f64);
        writeln!(
            out,
            "<rect class=\"live\" x=\"{:.1}\" y=\"{:.1}\" width=\"{:.1}\" height=\"{height:.1}\"><title>group {at}: {} \
             alive</title></rect>",
            x(at),
            8.0 + LIVE - height,
            (x(at + 1) - x(at) - 1.0).max(0.5),
            bytes(sum)
        )?;
    }
    axes(out, columns, plan.arena_bytes, x, y)?;
    for (index, info) in plan.buffers.iter().enumerate() {
        let (Some(offset), Some((first, last))) = (plan.placements[index], page.lifetimes[index]) else { continue };
        // Images have their own slots.
        if info.image.is_some() {
            continue;
        }
        let name = Text(&info.name);
        let (left, right) = (x(first), x((last + 1).min(columns)));
        let (top, bottom) = (y(offset), y(offset + info.bytes));
        let height = (bottom - top).max(1.0);
        writeln!(
            out,
            "<g class=\"box\" data-buffer=\"{index}\" style=\"--hue:{}\"><title>{name}\n{} ({} bytes) at {offset}\n\
             groups {first} to {last}{}</title><rect x=\"{left:.1}\" y=\"{top:.1}\" width=\"{:.1}\" \
             height=\"{height:.1}\"/>",
            hue(index),
            bytes(info.bytes),
            info.bytes,
            if info.keep { ", kept" } else { "" },
            (right - left).max(1.0),
        )?;
        // Labels are drawn only where they fit.
        let fits = (info.name.chars().count() as f64) * 6.4 + 8.0 < right - left && height > 12.0;
        if fits {
            writeln!(out, "<text x=\"{:.1}\" y=\"{:.1}\">{name}</text>", left + 4.0, top + height / 2.0 + 3.5)?;
        }
        writeln!(out, "</g>")?;
    }
    writeln!(out, "</svg></section>")
}

/// Writes ticks for groups (below) and offsets (left).
fn axes(out: &mut String, columns: usize, arena: u64, x: impl Fn(usize) -> f64, y: impl Fn(u64) -> f64) -> fmt::Result {
    let step = columns.div_ceil(24).max(1);
    for at in (0..columns).step_by(step) {
        let middle = (x(at) + x(at + 1)) / 2.0;
        writeln!(out, "<text class=\"tick\" x=\"{middle:.1}\" y=\"{}\">{at}</text>", HEIGHT - 8.0)?;
    }
    for part in 0..=4 {
        let offset = arena / 4 * part;
        let (line, text) = (y(offset), bytes(offset));
        writeln!(
            out,
            "<line class=\"grid\" x1=\"{LEFT}\" x2=\"{WIDTH}\" y1=\"{line:.1}\" y2=\"{line:.1}\"/>\
             <text class=\"tick side\" x=\"{}\" y=\"{:.1}\">{text}</text>",
            LEFT - 6.0,
            line + 3.5
        )?;
    }
    Ok(())
}
