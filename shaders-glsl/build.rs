//! Compiles every kernel of this folder and generates the Rust side.

use std::path::PathBuf;

fn main() {
    let root = PathBuf::from(std::env::var_os("CARGO_MANIFEST_DIR").expect("set by cargo"));
    let out = PathBuf::from(std::env::var_os("OUT_DIR").expect("set by cargo"));
    for family in ["include", "prim", "splat", "shade", "loss", "optim", "transport"] {
        println!("cargo:rerun-if-changed={}", root.join(family).display());
    }
    println!("cargo:rerun-if-changed=build.rs");
    let folder = match sgs_shader_compiler::compile_folder(&root) {
        Ok(folder) => folder,
        Err(error) => fail(&error.to_string()),
    };
    for kernel in &folder.kernels {
        let bytes: Vec<u8> = kernel.spirv.iter().flat_map(|w| w.to_le_bytes()).collect();
        let path = out.join(format!("{}.spv", kernel.name));
        std::fs::write(&path, bytes).unwrap_or_else(|e| fail(&format!("{}: {e}", path.display())));
    }
    let source = sgs_shader_compiler::generate(&folder, &out.to_string_lossy()).unwrap_or_else(|e| fail(&e));
    std::fs::write(out.join("kernels.rs"), source).unwrap_or_else(|e| fail(&e.to_string()));
}

fn fail(message: &str) -> ! {
    eprintln!("{message}");
    std::process::exit(1)
}
