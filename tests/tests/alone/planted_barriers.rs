//! Plans with a missing or weakened barrier: the verifier refuses each. The validation layer reports those hazards that
//! it can detect when the plan is run regardless.
//!
//! The two tests of the layer tell which hazards its silence excludes, and which ones only the verifier detects.

use sgs_engine::exec::{ExecOptions, Executor};
use sgs_engine::graph::{
    Accesses, Barrier, Buffer, BufferKind, CompileOptions, Dispatch, Graph, PassKind, Plan, VerifyError, verify,
};
use sgs_engine::{Device, DeviceBuffer, DeviceOptions, Location};
use sgs_tests::kernels::kernel;
use sgs_tests::turn;
use std::sync::Arc;

const BYTES: u64 = 256;

fn device() -> Device {
    let select = std::env::var("SGS_TEST_DEVICE").ok();
    Device::open(&DeviceOptions { select, validation: true, ..Default::default() }).unwrap()
}

/// Adds a pass that binds buffers in the order of the kernel's bindings.
fn pass(graph: &mut Graph, name: &str, stage: &str, bound: &[Buffer]) {
    let shader = kernel(stage);
    let mut pass = graph.pass(name, &shader).push(&1u32.to_ne_bytes());
    for (binding, buffer) in shader.bindings.iter().zip(bound) {
        pass = pass.bind(&binding.name, *buffer);
    }
    pass.dispatch([1, 1, 1]).unwrap();
}

/// Declares four external buffers and an input.
fn buffers(graph: &mut Graph) -> [Buffer; 5] {
    let [a, b, c, d] = ["a", "b", "c", "d"].map(|name| graph.external(name, BYTES));
    [a, b, c, d, graph.input("given", BYTES)]
}

/// Hazard: its name, its name in the layer's messages, and the two passes that cause it.
type Case = (&'static str, &'static str, fn(&mut Graph));

/// Hazards that the layer detects.
const SEEN: [Case; 11] = [
    ("a kernel reads what a kernel wrote", "READ-AFTER-WRITE", |g| {
        let [a, b, .., provided] = buffers(g);
        pass(g, "first", "map", &[provided, a]);
        pass(g, "second", "map", &[a, b]);
    }),
    ("a kernel overwrites what a kernel read", "WRITE-AFTER-READ", |g| {
        let [a, b, .., provided] = buffers(g);
        pass(g, "first", "map", &[a, b]);
        pass(g, "second", "map", &[provided, a]);
    }),
    ("a kernel adds to what a kernel wrote", "READ-AFTER-WRITE", |g| {
        let [a, .., provided] = buffers(g);
        pass(g, "first", "map", &[provided, a]);
        pass(g, "second", "sum", &[provided, a]);
    }),
    ("a kernel changes what a kernel added to", "WRITE-AFTER-READ", |g| {
        let [a, .., provided] = buffers(g);
        pass(g, "first", "sum", &[provided, a]);
        pass(g, "second", "change", &[provided, a]);
    }),
    ("a kernel reads what a fill wrote", "READ-AFTER-WRITE", |g| {
        let [a, b, ..] = buffers(g);
        g.fill("first", a, 1).unwrap();
        pass(g, "second", "map", &[a, b]);
    }),
    ("a kernel adds to what a fill wrote", "READ-AFTER-WRITE", |g| {
        let [a, .., provided] = buffers(g);
        g.fill("first", a, 1).unwrap();
        pass(g, "second", "sum", &[provided, a]);
    }),
    ("a fill overwrites what a kernel read", "WRITE-AFTER-READ", |g| {
        let [a, b, ..] = buffers(g);
        pass(g, "first", "map", &[a, b]);
        g.fill("second", a, 1).unwrap();
    }),
    ("a copy reads what a kernel wrote", "READ-AFTER-WRITE", |g| {
        let [a, b, .., provided] = buffers(g);
        pass(g, "first", "map", &[provided, a]);
        g.copy("second", a, b).unwrap();
    }),
    ("a copy overwrites some of what a fill wrote", "WRITE-AFTER-WRITE", |g| {
        let [a, .., provided] = buffers(g);
        g.fill("first", a, 1).unwrap();
        g.copy("second", provided.slice(0, 64), a.slice(64, 64)).unwrap();
    }),
    ("a fill overwrites some of what a kernel wrote", "WRITE-AFTER-WRITE", |g| {
        let [a, .., provided] = buffers(g);
        pass(g, "first", "map", &[provided, a]);
        g.fill("second", a.slice(64, 64), 1).unwrap();
    }),
    ("the device reads group counts that a kernel wrote", "READ-AFTER-WRITE", |g| {
        let [a, b, .., provided] = buffers(g);
        pass(g, "first", "counts", &[provided, a]);
        let map = kernel("map");
        let second = g.pass("second", &map).push(&[0; 4]).bind("from", provided).bind("to", b);
        second.dispatch_indirect(a, 0).unwrap();
    }),
];

/// Hazards that the layer misses up to version 1.3.239. These are writes of kernels after writes of kernels, with or
/// without reads. Writes by atomics are missed as well; the layer takes them for reads.
const UNSEEN: [Case; 4] = [
    ("a kernel overwrites some of what a kernel wrote", "WRITE-AFTER-WRITE", |g| {
        let [a, .., provided] = buffers(g);
        pass(g, "first", "map", &[provided, a]);
        pass(g, "second", "part", &[provided, a]);
    }),
    ("a kernel changes what a kernel wrote", "WRITE", |g| {
        let [a, .., provided] = buffers(g);
        pass(g, "first", "map", &[provided, a]);
        pass(g, "second", "change", &[provided, a]);
    }),
    ("a kernel changes what a kernel changed", "WRITE", |g| {
        let [a, .., provided] = buffers(g);
        pass(g, "first", "change", &[provided, a]);
        pass(g, "second", "change", &[provided, a]);
    }),
    ("a kernel reads what a kernel added to", "READ-AFTER-WRITE", |g| {
        let [a, b, .., provided] = buffers(g);
        pass(g, "first", "sum", &[provided, a]);
        pass(g, "second", "map", &[a, b]);
    }),
];

/// Layer of Debian 12. Newer layers word messages differently and detect other hazards.
const OLDER: (u32, u32, u32) = (1, 3, 239);

fn plan(declare: fn(&mut Graph)) -> Plan {
    let mut graph = Graph::new("planted");
    declare(&mut graph);
    let plan = graph.compile(&CompileOptions::default()).unwrap();
    assert_eq!((plan.groups.len(), plan.culled.len()), (2, 0), "{plan}");
    plan
}

/// Runs a plan, sound or not, and returns the layer's messages.
fn run(device: &Device, plan: &Plan) -> Vec<String> {
    let plan = Arc::new(plan.clone());
    let mut exec = Executor::new(device, plan.clone(), ExecOptions::default()).unwrap();
    let mut memory: Vec<DeviceBuffer> = Vec::new();
    for (buffer, info) in plan.buffers().filter(|(_, info)| info.kind == BufferKind::External) {
        let buffer_memory = device.buffer(&info.name, info.bytes, Location::Readback).unwrap();
        // Zeros make indirect group counts zero or small.
        buffer_memory.write(0, &vec![0; info.bytes as usize]).unwrap();
        exec.bind(buffer, &buffer_memory).unwrap();
        memory.push(buffer_memory);
    }
    exec.submit(&[]).unwrap();
    exec.finish().unwrap();
    device.messages().take()
}

#[test]
fn a_missing_barrier_is_refused_and_reported() {
    let _turn = turn();
    let device = device();
    for (what, hazard, declare) in SEEN {
        let sound = plan(declare);
        assert_eq!(run(&device, &sound), [""; 0], "{what}: the sound plan");
        let mut damaged = sound.clone();
        assert!(damaged.groups[1].barrier.take().is_some(), "{what}");
        assert!(matches!(verify(&damaged), Err(VerifyError::Hazard { .. })), "{what}: {:?}", verify(&damaged));
        let messages = run(&device, &damaged);
        let reported = messages.iter().any(|m| m.contains("SYNC-HAZARD") && m.contains(hazard));
        assert!(reported, "{what}: the layer says {messages:?}");
    }
}

#[test]
fn a_weakened_barrier_is_refused_and_reported() {
    let _turn = turn();
    let device = device();
    let (what, hazard, declare) = SEEN[0];
    let sound = plan(declare);
    let barrier = sound.groups[1].barrier.unwrap();
    for (less, weak) in [
        ("nothing is made available", Barrier { src_access: Accesses::NONE, ..barrier }),
        ("nothing is made visible", Barrier { dst_access: Accesses::NONE, ..barrier }),
        ("visible to the wrong access", Barrier { dst_access: Accesses::UNIFORM_READ, ..barrier }),
    ] {
        let mut damaged = sound.clone();
        damaged.groups[1].barrier = Some(weak);
        assert!(matches!(verify(&damaged), Err(VerifyError::Hazard { .. })), "{less}: {:?}", verify(&damaged));
        let messages = run(&device, &damaged);
        assert!(messages.iter().any(|m| m.contains(hazard)), "{what}, {less}: the layer says {messages:?}");
    }
}

#[test]
fn aliased_memory_without_a_barrier_is_refused_and_reported() {
    let _turn = turn();
    let mut graph = Graph::new("hands");
    let [a, b, .., provided] = buffers(&mut graph);
    let [first, second] = ["first", "second"].map(|name| graph.transient(name, BYTES));
    pass(&mut graph, "make first", "map", &[provided, first]);
    pass(&mut graph, "use first", "map", &[first, a]);
    // This pass follows the previous one, so the lifetimes of the two transients do not overlap.
    pass(&mut graph, "make second", "map", &[a, second]);
    pass(&mut graph, "use second", "map", &[second, b]);
    let sound = graph.compile(&CompileOptions::default()).unwrap();
    let place = |buffer: Buffer| sound.placements[buffer.index()];
    assert_eq!((sound.groups.len(), sound.arena_bytes), (4, BYTES), "{sound}");
    assert_eq!(place(first), place(second));
    let device = device();
    assert_eq!(run(&device, &sound), [""; 0]);
    // Without the data flow through `a`, the two passes share only memory.
    let mut damaged = sound.clone();
    damaged.groups[2].barrier = None;
    assert!(verify(&damaged).is_err());
    let messages = run(&device, &damaged);
    // A newer layer reports only the first hazard of a dispatch: here that of `a`.
    let of_the_arena = |m: &String| m.contains("arena of hands") && m.contains("WRITE-AFTER-READ");
    let of_the_flow = |m: &String| m.contains("[a]") && m.contains("READ-AFTER-WRITE");
    let newer = device.validation_version().is_some_and(|version| version > OLDER);
    assert!(messages.iter().any(|m| of_the_arena(m) || newer && of_the_flow(m)), "{messages:?}");
}

#[test]
fn verifier_finds_hazards_missed_by_validation_layer() {
    let _turn = turn();
    let device = device();
    let blind = device.validation_version().is_some_and(|version| version <= OLDER);
    for (what, hazard, declare) in UNSEEN {
        let sound = plan(declare);
        assert_eq!(run(&device, &sound), [""; 0], "{what}: the sound plan");
        let mut damaged = sound.clone();
        assert!(damaged.groups[1].barrier.take().is_some(), "{what}");
        assert!(matches!(verify(&damaged), Err(VerifyError::Hazard { .. })), "{what}: {:?}", verify(&damaged));
        let messages = run(&device, &damaged);
        if blind {
            assert_eq!(messages, [""; 0], "{what}: the layer sees more than docs/project/testing.md says");
        } else {
            // Newer layers detect some of these hazards. Any message must be about the planted one.
            assert!(messages.iter().all(|m| m.contains(hazard)), "{what}: {messages:?}");
        }
    }
}

#[test]
fn messages_name_the_plan_the_group_the_pass_and_the_objects() {
    let _turn = turn();
    let device = device();
    let mut graph = Graph::new("labeled plan");
    let middle = graph.external("middle buffer", BYTES);
    let out = graph.external("out buffer", BYTES);
    let provided = graph.input("given", BYTES);
    pass(&mut graph, "maker pass", "map", &[provided, middle]);
    pass(&mut graph, "reader pass", "twice", &[middle, out]);
    let mut plan = graph.compile(&CompileOptions::default()).unwrap();
    assert_eq!(run(&device, &plan), [""; 0]);
    let newer = device.validation_version().is_some_and(|version| version > OLDER);
    plan.groups[1].barrier = None;
    let messages = run(&device, &plan);
    let message = messages.first().expect("the layer reports the missing barrier");
    // The buffer and the pipeline come first, then labels, outermost first. A newer layer passes them itself.
    let place = if newer { "In the command buffer" } else { "Recording" };
    assert!(message.contains(&format!("{place}: labeled plan, group 1, reader pass.")), "{message}");
    for name in ["[middle buffer]", "[twice]"] {
        assert!(message.contains(name), "{name} is missing: {message}");
    }
    assert!(newer || message.contains("[labeled plan]"), "the command buffer is missing: {message}");
    assert!(!message.contains("group 0, maker pass"), "a label was not closed: {message}");
    // For the command buffer itself, the layer lists the labels that were recorded in it.
    let maker = plan.passes.iter_mut().find(|pass| pass.name == "maker pass").unwrap();
    let PassKind::Compute { dispatch, .. } = &mut maker.kind else { panic!("a kernel is a kernel") };
    *dispatch = Dispatch::Groups([1, 65_536, 1]);
    let messages = run(&device, &plan);
    let seen = messages.iter().any(|m| m.contains("In the command buffer: labeled plan, group 0, maker pass."));
    assert!(seen, "{messages:?}");
}
