//! Histories, without a device.

use super::kernels::pass;
use super::*;
use crate::shader::Access::{Read, ReadWrite, Write};

/// Graph that reads the previous half of a history and writes the current one.
fn filter() -> (Graph, History) {
    let mut graph = Graph::new("filter");
    let input = graph.input("input", 256);
    let history = graph.history("state", 256, 0);
    let (previous, current) = (history.previous.slice(0, 256), history.current.slice(0, 256));
    pass(&mut graph, "blend", &[(input.slice(0, 256), Read), (previous, Read), (current, Write)]);
    (graph, history)
}

fn plan() -> Plan {
    filter().0.compile(&CompileOptions::default()).unwrap()
}

#[test]
fn next_replay_sees_current_half() {
    let plan = plan();
    // The last replay's write has been available since its end. The half written two replays ago, which copies may
    // have read, is overwritten.
    assert_eq!(plan.groups[0].barrier.unwrap().to_string(), "transfer[none] -> compute[storage_read]");
    let mut damaged = plan.clone();
    damaged.groups[0].barrier = None;
    assert_eq!(
        verify(&damaged).unwrap_err().to_string(),
        "Pass [blend] on buffer [state (previous)] has a read after write with pass [blend] on buffer [state] at byte 0 \
         within 2 replay(s), but no barrier makes the write visible to storage_read."
    );
}

#[test]
fn hazards_span_two_replays() {
    let mut graph = Graph::new("write");
    let history = graph.history("state", 256, 0);
    pass(&mut graph, "write", &[(history.current.slice(0, 256), Write)]);
    let plan = graph.compile(&CompileOptions::default()).unwrap();
    let mut damaged = plan.clone();
    damaged.groups[0].barrier = None;
    let error = verify(&damaged).unwrap_err().to_string();
    assert!(error.contains("within 3 replay(s)"), "{error}");
}

#[test]
fn previous_half_is_read_only() {
    let (mut graph, history) = filter();
    assert_eq!(
        graph.fill("fill", history.previous, 0).unwrap_err().to_string(),
        "Pass [fill] writes buffer [state (previous)] through [fill], but it is the previous half of a history."
    );
    let mut graph = Graph::new("g");
    let history = graph.history("state", 256, 0);
    pass(&mut graph, "in place", &[(history.current.slice(0, 256), ReadWrite)]);
    graph.compile(&CompileOptions::default()).unwrap();
}

#[test]
fn dumps_and_keys_include_histories() {
    let plan = plan();
    let text = dump::text(&plan);
    assert!(text.contains("state history 256 bytes, initially 0x0, swaps with state (previous)"), "{text}");
    let json: serde_json::Value = serde_json::from_str(&dump::json(&plan)).unwrap();
    assert_eq!(json["buffers"][2]["partner"], 1);
    let build = |value| {
        let mut graph = Graph::new("g");
        graph.history("state", 256, value);
        graph.compile(&CompileOptions::default()).unwrap().key
    };
    assert_ne!(build(0), build(1));
}

#[test]
fn mismatched_pair_is_rejected() {
    let mut damaged = plan();
    damaged.buffers[1].bytes = 128;
    damaged.passes[0].accesses[1].0.bytes = 128;
    if let PassKind::Compute { bindings, .. } = &mut damaged.passes[0].kind {
        bindings[1].1.bytes = 128;
    }
    assert_eq!(
        verify(&damaged).unwrap_err().to_string(),
        "Buffer [state (previous)] belongs to a history whose two buffers differ."
    );
}
