//! Links the static glslang and SPIRV-Tools that a system shaderc needs.
//!
//! Debian's `libshaderc_combined.a` leaves glslang undefined (docs/adr/0001-shader-compiler.md). Where the
//! distribution's static libraries are present, this script links them after it. Elsewhere shaderc-sys builds
//! everything from source into one archive, and this script links nothing. The script also links nothing where
//! `SHADERC_LIB_DIR` names another shaderc, such as a newer one, because the distribution's libraries would replace
//! parts of it.

use std::path::Path;

fn main() {
    println!("cargo:rerun-if-changed=build.rs");
    println!("cargo:rerun-if-env-changed=SHADERC_LIB_DIR");
    let dirs = ["/usr/lib/x86_64-linux-gnu", "/usr/lib/aarch64-linux-gnu", "/usr/lib64", "/usr/lib"];
    let libraries = [
        "MachineIndependent",
        "GenericCodeGen",
        "OSDependent",
        "OGLCompiler",
        "SPIRV",
        "SPIRV-Tools-opt",
        "SPIRV-Tools",
    ];
    let Some(dir) = dirs.iter().find(|d| Path::new(d).join("libshaderc_combined.a").exists()) else {
        return;
    };
    if std::env::var_os("SHADERC_LIB_DIR").is_some_and(|other| Path::new(&other) != Path::new(dir)) {
        return;
    }
    if libraries.iter().all(|l| Path::new(dir).join(format!("lib{l}.a")).exists()) {
        println!("cargo:rustc-link-search=native={dir}");
        for library in libraries {
            println!("cargo:rustc-link-lib=static:-bundle={library}");
        }
    }
}
