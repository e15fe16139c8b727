//! Text, JSON and DOT output of a plan. The text is a golden file; every change needs a reason.

use super::kernels::{kernel, pass, with_kinds};
use super::*;
use crate::shader::Access::{Accumulate, Read, ReadWrite, Write};
use crate::shader::BindingKind;

/// Builds a small training step: project, count, scan, blend indirectly, backward pass, update.
pub(super) fn step() -> Graph {
    let mut graph = Graph::new("step");
    let camera = graph.uniform("camera", 256);
    let target = graph.input("target", 4096);
    let means = graph.external("means", 8192);
    let moments = graph.external("moments", 8192);
    let stats = graph.external("stats", 64);
    let splats = graph.transient("splats", 16384);
    let counts = graph.transient("counts", 2048);
    let arguments = graph.transient("arguments", 16);
    let image = graph.transient("image", 4096);
    let image_grad = graph.transient("image_grad", 4096);
    let splats_grad = graph.transient("splats_grad", 16384);
    let unused = graph.transient("debug", 4096);

    let project = with_kinds(
        "project",
        &[(BindingKind::Uniform, Read), (BindingKind::Storage, Read), (BindingKind::Storage, Write)],
    );
    graph.fill("zero_splats_grad", splats_grad, 0).unwrap();
    graph.fill("zero_stats", stats, 0).unwrap();
    let project = graph.pass("project", &project).bind("b0", camera).bind("b1", means).bind("b2", splats);
    project.dispatch([16, 1, 1]).unwrap();
    pass(&mut graph, "count", &[(splats.slice(0, 16384), Read), (counts.slice(0, 2048), Write)]);
    pass(&mut graph, "scan", &[(counts.slice(0, 2048), ReadWrite), (arguments.slice(0, 16), Write)]);
    let blend = kernel("blend", &[Read, Read, Write]);
    let blend = graph.pass("blend", &blend).bind("b0", splats).bind("b1", counts).bind_discard("b2", image);
    blend.dispatch_indirect(arguments, 0).unwrap();
    graph.copy("debug", image, unused).unwrap();
    pass(
        &mut graph,
        "loss",
        &[
            (image.slice(0, 4096), Read),
            (target.slice(0, 4096), Read),
            (image_grad.slice(0, 4096), Write),
            (stats.slice(0, 4), Accumulate),
        ],
    );
    let blend_bwd = kernel("blend_bwd", &[Read, Read, Accumulate]);
    let blend_bwd = graph.pass("blend_bwd", &blend_bwd).bind("b0", image_grad).bind("b1", splats);
    blend_bwd.bind("b2", splats_grad).dispatch_indirect(arguments, 0).unwrap();
    pass(&mut graph, "smooth_bwd", &[(splats.slice(0, 16384), Read), (splats_grad.slice(0, 16384), Accumulate)]);
    pass(
        &mut graph,
        "adam",
        &[(splats_grad.slice(0, 16384), Read), (moments.slice(0, 8192), ReadWrite), (means.slice(0, 8192), ReadWrite)],
    );
    graph
}

fn plan() -> Plan {
    step().compile(&CompileOptions::default()).unwrap()
}

#[test]
fn text_matches_golden_file() {
    let golden = include_str!("step.txt");
    let text = dump::text(&plan());
    assert!(text == golden, "the plan of the golden step is now\n{text}");
}

#[test]
fn json_matches_plan() {
    let plan = plan();
    let json: serde_json::Value = serde_json::from_str(&dump::json(&plan)).unwrap();
    assert_eq!(json["name"], "step");
    assert_eq!(json["key"], format!("{:016x}", plan.key));
    assert_eq!(json["arena_bytes"], plan.arena_bytes);
    assert_eq!(json["groups"].as_array().unwrap().len(), plan.groups.len());
    assert_eq!(json["culled"].as_array().unwrap().len(), plan.culled.len());
    let blend = json["passes"].as_array().unwrap().iter().find(|pass| pass["name"] == "blend").unwrap();
    assert_eq!(blend["does"], "blend indirect");
    assert_eq!(blend["accesses"][3]["name"], "group counts");
    assert_eq!(blend["accesses"][3]["use"], "indirect");
    assert_eq!(blend["accesses"][2]["discards"], true);
    let barrier = &json["final_barrier"];
    assert_eq!(barrier["dst_stage"], serde_json::json!(["transfer", "host"]));
    assert_eq!(barrier["dst_access"], serde_json::json!(["transfer_read", "host_read"]));
}

#[test]
fn dot_contains_every_pass_and_is_balanced() {
    let plan = plan();
    let dot = dump::dot(&plan);
    for index in 0..plan.passes.len() {
        assert!(dot.contains(&format!("p{index} [label=")), "pass {index} in\n{dot}");
    }
    assert_eq!(dot.matches('{').count(), dot.matches('}').count());
    assert!(dot.contains("[label=\"splats, arguments\"]") || dot.contains("[label=\"counts, arguments\"]"), "{dot}");
    let quoted = Graph::new("a \"b\" \\").compile(&CompileOptions::default()).unwrap();
    assert!(dump::dot(&quoted).starts_with("digraph \"a \\\"b\\\" \\\\\" {"));
}
