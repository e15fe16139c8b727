//! Data-flow verification: no needed pass is culled, and dependent passes keep their declared order.

use super::cells::Cells;
use super::{Hazard, VerifyError, buffer_name, pass_name};
use crate::graph::pass::{Pass, PassKind};
use crate::graph::plan::Plan;
use crate::graph::resource::Slice;
use crate::shader::Access;

/// Contents of a cell after a write.
struct Version {
    writer: usize,
    buffer: usize,
    /// Version before the write, if part of it may remain.
    before: Option<usize>,
}

/// User of a version.
#[derive(Clone, Copy)]
enum VersionUser {
    Output,
    Pass(usize),
}

fn cells(plan: &Plan) -> Cells {
    let slices = plan.passes.iter().flat_map(|pass| &pass.accesses);
    Cells::new(plan.buffers.len(), slices.map(|(slice, ..)| (slice.buffer.index(), slice.range())))
}

/// Returns whether the pass discards the slice's earlier contents. It neither preserves nor reads them.
fn overwrites(pass: &Pass, slice: &Slice) -> bool {
    match &pass.kind {
        PassKind::Fill { target, .. } | PassKind::Copy { target, .. } => target == slice,
        PassKind::CopyToImage { target, .. } | PassKind::ClearImage { target, .. } => target.0 == slice.buffer,
        PassKind::CopyFromImage { target, .. } => target == slice,
        PassKind::Compute { .. } => pass.discards.contains(slice),
    }
}

/// Checks that every pass that outputs depend on is in a group. Numbers all versions of all cells, then walks from the
/// outputs back to the versions that they depend on.
pub(super) fn check_needed(plan: &Plan, group_of: &[Option<usize>]) -> Result<(), VerifyError> {
    let cells = cells(plan);
    let mut current: Vec<Vec<Option<usize>>> = cells.table();
    let mut versions: Vec<Version> = Vec::new();
    let mut reads: Vec<Vec<usize>> = vec![Vec::new(); plan.passes.len()];
    for (index, pass) in plan.passes.iter().enumerate() {
        for (slice, access, _) in &pass.accesses {
            let buffer = slice.buffer.index();
            let overwrites = overwrites(pass, slice);
            for current in &mut current[buffer][cells.of(buffer, &slice.range())] {
                match access {
                    Access::Read => reads[index].extend(*current),
                    Access::ReadWrite if !overwrites => reads[index].extend(*current),
                    Access::ReadWrite | Access::Write | Access::Accumulate => {}
                }
                if *access != Access::Read {
                    let before = if overwrites { None } else { *current };
                    *current = Some(versions.len());
                    versions.push(Version { writer: index, buffer, before });
                }
            }
        }
    }

    let outputs = plan.buffers.iter().zip(current).filter(|(info, _)| info.keep).flat_map(|(_, current)| current);
    let mut todo: Vec<(usize, VersionUser)> = outputs.flatten().map(|version| (version, VersionUser::Output)).collect();
    let mut seen = vec![false; versions.len()];
    let mut needed = vec![false; plan.passes.len()];
    while let Some((version, by)) = todo.pop() {
        if std::mem::replace(&mut seen[version], true) {
            continue;
        }
        let Version { writer, buffer, before } = versions[version];
        if group_of[writer].is_none() {
            let by = match by {
                VersionUser::Output => "the output".to_owned(),
                VersionUser::Pass(pass) => format!("pass [{}]", plan.passes[pass].name),
            };
            let (pass, buffer) = (pass_name(plan, writer), buffer_name(plan, buffer));
            return Err(VerifyError::NeededPassCulled { pass, buffer, by });
        }
        todo.extend(before.map(|before| (before, by)));
        if !std::mem::replace(&mut needed[writer], true) {
            todo.extend(reads[writer].iter().map(|&version| (version, VersionUser::Pass(writer))));
        }
    }
    Ok(())
}

/// Latest pass of some kind that accessed a cell: its group and index.
type Latest = Option<(usize, usize)>;

/// Accesses of a cell since its last non-commuting write.
#[derive(Clone, Copy, Default)]
struct RecentAccesses {
    /// Last non-commuting write.
    base: Latest,
    accumulations: Latest,
    reads: Latest,
}

/// Checks that conflicting passes are in ordered groups.
pub(super) fn check_order(plan: &Plan, group_of: &[Option<usize>]) -> Result<(), VerifyError> {
    let cells = cells(plan);
    let mut state: Vec<Vec<RecentAccesses>> = cells.table();
    for (index, pass) in plan.passes.iter().enumerate() {
        let Some(group) = group_of[index] else { continue };
        for (slice, access, _) in &pass.accesses {
            let buffer = slice.buffer.index();
            let check_after = |latest: Latest, hazard| match latest {
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
            for recent in &mut state[buffer][cells.of(buffer, &slice.range())] {
                match access {
                    Access::Read => {
                        check_after(recent.base, Hazard::ReadAfterWrite)?;
                        check_after(recent.accumulations, Hazard::ReadAfterWrite)?;
                        recent.reads = recent.reads.max(here);
                    }
                    Access::Accumulate => {
                        check_after(recent.base, Hazard::WriteAfterWrite)?;
                        check_after(recent.reads, Hazard::WriteAfterRead)?;
                        recent.accumulations = recent.accumulations.max(here);
                    }
                    Access::Write | Access::ReadWrite => {
                        check_after(recent.base, Hazard::WriteAfterWrite)?;
                        check_after(recent.accumulations, Hazard::WriteAfterWrite)?;
                        check_after(recent.reads, Hazard::WriteAfterRead)?;
                        *recent = RecentAccesses { base: here, ..RecentAccesses::default() };
                    }
                }
            }
        }
    }
    Ok(())
}
