//! Graphs joined, and plans kept.

use super::kernels::{gate, kernel, pass};
use super::*;
use crate::format::ImageFormat;
use crate::shader::Access::{Read, ReadWrite, Write};

/// Squares `x` into `y`.
fn forward() -> (Graph, [Buffer; 2]) {
    let mut graph = Graph::new("forward");
    let x = graph.input("x", 256);
    let y = graph.external("y", 256);
    let middle = graph.transient("middle", 256);
    pass(&mut graph, "load", &[(x.slice(0, 256), Read), (middle.slice(0, 256), Write)]);
    pass(&mut graph, "square", &[(middle.slice(0, 256), Read), (y.slice(0, 256), Write)]);
    (graph, [x, y])
}

/// Changes `parameters` by `gradient`.
fn optimizer() -> (Graph, [Buffer; 2]) {
    let mut graph = Graph::new("optimizer");
    let gradient = graph.input("gradient", 256);
    let parameters = graph.external("parameters", 256);
    pass(&mut graph, "step", &[(gradient.slice(0, 256), Read), (parameters.slice(0, 256), ReadWrite)]);
    (graph, [gradient, parameters])
}

/// Both, and what is between them in a transient.
fn joined() -> (Graph, Buffer) {
    let mut graph = Graph::new("step");
    let parameters = graph.external("parameters", 256);
    let between = graph.transient("between", 512);
    let (first, [x, y]) = forward();
    graph.join(first, &[(x, parameters), (y, between)]).unwrap();
    let (second, [gradient, theirs]) = optimizer();
    let names = graph.join(second, &[(gradient, between), (theirs, parameters)]).unwrap();
    assert_eq!((names.buffer(gradient), names.buffer(theirs)), (between, parameters));
    (graph, parameters)
}

fn compile(graph: Graph) -> Plan {
    graph.compile(&CompileOptions::default()).unwrap()
}

#[test]
fn joined_graphs_compile_as_one() {
    let plan = compile(joined().0);
    let names: Vec<_> = plan.buffers.iter().map(|info| info.name.as_str()).collect();
    assert_eq!(names, ["parameters", "between", "middle"], "nothing stands for what was mapped");
    assert_eq!(plan.groups.len(), 3);
    // As if it had been declared in one piece.
    let mut whole = Graph::new("step");
    let [parameters, between] = [whole.external("parameters", 256), whole.transient("between", 512)];
    let middle = whole.transient("middle", 256);
    pass(&mut whole, "load", &[(parameters.slice(0, 256), Read), (middle.slice(0, 256), Write)]);
    pass(&mut whole, "square", &[(middle.slice(0, 256), Read), (between.slice(0, 256), Write)]);
    pass(&mut whole, "step", &[(between.slice(0, 256), Read), (parameters.slice(0, 256), ReadWrite)]);
    assert_eq!(compile(whole).key, plan.key);
}

#[test]
fn everything_moves_with_its_buffers() {
    let mut other = Graph::new("other");
    other.set_gate(&gate());
    let history = other.history("history", 256, 3);
    let image = other.transient_image("image", [4, 4], ImageFormat::Rgba32Float);
    let flags = other.external("flags", 16);
    let switch = other.switch("switch");
    other.copy_to_image("in", history.previous, image).unwrap();
    other.copy_from_image("out", image, history.current).unwrap();
    other.clear_image("clear", image, [0.0; 4]).unwrap();
    let update = kernel("update", &[ReadWrite]);
    other.pass("a", &update).bind("b0", history.current).when(flags.slice(4, 4)).dispatch([1, 1, 1]).unwrap();
    other.pass("b", &update).bind("b0", history.current).when(switch).dispatch([1, 1, 1]).unwrap();
    other.fill("f", flags.slice(8, 4), 1).unwrap();
    other.copy("c", flags.slice(8, 4), flags.slice(12, 4)).unwrap();
    let alone = compile(other.clone());

    let mut graph = Graph::new("graph");
    let ours = graph.external("ours", 64);
    let names = graph.join(other, &[(flags, ours)]).unwrap();
    let plan = compile(graph);
    assert_eq!(plan.groups.len(), alone.groups.len());
    assert_eq!(plan.buffers[names.image(image).index()].name, "image");
    let pair = plan.buffers[names.buffer(history.current).index()].pair.unwrap();
    assert_eq!(pair.partner, names.buffer(history.previous));
    assert!(plan.passes.iter().any(|pass| pass.condition == Some(ours.slice(4, 4))));
}

#[test]
fn what_does_not_fit_is_named() {
    let said = |build: &dyn Fn(&mut Graph) -> Result<Joined, GraphError>| {
        let mut graph = Graph::new("g");
        let error = build(&mut graph).unwrap_err().to_string();
        assert!(graph.compile(&CompileOptions::default()).is_err(), "half a graph does not compile");
        error
    };
    let (other, [x, y]) = forward();
    assert_eq!(
        said(&|g| {
            let small = g.external("small", 64);
            g.join(other.clone(), &[(x, small)])
        }),
        "Buffer [x] of graph [forward] cannot be taken for [small]: it is larger."
    );
    assert_eq!(
        said(&|g| {
            let input = g.input("input", 256);
            g.join(other.clone(), &[(y, input)])
        }),
        "Pass [square] writes buffer [input] through [join], but it is a read-only input."
    );
    assert_eq!(
        said(&|g| {
            let scratch = g.transient("scratch", 256);
            g.join(other.clone(), &[(x, scratch)])
        }),
        "Pass [load] reads 256 bytes at offset 0 of transient buffer [scratch], which no earlier pass writes."
    );
    assert_eq!(
        said(&|g| {
            let image = g.transient_image("image", [4, 4], ImageFormat::Rgba32Float);
            g.join(other.clone(), &[(x, image.into())])
        }),
        "Buffer [x] of graph [forward] cannot be taken for [image]: it is of another size and format."
    );
    assert_eq!(
        said(&|g| {
            let [a, b] = ["a", "b"].map(|name| g.external(name, 256));
            g.join(other.clone(), &[(x, a), (x, b)])
        }),
        "Buffer [x] of graph [forward] cannot be taken for [b]: it is taken for two buffers."
    );
    assert_eq!(
        said(&|g| {
            let a = g.external("a", 256);
            g.join(other.clone(), &[(Buffer(2), a)])
        }),
        "Buffer [middle] of graph [forward] cannot be taken for [a]: it is a transient."
    );
    let (both, [gradient, parameters]) = optimizer();
    assert_eq!(
        said(&|g| {
            let a = g.external("a", 256);
            g.join(both.clone(), &[(gradient, a), (parameters, a)])
        }),
        "Pass [step] touches the same bytes of buffer [a] as [one] and as [another] and writes them."
    );
}

#[test]
fn plans_are_kept_by_declaration() {
    let mut cache = PlanCache::new(2);
    let options = CompileOptions::default();
    let first = cache.compile(joined().0, &options).unwrap();
    let again = cache.compile(joined().0, &options).unwrap();
    assert!(std::sync::Arc::ptr_eq(&first, &again));
    assert_eq!(cache.counts(), (1, 1));
    // Other options, another graph: the one used longest ago goes.
    let apart = CompileOptions { alias: false, ..options };
    assert!(!std::sync::Arc::ptr_eq(&first, &cache.compile(joined().0, &apart).unwrap()));
    cache.compile(joined().0, &options).unwrap();
    cache.compile(forward().0, &options).unwrap();
    assert_eq!((cache.counts(), cache.len()), ((2, 3), 2));
    cache.compile(joined().0, &options).unwrap();
    assert_eq!(cache.counts(), (3, 3));
    cache.compile(joined().0, &apart).unwrap();
    assert_eq!(cache.counts(), (3, 4));
    // Mistakes are not plans.
    let (mut graph, parameters) = joined();
    graph.keep(Buffer(99));
    let _ = parameters;
    assert!(cache.compile(graph, &options).is_err());
    cache.clear();
    assert!(cache.is_empty());
}

#[test]
fn equal_keys_do_not_make_equal_declarations() {
    // A key that two declarations share is what the comparison is there for: take one plan for the other.
    let plan = compile(forward().0);
    assert!(crate::graph::cache::same(&forward().0, &plan));
    assert!(!crate::graph::cache::same(&optimizer().0, &plan));
}
