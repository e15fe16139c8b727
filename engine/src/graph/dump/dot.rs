//! DOT output of a plan: one box per group, one edge per dependency, labeled with its buffers.

use std::fmt::{self, Write};

use super::{describe, transition};
use crate::graph::pass::writes;
use crate::graph::plan::Plan;

/// Returns the plan in the DOT language of Graphviz.
pub fn dot(plan: &Plan) -> String {
    let mut out = String::new();
    // Writing to a string cannot fail.
    let _ = write(plan, &mut out);
    out
}

fn write(plan: &Plan, out: &mut String) -> fmt::Result {
    writeln!(out, "digraph {} {{", quote(&plan.name))?;
    writeln!(out, "  rankdir=TB; node [shape=box, fontname=monospace]; edge [fontname=monospace, fontsize=9];")?;
    for (at, group) in plan.groups.iter().enumerate() {
        let mut barrier = group.barrier.map_or_else(String::new, |barrier| format!("\n{barrier}"));
        for change in plan.entry.iter().filter(|_| at == 0) {
            barrier += &format!("\n{}", transition(plan, change));
        }
        writeln!(out, "  subgraph cluster_{at} {{ label={};", quote(&format!("group {at}{barrier}")))?;
        for &pass in &group.passes {
            let label = format!("{}\n{}", plan.passes[pass].name, describe(&plan.passes[pass]));
            writeln!(out, "    p{pass} [label={}];", quote(&label))?;
        }
        writeln!(out, "  }}")?;
    }
    for (pass, dependencies) in plan.dependencies().iter().enumerate() {
        for &before in dependencies {
            let causes = causes(plan, before as usize, pass).join(", ");
            writeln!(out, "  p{before} -> p{pass} [label={}];", quote(&causes))?;
        }
    }
    for &pass in &plan.culled {
        writeln!(out, "  p{pass} [label={}, style=dashed];", quote(&plan.passes[pass].name))?;
    }
    writeln!(out, "}}")
}

/// Returns the buffers through which two passes depend on each other.
fn causes(plan: &Plan, first: usize, second: usize) -> Vec<&str> {
    let mut names = Vec::new();
    for (slice, access, _) in &plan.passes[first].accesses {
        for (other, after, _) in &plan.passes[second].accesses {
            let name = plan.buffers[slice.buffer.index()].name.as_str();
            if slice.overlaps(other) && (writes(*access) || writes(*after)) && !names.contains(&name) {
                names.push(name);
            }
        }
    }
    names
}

fn quote(text: &str) -> String {
    format!("\"{}\"", text.replace('\\', "\\\\").replace('"', "\\\"").replace('\n', "\\n"))
}
