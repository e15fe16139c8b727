//! Crate layers: engine ← passes ← tools; Vulkan and `unsafe` in the engine only.
//!
//! Only passes use shaders. The checks read `cargo metadata` and the sources. Each check has a planted violation that
//! it must catch.

use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use std::process::Command;

/// Folders, and the folders that their crates may depend on.
///
/// `tools/*` stands for all crates in `tools`.
const ALLOWED: &[(&str, &[&str])] = &[
    ("shaders-glsl/abi", &[]),
    ("engine", &["shaders-glsl/abi"]),
    ("shaders-glsl/compiler", &["shaders-glsl/abi"]),
    ("shaders-glsl", &["shaders-glsl/abi", "shaders-glsl/compiler"]),
    ("passes", &["engine", "shaders-glsl"]),
    ("tools/scene", &[]),
    ("tools/capture", &["tools/scene"]),
    ("tools/synth", &["tools/scene"]),
    ("tools/report", &["tools/scene"]),
    ("tools/provider", &["tools/scene"]),
    ("tools/config", &["engine", "passes", "tools/provider", "tools/scene"]),
    ("tools/run", &["engine", "passes", "tools/config", "tools/scene"]),
    ("tools/evaluate", &["engine", "passes", "tools/run", "tools/scene"]),
    ("tools/transport", &["engine", "passes", "tools/config", "tools/run", "tools/scene"]),
    (
        "tools/train",
        &["engine", "passes", "tools/config", "tools/provider", "tools/run", "tools/scene", "tools/transport"],
    ),
    (
        "tools/relight",
        &[
            "engine",
            "passes",
            "tools/config",
            "tools/evaluate",
            "tools/run",
            "tools/scene",
            "tools/train",
            "tools/transport",
        ],
    ),
    ("tools/study", &["tools/config", "tools/evaluate", "tools/run", "tools/scene"]),
    ("tools/batch", &["tools/config", "tools/report", "tools/run", "tools/scene"]),
    ("tools/view", &["engine", "passes", "tools/config", "tools/relight", "tools/run", "tools/scene"]),
    ("tools/capi", &["engine", "passes", "tools/config", "tools/relight", "tools/run", "tools/scene", "tools/train"]),
    (
        "tools/api",
        &[
            "engine",
            "passes",
            "tools/batch",
            "tools/capture",
            "tools/config",
            "tools/evaluate",
            "tools/relight",
            "tools/run",
            "tools/scene",
            "tools/study",
            "tools/synth",
            "tools/train",
        ],
    ),
    (
        "tools/python",
        &[
            "engine",
            "passes",
            "tools/api",
            "tools/config",
            "tools/evaluate",
            "tools/relight",
            "tools/run",
            "tools/scene",
            "tools/synth",
            "tools/train",
        ],
    ),
    ("tools/sgs", &["engine", "passes", "tools/*"]),
    ("tests", &["engine", "shaders-glsl", "shaders-glsl/compiler", "passes", "tools/*", "tests/emulator"]),
    ("tests/emulator", &["engine"]),
    ("tests/embedding", &["engine", "shaders-glsl", "passes", "tools/*", "tests"]),
    ("tests/fuzz", &["engine", "passes", "tools/*"]),
    ("bench", &["engine", "shaders-glsl", "passes", "tools/*", "bench/null-driver"]),
    ("bench/null-driver", &[]),
];

/// Crates that only some folders may name, in a manifest or in code.
///
/// The embedding tests contain a host application with its own Vulkan device. The null driver is a Vulkan driver.
const RESERVED: &[(&str, &[&str])] = &[
    ("ash", &["engine", "tests/embedding", "bench/null-driver"]),
    ("ash-window", &["engine"]),
    ("gpu-allocator", &["engine"]),
    ("shaderc", &["shaders-glsl/compiler"]),
    ("spirq", &["shaders-glsl/compiler"]),
];

/// Places where `unsafe` is allowed.
///
/// The engine, the C interface, arrays of Python, the test host, the null driver, a counting allocator, and a function that the
/// compiler's counters call.
const UNSAFE: &[&str] = &[
    "engine",
    "tools/capi",
    "tools/python/src/arrays.rs",
    "tools/python/src/run.rs",
    "tools/python/src/scene.rs",
    "tests/embedding",
    "bench/null-driver",
    "tests/fuzz/src/count.rs",
    "tests/fuzz/src/hook.rs",
];

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().expect("tests lie in the workspace").to_owned()
}

fn metadata() -> Value {
    let output = Command::new(env!("CARGO"))
        .args(["metadata", "--no-deps", "--format-version", "1", "--offline"])
        .current_dir(root())
        .output()
        .expect("cargo runs");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).expect("cargo metadata is JSON")
}

/// Returns the folder of `ALLOWED` that is the longest prefix of a path.
fn folder(path: &str) -> Option<&'static str> {
    let within = |f: &str| path == f || path.strip_prefix(f).is_some_and(|rest| rest.starts_with('/'));
    ALLOWED.iter().map(|(f, _)| *f).filter(|f| within(f)).max_by_key(|f| f.len())
}

fn relative(root: &str, path: &str) -> String {
    path.strip_prefix(root).map_or(path, |p| p.trim_start_matches('/')).to_owned()
}

/// Lists forbidden dependencies of a workspace, one sentence each.
fn wrong_edges(metadata: &Value) -> Vec<String> {
    let root = metadata["workspace_root"].as_str().expect("a workspace");
    let mut wrong = Vec::new();
    for package in metadata["packages"].as_array().expect("packages") {
        let name = package["name"].as_str().unwrap_or_default();
        let manifest = relative(root, package["manifest_path"].as_str().unwrap_or_default());
        let home = manifest.trim_end_matches("/Cargo.toml");
        let Some(floor) = folder(home) else {
            wrong.push(format!("\"{name}\" lies in \"{home}\", which is on no floor"));
            continue;
        };
        let allowed = ALLOWED.iter().find(|(f, _)| *f == floor).map_or(&[][..], |(_, a)| a);
        // Build and test dependencies count as well.
        for dependency in package["dependencies"].as_array().expect("dependencies") {
            let needs = dependency["name"].as_str().unwrap_or_default();
            if let Some((_, owners)) = RESERVED.iter().find(|(n, owners)| *n == needs && !owners.contains(&floor)) {
                wrong.push(format!("\"{name}\" depends on \"{needs}\", which belongs to {owners:?}"));
            }
            let Some(path) = dependency["path"].as_str() else { continue };
            let path = relative(root, path);
            if !folder(&path)
                .is_some_and(|f| allowed.contains(&f) || allowed.contains(&"tools/*") && f.starts_with("tools/"))
            {
                wrong.push(format!("\"{name}\" in \"{home}\" depends on \"{needs}\" in \"{path}\""));
            }
        }
    }
    wrong
}

/// Returns the words of Rust source outside comments and literals.
fn words(source: &str) -> Vec<String> {
    let c: Vec<char> = source.chars().collect();
    let at = |i: usize| c.get(i).copied().unwrap_or('\0');
    let mut found = Vec::new();
    let mut i = 0;
    while i < c.len() {
        if at(i) == '/' && at(i + 1) == '/' {
            while i < c.len() && c[i] != '\n' {
                i += 1;
            }
        } else if at(i) == '/' && at(i + 1) == '*' {
            let mut depth = 0;
            loop {
                let step = match (at(i), at(i + 1)) {
                    ('/', '*') => 1,
                    ('*', '/') => -1,
                    _ => 0,
                };
                depth += step;
                i += if step == 0 { 1 } else { 2 };
                if depth == 0 || i >= c.len() {
                    break;
                }
            }
        } else if at(i) == '"' {
            i += 1;
            while i < c.len() && c[i] != '"' {
                i += if c[i] == '\\' { 2 } else { 1 };
            }
            i += 1;
        } else if at(i) == '\'' && (at(i + 1) == '\\' || at(i + 2) == '\'') {
            // A character literal. A lifetime has no closing quote that close.
            i += if at(i + 1) == '\\' { 3 } else { 2 };
            while i < c.len() && c[i] != '\'' {
                i += 1;
            }
            i += 1;
        } else if at(i).is_alphabetic() || at(i) == '_' {
            let start = i;
            while at(i).is_alphanumeric() || at(i) == '_' {
                i += 1;
            }
            let word: String = c[start..i].iter().collect();
            let hashes = (i..).take_while(|&j| at(j) == '#').count();
            if matches!(word.as_str(), "r" | "br" | "cr") && at(i + hashes) == '"' {
                // A raw string ends at a quote with the same number of hashes.
                i += hashes + 1;
                while i < c.len() && !(c[i] == '"' && (1..=hashes).all(|k| at(i + k) == '#')) {
                    i += 1;
                }
                i += 1 + hashes;
            } else {
                found.push(word);
            }
        } else {
            i += 1;
        }
    }
    found
}

/// Lists words that a source file may not use at its path.
fn wrong_words(path: &str, source: &str) -> Vec<String> {
    let inside = |f: &str| Path::new(path).starts_with(f);
    let mut wrong = Vec::new();
    for word in words(source) {
        if word == "unsafe" && !UNSAFE.iter().any(|f| inside(f)) {
            wrong.push(format!("{path} uses unsafe"));
        }
        if let Some((name, owners)) = RESERVED.iter().find(|(n, _)| n.replace('-', "_") == word)
            && !owners.iter().any(|owner| inside(owner))
        {
            wrong.push(format!("{path} names {name}, which belongs to {owners:?}"));
        }
    }
    wrong.dedup();
    wrong
}

/// Collects every Rust file of the workspace's crates, without build products.
fn sources(folder: &Path, into: &mut Vec<PathBuf>) {
    for entry in std::fs::read_dir(folder).expect("a folder") {
        let path = entry.expect("an entry").path();
        if path.is_dir() {
            if !path.ends_with("target") {
                sources(&path, into);
            }
        } else if path.extension().is_some_and(|e| e == "rs") {
            into.push(path);
        }
    }
}

#[test]
fn crates_depend_only_downwards() {
    let wrong = wrong_edges(&metadata());
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn unsafe_and_vulkan_stay_in_the_engine() {
    let root = root();
    let mut files = Vec::new();
    for folder in ["engine", "shaders-glsl", "passes", "tools", "tests", "bench"] {
        sources(&root.join(folder), &mut files);
    }
    assert!(files.len() > 100, "only {} source files were found", files.len());
    let mut wrong = Vec::new();
    let mut in_engine = 0;
    for file in &files {
        let source = std::fs::read_to_string(file).expect("readable source");
        let path = file.strip_prefix(&root).expect("below the root").to_string_lossy().replace('\\', "/");
        in_engine += usize::from(path.starts_with("engine/") && words(&source).iter().any(|w| w == "unsafe"));
        wrong.extend(wrong_words(&path, &source));
    }
    assert!(in_engine > 0, "the engine has no unsafe code, so nothing was looked at");
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

/// Returns the forbidden dependencies after package `name` gains a dependency.
fn planted(name: &str, dependency: Value) -> Vec<String> {
    let mut metadata = metadata();
    let packages = metadata["packages"].as_array_mut().expect("packages");
    let package = packages.iter_mut().find(|p| p["name"] == name).expect("the package exists");
    package["dependencies"].as_array_mut().expect("dependencies").push(dependency);
    wrong_edges(&metadata)
}

#[test]
fn planted_edges_are_caught() {
    let root = metadata()["workspace_root"].as_str().expect("a root").to_owned();
    let local = |name: &str, path: &str| json!({ "name": name, "path": format!("{root}/{path}"), "kind": "dev" });
    for (from, to, path) in [
        ("sgs-engine", "sgs-passes", "passes"),
        ("sgs-engine", "sgs-shaders", "shaders-glsl"),
        ("sgs-passes", "sgs-scene", "tools/scene"),
        ("sgs-passes", "sgs-shader-compiler", "shaders-glsl/compiler"),
        ("sgs-shaders", "sgs-engine", "engine"),
        ("sgs-train", "sgs-shaders", "shaders-glsl"),
        ("sgs-train", "sgs-relight", "tools/relight"),
        ("sgs-run", "sgs-train", "tools/train"),
        ("sgs-scene", "sgs-config", "tools/config"),
        ("sgs", "sgs-tests", "tests"),
        ("sgs-tests", "sgs-bench", "bench"),
        ("sgs-scene", "elsewhere", "elsewhere"),
    ] {
        let wrong = planted(from, local(to, path));
        assert_eq!(wrong.len(), 1, "{from} -> {to}: {wrong:?}");
        assert!(wrong[0].contains(from) && wrong[0].contains(to), "{wrong:?}");
    }
    for (from, to) in [("sgs-passes", "ash"), ("sgs", "gpu-allocator"), ("sgs-shaders", "shaderc")] {
        let wrong = planted(from, json!({ "name": to, "path": null }));
        assert_eq!(wrong.len(), 1, "{from} -> {to}: {wrong:?}");
    }
    assert!(planted("sgs-train", local("sgs-scene", "tools/scene")).is_empty());
}

#[test]
fn crates_outside_the_layers_are_caught() {
    let mut metadata = metadata();
    let root = metadata["workspace_root"].as_str().expect("a root").to_owned();
    let stray =
        json!({ "name": "stray", "manifest_path": format!("{root}/enginelike/Cargo.toml"), "dependencies": [] });
    metadata["packages"].as_array_mut().expect("packages").push(stray);
    assert_eq!(wrong_edges(&metadata).len(), 1);
}

#[test]
fn planted_words_are_caught() {
    let path = "passes/src/kernel.rs";
    for code in [
        "fn f() { unsafe { g() } }",
        "let c = '\"'; unsafe fn g() {}",
        "let c = ['\\'', '\"', '\\\\', '\\u{41}']; unsafe fn g() {}",
        "/* a /* b */ c */ unsafe impl X for Y {}",
        "fn f<'a>(x: &'a str) { use ash::vk; }",
        "let s = r#\"a \" b\"#; gpu_allocator::vulkan::Allocator::new();",
        "let s = \"a\\\"\"; unsafe {}",
    ] {
        assert_eq!(wrong_words(path, code).len(), 1, "{code}");
        let engine = wrong_words("engine/src/lib.rs", code);
        assert!(engine.is_empty(), "{engine:?}");
    }
    for code in [
        "// unsafe lives elsewhere, as ash does\nfn f() {}",
        "/* unsafe /* ash */ unsafe */ fn f() {}",
        "let s = \"unsafe ash\"; let hash = 'a'; fn crash() {}",
        "let s = r#\"unsafe \" ash\"#;",
        "#![forbid(unsafe_op_in_unsafe_fn)]",
    ] {
        let wrong = wrong_words(path, code);
        assert!(wrong.is_empty(), "{code}: {wrong:?}");
    }
    assert_eq!(wrong_words("tools/enginelike.rs", "unsafe {}").len(), 1);
}
