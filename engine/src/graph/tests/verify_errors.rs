//! What the verifier says of single, deliberate damages.

use super::kernels::pass;
use super::*;
use crate::shader::Access::{Read, ReadWrite, Write};

/// Writes a transient, reads it, and changes an output: two groups.
fn plan() -> Plan {
    let mut graph = Graph::new("plan");
    let input = graph.input("input", 256);
    let middle = graph.transient("middle", 256);
    let out = graph.external("out", 256);
    pass(&mut graph, "make", &[(input.slice(0, 256), Read), (middle.slice(0, 256), Write)]);
    pass(&mut graph, "use", &[(middle.slice(0, 256), Read), (out.slice(0, 256), ReadWrite)]);
    graph.compile(&CompileOptions::default()).unwrap()
}

fn refused(damage: impl FnOnce(&mut Plan)) -> String {
    let mut plan = plan();
    assert_eq!(verify(&plan), Ok(()));
    damage(&mut plan);
    verify(&plan).unwrap_err().to_string()
}

#[test]
fn a_missing_barrier_is_named() {
    assert_eq!(
        refused(|plan| plan.groups[1].barrier = None),
        "Pass [use] on buffer [middle] has a read after write with pass [make] on buffer [middle] at byte 0 within 1 \
         replay(s), but no barrier makes the write visible to storage_read."
    );
    assert_eq!(
        refused(|plan| plan.groups[0].barrier = None),
        "Pass [make] on buffer [middle] has a write after read with pass [use] on buffer [middle] at byte 0 within 2 \
         replay(s), but no barrier makes compute wait for the read."
    );
    assert_eq!(
        refused(|plan| plan.final_barrier = None),
        "What pass [use] writes to output [out] is not made visible to transfer_read|host_read after the replay."
    );
}

#[test]
fn a_barrier_must_be_one_that_vulkan_takes() {
    let damaged = refused(|plan| plan.groups[1].barrier.as_mut().unwrap().dst_stage = Stages::TRANSFER);
    assert_eq!(
        damaged,
        "The barrier before group 1 names access storage_read without the stage compute that performs it."
    );
}

#[test]
fn a_wrong_schedule_is_named() {
    assert_eq!(
        refused(|plan| plan.groups.swap(0, 1)),
        "Pass [use] in group 0 must come after pass [make] in group 1: read after write of buffer [middle]."
    );
    assert_eq!(
        refused(|plan| plan.groups[1].passes.push(0)),
        "Pass [make] is scheduled or dropped 2 times instead of once."
    );
    assert_eq!(
        refused(|plan| {
            plan.groups[0].passes.clear();
            plan.culled.push(0);
        }),
        "Pass [make] was dropped, but pass [use] needs what it writes to buffer [middle]."
    );
    assert_eq!(
        refused(|plan| {
            plan.groups[1].passes.clear();
            plan.culled.push(1);
        }),
        "Pass [use] was dropped, but the output needs what it writes to buffer [out]."
    );
}

#[test]
fn a_wrong_layout_is_named() {
    assert_eq!(refused(|plan| plan.placements[1] = None), "Transient [middle] is used but has no place in the arena.");
    assert_eq!(
        refused(|plan| plan.arena_bytes = 128),
        "Transient [middle] occupies bytes 0..256 of an arena of 128 bytes."
    );
    assert!(refused(|plan| plan.placements.clear()).starts_with("The plan has 0 placements"));
}

#[test]
fn wrong_declarations_are_named() {
    assert_eq!(refused(|plan| plan.groups[0].passes[0] = 7), "The plan has 2 passes where 8 are expected.");
    assert_eq!(
        refused(|plan| plan.buffers[0].bytes = 128),
        "Pass [make] touches bytes 0..256 of buffer [input], which has 128."
    );
    assert_eq!(refused(|plan| plan.buffers[2].keep = false), "Pass [use] writes buffer [out], which is read-only.");
    assert_eq!(
        refused(|plan| plan.passes[1].accesses[1].1 = Read),
        "Pass [use] touches binding [b1] without saying so in its accesses, or says so without doing it."
    );
    assert!(refused(|plan| plan.passes[0].accesses[0].0.buffer = Buffer(9)).starts_with("The plan has 3 buffers"));
}
