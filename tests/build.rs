//! Compiles the tests' kernels and writes a table of them with their bindings.
//!
//! The table lists the access of each binding: read, write or both.

use sgs_shader_compiler::BindingKind;
use std::fmt::Write;
use std::path::PathBuf;

fn main() {
    let root = PathBuf::from(std::env::var_os("CARGO_MANIFEST_DIR").expect("set by cargo")).join("kernels");
    let out = PathBuf::from(std::env::var_os("OUT_DIR").expect("set by cargo"));
    println!("cargo:rerun-if-changed={}", root.display());
    // Kernels of tests may include what they test.
    println!("cargo:rerun-if-changed={}", root.join("../../shaders-glsl/include").display());
    println!("cargo:rerun-if-changed=build.rs");
    let kernels = sgs_shader_compiler::compile_folder(&root).unwrap_or_else(|e| fail(&e.to_string())).kernels;
    let mut table = String::from("&[\n");
    for kernel in &kernels {
        let mut listed = String::new();
        for b in &kernel.bindings {
            let kind = match b.kind {
                BindingKind::Storage => "Storage".to_owned(),
                BindingKind::Uniform => "Uniform".to_owned(),
                BindingKind::Image(format) => format!("Image(sgs_engine::ImageFormat::{format:?})"),
            };
            let _ = write!(listed, "({:?}, {}, BindingKind::{kind}, Access::{:?}), ", b.name, b.number, b.access);
        }
        let push = kernel.push.as_ref().map_or(0, |p| p.bytes);
        let _ = writeln!(
            table,
            "Entry {{ name: {:?}, push_bytes: {push}, bindings: &[{listed}], spirv: &{:?} }},",
            kernel.name, kernel.spirv
        );
    }
    table.push(']');
    std::fs::write(out.join("test_kernels.rs"), table).unwrap_or_else(|e| fail(&e.to_string()));
}

fn fail(message: &str) -> ! {
    eprintln!("{message}");
    std::process::exit(1)
}
