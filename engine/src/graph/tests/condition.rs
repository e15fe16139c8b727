//! Conditional passes, without a device.

use super::kernels::{gate, kernel, pass};
use super::*;
use crate::shader::Access::{Accumulate, Read, ReadWrite, Write};

struct Fixture {
    graph: Graph,
    out: Buffer,
    flags: Buffer,
    scratch: Buffer,
}

fn fixture() -> Fixture {
    let mut graph = Graph::new("conditions");
    graph.set_gate(&gate());
    let out = graph.external("out", 256);
    let flags = graph.external("flags", 1024);
    let scratch = graph.transient("scratch", 256);
    Fixture { graph, out, flags, scratch }
}

fn compile(graph: Graph) -> Plan {
    graph.compile(&CompileOptions::default()).unwrap()
}

#[test]
fn gate_precedes_conditional_pass() {
    let mut w = fixture();
    let update = kernel("update", &[ReadWrite]);
    pass(&mut w.graph, "find", &[(w.flags.slice(0, 1024), Write)]);
    w.graph.pass("update", &update).bind("b0", w.out).when(w.flags.slice(516, 4)).dispatch([7, 2, 1]).unwrap();
    let plan = compile(w.graph);
    let names: Vec<_> = plan.groups.iter().map(|g| plan.passes[g.passes[0]].name.as_str()).collect();
    assert_eq!(names, ["find", "update.when", "update"]);
    let PassKind::Compute { push, bindings, .. } = &plan.passes[1].kind else { panic!("the gate is a kernel") };
    let words: Vec<u32> = push.chunks(4).map(|w| u32::from_ne_bytes(w.try_into().unwrap())).collect();
    assert_eq!(words, [7, 2, 1, 0, 1, 1], "the word is the second of an aligned slice");
    assert_eq!(bindings[0].1, w.flags.slice(512, 8));
    assert_eq!(plan.groups[2].barrier.unwrap().dst_access, Accesses::INDIRECT_READ);
    assert!(dump::text(&plan).contains("update: update indirect if flags [516]"), "{plan}");
}

#[test]
fn indirect_counts_pass_through_gate() {
    let mut w = fixture();
    let counts = w.graph.external("counts", 64);
    let update = kernel("update", &[ReadWrite]);
    let pass = w.graph.pass("update", &update).bind("b0", w.out).when(w.flags.slice(0, 4));
    pass.dispatch_indirect(counts, 12).unwrap();
    let plan = compile(w.graph);
    let PassKind::Compute { push, .. } = &plan.passes[0].kind else { panic!("the gate is a kernel") };
    assert_eq!(push[12..24], [[1, 0, 0, 0], [0, 0, 0, 0], [3, 0, 0, 0]].concat());
}

#[test]
fn conditional_pass_discards_nothing() {
    let build = |conditional: bool| {
        let mut w = fixture();
        let over = kernel("over", &[Write]);
        w.graph.fill("first", w.out, 1).unwrap();
        let pass = w.graph.pass("second", &over).bind_discard("b0", w.out);
        let pass = if conditional { pass.when(w.flags.slice(0, 4)) } else { pass };
        pass.dispatch([1, 1, 1]).unwrap();
        compile(w.graph)
    };
    assert_eq!(build(false).culled, [0]);
    let plan = build(true);
    assert!(plan.culled.is_empty());
    let mut damaged = plan.clone();
    damaged.passes[2].discards.push(Buffer(0).slice(0, 256));
    let expected = "Pass [second] runs on a condition, but its group counts are constant or it discards contents.";
    assert_eq!(verify(&damaged).unwrap_err().to_string(), expected);
}

#[test]
fn conditional_writes_are_readable_on_same_condition_only() {
    let build = |then: Option<u64>, change: bool| {
        let mut w = fixture();
        let make = kernel("make", &[Write]);
        w.graph.pass("make", &make).bind("b0", w.scratch).when(w.flags.slice(0, 4)).dispatch([1, 1, 1]).unwrap();
        if change {
            pass(&mut w.graph, "change", &[(w.flags.slice(0, 4), Accumulate)]);
        }
        let take = kernel("take", &[Read, Write]);
        let pass = w.graph.pass("take", &take).bind("b0", w.scratch).bind("b1", w.out);
        let pass = then.into_iter().fold(pass, |pass, at| pass.when(w.flags.slice(at, 4)));
        pass.dispatch([1, 1, 1])
    };
    assert!(build(Some(0), false).is_ok());
    for (then, change) in [(None, false), (Some(4), false), (Some(0), true)] {
        assert!(matches!(build(then, change), Err(GraphError::Unwritten { .. })), "{then:?} {change}");
    }
}

#[test]
fn switches_are_conditions() {
    let mut w = fixture();
    let switch = w.graph.switch("debug");
    let update = kernel("update", &[ReadWrite]);
    w.graph.pass("update", &update).bind("b0", w.out).when(switch).dispatch([1, 1, 1]).unwrap();
    let plan = compile(w.graph);
    assert!(plan.buffers.iter().any(|info| info.switch && info.name == "debug" && info.kind == BufferKind::Uniform));
}

#[test]
fn invalid_conditions_are_rejected() {
    let mut w = fixture();
    let update = kernel("update", &[ReadWrite]);
    let pass = w.graph.pass("p", &update).bind("b0", w.out).when(w.flags.slice(4, 8));
    assert_eq!(
        pass.dispatch([1, 1, 1]).unwrap_err().to_string(),
        "Pass [p] runs on 8 bytes at offset 4 of buffer [flags], but a condition is a 32-bit word."
    );
    let pass = w.graph.pass("p", &update).bind("b0", w.out).when(w.scratch.slice(0, 4));
    assert_eq!(
        pass.dispatch([1, 1, 1]).unwrap_err().to_string(),
        "Pass [p] reads 4 bytes at offset 0 of transient buffer [scratch], which no earlier pass writes."
    );
    let mut graph = Graph::new("g");
    let out = graph.external("out", 256);
    let pass = graph.pass("p", &update).bind("b0", out).when(out.slice(0, 4));
    assert_eq!(
        pass.dispatch([1, 1, 1]).unwrap_err().to_string(),
        "Pass [p] runs on a condition, but its graph has no gate; call Graph::set_gate first."
    );
    let mut graph = Graph::new("g");
    graph.set_gate(&update);
    assert_eq!(
        graph.compile(&CompileOptions::default()).unwrap_err().to_string(),
        "Graph [g] cannot use kernel [update] as its gate: a gate reads [word] and [counts], writes [arguments], and has \
         24 bytes of constants."
    );
}
