//! Verifier errors of single, deliberate damages.

use super::kernels::pass;
use super::*;
use crate::shader::Access::{Read, ReadWrite, Write};

/// Compiles a plan that writes a transient, reads it, and changes an output: two groups.
fn plan() -> Plan {
    let mut graph = Graph::new("plan");
    let input = graph.input("input", 256);
    let middle = graph.transient("middle", 256);
    let out = graph.external("out", 256);
    pass(&mut graph, "make", &[(input.slice(0, 256), Read), (middle.slice(0, 256), Write)]);
    pass(&mut graph, "use", &[(middle.slice(0, 256), Read), (out.slice(0, 256), ReadWrite)]);
    graph.compile(&CompileOptions::default()).unwrap()
}

fn verify_error_after(damage: impl FnOnce(&mut Plan)) -> String {
    let mut plan = plan();
    assert_eq!(verify(&plan), Ok(()));
    damage(&mut plan);
    verify(&plan).unwrap_err().to_string()
}

#[test]
fn missing_barrier_is_rejected() {
    assert_eq!(
        verify_error_after(|plan| plan.groups[1].barrier = None),
        "Pass [use] on buffer [middle] has a read after write with pass [make] on buffer [middle] at byte 0 within 1 \
         replay(s), but no barrier makes the write visible to storage_read."
    );
    assert_eq!(
        verify_error_after(|plan| plan.groups[0].barrier = None),
        "Pass [make] on buffer [middle] has a write after read with pass [use] on buffer [middle] at byte 0 within 2 \
         replay(s), but no barrier makes compute wait for the read."
    );
    assert_eq!(
        verify_error_after(|plan| plan.final_barrier = None),
        "The write of pass [use] to output [out] is not visible to transfer_read|host_read after the replay."
    );
}

/// Visibility needs a barrier that waits for the stage of the availability. Data made available for one stage is not
/// visible through a barrier that waits for another stage. Nothing orders the first barrier before the second.
#[test]
fn availability_and_visibility_must_be_one_chain() {
    let mut graph = Graph::new("chain");
    let [counts, filled, seen, out] = ["counts", "filled", "seen", "out"].map(|name| graph.external(name, 256));
    pass(&mut graph, "make", &[(counts.slice(0, 256), Write)]);
    graph.fill("fill", filled, 0).unwrap();
    pass(&mut graph, "look", &[(counts.slice(0, 256), Read), (seen.slice(0, 256), ReadWrite)]);
    let kernel = super::kernels::kernel("use", &[Read, Write]);
    let pass = graph.pass("use", &kernel).bind("b0", filled).bind("b1", out);
    pass.dispatch_indirect(counts, 0).unwrap();
    let mut plan = graph.compile(&CompileOptions::default()).unwrap();
    let barrier =
        |src_stage, src_access, dst_stage, dst_access| Barrier { src_stage, src_access, dst_stage, dst_access };
    let ready = barrier(
        Stages::TRANSFER | Stages::COMPUTE,
        Accesses::TRANSFER_WRITE,
        Stages::COMPUTE | Stages::INDIRECT,
        Accesses::STORAGE_READ | Accesses::INDIRECT_READ,
    );
    let barriers = [
        Barrier::FULL,
        barrier(Stages::COMPUTE, Accesses::NONE, Stages::TRANSFER, Accesses::NONE),
        // The counts become available here, and visible to kernels.
        barrier(Stages::COMPUTE, Accesses::STORAGE_WRITE, Stages::COMPUTE, Accesses::STORAGE_READ),
        ready,
    ];
    plan.groups = (0..4).map(|at| Group { barrier: Some(barriers[at]), passes: vec![at] }).collect();
    plan.final_barrier = Some(plan.final_barrier.unwrap().merge(&Barrier::FULL));
    // It waits for kernels, which waited for the availability of the counts.
    assert_eq!(verify(&plan), Ok(()));
    // The fill still orders it after the kernel that wrote the counts, but not after the intermediate barrier.
    plan.groups[3].barrier = Some(Barrier { src_stage: Stages::TRANSFER, ..ready });
    assert_eq!(
        verify(&plan).unwrap_err().to_string(),
        "Pass [use] on buffer [counts] has a read after write with pass [make] on buffer [counts] at byte 0 within 1 \
         replay(s), but no barrier makes the write visible to indirect_read."
    );
}

#[test]
fn barrier_accesses_require_their_stages() {
    let damaged = verify_error_after(|plan| plan.groups[1].barrier.as_mut().unwrap().dst_stage = Stages::TRANSFER);
    assert_eq!(
        damaged,
        "The barrier before group 1 names access storage_read without the stage compute that performs it."
    );
}

#[test]
fn wrong_schedule_is_rejected() {
    assert_eq!(
        verify_error_after(|plan| plan.groups.swap(0, 1)),
        "Pass [use] in group 0 must come after pass [make] in group 1: read after write of buffer [middle]."
    );
    assert_eq!(
        verify_error_after(|plan| plan.groups[1].passes.push(0)),
        "Pass [make] is scheduled or dropped 2 times instead of once."
    );
    assert_eq!(
        verify_error_after(|plan| {
            plan.groups[0].passes.clear();
            plan.culled.push(0);
        }),
        "Pass [make] was dropped, but pass [use] needs its write to buffer [middle]."
    );
    assert_eq!(
        verify_error_after(|plan| {
            plan.groups[1].passes.clear();
            plan.culled.push(1);
        }),
        "Pass [use] was dropped, but the output needs its write to buffer [out]."
    );
}

#[test]
fn wrong_placement_is_rejected() {
    assert_eq!(
        verify_error_after(|plan| plan.placements[1] = None),
        "Transient [middle] is used but has no place in the arena."
    );
    assert_eq!(
        verify_error_after(|plan| plan.arena_bytes = 128),
        "Transient [middle] occupies bytes 0..256 of an arena of 128 bytes."
    );
    assert!(verify_error_after(|plan| plan.placements.clear()).starts_with("The plan has 0 placements"));
}

#[test]
fn wrong_declarations_are_rejected() {
    assert_eq!(verify_error_after(|plan| plan.groups[0].passes[0] = 7), "The plan has 2 passes where 8 are expected.");
    assert_eq!(
        verify_error_after(|plan| plan.buffers[0].bytes = 128),
        "Pass [make] touches bytes 0..256 of buffer [input], which has 128."
    );
    assert_eq!(
        verify_error_after(|plan| plan.buffers[2].keep = false),
        "Pass [use] writes buffer [out], which is read-only."
    );
    assert_eq!(
        verify_error_after(|plan| plan.passes[1].accesses[1].1 = Read),
        "The declared accesses of pass [use] do not match its kind: it touches binding [b1]."
    );
    assert!(
        verify_error_after(|plan| plan.passes[0].accesses[0].0.buffer = Buffer(9))
            .starts_with("The plan has 3 buffers")
    );
}
