//! Compile steps, tested on small graphs.

use std::sync::Arc;

use super::kernels::{kernel, pass, with_kinds};
use super::*;
use crate::shader::Access::{Accumulate, Read, ReadWrite, Write};
use crate::shader::BindingKind;

fn compile(graph: Graph) -> Plan {
    graph.compile(&CompileOptions::default()).unwrap()
}

fn names(plan: &Plan, passes: &[usize]) -> Vec<String> {
    passes.iter().map(|&pass| plan.passes[pass].name.clone()).collect()
}

fn groups(plan: &Plan) -> Vec<Vec<String>> {
    plan.groups.iter().map(|group| names(plan, &group.passes)).collect()
}

fn barrier(src_stage: Stages, src_access: Accesses, dst_stage: Stages, dst_access: Accesses) -> Option<Barrier> {
    Some(Barrier { src_stage, src_access, dst_stage, dst_access })
}

/// Builds a plan that writes `middle` by `write` and reads it into `out` by `read`.
fn pair(write: impl FnOnce(&mut Graph, Buffer), read: impl FnOnce(&mut Graph, Buffer, Buffer)) -> Plan {
    let mut graph = Graph::new("pair");
    let middle = graph.transient("middle", 256);
    let out = graph.external("out", 256);
    write(&mut graph, middle);
    read(&mut graph, middle, out);
    compile(graph)
}

#[test]
fn culling_drops_unneeded_passes() {
    let mut graph = Graph::new("cull");
    let [used, unused] = ["used", "unused"].map(|name| graph.transient(name, 256));
    let out = graph.external("out", 256);
    pass(&mut graph, "lost", &[(unused.slice(0, 256), Write)]);
    pass(&mut graph, "make", &[(used.slice(0, 256), Write)]);
    pass(&mut graph, "lost_too", &[(unused.slice(0, 256), ReadWrite), (used.slice(0, 256), Read)]);
    pass(&mut graph, "finish", &[(used.slice(0, 256), Read), (out.slice(0, 256), Write)]);
    let plan = compile(graph);
    assert_eq!(names(&plan, &plan.culled), ["lost", "lost_too"]);
    assert_eq!(plan.placements, [Some(0), None, None]);
}

#[test]
fn culling_respects_partial_writes_and_discards() {
    let build = |discard: bool| {
        let mut graph = Graph::new("partial");
        let out = graph.external("out", 256);
        pass(&mut graph, "first", &[(out.slice(0, 256), Write)]);
        let over = kernel("second", &[Write]);
        let second = graph.pass("second", &over);
        let second = if discard { second.bind_discard("b0", out) } else { second.bind("b0", out) };
        second.dispatch([1, 1, 1]).unwrap();
        compile(graph)
    };
    assert!(build(false).culled.is_empty());
    assert_eq!(build(true).culled, [0]);
}

#[test]
fn culling_is_per_byte() {
    let mut graph = Graph::new("ranges");
    let out = graph.external("out", 512);
    graph.fill("low", out.slice(0, 256), 1).unwrap();
    graph.fill("high", out.slice(256, 256), 1).unwrap();
    graph.fill("high_again", out.slice(256, 256), 2).unwrap();
    let plan = compile(graph);
    assert_eq!(names(&plan, &plan.culled), ["high"]);
}

#[test]
fn unread_accumulation_needs_no_initial_value() {
    let mut graph = Graph::new("accumulate");
    let sum = graph.transient("sum", 256);
    let out = graph.external("out", 256);
    graph.fill("zero", sum, 0).unwrap();
    pass(&mut graph, "add", &[(sum.slice(0, 256), Accumulate), (out.slice(0, 256), Write)]);
    let plan = compile(graph);
    assert_eq!(names(&plan, &plan.culled), ["zero"]);
}

#[test]
fn kept_transients_are_outputs() {
    let mut graph = Graph::new("keep");
    let [retained, other] = ["kept", "other"].map(|name| graph.transient(name, 256));
    let out = graph.external("out", 512);
    graph.keep(retained);
    graph.fill("fill_kept", retained, 1).unwrap();
    graph.copy("use", retained, out.slice(0, 256)).unwrap();
    pass(&mut graph, "fill_other", &[(other.slice(0, 256), Write), (out.slice(0, 256), Read)]);
    graph.copy("use_other", other, out.slice(256, 256)).unwrap();
    let plan = compile(graph);
    assert_eq!(plan.lifetimes()[..2], [Some((0, plan.groups.len())), Some((2, 3))]);
    assert_ne!(plan.placements[0], plan.placements[1]);
}

#[test]
fn groups_are_levels() {
    let mut graph = Graph::new("levels");
    let a = graph.external("a", 256);
    let b = graph.external("b", 256);
    let c = graph.external("c", 256);
    pass(&mut graph, "a1", &[(a.slice(0, 256), ReadWrite)]);
    pass(&mut graph, "a2", &[(a.slice(0, 256), ReadWrite)]);
    pass(&mut graph, "b1", &[(b.slice(0, 256), ReadWrite)]);
    pass(&mut graph, "b2", &[(b.slice(0, 256), ReadWrite)]);
    pass(&mut graph, "join", &[(a.slice(0, 256), Read), (b.slice(0, 256), Read), (c.slice(0, 256), Write)]);
    let declared = graph.clone().compile(&CompileOptions { reorder: false, ..Default::default() }).unwrap();
    assert_eq!(groups(&compile(graph)), [vec!["a1", "b1"], vec!["a2", "b2"], vec!["join"]]);
    assert_eq!(groups(&declared), [vec!["a1"], vec!["a2", "b1"], vec!["b2"], vec!["join"]]);
}

#[test]
fn accumulations_share_a_group_unless_read_between() {
    let mut graph = Graph::new("sums");
    let sum = graph.external("sum", 256);
    let out = graph.external("out", 256);
    pass(&mut graph, "add1", &[(sum.slice(0, 256), Accumulate)]);
    pass(&mut graph, "add2", &[(sum.slice(0, 256), Accumulate)]);
    pass(&mut graph, "look", &[(sum.slice(0, 256), Read), (out.slice(0, 256), Write)]);
    pass(&mut graph, "add3", &[(sum.slice(0, 256), Accumulate)]);
    pass(&mut graph, "add4", &[(sum.slice(0, 256), Accumulate)]);
    let plan = compile(graph);
    assert_eq!(groups(&plan), [vec!["add1", "add2"], vec!["look"], vec!["add3", "add4"]]);
    let (compute, none) = (Stages::COMPUTE, Accesses::NONE);
    assert_eq!(plan.groups[2].barrier, barrier(compute, none, compute, none));
}

#[test]
fn accumulations_into_one_buffer_need_no_barrier_between_replays() {
    let mut graph = Graph::new("sums");
    let sum = graph.external("sum", 256);
    pass(&mut graph, "add", &[(sum.slice(0, 256), Accumulate)]);
    let plan = compile(graph);
    // Waits only for copies that may have read the sum in between.
    assert_eq!(plan.groups[0].barrier, barrier(Stages::TRANSFER, Accesses::NONE, Stages::COMPUTE, Accesses::NONE));
}

#[test]
fn fill_is_scheduled_before_its_first_user() {
    let mut graph = Graph::new("late");
    let chain = graph.external("chain", 256);
    let sum = graph.transient("sum", 4096);
    graph.fill("zero", sum, 0).unwrap();
    for name in ["one", "two", "three"] {
        pass(&mut graph, name, &[(chain.slice(0, 256), ReadWrite)]);
    }
    pass(&mut graph, "add", &[(sum.slice(0, 4096), Accumulate), (chain.slice(0, 256), Read)]);
    pass(&mut graph, "end", &[(sum.slice(0, 4096), Read), (chain.slice(0, 256), ReadWrite)]);
    let plan = compile(graph);
    assert_eq!(
        groups(&plan),
        [vec!["one"], vec!["two"], vec!["zero", "three"], vec!["add"], vec!["end"]],
        "the fill is scheduled as late as possible, first in its group"
    );
}

#[test]
fn dispatch_to_dispatch() {
    let plan = pair(
        |graph, middle| pass(graph, "write", &[(middle.slice(0, 256), Write)]),
        |graph, middle, out| pass(graph, "read", &[(middle.slice(0, 256), Read), (out.slice(0, 256), Write)]),
    );
    let (compute, write, read) = (Stages::COMPUTE, Accesses::STORAGE_WRITE, Accesses::STORAGE_READ);
    assert_eq!(plan.groups[1].barrier, barrier(compute, write, compute, read));
    let after = Stages::TRANSFER | Stages::HOST;
    let seen = Accesses::TRANSFER_READ | Accesses::HOST_READ;
    assert_eq!(plan.final_barrier, barrier(compute, write, after, seen));
    // The next replay overwrites data that kernels, and copies from the outputs, have read, so it only has to wait.
    // Waiting for the copies suffices: the final barrier made those wait for the kernels.
    let none = Accesses::NONE;
    assert_eq!(plan.groups[0].barrier, barrier(Stages::TRANSFER, none, compute, none));
}

#[test]
fn dispatch_to_indirect_arguments() {
    let plan = pair(
        |graph, middle| pass(graph, "count", &[(middle.slice(0, 256), Write)]),
        |graph, middle, out| {
            let run = kernel("run", &[Write]);
            graph.pass("run", &run).bind("b0", out).dispatch_indirect(middle, 16).unwrap();
        },
    );
    let expected = barrier(Stages::COMPUTE, Accesses::STORAGE_WRITE, Stages::INDIRECT, Accesses::INDIRECT_READ);
    assert_eq!(plan.groups[1].barrier, expected);
}

#[test]
fn indirect_arguments_that_the_kernel_reads_too() {
    let plan = pair(
        |graph, middle| pass(graph, "count", &[(middle.slice(0, 256), Write)]),
        |graph, middle, out| {
            let run = kernel("run", &[Read, Write]);
            graph.pass("run", &run).bind("b0", middle).bind("b1", out).dispatch_indirect(middle, 0).unwrap();
        },
    );
    let stages = Stages::COMPUTE | Stages::INDIRECT;
    let accesses = Accesses::STORAGE_READ | Accesses::INDIRECT_READ;
    assert_eq!(plan.groups[1].barrier, barrier(Stages::COMPUTE, Accesses::STORAGE_WRITE, stages, accesses));
}

#[test]
fn fill_to_copy_and_dispatch_to_uniform() {
    let plan = pair(
        |graph, middle| graph.fill("fill", middle, 7).unwrap(),
        |graph, middle, out| graph.copy("copy", middle, out).unwrap(),
    );
    let transfer = Stages::TRANSFER;
    let expected = barrier(transfer, Accesses::TRANSFER_WRITE, transfer, Accesses::TRANSFER_READ);
    assert_eq!(plan.groups[1].barrier, expected);

    let plan = pair(
        |graph, middle| pass(graph, "write", &[(middle.slice(0, 256), Write)]),
        |graph, middle, out| {
            let kernel = with_kinds("u", &[(BindingKind::Uniform, Read), (BindingKind::Storage, Write)]);
            graph.pass("use", &kernel).bind("b0", middle).bind("b1", out).dispatch([1, 1, 1]).unwrap();
        },
    );
    let compute = Stages::COMPUTE;
    let expected = barrier(compute, Accesses::STORAGE_WRITE, compute, Accesses::UNIFORM_READ);
    assert_eq!(plan.groups[1].barrier, expected);
}

#[test]
fn read_before_write_needs_execution_barrier_only() {
    let mut graph = Graph::new("war");
    let state = graph.external("state", 256);
    let out = graph.external("out", 256);
    pass(&mut graph, "read", &[(state.slice(0, 256), Read), (out.slice(0, 256), Write)]);
    graph.fill("reset", state, 0).unwrap();
    let plan = compile(graph);
    let none = Accesses::NONE;
    assert_eq!(plan.groups[1].barrier, barrier(Stages::COMPUTE, none, Stages::TRANSFER, none));
}

#[test]
fn visibility_persists() {
    let mut graph = Graph::new("visible");
    let made = graph.transient("made", 256);
    let chain = graph.external("chain", 256);
    let late = graph.external("late", 256);
    pass(&mut graph, "make", &[(made.slice(0, 256), Write), (chain.slice(0, 256), Write)]);
    pass(&mut graph, "one", &[(made.slice(0, 256), Read), (chain.slice(0, 256), ReadWrite)]);
    graph.copy("two", chain, late).unwrap();
    graph.fill("three", late, 0).unwrap();
    pass(&mut graph, "four", &[(made.slice(0, 256), Read), (late.slice(0, 256), ReadWrite)]);
    let plan = graph.compile(&CompileOptions { reorder: false, ..Default::default() }).unwrap();
    // `four` waits only for the fill; `made` has been visible to kernels since `one`.
    let last = plan.groups.last().unwrap().barrier.unwrap();
    assert_eq!((last.src_stage, last.src_access), (Stages::TRANSFER, Accesses::TRANSFER_WRITE));
}

#[test]
fn disjoint_ranges_do_not_conflict() {
    let mut graph = Graph::new("ranges");
    let both = graph.external("both", 512);
    pass(&mut graph, "low", &[(both.slice(0, 256), ReadWrite)]);
    pass(&mut graph, "high", &[(both.slice(256, 256), ReadWrite)]);
    assert_eq!(compile(graph).groups.len(), 1);
}

/// Graph with two chains in sequence, each through its own transient.
fn two_chains() -> Graph {
    let mut graph = Graph::new("hand-off");
    let [first, second] = ["first", "second"].map(|name| graph.transient(name, 1000));
    let out = graph.external("out", 1000);
    pass(&mut graph, "make1", &[(first.slice(0, 1000), Write)]);
    pass(&mut graph, "use1", &[(first.slice(0, 1000), Read), (out.slice(0, 1000), ReadWrite)]);
    graph.fill("make2", second, 0).unwrap();
    pass(&mut graph, "use2", &[(second.slice(0, 1000), Read), (out.slice(0, 1000), ReadWrite)]);
    graph
}

#[test]
fn aliased_transients_are_separated_by_barriers() {
    let options = CompileOptions { reorder: false, ..Default::default() };
    let mut plan = two_chains().compile(&options).unwrap();
    // `make2` has no dependency and joins `use1`, where `first` is still alive.
    assert_eq!(groups(&plan), [vec!["make1"], vec!["use1", "make2"], vec!["use2"]]);
    assert_eq!((plan.arena_bytes, plan.arena_unaliased_bytes), (2048, 2048));

    let mut graph = two_chains();
    let third = graph.transient("third", 1000);
    let out = Buffer(2);
    graph.fill("make3", third, 0).unwrap();
    pass(&mut graph, "use3", &[(third.slice(0, 1000), Read), (out.slice(0, 1000), ReadWrite)]);
    plan = graph.compile(&options).unwrap();
    assert_eq!((plan.arena_bytes, plan.arena_unaliased_bytes), (2048, 3072));
    let group = plan.groups.iter().position(|g| names(&plan, &g.passes).contains(&"make3".to_owned())).unwrap();
    assert_eq!(plan.placements[third.index()], plan.placements[0], "make3 aliases the memory of use1");

    // Only memory aliasing orders `use1` before `make3`.
    let barrier = plan.groups[group].barrier.as_mut().unwrap();
    barrier.dst_stage = barrier.dst_stage.without(Stages::TRANSFER);
    barrier.dst_access = barrier.dst_access.without(Accesses::TRANSFER_WRITE);
    match verify(&plan) {
        Err(VerifyError::Hazard { first_buffer, second_buffer, .. }) => {
            assert_eq!((first_buffer.as_str(), second_buffer.as_str()), ("first", "third"));
        }
        other => panic!("{other:?}"),
    }
}

#[test]
fn transients_are_disjoint_without_aliasing() {
    let plan = two_chains().compile(&CompileOptions { alias: false, ..Default::default() }).unwrap();
    assert_eq!(plan.arena_bytes, plan.arena_unaliased_bytes);
    assert_eq!(plan.placements, [Some(0), Some(1024), None]);
}

#[test]
fn empty_graph_compiles() {
    let plan = compile(Graph::new("empty"));
    assert!(plan.groups.is_empty() && plan.final_barrier.is_none() && plan.arena_bytes == 0);
}

#[test]
fn graph_without_outputs_runs_nothing() {
    let mut graph = Graph::new("idle");
    let input = graph.input("input", 256);
    let scratch = graph.transient("scratch", 256);
    graph.copy("copy", input, scratch).unwrap();
    let plan = compile(graph);
    assert!(plan.groups.is_empty());
    assert_eq!(plan.culled, [0]);
}

#[test]
fn key_depends_on_declaration_and_options() {
    fn graph(change: usize) -> Graph {
        let mut graph = Graph::new(if change == 1 { "other" } else { "same" });
        let out = graph.external("out", if change == 2 { 512 } else { 256 });
        let mut shader = kernel("k", &[if change == 3 { ReadWrite } else { Write }]);
        if change == 4 {
            Arc::make_mut(&mut shader).spirv.to_mut().push(1);
        }
        let pass = graph.pass(if change == 5 { "q" } else { "p" }, &shader);
        let pass = pass.spec("size", if change == 6 { 2 } else { 1 });
        let pass = pass.subgroup_size((change == 7).then_some(32));
        let pass = if change == 8 { pass.bind_discard("b0", out) } else { pass.bind("b0", out) };
        pass.dispatch([1, 1, if change == 9 { 2 } else { 1 }]).unwrap();
        if change == 10 {
            graph.fill("f", out, 1).unwrap();
        }
        graph
    }
    let mut keys: Vec<_> = (0..11).map(|change| compile(graph(change)).key).collect();
    assert_eq!(keys[0], compile(graph(0)).key);
    keys.push(graph(0).compile(&CompileOptions { alias: false, ..Default::default() }).unwrap().key);
    keys.sort_unstable();
    keys.dedup();
    assert_eq!(keys.len(), 12);
}
