//! Test kernels that consist only of reflection data.

use std::sync::Arc;

use crate::graph::{Graph, Image, PassBuilder, Slice};
use crate::shader::{Access, Binding, BindingKind, Shader, SpecConstant};

/// Returns a kernel with storage bindings `b0`, `b1`, … of these accesses.
pub(super) fn kernel(name: &str, accesses: &[Access]) -> Arc<Shader> {
    let bindings: Vec<_> = accesses.iter().map(|&access| (BindingKind::Storage, access)).collect();
    with_kinds(name, &bindings)
}

/// Returns a kernel with bindings `b0`, `b1`, … of these kinds and accesses.
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

/// Declares a pass with these accesses.
pub(super) fn pass(graph: &mut Graph, name: &str, touched: &[(Slice, Access)]) {
    let kernel = with_kinds(name, &touched.iter().map(|(s, access)| (kind_of(graph, s), *access)).collect::<Vec<_>>());
    let pass = graph.pass(name, &kernel);
    let pass = touched.iter().enumerate().fold(pass, |pass, (index, (slice, _))| bind(pass, index, *slice, false));
    pass.dispatch([1, 1, 1]).unwrap();
}

/// Returns the binding kind of a slice's resource.
pub(super) fn kind_of(graph: &Graph, slice: &Slice) -> BindingKind {
    let image = graph.buffers[slice.buffer.index()].image;
    image.map_or(BindingKind::Storage, |image| BindingKind::Image(image.format))
}

/// Binds a buffer slice, or its image, as binding `b{index}`.
pub(super) fn bind(pass: PassBuilder<'_>, index: usize, slice: Slice, discard: bool) -> PassBuilder<'_> {
    let name = format!("b{index}");
    let image = matches!(pass.shader.bindings[index].kind, BindingKind::Image(_));
    match (image, discard) {
        (true, false) => pass.bind_image(&name, Image(slice.buffer)),
        (true, true) => pass.bind_image_discard(&name, Image(slice.buffer)),
        (false, false) => pass.bind(&name, slice),
        (false, true) => pass.bind_discard(&name, slice),
    }
}
