//! C program of `tools/capi/examples`, built by gcc and run on a device.

use sgs_passes::scene::Model;
use sgs_tests::scenes;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use tempfile::TempDir;

/// Use of the library, which cargo builds next to these tests.
const _: () = assert!(sgs::SGS_LAYER_ALPHA == 3);

fn capi() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tools/capi")
}

/// Runs a tool that tools/setup installs. Fails if the tool is missing, so no test is skipped silently.
#[track_caller]
fn run(command: &mut Command) -> Output {
    match command.output() {
        Ok(output) => output,
        Err(error) => panic!("{:?} cannot be run ({error}); tools/setup installs it", command.get_program()),
    }
}

#[track_caller]
fn ok(output: Output) -> String {
    let text = |b: &[u8]| String::from_utf8_lossy(b).into_owned();
    assert!(output.status.success(), "{}\n{}{}", output.status, text(&output.stdout), text(&output.stderr));
    text(&output.stdout)
}

/// Installs the library in a temporary directory.
fn installed() -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    let built = std::env::current_exe().unwrap().parent().unwrap().to_owned();
    for name in ["libsgs.so", "libsgs.a"] {
        assert!(built.join(name).is_file(), "{name} is not beside the tests");
    }
    ok(run(Command::new(capi().join("install")).arg(folder.path()).arg(&built)));
    folder
}

fn flags(prefix: &Path, more: &[&str]) -> Vec<String> {
    let path = prefix.join("lib/pkgconfig");
    let mut command = Command::new("pkg-config");
    command.env("PKG_CONFIG_PATH", &path).args(more).args(["--cflags", "--libs", "sgs", "vulkan"]);
    ok(run(&mut command)).split_whitespace().map(str::to_owned).collect()
}

/// Writes some splats in front of a camera that looks along z.
fn scene(folder: &Path) -> PathBuf {
    let data = scenes::data(&scenes::ordinary(200, 2, false, 5));
    let path = folder.join("scene.ply");
    sgs_run::splats(&data, Model { sh_degree: 2, normals: false, ..Default::default() }).write_ply(&path).unwrap();
    path
}

/// Compiles an example and returns the command that runs it.
fn compiled(name: &str, compiler: &[&str], link: &[String], prefix: &Path) -> Command {
    let program = prefix.join(name);
    let mut command = Command::new(compiler[0]);
    command.args(&compiler[1..]).arg(capi().join(format!("examples/{name}.c"))).arg("-o").arg(&program);
    ok(run(command.args(link).arg("-lm")));
    let mut command = Command::new(&program);
    command.env("LD_LIBRARY_PATH", prefix.join("lib"));
    command
}

/// Compiles the example and runs it.
fn works(compiler: &[&str], link: &[String], prefix: &Path) {
    let mut host = compiled("host", compiler, link, prefix);
    let ppm = prefix.join("out.ppm");
    let lit = prefix.join("run");
    sgs_tests::runs::fabricate(&lit, sgs_tests::runs::Parts::ALL);
    host.arg(scene(prefix)).arg(&ppm).arg(&lit);
    let printed = ok(run(&mut host));
    assert!(
        printed.starts_with("4 lights, ")
            && printed.contains("200 Gaussians, ")
            && printed.contains("2 frames, 0 incomplete"),
        "{printed}"
    );
    let ppm = std::fs::read(ppm).unwrap();
    let pixels = ppm.strip_prefix(b"P6\n96 64\n255\n").expect("a PPM");
    assert_eq!(pixels.len(), 96 * 64 * 3);
    // The image shows neither the host's red nor the background alone.
    assert!(pixels.chunks(3).all(|p| p != [255, 0, 0]));
    assert!(pixels.chunks(3).any(|p| p != [0, 0, 64]));
}

// Structs are initialized by their first field, with the rest zero, as in Vulkan and this library.
const WARNINGS: [&str; 7] =
    ["gcc", "-std=c11", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-Wno-missing-field-initializers"];

#[test]
fn a_c_program_shows_splats_in_its_own_image() {
    let prefix = installed();
    works(&WARNINGS, &flags(prefix.path(), &[]), prefix.path());
}

#[test]
fn a_c_program_lists_and_switches_emitters() {
    let prefix = installed();
    let prefix = prefix.path();
    sgs_tests::emitting::fabricate_emitting(prefix);
    let mut program = compiled("emitters", &WARNINGS, &flags(prefix, &[]), prefix);
    let printed = ok(run(program.arg(prefix.join("run")).args(["0", "0", "-0.8"])));
    let lines: Vec<&str> = printed.lines().collect();
    assert_eq!(lines[0], "window 1: rectangle, color 0.5 0.6 1", "{printed}");
    assert_eq!(lines[1], "light 1: sphere, color 12 9 6", "{printed}");
    assert_eq!(lines[2], "light 2: point, off, color 0.2 0.6 0.3", "{printed}");
    assert!(lines[3].starts_with("3 emitters, up to "), "{printed}");
}

#[test]
fn a_c_program_links_with_the_static_library() {
    let prefix = installed();
    let lib = prefix.path().join("lib");
    for name in ["libsgs.so", "libsgs.so.0"] {
        std::fs::remove_file(lib.join(name)).unwrap();
    }
    works(&WARNINGS, &flags(prefix.path(), &["--static"]), prefix.path());
}

#[test]
fn header_compiles_as_c_and_cpp_before_and_after_vulkan() {
    let folder = tempfile::tempdir().unwrap();
    let include = format!("-I{}", capi().join("include").display());
    for (compiler, standard, name) in [
        ("gcc", "-std=c11", "a.c"),
        ("gcc", "-std=c99", "b.c"),
        ("g++", "-std=c++11", "a.cpp"),
        ("g++", "-std=c++17", "b.cpp"),
    ] {
        for order in [
            "#include \"sgs.h\"\n",
            "#include <vulkan/vulkan.h>\n#include \"sgs.h\"\n",
            "#include \"sgs.h\"\n#include <vulkan/vulkan.h>\n",
        ] {
            // Repeated definitions of a name are allowed from C11 on.
            if standard == "-std=c99" && order.ends_with("vulkan.h>\n") {
                continue;
            }
            let path = folder.path().join(name);
            std::fs::write(&path, format!("{order}SgsResult f(SgsContext **c) {{ return sgs_context_destroy(c); }}\n"))
                .unwrap();
            let mut command = Command::new(compiler);
            command.args([standard, "-Wall", "-Wextra", "-Werror", "-fsyntax-only", &include]).arg(&path);
            ok(run(&mut command));
        }
    }
}

#[test]
fn a_wrong_call_does_not_compile() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("wrong.c");
    std::fs::write(&path, "#include \"sgs.h\"\nint f(void) { return sgs_version(1); }\n").unwrap();
    let include = format!("-I{}", capi().join("include").display());
    let output = run(Command::new("gcc").args(["-std=c11", "-fsyntax-only", &include]).arg(&path));
    assert!(!output.status.success());
}
