//! Two-queue plans without a device: lane assignment, gain, and damaged waits.

use proptest::prelude::*;

use super::kernels::pass;
use super::random::recipes;
use super::*;
use crate::shader::Access::{Read, ReadWrite, Write};

/// Graph with a long and a short chain that join at the end, each with a transient.
fn two_chains() -> Graph {
    let mut graph = Graph::new("chains");
    let input = graph.input("input", 4096);
    let [left, right, start] = ["left", "right", "start"].map(|name| graph.transient(name, 4096));
    let out = graph.external("out", 4096);
    let s = |buffer: Buffer| buffer.slice(0, 4096);
    pass(&mut graph, "begin", &[(s(input), Read), (s(start), Write)]);
    pass(&mut graph, "l0", &[(s(start), Read), (s(left), Write)]);
    pass(&mut graph, "r0", &[(s(start), Read), (s(right), Write)]);
    for at in 1..4 {
        pass(&mut graph, &format!("l{at}"), &[(s(left), ReadWrite)]);
    }
    for at in 1..3 {
        pass(&mut graph, &format!("r{at}"), &[(s(right), ReadWrite)]);
    }
    pass(&mut graph, "end", &[(s(left), Read), (s(right), Read), (s(out), Write)]);
    graph
}

fn compile(graph: Graph, queues: Queues) -> Plan {
    graph.compile(&CompileOptions { queues, ..Default::default() }).unwrap()
}

fn lanes(plan: &Plan) -> Vec<(Lane, Vec<String>, Vec<usize>)> {
    let names = |segment: &Segment| {
        let passes = plan.groups[segment.groups.clone()].iter().flat_map(|group| &group.passes);
        passes.map(|&pass| plan.passes[pass].name.clone()).collect()
    };
    plan.segments.iter().map(|segment| (segment.lane, names(segment), segment.waits.clone())).collect()
}

#[test]
fn shorter_chain_runs_on_side_lane() {
    let plan = compile(two_chains(), Queues::Forced);
    let expected = [
        (Lane::Main, vec!["begin"], vec![]),
        (Lane::Side, vec!["r0", "r1", "r2"], vec![0]),
        (Lane::Main, vec!["l0", "l1", "l2", "l3"], vec![]),
        (Lane::Main, vec!["end"], vec![1]),
    ];
    let found = lanes(&plan);
    assert_eq!(found.len(), expected.len(), "{plan}");
    for ((lane, names, waits), (expected_lane, expected_names, expected_waits)) in found.into_iter().zip(expected) {
        assert_eq!((lane, waits), (expected_lane, expected_waits));
        assert_eq!(names, expected_names);
    }
    // The side lane places its own barriers.
    assert_eq!(plan.groups[1].barrier, None, "a wait precedes the first group of a side segment");
    assert!(plan.groups[2].barrier.is_some());
}

#[test]
fn one_queue_is_the_default() {
    let plan = compile(two_chains(), Queues::One);
    assert_eq!(plan.segments, [Segment { lane: Lane::Main, groups: 0..plan.groups.len(), waits: vec![], last: None }]);
}

#[test]
fn second_queue_requires_minimum_gain() {
    let two = |gain_percent, wait_nanoseconds| Queues::Two { gain_percent, wait_nanoseconds };
    let costs = |left: u64, right: u64| {
        let mut graph = two_chains();
        let chains = (0..4).map(move |at| (format!("l{at}"), left * (1 + at % 2)));
        graph.set_costs(chains.chain((0..3).map(move |at| (format!("r{at}"), right * (2 - at % 2)))));
        graph
    };
    // Groups of 1 + 2, 2 + 1, ... take 2 each on one queue; on two queues, the chains run independently.
    assert_eq!(compile(costs(100_000, 100_000), two(5, 1_000)).segments.len(), 4);
    assert_eq!(compile(costs(100_000, 100_000), two(40, 1_000)).segments.len(), 1, "below the requested gain");
    assert_eq!(compile(costs(100_000, 100_000), two(5, 400_000)).segments.len(), 1, "waits cost more");
    assert_eq!(compile(costs(100_000, 1_000), two(5, 1_000)).segments.len(), 1, "no gain");
}

#[test]
fn concurrent_passes_do_not_alias() {
    let plan = compile(two_chains(), Queues::Forced);
    let lives = plan.lifetimes();
    let right = plan.buffers.iter().position(|info| info.name == "right").unwrap();
    let left = plan.buffers.iter().position(|info| info.name == "left").unwrap();
    assert!(lives[right].unwrap().1 >= lives[left].unwrap().0);
    assert_ne!(plan.placements[right], plan.placements[left]);
    let mut damaged = plan.clone();
    damaged.placements[right] = damaged.placements[left];
    assert!(matches!(verify(&damaged), Err(VerifyError::Overlap { .. })));
}

fn verify_error_after(damage: impl FnOnce(&mut Plan)) -> String {
    let mut plan = compile(two_chains(), Queues::Forced);
    assert_eq!(verify(&plan), Ok(()));
    damage(&mut plan);
    verify(&plan).unwrap_err().to_string()
}

#[test]
fn damaged_waits_are_rejected() {
    assert_eq!(
        verify_error_after(|plan| plan.segments[1].waits.clear()),
        "Pass [r0] on buffer [start] has a read after write with pass [begin] on buffer [start] at byte 4096 within \
         1 replay(s), but no barrier between the queues comes before it."
    );
    assert_eq!(
        verify_error_after(|plan| plan.segments[3].waits.clear()),
        "Segment 3 of the plan does not wait for all of the second lane."
    );
    assert_eq!(
        verify_error_after(|plan| plan.segments[1].waits.push(3)),
        "Segment 1 of the plan waits for a later segment."
    );
    assert_eq!(
        verify_error_after(|plan| plan.segments[2].groups.end -= 1),
        "Segment 3 of the plan does not begin where the previous segment ends."
    );
    assert_eq!(
        verify_error_after(|plan| plan.segments.truncate(3)),
        "Segment 4 of the plan is missing: some groups are in no segment.".replace("Segment 4", "Segment 3")
    );
    assert_eq!(
        verify_error_after(|plan| plan.segments[0].lane = Lane::Side),
        "Segment 0 of the plan is not on the main lane; the first and the last must be."
    );
    assert!(verify_error_after(|plan| plan.groups[2].barrier = None).contains("Pass [r1] on buffer [right] has a"));
}

#[test]
fn second_queue_outputs_are_host_visible() {
    let mut graph = two_chains();
    let seen = graph.external("seen", 4096);
    let right = Buffer(2);
    graph.copy("look", right, seen).unwrap();
    let plan = compile(graph, Queues::Forced);
    let side = plan.segments.iter().position(|segment| segment.lane == Lane::Side).unwrap();
    let on_side = plan.groups[plan.segments[side].groups.clone()].iter().flat_map(|group| &group.passes);
    if on_side.into_iter().any(|&pass| plan.passes[pass].name == "look") {
        let mut damaged = plan.clone();
        damaged.segments[side].last = None;
        assert!(matches!(verify(&damaged), Err(VerifyError::OutputHidden { .. })), "{plan}");
    } else {
        panic!("the copy does not leave the main lane in\n{plan}");
    }
}

#[test]
fn dumps_show_both_lanes() {
    let plan = compile(two_chains(), Queues::Forced);
    let text = dump::text(&plan);
    assert!(text.contains("segment 1, side, waits for 0"), "{text}");
    let json: serde_json::Value = serde_json::from_str(&dump::json(&plan)).unwrap();
    assert_eq!(json["segments"][1]["lane"], "side");
    assert_eq!(json["segments"][3]["waits"], serde_json::json!([1]));
    assert!(dump::dot(&plan).contains("side: group 1"), "{}", dump::dot(&plan));
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 300, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn verifier_detects_missing_main_lane_waits(mut recipe in recipes(40)) {
        recipe.options.queues = Queues::Forced;
        let plan = recipe.build().compile(&recipe.options).unwrap();
        for (at, segment) in plan.segments.iter().enumerate() {
            if segment.lane == Lane::Main && !segment.waits.is_empty() {
                let mut damaged = plan.clone();
                damaged.segments[at].waits.clear();
                prop_assert!(verify(&damaged).is_err(), "the waits of segment {} are not detected in\n{}", at, plan);
            }
        }
    }
}

/// Guards the properties above: random graphs must contain excursions.
#[test]
fn random_graphs_use_both_queues() {
    use proptest::strategy::{Strategy, ValueTree};
    let mut runner = proptest::test_runner::TestRunner::deterministic();
    let [mut with, mut moved] = [0; 2];
    for _ in 0..200 {
        let mut recipe = recipes(40).new_tree(&mut runner).unwrap().current();
        recipe.options.queues = Queues::Forced;
        let plan = recipe.build().compile(&recipe.options).unwrap();
        let side = plan.segments.iter().filter(|segment| segment.lane == Lane::Side);
        let groups: usize = side.clone().map(|segment| segment.groups.len()).sum();
        with += usize::from(groups > 0);
        moved += groups;
    }
    println!("{with} of 200 plans with a second lane, {moved} groups on it");
    assert!(with > 30 && moved > 40, "{with} {moved}");
}
