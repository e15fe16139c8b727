//! Code generator: one Rust module per kernel, one type per shared struct.

use crate::compile::{Absent, Folder};
use crate::reflect::{Kernel, Struct};
use sgs_shader_abi::{BindingKind, SpecConstant};
use std::fmt::Write;

/// Generates the Rust source for the kernels of a folder.
///
/// The source includes SPIR-V from `spirv_dir/NAME.spv`, which the caller writes.
///
/// # Errors
/// If two kernels give the same struct name different layouts.
pub fn generate(folder: &Folder, spirv_dir: &str) -> Result<String, String> {
    let kernels = &folder.kernels;
    let mut out = String::from("// Generated from the GLSL by build.rs.\n");
    let mut shared: Vec<&Struct> = Vec::new();
    for kernel in kernels {
        for s in &kernel.structs {
            match shared.iter().find(|o| o.name == s.name) {
                Some(o) if *o != s => {
                    return Err(format!(
                        "struct \"{}\" of kernel \"{}\" differs from its namesake",
                        s.name, kernel.name
                    ));
                }
                Some(_) => {}
                None => shared.push(s),
            }
        }
    }
    out.push_str("/// Structs that host and shader share.\npub mod structs {\n");
    for s in &shared {
        emit_struct(&mut out, s, "");
    }
    out.push_str("}\n");
    for kernel in kernels {
        emit_kernel(&mut out, kernel, spirv_dir);
    }
    out.push_str("/// Kernels that need newer GLSL than some compilers know.\npub static OPTIONAL: &[Optional] = &[");
    for kernel in kernels {
        let Some(extension) = kernel.extension else { continue };
        let name = &kernel.name;
        let _ = write!(out, "Optional {{ name: {name:?}, extension: {extension:?}, kernel: Some(&{name}::KERNEL) }}, ");
    }
    for Absent { name, extension } in &folder.absent {
        let _ = write!(out, "Optional {{ name: {name:?}, extension: {extension:?}, kernel: None }}, ");
    }
    out.push_str("];\n");
    out.push_str("/// Every kernel, by name.\npub static ALL: &[&Kernel] = &[");
    for kernel in kernels {
        let _ = write!(out, "&{}::KERNEL, ", kernel.name);
    }
    out.push_str("];\n");
    Ok(out)
}

fn emit_struct(out: &mut String, s: &Struct, prefix: &str) {
    let _ = writeln!(
        out,
        "/// `{0}` as the shader lays it out ({1} bytes).\n#[repr(C)]\n#[derive(Clone, Copy, Debug, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]\npub struct {0} {{",
        s.name, s.bytes
    );
    for f in &s.fields {
        let ty = f.ty.rust();
        let _ = writeln!(
            out,
            "/// GLSL `{}` at byte {}.\npub {}: {},",
            f.name,
            f.offset,
            f.name,
            qualify(&ty, &f.ty, prefix)
        );
    }
    out.push_str("}\n");
    let _ = writeln!(
        out,
        "impl Default for {0} {{ fn default() -> Self {{ bytemuck::Zeroable::zeroed() }} }}\nconst _: () = assert!(std::mem::size_of::<{0}>() == {1});",
        s.name, s.bytes
    );
    for f in &s.fields {
        let _ = writeln!(out, "const _: () = assert!(std::mem::offset_of!({}, {}) == {});", s.name, f.name, f.offset);
    }
}

fn qualify(rust: &str, ty: &crate::reflect::FieldType, prefix: &str) -> String {
    let mut inner = ty;
    while let crate::reflect::FieldType::Array(t, _) = inner {
        inner = t;
    }
    match inner {
        crate::reflect::FieldType::Struct(name) => rust.replace(name.as_str(), &format!("{prefix}{name}")),
        _ => rust.to_owned(),
    }
}

/// Returns the Rust expression of a binding's kind.
fn kind(kind: BindingKind) -> String {
    match kind {
        BindingKind::Image(format) => format!("crate::BindingKind::Image(crate::ImageFormat::{format:?})"),
        other => format!("crate::BindingKind::{other:?}"),
    }
}

fn emit_kernel(out: &mut String, k: &Kernel, spirv_dir: &str) {
    let _ = writeln!(out, "/// Kernel `{}` of family `{}`.\npub mod {} {{", k.name, k.family, k.name);
    if let Some(push) = &k.push {
        emit_struct(out, push, "super::structs::");
    }
    let _ = writeln!(
        out,
        "/// One value for each binding, by name.\n#[derive(Clone, Copy, Debug)]\npub struct Bindings<B> {{"
    );
    for b in &k.bindings {
        let _ = writeln!(out, "/// Binding {} ({:?}).\npub {}: B,", b.number, b.access, b.name);
    }
    if k.bindings.is_empty() {
        out.push_str("/// No bindings.\npub none: std::marker::PhantomData<B>,");
    }
    let _ = writeln!(
        out,
        "}}\nimpl<B> Bindings<B> {{\n/// Name and value of each.\npub fn entries(self) -> [(&'static str, B); {}] {{ [",
        k.bindings.len()
    );
    for b in &k.bindings {
        let _ = write!(out, "(\"{0}\", self.{0}),", b.name);
    }
    out.push_str("] }\n}\n");
    let _ = writeln!(out, "/// Specialization constants, by name.\n#[derive(Clone, Copy, Debug)]\npub struct Specs {{");
    for s in &k.specs {
        let _ = writeln!(out, "/// constant_id {}.\npub {}: {},", s.constant.id, s.constant.name.to_lowercase(), s.ty);
    }
    out.push_str("}\n#[allow(clippy::derivable_impls)]\nimpl Default for Specs {\nfn default() -> Self { Specs {");
    for s in &k.specs {
        let value = match s.ty {
            "f32" => format!("f32::from_bits({})", s.constant.default),
            "bool" => (s.constant.default != 0).to_string(),
            "i32" => format!("{}", s.constant.default as i32),
            _ => s.constant.default.to_string(),
        };
        let _ = write!(out, "{}: {value},", s.constant.name.to_lowercase());
    }
    let _ = writeln!(
        out,
        "}} }}\n}}\nimpl Specs {{\n/// Name and bits of each.\npub fn entries(self) -> [(&'static str, u32); {}] {{ [",
        k.specs.len()
    );
    for s in &k.specs {
        let field = s.constant.name.to_lowercase();
        let bits = match s.ty {
            "f32" => format!("self.{field}.to_bits()"),
            "u32" => format!("self.{field}"),
            _ => format!("self.{field} as u32"),
        };
        let _ = write!(out, "(\"{}\", {bits}),", s.constant.name);
    }
    out.push_str("] }\n}\n");
    let _ = writeln!(
        out,
        "const BYTES: &[u8] = include_bytes!(\"{2}/{0}.spv\");\nstatic SPIRV: crate::Aligned<{{ BYTES.len() }}> = crate::Aligned(*include_bytes!(\"{2}/{0}.spv\"));\n/// The kernel.\npub static KERNEL: crate::Kernel = crate::Kernel {{ name: \"{0}\", family: \"{1}\", spirv: crate::Spirv {{ bytes: SPIRV.as_slice() }}, push_bytes: {3}, bindings: &[",
        k.name,
        k.family,
        spirv_dir,
        k.push.as_ref().map_or(0, |p| p.bytes)
    );
    for b in &k.bindings {
        let _ = writeln!(
            out,
            "crate::Binding {{ name: crate::Cow::Borrowed({:?}), number: {}, kind: {}, access: crate::Access::{:?} }},",
            b.name,
            b.number,
            kind(b.kind),
            b.access
        );
    }
    out.push_str("], specs: &[");
    for s in &k.specs {
        let SpecConstant { name, id, default } = &s.constant;
        let _ = write!(
            out,
            "crate::SpecConstant {{ name: crate::Cow::Borrowed({name:?}), id: {id}, default: {default} }},"
        );
    }
    out.push_str("] };\n}\n");
}
