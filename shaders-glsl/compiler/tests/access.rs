//! Access reflected from the code of small kernels.

use sgs_shader_compiler::{Access, compile_folder};

/// Returns the access to the only binding of a kernel with this body.
fn access(name: &str, body: &str) -> Access {
    let root = std::env::temp_dir().join(format!("sgs-access-{}-{name}", std::process::id()));
    let family = root.join("family");
    std::fs::create_dir_all(&family).unwrap();
    let source = format!(
        "#version 460\nlayout(local_size_x = 64) in;\nlayout(std430, binding = 0) buffer Words {{ uint words[]; }};\n\
         void main() {{ uint i = gl_GlobalInvocationID.x; {body} }}\n"
    );
    std::fs::write(family.join(format!("{name}.comp")), source).unwrap();
    let folder = compile_folder(&root);
    std::fs::remove_dir_all(&root).unwrap();
    folder.unwrap().kernels[0].bindings[0].access
}

#[test]
fn only_additions_whose_result_is_unused_accumulate() {
    assert_eq!(access("add", "atomicAdd(words[i % 7u], i);"), Access::Accumulate);
    assert_eq!(access("subtract", "atomicAdd(words[0], -3u); atomicAdd(words[1], i);"), Access::Accumulate);
    for (name, body) in [
        ("result", "if (atomicAdd(words[0], 1u) == 3u) atomicAdd(words[1], 1u);"),
        ("max", "atomicMax(words[0], i);"),
        ("min", "atomicMin(words[0], i);"),
        ("and", "atomicAnd(words[0], i);"),
        ("or", "atomicOr(words[0], i);"),
        ("xor", "atomicXor(words[0], i);"),
        ("mixed", "atomicAdd(words[0], i); atomicMax(words[1], i);"),
        ("exchange", "atomicExchange(words[0], i);"),
        ("add_and_load", "atomicAdd(words[0], words[1]);"),
    ] {
        assert_eq!(access(name, body), Access::ReadWrite, "{name}");
    }
    assert_eq!(access("store", "words[i] = i;"), Access::Write);
    assert_eq!(access("load", "if (words[i] == 77u) return;"), Access::Read);
}
