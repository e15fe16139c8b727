//! Text output of a plan: one line per fact, equal for equal plans, for snapshot tests.

use std::fmt::{self, Write};

use super::{describe, labels, state, transition, verb};
use crate::graph::plan::Plan;
use crate::graph::resource::{BufferKind, BufferState};

/// Returns the plan as text.
pub fn text(plan: &Plan) -> String {
    let mut out = String::new();
    // Writing to a string cannot fail.
    let _ = write(plan, &mut out);
    out
}

fn write(plan: &Plan, out: &mut String) -> fmt::Result {
    writeln!(out, "plan {} {:016x}", plan.name, plan.key)?;
    writeln!(
        out,
        "{} passes in {} groups, {} barriers, {} dropped",
        plan.passes.len() - plan.culled.len(),
        plan.groups.len(),
        plan.groups.iter().filter_map(|group| group.barrier).chain(plan.final_barrier).count(),
        plan.culled.len(),
    )?;
    let saved = plan.arena_unaliased_bytes - plan.arena_bytes;
    writeln!(out, "arena {} bytes, {} without sharing, {saved} saved", plan.arena_bytes, plan.arena_unaliased_bytes)?;

    writeln!(out, "\nbuffers")?;
    let lifetimes = plan.lifetimes();
    for (buffer, info) in plan.buffers() {
        let kind = match info.kind {
            BufferKind::External if !info.keep => "input",
            BufferKind::External => "external",
            BufferKind::Transient => "transient",
            BufferKind::Uniform => "uniform",
        };
        write!(out, "  {} {kind} ", info.name)?;
        match &info.image {
            Some(image) => write!(out, "image {}x{} {}", image.size[0], image.size[1], image.format)?,
            None => write!(out, "{} bytes", info.bytes)?,
        }
        match (info.kind, plan.placements[buffer.index()], lifetimes[buffer.index()]) {
            (BufferKind::Transient, Some(slot), Some((first, last))) if info.image.is_some() => {
                write!(out, " in slot {slot}, groups {first}..={last}")?;
            }
            (BufferKind::Transient, Some(offset), Some((first, last))) => {
                write!(out, " at {offset}, groups {first}..={last}")?;
            }
            (BufferKind::Transient, ..) => write!(out, ", unused")?,
            (BufferKind::External, ..) => match &info.image {
                Some(image) => write!(out, ", {} on entry, {} on exit", state(image.entry), state(image.exit))?,
                None if (info.entry, info.exit) != (BufferState::Ready, BufferState::Ready) => {
                    write!(out, ", {} on entry, {} on exit", shared(info.entry), shared(info.exit))?;
                }
                None => {}
            },
            (BufferKind::Uniform, ..) => {}
        }
        writeln!(out, "{}", if info.kind == BufferKind::Transient && info.keep { ", kept" } else { "" })?;
    }

    for (at, group) in plan.groups.iter().enumerate() {
        writeln!(out, "\ngroup {at}")?;
        if let Some(barrier) = group.barrier {
            writeln!(out, "  barrier {barrier}")?;
        }
        for change in plan.entry.iter().filter(|_| at == 0) {
            writeln!(out, "  {}", transition(plan, change))?;
        }
        for &pass in &group.passes {
            let pass = &plan.passes[pass];
            writeln!(out, "  {}: {}", pass.name, describe(pass))?;
            for ((slice, access, used), label) in pass.accesses.iter().zip(labels(pass)) {
                let info = &plan.buffers[slice.buffer.index()];
                write!(out, "    {label} {} {}", verb(*access, *used), info.name)?;
                if slice.bytes != info.bytes {
                    write!(out, " [{}..{}]", slice.offset, slice.offset + slice.bytes)?;
                }
                writeln!(out, "{}", if pass.discards(slice) { " (discards)" } else { "" })?;
            }
        }
    }
    if let Some(barrier) = plan.final_barrier {
        writeln!(out, "\nend\n  barrier {barrier}")?;
    }
    for change in &plan.exit {
        writeln!(out, "  {}", transition(plan, change))?;
    }
    if !plan.culled.is_empty() {
        writeln!(out, "\ndropped")?;
        for &pass in &plan.culled {
            writeln!(out, "  {}: {}", plan.passes[pass].name, describe(&plan.passes[pass]))?;
        }
    }
    Ok(())
}

/// Returns the name of a buffer state.
fn shared(state: BufferState) -> &'static str {
    match state {
        BufferState::Ready => "ready",
        BufferState::Host => "host",
        BufferState::Queue => "queue",
    }
}

impl fmt::Display for Plan {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&text(self))
    }
}
