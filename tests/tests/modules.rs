//! Dependencies between modules: the modules that a crate's root names form no cycle.
//!
//! A module depends on another if its code outside tests names it by a path from `crate`. Names that the root
//! re-exports count as well. Each check has a control with a planted cycle.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use syn::visit::{self, Visit};
use syn::{Attribute, Item, UseTree};

/// Crates that are checked for cycles.
const CRATES: &[&str] = &[
    "bench",
    "engine",
    "passes",
    "tests/emulator",
    "tools/api",
    "tools/batch",
    "tools/capture",
    "tools/capi",
    "tools/config",
    "tools/evaluate",
    "tools/provider",
    "tools/python",
    "tools/relight",
    "tools/report",
    "tools/run",
    "tools/scene",
    "tools/sgs",
    "tools/study",
    "tools/synth",
    "tools/train",
    "tools/transport",
    "tools/view",
];

/// Source file: path below `src` and text.
type Source = (PathBuf, String);

/// Modules that a crate's root declares, and the module of each exported name.
#[derive(Default)]
struct Root {
    modules: BTreeSet<String>,
    exports: BTreeMap<String, String>,
}

impl Root {
    fn of(text: &str) -> Root {
        let file = syn::parse_file(text).expect("the root is Rust");
        let mut root = Root::default();
        for item in &file.items {
            if let Item::Mod(module) = item {
                root.modules.insert(module.ident.to_string());
            }
        }
        for item in &file.items {
            if let Item::Use(item) = item {
                for (path, name) in paths(&item.tree) {
                    let path: Vec<_> = path.into_iter().skip_while(|s| s == "self" || s == "crate").collect();
                    if let [module, _, ..] = &path[..]
                        && root.modules.contains(module)
                    {
                        root.exports.insert(name, module.clone());
                    }
                }
            }
        }
        root
    }

    /// Returns the module that a name after `crate::` belongs to.
    fn module(&self, name: &str) -> Option<&str> {
        let exported = || self.exports.get(name).map(String::as_str);
        self.modules.get(name).map(String::as_str).or_else(exported)
    }
}

/// Returns the paths of a use tree, each with its imported name.
fn paths(tree: &UseTree) -> Vec<(Vec<String>, String)> {
    let one = |segment: String, name: String| vec![(vec![segment], name)];
    match tree {
        UseTree::Path(path) => {
            let mut all = paths(&path.tree);
            all.iter_mut().for_each(|(segments, _)| segments.insert(0, path.ident.to_string()));
            all
        }
        UseTree::Name(name) => one(name.ident.to_string(), name.ident.to_string()),
        UseTree::Rename(rename) => one(rename.ident.to_string(), rename.rename.to_string()),
        UseTree::Glob(_) => one("*".to_owned(), "*".to_owned()),
        UseTree::Group(group) => group.items.iter().flat_map(paths).collect(),
    }
}

fn is_test(attributes: &[Attribute]) -> bool {
    attributes.iter().any(|a| a.path().is_ident("cfg") && a.parse_args::<syn::Ident>().is_ok_and(|i| i == "test"))
}

/// Visitor that collects the names after `crate::` outside tests.
#[derive(Default)]
struct Names(BTreeSet<String>);

impl<'ast> Visit<'ast> for Names {
    fn visit_item_mod(&mut self, module: &'ast syn::ItemMod) {
        if !is_test(&module.attrs) {
            visit::visit_item_mod(self, module);
        }
    }

    fn visit_item_use(&mut self, item: &'ast syn::ItemUse) {
        if is_test(&item.attrs) {
            return;
        }
        for (path, _) in paths(&item.tree) {
            if let [first, name, ..] = &path[..]
                && first == "crate"
            {
                self.0.insert(name.clone());
            }
        }
    }

    fn visit_path(&mut self, path: &'ast syn::Path) {
        let mut segments = path.segments.iter();
        if segments.next().is_some_and(|s| s.ident == "crate")
            && let Some(name) = segments.next()
        {
            self.0.insert(name.ident.to_string());
        }
        visit::visit_path(self, path);
    }
}

/// Returns the modules that each module depends on.
fn edges(root: &Root, sources: &[Source]) -> BTreeMap<String, BTreeSet<String>> {
    let mut edges = BTreeMap::<String, BTreeSet<String>>::new();
    for (path, text) in sources {
        let first = path.components().next().map(|c| c.as_os_str().to_string_lossy().into_owned()).unwrap_or_default();
        let from = first.trim_end_matches(".rs").to_owned();
        let mut names = Names::default();
        names.visit_file(&syn::parse_file(text).unwrap_or_else(|e| panic!("{}: {e}", path.display())));
        let found = names.0.iter().filter_map(|name| root.module(name)).filter(|to| *to != from);
        edges.entry(from.clone()).or_default().extend(found.map(str::to_owned));
    }
    edges
}

/// Returns a cycle of modules, if any.
fn cycle(edges: &BTreeMap<String, BTreeSet<String>>) -> Option<Vec<String>> {
    fn walk<'a>(
        at: &'a str,
        edges: &'a BTreeMap<String, BTreeSet<String>>,
        way: &mut Vec<&'a str>,
        done: &mut BTreeSet<&'a str>,
    ) -> Option<Vec<String>> {
        if let Some(begin) = way.iter().position(|m| *m == at) {
            return Some(way[begin..].iter().map(|m| (*m).to_owned()).collect());
        }
        if !done.insert(at) {
            return None;
        }
        way.push(at);
        let found = edges.get(at).into_iter().flatten().find_map(|to| walk(to, edges, way, done));
        way.pop();
        found
    }
    let mut done = BTreeSet::new();
    edges.keys().find_map(|from| walk(from, edges, &mut Vec::new(), &mut done))
}

fn sources(src: &Path, root: &Path, folder: &Path, into: &mut Vec<Source>) {
    for entry in std::fs::read_dir(folder).expect("a folder") {
        let path = entry.expect("an entry").path();
        // Test modules may depend on any module.
        if path.file_stem().is_some_and(|stem| stem == "tests") {
            continue;
        }
        if path.is_dir() {
            sources(src, root, &path, into);
        } else if path.extension().is_some_and(|e| e == "rs") && path != *root {
            let text = std::fs::read_to_string(&path).expect("readable source");
            into.push((path.strip_prefix(src).expect("below src").to_owned(), text));
        }
    }
}

#[test]
fn modules_form_no_cycle() {
    for name in CRATES {
        let src = Path::new(env!("CARGO_MANIFEST_DIR")).parent().expect("the workspace").join(name).join("src");
        let file = ["lib.rs", "main.rs"].map(|f| src.join(f)).into_iter().find(|f| f.is_file()).expect("a root");
        let root = Root::of(&std::fs::read_to_string(&file).expect("readable source"));
        let mut files = Vec::new();
        sources(&src, &file, &src, &mut files);
        let edges = edges(&root, &files);
        assert!(edges.values().any(|to| !to.is_empty()), "{name}: no module depends on another one, which cannot be");
        let cycle = cycle(&edges);
        assert!(cycle.is_none(), "{name}: the modules {} depend on each other", cycle.unwrap_or_default().join(" -> "));
    }
}

#[test]
fn planted_cycles_are_detected() {
    let root = Root::of("mod a;\npub mod b;\nmod c;\npub use c::Thing;\npub use b::{Other as Named};");
    let of = |a: &str, b: &str, c: &str| {
        let files = [("a/deep.rs", a), ("b.rs", b), ("c.rs", c)].map(|(p, s)| (PathBuf::from(p), s.to_owned()));
        cycle(&edges(&root, &files))
    };
    assert_eq!(of("use crate::b::f;", "use crate::Thing;", "fn f() {}"), None);
    let all = Some(vec!["a".to_owned(), "b".to_owned(), "c".to_owned()]);
    assert_eq!(of("use crate::b::f;", "use crate::Thing;", "fn f() { crate::a::g() }"), all);
    assert_eq!(of("fn f(_: crate::Named) {}", "use crate::{Thing, error};", "use crate::a as other;"), all);
    // Test modules may depend on any module.
    assert_eq!(of("use crate::b::f;", "fn f() {}", "#[cfg(test)]\nmod tests { use crate::a::f; }"), None);
}
