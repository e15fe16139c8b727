//! Error messages of invalid declarations.

use std::sync::Arc;

use super::kernels::{kernel, pass, with_kinds};
use super::*;
use crate::shader::Access::{Accumulate, Read, ReadWrite, Write};
use crate::shader::{BindingKind, Shader};

/// Graph with one buffer of each kind, and a kernel that reads one and writes one.
struct Fixture {
    graph: Graph,
    out: Buffer,
    input: Buffer,
    uniform: Buffer,
    scratch: Buffer,
    map: Arc<Shader>,
}

fn fixture() -> Fixture {
    let mut graph = Graph::new("world");
    Fixture {
        out: graph.external("out", 1024),
        input: graph.input("input", 1024),
        uniform: graph.uniform("uniform", 256),
        scratch: graph.transient("scratch", 1024),
        map: kernel("map", &[Read, Write]),
        graph,
    }
}

impl Fixture {
    fn map(&mut self, from: impl Into<Slice>, to: impl Into<Slice>) -> String {
        let pass = self.graph.pass("p", &self.map).bind("b0", from).bind("b1", to);
        pass.dispatch([1, 1, 1]).unwrap_err().to_string()
    }

    fn compile(self) -> String {
        self.graph.compile(&CompileOptions::default()).unwrap_err().to_string()
    }
}

#[test]
fn prefix_applies_to_later_declarations() {
    let mut w = fixture();
    w.graph.set_prefix("second.");
    let scratch = w.graph.transient("scratch", 1024);
    let external = w.graph.external("given", 64);
    w.graph.fill("clear", scratch, 0).unwrap();
    assert!(w.map(scratch, w.input).starts_with("Pass [second.p] "));
    w.graph.set_prefix("");
    w.graph.fill("clear", w.scratch, 0).unwrap();
    let name = |b: Buffer| w.graph.buffers[b.index()].name.as_str();
    assert_eq!([name(w.scratch), name(scratch), name(external)], ["scratch", "second.scratch", "given"]);
    let passes: Vec<&str> = w.graph.passes.iter().map(|p| p.name.as_str()).collect();
    assert_eq!(passes, ["second.clear", "clear"]);
}

#[test]
fn invalid_slices_are_rejected() {
    let mut w = fixture();
    assert_eq!(
        w.map(w.input.slice(512, 1024), w.out),
        "Pass [p] uses 1024 bytes of buffer [input] at offset 512, which end after its 1024 bytes."
    );
    assert_eq!(
        w.map(w.input.slice(u64::MAX, 2), w.out),
        "Pass [p] uses 2 bytes of buffer [input] at offset 18446744073709551615, which end after its 1024 bytes."
    );
    assert_eq!(
        w.map(w.input.slice(512, 0), w.out),
        "Pass [p] uses 0 bytes of buffer [input] at offset 512, but a slice needs at least 1."
    );
    assert_eq!(w.map(Buffer(9), w.out), "Pass [p] uses buffer number 9, but its graph has 4 buffers.");
}

#[test]
fn invalid_bindings_are_rejected() {
    let mut w = fixture();
    let error = w.graph.pass("p", &w.map).bind("b0", w.input).bind("b1", w.out).bind("c", w.out).dispatch([1, 1, 1]);
    assert_eq!(error.unwrap_err().to_string(), "Pass [p] binds [c], but kernel [map] has only the bindings [b0, b1].");
    let error = w.graph.pass("p", &w.map).bind("b0", w.input).dispatch([1, 1, 1]).unwrap_err();
    assert_eq!(error.to_string(), "Pass [p] leaves binding [b1] of kernel [map] unbound.");
    let twice = w.graph.pass("p", &w.map).bind("b0", w.input).bind("b1", w.out).bind("b0", w.uniform);
    assert_eq!(
        twice.dispatch([1, 1, 1]).unwrap_err().to_string(),
        "Pass [p] binds [b0] twice: to buffer [input] and to buffer [uniform]."
    );
    let several = w.graph.pass("p", &w.map).bind("c", w.input).dispatch([1, 1, 1]).unwrap_err();
    assert!(matches!(several, GraphError::Several(ref errors) if errors.len() == 3), "{several}");
    let together = w.graph.pass("p", &w.map).bind_all([("b0", w.input.into()), ("b1", w.out.slice(0, 512))]);
    together.dispatch([1, 1, 1]).unwrap();
}

#[test]
fn failed_binding_is_reported_once() {
    let mut w = fixture();
    let error = w.map(w.input, w.input.slice(0, 4));
    assert_eq!(error, "Pass [p] writes buffer [input] through [b1], but it is a read-only input.");
}

#[test]
fn invalid_constants_are_rejected() {
    let mut w = fixture();
    let pass = w.graph.pass("p", &w.map).bind("b0", w.input).bind("b1", w.out).spec("width", 1);
    assert_eq!(
        pass.dispatch([1, 1, 1]).unwrap_err().to_string(),
        "Pass [p] specializes [width], but kernel [map] has only the constants [size]."
    );
    let pass = w.graph.pass("p", &w.map).bind("b0", w.input).bind("b1", w.out).spec("size", 1).spec("size", 2);
    assert_eq!(
        pass.dispatch([1, 1, 1]).unwrap_err().to_string(),
        "Pass [p] specializes [size] twice: with 0x1 and with 0x2."
    );
    let pass = w.graph.pass("p", &w.map).bind("b0", w.input).bind("b1", w.out).push(&[0; 8]);
    assert_eq!(
        pass.dispatch([1, 1, 1]).unwrap_err().to_string(),
        "Pass [p] pushes 8 bytes of constants, but kernel [map] has 0."
    );
    let pass = w.graph.pass("p", &w.map).bind("b0", w.input).bind("b1", w.out).subgroup_size(Some(24));
    assert_eq!(
        pass.dispatch([1, 1, 1]).unwrap_err().to_string(),
        "Pass [p] requires subgroups of 24, which is not a power of two between 1 and 128."
    );
}

#[test]
fn subgroup_size_must_match_specialization() {
    const CAPABILITY: u32 = 2 << 16 | 17;
    let refusal = |constant: u32, requested: Option<u32>, capability: u32, promised: bool| {
        let mut w = fixture();
        let shader = Arc::make_mut(&mut w.map);
        shader.specs[0].name = "SUBGROUP".into();
        shader.spirv = vec![0x0723_0203, 0, 0, 0, 0, CAPABILITY, 1, CAPABILITY, capability].into();
        let pass = w.graph.pass("p", &w.map).bind("b0", w.input).bind("b1", w.out);
        let pass = pass.spec("SUBGROUP", constant).subgroup_size(requested);
        let pass = if promised { pass.without_subgroups() } else { pass };
        pass.dispatch([1, 1, 1]).err().map(|e| e.to_string())
    };
    const BALLOT: u32 = 64;
    assert_eq!(refusal(16, Some(16), BALLOT, false), None);
    let sentence = "Pass [p] specializes kernel [map] for subgroups of 16, but requests subgroups of 32.";
    assert_eq!(refusal(16, Some(32), BALLOT, false).as_deref(), Some(sentence));
    let sentence = "Pass [p] specializes kernel [map] for subgroups of 16, but requests no subgroup size.";
    assert_eq!(refusal(16, None, BALLOT, false).as_deref(), Some(sentence));
    // Without subgroup operations, the constant has no special meaning.
    assert_eq!(refusal(16, None, 9, false), None);
    assert_eq!(refusal(16, None, BALLOT, true), None);
}

#[test]
fn invalid_dispatches_are_rejected() {
    let mut w = fixture();
    let bound = |w: &mut Fixture| {
        let map = Arc::clone(&w.map);
        let (input, out) = (w.input, w.out);
        move |graph: &mut Graph, run: &dyn Fn(PassBuilder<'_>) -> Result<(), GraphError>| {
            run(graph.pass("p", &map).bind("b0", input.slice(0, 512)).bind("b1", out)).unwrap_err().to_string()
        }
    };
    let bound = bound(&mut w);
    assert_eq!(
        bound(&mut w.graph, &|pass| pass.dispatch([1, 65_536, 1])),
        "Pass [p] dispatches 65536 groups along y, more than the 65535 that every device supports."
    );
    assert_eq!(
        bound(&mut w.graph, &|pass| pass.dispatch_indirect(w.input, 514)),
        "Pass [p] reads its group counts at offset 514 of buffer [input], not a multiple of 4."
    );
    assert_eq!(
        bound(&mut w.graph, &|pass| pass.dispatch_indirect(w.input, 1016)),
        "Pass [p] uses 12 bytes of buffer [input] at offset 1016, which end after its 1024 bytes."
    );
    assert_eq!(
        bound(&mut w.graph, &|pass| pass.dispatch_indirect(w.uniform, 0)),
        "Pass [p] uses uniform [uniform] as its group counts, but only kernels can read it."
    );
    assert_eq!(
        bound(&mut w.graph, &|pass| pass.dispatch_indirect(w.out, 0)),
        "Pass [p] touches the same bytes of buffer [out] as [b1] and as [group counts] and writes them."
    );
    let unwritten = w.scratch;
    assert_eq!(
        bound(&mut w.graph, &|pass| pass.dispatch_indirect(unwritten, 4)),
        "Pass [p] reads 12 bytes at offset 4 of transient buffer [scratch], which no earlier pass writes."
    );
}

#[test]
fn overlapping_writes_are_rejected() {
    let mut w = fixture();
    assert_eq!(
        w.map(w.out.slice(0, 512), w.out.slice(256, 512)),
        "Pass [p] touches the same bytes of buffer [out] as [b0] and as [b1] and writes them."
    );
    let apart = w.graph.pass("p", &w.map).bind("b0", w.out.slice(0, 512)).bind("b1", w.out.slice(512, 512));
    apart.dispatch([1, 1, 1]).unwrap();
    let reads = kernel("reads", &[Read, Read, Write]);
    let same = w.graph.pass("p", &reads).bind("b0", w.input).bind("b1", w.input).bind("b2", w.out);
    same.dispatch([1, 1, 1]).unwrap();
}

#[test]
fn reads_of_unwritten_transients_are_rejected() {
    for access in [Read, ReadWrite, Accumulate] {
        let mut w = fixture();
        let kernel = kernel("k", &[access]);
        let error = w.graph.pass("p", &kernel).bind("b0", w.scratch.slice(256, 256)).dispatch([1, 1, 1]).unwrap_err();
        assert_eq!(
            error.to_string(),
            "Pass [p] reads 256 bytes at offset 256 of transient buffer [scratch], which no earlier pass writes."
        );
    }
    let mut w = fixture();
    w.graph.fill("f", w.scratch.slice(0, 256), 0).unwrap();
    assert!(w.map(w.scratch.slice(256, 256), w.out).contains("which no earlier pass writes"));
    assert!(w.graph.copy("c", w.scratch.slice(256, 256), w.out.slice(0, 256)).is_err());
    // One written byte suffices, and a kernel that discards reads nothing.
    pass(&mut w.graph, "some", &[(w.scratch.slice(0, 1024), Read)]);
    let both = kernel("both", &[ReadWrite]);
    w.graph.pass("d", &both).bind_discard("b0", w.scratch.slice(512, 512)).dispatch([1, 1, 1]).unwrap();
}

#[test]
fn writes_to_read_only_buffers_are_rejected() {
    let mut w = fixture();
    assert_eq!(
        w.map(w.input.slice(0, 4), w.uniform),
        "Pass [p] writes buffer [uniform] through [b1], but it is a uniform."
    );
    assert_eq!(
        w.graph.fill("f", w.input, 0).unwrap_err().to_string(),
        "Pass [f] writes buffer [input] through [fill], but it is a read-only input."
    );
    assert_eq!(
        w.graph.copy("c", w.out, w.input).unwrap_err().to_string(),
        "Pass [c] writes buffer [input] through [copy], but it is a read-only input."
    );
    w.graph.keep(w.input);
    w.graph.fill("f", w.out, 0).unwrap();
    assert!(w.compile().contains("Buffer [input] cannot be kept: it is a read-only input, which no pass can write."));
}

#[test]
fn discards_of_read_bindings_are_rejected() {
    let mut w = fixture();
    let pass = w.graph.pass("p", &w.map).bind_discard("b0", w.input).bind("b1", w.out);
    assert_eq!(
        pass.dispatch([1, 1, 1]).unwrap_err().to_string(),
        "Pass [p] discards the contents of [b0], but its kernel's access is Read, which needs them."
    );
    let sum = kernel("sum", &[Accumulate]);
    let pass = w.graph.pass("p", &sum).bind_discard("b0", w.out);
    assert!(matches!(pass.dispatch([1, 1, 1]), Err(GraphError::DiscardOfRead { .. })));
}

#[test]
fn invalid_fills_and_copies_are_rejected() {
    let mut w = fixture();
    assert_eq!(
        w.graph.fill("f", w.out.slice(2, 8), 0).unwrap_err().to_string(),
        "Pass [f] fills 8 bytes at offset 2 of buffer [out]; both must be multiples of 4."
    );
    assert!(matches!(w.graph.fill("f", w.out.slice(0, 7), 0), Err(GraphError::FillAlignment { .. })));
    assert_eq!(
        w.graph.copy("c", w.input, w.out.slice(0, 512)).unwrap_err().to_string(),
        "Pass [c] copies 1024 bytes of buffer [input] to 512 bytes of buffer [out]."
    );
    assert_eq!(
        w.graph.copy("c", w.out.slice(0, 512), w.out.slice(256, 512)).unwrap_err().to_string(),
        "Pass [c] touches the same bytes of buffer [out] as [source] and as [target] and writes them."
    );
    assert_eq!(
        w.graph.copy("c", w.uniform, w.out.slice(0, 256)).unwrap_err().to_string(),
        "Pass [c] uses uniform [uniform] as the source of a copy, but only kernels can read it."
    );
}

#[test]
fn graph_with_rejected_pass_does_not_compile() {
    let mut w = fixture();
    w.graph.fill("f", w.input, 0).unwrap_err();
    w.graph.fill("g", w.out, 0).unwrap();
    assert_eq!(w.compile(), "Pass [f] was begun in graph [world] but never dispatched without an error.");
    let mut w = fixture();
    let _ = w.graph.pass("p", &w.map);
    assert!(w.compile().starts_with("Pass [p] was begun"));
}

#[test]
fn compile_errors_are_reported() {
    let mut graph = Graph::new("g");
    graph.external("nothing", 0);
    let error = graph.compile(&CompileOptions::default()).unwrap_err();
    assert_eq!(error.to_string(), "Buffer [nothing] is declared with 0 bytes, but a buffer needs at least 1.");

    let mut graph = Graph::new("g");
    graph.keep(Buffer(3));
    assert!(matches!(graph.compile(&CompileOptions::default()), Err(GraphError::UnknownBuffer { index: 3, .. })));

    let odd = CompileOptions { alignment: 48, ..Default::default() };
    assert_eq!(
        Graph::new("g").compile(&odd).unwrap_err().to_string(),
        "Graph [g] is compiled for offsets aligned to 48 bytes, which is not a power of two."
    );

    let mut graph = Graph::new("g");
    let out = graph.external("out", 1024);
    let both = with_kinds("both", &[(BindingKind::Storage, ReadWrite)]);
    graph.pass("p", &both).bind("b0", out.slice(64, 64)).dispatch([1, 1, 1]).unwrap();
    graph.clone().compile(&CompileOptions { alignment: 64, ..Default::default() }).unwrap();
    assert_eq!(
        graph.compile(&CompileOptions::default()).unwrap_err().to_string(),
        "Pass [p] binds buffer [out] as [b0] at offset 64, not a multiple of the device's 256."
    );
}
