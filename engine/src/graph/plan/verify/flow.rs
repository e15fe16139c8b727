//! Whether the data arrives: nothing needed was dropped, and what depends on each other keeps its declared order.

use super::cells::Cells;
use super::{Hazard, VerifyError, buffer_name, pass_name};
use crate::graph::pass::{Pass, PassKind};
use crate::graph::plan::Plan;
use crate::graph::resource::Slice;
use crate::shader::Access;

/// What a cell holds after a write.
struct Version {
    writer: usize,
    buffer: usize,
    /// What it held before, if part of that may remain.
    before: Option<usize>,
}

/// Who wants a version.
#[derive(Clone, Copy)]
enum Wanted {
    Output,
    Pass(usize),
}

fn cells(plan: &Plan) -> Cells {
    let slices = plan.passes.iter().flat_map(|pass| &pass.accesses);
    Cells::new(plan.buffers.len(), slices.map(|(slice, ..)| (slice.buffer.index(), slice.range())))
}

/// Whether nothing of what the slice held survives the pass, or matters to it.
fn overwrites(pass: &Pass, slice: &Slice) -> bool {
    // Who may not run at all overwrites nothing.
    if pass.condition.is_some() {
        return false;
    }
    match &pass.kind {
        PassKind::Fill { target, .. } | PassKind::Copy { target, .. } => target == slice,
        PassKind::CopyToImage { target, .. } | PassKind::ClearImage { target, .. } => target.0 == slice.buffer,
        PassKind::CopyFromImage { target, .. } => target == slice,
        PassKind::Compute { .. } => pass.discards.contains(slice),
    }
}

/// Names every version of every cell, then walks from the outputs back to whatever they are made of.
pub(super) fn check_needed(plan: &Plan, group_of: &[Option<usize>]) -> Result<(), VerifyError> {
    let cells = cells(plan);
    let mut held: Vec<Vec<Option<usize>>> = cells.table();
    let mut versions: Vec<Version> = Vec::new();
    let mut reads: Vec<Vec<usize>> = vec![Vec::new(); plan.passes.len()];
    for (index, pass) in plan.passes.iter().enumerate() {
        for (slice, access, _) in &pass.accesses {
            let buffer = slice.buffer.index();
            let overwrites = overwrites(pass, slice);
            for held in &mut held[buffer][cells.of(buffer, &slice.range())] {
                match access {
                    Access::Read => reads[index].extend(*held),
                    Access::ReadWrite if !overwrites => reads[index].extend(*held),
                    Access::ReadWrite | Access::Write | Access::Accumulate => {}
                }
                if *access != Access::Read {
                    let before = if overwrites { None } else { *held };
                    *held = Some(versions.len());
                    versions.push(Version { writer: index, buffer, before });
                }
            }
        }
    }

    let outputs = plan.buffers.iter().zip(held).filter(|(info, _)| info.keep).flat_map(|(_, held)| held);
    let mut todo: Vec<(usize, Wanted)> = outputs.flatten().map(|version| (version, Wanted::Output)).collect();
    let mut seen = vec![false; versions.len()];
    let mut needed = vec![false; plan.passes.len()];
    while let Some((version, by)) = todo.pop() {
        if std::mem::replace(&mut seen[version], true) {
            continue;
        }
        let Version { writer, buffer, before } = versions[version];
        if group_of[writer].is_none() {
            let by = match by {
                Wanted::Output => "the output".to_owned(),
                Wanted::Pass(pass) => format!("pass [{}]", plan.passes[pass].name),
            };
            let (pass, buffer) = (pass_name(plan, writer), buffer_name(plan, buffer));
            return Err(VerifyError::NeededPassCulled { pass, buffer, by });
        }
        todo.extend(before.map(|before| (before, by)));
        if !std::mem::replace(&mut needed[writer], true) {
            todo.extend(reads[writer].iter().map(|&version| (version, Wanted::Pass(writer))));
        }
    }
    Ok(())
}

/// The latest pass of some kind that touched a cell: its group and its number.
type Latest = Option<(usize, usize)>;

/// Who touched a cell since its last write that commutes with nothing.
#[derive(Clone, Copy, Default)]
struct Since {
    /// That write.
    base: Latest,
    accumulations: Latest,
    reads: Latest,
}

/// Compares the groups of conflicting passes.
pub(super) fn check_order(plan: &Plan, group_of: &[Option<usize>]) -> Result<(), VerifyError> {
    let cells = cells(plan);
    let mut state: Vec<Vec<Since>> = cells.table();
    for (index, pass) in plan.passes.iter().enumerate() {
        let Some(group) = group_of[index] else { continue };
        for (slice, access, _) in &pass.accesses {
            let buffer = slice.buffer.index();
            let behind = |latest: Latest, hazard| match latest {
                Some((first_group, first)) if first_group >= group && first != index => Err(VerifyError::Order {
                    hazard,
                    buffer: buffer_name(plan, buffer),
                    first: pass_name(plan, first),
                    first_group,
                    second: pass.name.clone(),
                    second_group: group,
                }),
                _ => Ok(()),
            };
            let here = Some((group, index));
            for since in &mut state[buffer][cells.of(buffer, &slice.range())] {
                match access {
                    Access::Read => {
                        behind(since.base, Hazard::ReadAfterWrite)?;
                        behind(since.accumulations, Hazard::ReadAfterWrite)?;
                        since.reads = since.reads.max(here);
                    }
                    Access::Accumulate => {
                        behind(since.base, Hazard::WriteAfterWrite)?;
                        behind(since.reads, Hazard::WriteAfterRead)?;
                        since.accumulations = since.accumulations.max(here);
                    }
                    Access::Write | Access::ReadWrite => {
                        behind(since.base, Hazard::WriteAfterWrite)?;
                        behind(since.accumulations, Hazard::WriteAfterWrite)?;
                        behind(since.reads, Hazard::WriteAfterRead)?;
                        *since = Since { base: here, ..Since::default() };
                    }
                }
            }
        }
    }
    Ok(())
}
