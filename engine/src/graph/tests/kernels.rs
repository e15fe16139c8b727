//! Kernels that exist only as reflections.

use std::sync::Arc;

use crate::graph::{Graph, Slice};
use crate::shader::{Access, Binding, BindingKind, Shader, SpecConstant};

/// A kernel with storage bindings `b0`, `b1`, … of these accesses.
pub(super) fn kernel(name: &str, accesses: &[Access]) -> Arc<Shader> {
    let bindings: Vec<_> = accesses.iter().map(|&access| (BindingKind::Storage, access)).collect();
    with_kinds(name, &bindings)
}

/// A kernel with bindings `b0`, `b1`, … of these kinds and accesses.
pub(super) fn with_kinds(name: &str, bindings: &[(BindingKind, Access)]) -> Arc<Shader> {
    let bindings = bindings.iter().enumerate().map(|(index, &(kind, access))| Binding {
        name: format!("b{index}").into(),
        number: index as u32,
        kind,
        access,
    });
    Arc::new(Shader {
        name: name.to_owned().into(),
        spirv: vec![0x0723_0203, name.len() as u32].into(),
        bindings: bindings.collect(),
        push_bytes: 0,
        specs: vec![SpecConstant { name: "size".into(), id: 3, default: 0 }],
    })
}

/// Declares a pass that does this to these slices.
pub(super) fn pass(graph: &mut Graph, name: &str, touched: &[(Slice, Access)]) {
    let accesses: Vec<_> = touched.iter().map(|&(_, access)| access).collect();
    let kernel = kernel(name, &accesses);
    let mut pass = graph.pass(name, &kernel);
    for (index, &(slice, _)) in touched.iter().enumerate() {
        pass = pass.bind(&format!("b{index}"), slice);
    }
    pass.dispatch([1, 1, 1]).unwrap();
}
