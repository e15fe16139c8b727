//! Shape verification: indices, slices, accesses that match the passes, valid barriers.

use super::{VerifyError, buffer_name, pass_name};
use crate::graph::pass::{Dispatch, Pass, PassKind, Use};
use crate::graph::plan::Plan;
use crate::graph::plan::scope::{Accesses, Stages};
use crate::graph::resource::{BufferKind, Image, Slice};
use crate::shader::{Access, BindingKind};

/// Checks the shape; returns the group of each pass that runs.
pub(super) fn check(plan: &Plan) -> Result<Vec<Option<usize>>, VerifyError> {
    let count = |what, found, expected| {
        if found == expected { Ok(()) } else { Err(VerifyError::Count { what, found, expected }) }
    };
    count("placements", plan.placements.len(), plan.buffers.len())?;
    count("homes", plan.homes.len(), plan.buffers.len())?;
    let mut group_of = vec![None; plan.passes.len()];
    let mut times = vec![0; plan.passes.len()];
    let scheduled =
        plan.groups.iter().enumerate().flat_map(|(at, group)| group.passes.iter().map(move |&p| (Some(at), p)));
    for (group, pass) in scheduled.chain(plan.culled.iter().map(|&pass| (None, pass))) {
        if pass >= plan.passes.len() {
            return Err(VerifyError::Count { what: "passes", found: plan.passes.len(), expected: pass + 1 });
        }
        times[pass] += 1;
        group_of[pass] = group;
    }
    if let Some(pass) = times.iter().position(|&times| times != 1) {
        return Err(VerifyError::NotOnce { pass: pass_name(plan, pass), times: times[pass] });
    }
    for pass in &plan.passes {
        check_slices(plan, pass)?;
        check_accesses(plan, pass)?;
    }
    let barriers = plan.groups.iter().map(|group| group.barrier).chain([plan.final_barrier]);
    for (group, barrier) in barriers.enumerate() {
        let Some(barrier) = barrier else { continue };
        for (accesses, stages) in [(barrier.src_access, barrier.src_stage), (barrier.dst_access, barrier.dst_stage)] {
            for access in Accesses::ALL.into_iter().filter(|&access| accesses.contains(access)) {
                let stage = performs(access);
                if !stages.contains(stage) {
                    return Err(VerifyError::AccessWithoutStage { group, access, stage });
                }
            }
        }
    }
    Ok(group_of)
}

/// Returns the stage that performs a single access.
pub(super) fn performs(access: Accesses) -> Stages {
    if access == Accesses::OUTSIDE_READ || access == Accesses::OUTSIDE_WRITE {
        Stages::OUTSIDE
    } else if access == Accesses::HOST_READ {
        Stages::HOST
    } else if access == Accesses::INDIRECT_READ {
        Stages::INDIRECT
    } else if access == Accesses::TRANSFER_READ || access == Accesses::TRANSFER_WRITE {
        Stages::TRANSFER
    } else {
        Stages::COMPUTE
    }
}

fn check_slices(plan: &Plan, pass: &Pass) -> Result<(), VerifyError> {
    for (slice, access, _) in &pass.accesses {
        let Some(info) = plan.buffers.get(slice.buffer.index()) else {
            let expected = slice.buffer.index() + 1;
            return Err(VerifyError::Count { what: "buffers", found: plan.buffers.len(), expected });
        };
        let end = slice.offset.saturating_add(slice.bytes);
        if slice.bytes == 0 || end > info.bytes {
            return Err(VerifyError::OutOfBuffer {
                pass: pass.name.clone(),
                buffer: info.name.clone(),
                start: slice.offset,
                end,
                bytes: info.bytes,
            });
        }
        if info.image.is_some() && (slice.offset, slice.bytes) != (0, info.bytes) {
            let (pass, image) = (pass.name.clone(), info.name.clone());
            return Err(VerifyError::PartOfImage { pass, image });
        }
        let input = info.kind == BufferKind::Uniform || (info.kind == BufferKind::External && !info.keep);
        if input && *access != Access::Read {
            let buffer = buffer_name(plan, slice.buffer.index());
            return Err(VerifyError::WriteToReadOnly { pass: pass.name.clone(), buffer });
        }
    }
    Ok(())
}

/// Compares the declared accesses of a pass with those derived from its kind.
fn check_accesses(plan: &Plan, pass: &Pass) -> Result<(), VerifyError> {
    let whole = |image: Image| image.0.slice(0, plan.buffers.get(image.index()).map_or(0, |info| info.bytes));
    let mut expected: Vec<(Slice, Access, Use, String)> = Vec::new();
    match &pass.kind {
        PassKind::Fill { target, .. } => {
            expected.push((*target, Access::Write, Use::Transfer, "fills its target".into()));
        }
        PassKind::Copy { source, target } => {
            expected.push((*source, Access::Read, Use::Transfer, "reads its source".into()));
            expected.push((*target, Access::Write, Use::Transfer, "writes its target".into()));
        }
        PassKind::CopyToImage { source, target } => {
            expected.push((*source, Access::Read, Use::Transfer, "reads its source".into()));
            expected.push((whole(*target), Access::Write, Use::Transfer, "writes its target".into()));
        }
        PassKind::CopyFromImage { source, target } => {
            expected.push((whole(*source), Access::Read, Use::Transfer, "reads its source".into()));
            expected.push((*target, Access::Write, Use::Transfer, "writes its target".into()));
        }
        PassKind::ClearImage { target, .. } => {
            expected.push((whole(*target), Access::Write, Use::Transfer, "clears its target".into()));
        }
        PassKind::Compute { shader, bindings, dispatch, .. } => {
            for binding in &shader.bindings {
                let used = if binding.kind == BindingKind::Uniform { Use::Uniform } else { Use::Compute };
                let what = format!("touches binding [{}]", binding.name);
                match bindings.iter().find(|(number, _)| *number == binding.number) {
                    Some((_, slice)) => expected.push((*slice, binding.access, used, what)),
                    None => return Err(VerifyError::Undeclared { pass: pass.name.clone(), what }),
                }
            }
            if let Dispatch::Indirect { buffer, offset } = dispatch {
                let arguments = buffer.slice(*offset, 12);
                expected.push((arguments, Access::Read, Use::Indirect, "reads its group counts".into()));
            }
        }
    }
    // Each declared access matches one expected access: two bindings of one slice are two accesses.
    let mut declared = pass.accesses.clone();
    for (slice, access, used, what) in expected {
        match declared.iter().position(|declared| *declared == (slice, access, used)) {
            Some(at) => _ = declared.swap_remove(at),
            None => return Err(VerifyError::Undeclared { pass: pass.name.clone(), what }),
        }
    }
    if !declared.is_empty() {
        let what = format!("touches {} more ranges", declared.len());
        return Err(VerifyError::Undeclared { pass: pass.name.clone(), what });
    }
    Ok(())
}
