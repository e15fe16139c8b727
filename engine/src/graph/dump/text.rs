//! A plan as text: one line a fact, nothing that changes between equal plans, so that snapshots can be compared.

use std::fmt::{self, Write};

use super::{describe, labels, verb};
use crate::graph::plan::Plan;
use crate::graph::resource::BufferKind;

/// The plan as text.
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
        write!(out, "  {} {kind} {} bytes", info.name, info.bytes)?;
        match (info.kind, plan.placements[buffer.index()], lifetimes[buffer.index()]) {
            (BufferKind::Transient, Some(offset), Some((first, last))) => {
                write!(out, " at {offset}, groups {first}..={last}")?;
            }
            (BufferKind::Transient, ..) => write!(out, ", unused")?,
            _ => {}
        }
        writeln!(out, "{}", if info.kind == BufferKind::Transient && info.keep { ", kept" } else { "" })?;
    }

    for (at, group) in plan.groups.iter().enumerate() {
        writeln!(out, "\ngroup {at}")?;
        if let Some(barrier) = group.barrier {
            writeln!(out, "  barrier {barrier}")?;
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
    if !plan.culled.is_empty() {
        writeln!(out, "\ndropped")?;
        for &pass in &plan.culled {
            writeln!(out, "  {}: {}", plan.passes[pass].name, describe(&plan.passes[pass]))?;
        }
    }
    Ok(())
}

impl fmt::Display for Plan {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&text(self))
    }
}
